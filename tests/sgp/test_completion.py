"""Scripts that complete commands and options in shells."""

import io
import shutil
import subprocess
from contextlib import redirect_stdout

import pytest

from sgp.app import build, run
from tests.quick_sample import quick

SHELLS = ("bash", "zsh", "fish")


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    """Write the scripts of both programs for all shells."""
    folder = tmp_path_factory.mktemp("completion")
    for program in ("sgp", "capture"):
        for shell in SHELLS:
            words = ["completion", shell, "--program", program]
            with redirect_stdout(io.StringIO()) as script:
                assert run(build(words), words) == 0
            (folder / f"{program}.{shell}").write_text(script.getvalue())
    return folder


def completed(script, *words):
    """Return what bash offers for the last word."""
    program = words[0]
    lines = [
        f"source '{script}'",
        f"COMP_WORDS=({' '.join(repr(word) for word in words)})",
        f"COMP_CWORD={len(words) - 1}",
        f"_{program}",
        'printf "%s\\n" "${COMPREPLY[@]}"',
    ]
    done = subprocess.run(
        ["bash", "--norc", "-c", "\n".join(lines)], capture_output=True, text=True
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="requires bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    quick(
        [
            pytest.param(("sgp", "do"), ["doctor"], id="command"),
            pytest.param(("sgp", "rig", "s"), ["snap", "selftest"], id="command of a group"),
            pytest.param(("sgp", "rig", "snap", "--ou"), ["--out"], id="option"),
            pytest.param(("sgp", "detail", "transfer", "--js"), ["--json"], id="common option"),
            pytest.param(("sgp", "normals", "x", "--method", "c"), ["cauchy"], id="choice"),
            pytest.param(("sgp", "completion", "z"), ["zsh"], id="argument"),
            pytest.param(("capture", "res"), ["resume"], id="capture"),
            pytest.param(("capture", "run", "x", "--meter", "e"), ["each"], id="option of capture"),
        ],
        every=4,
    ),
)
def test_bash_completes(scripts, words, expected):
    assert sorted(completed(scripts / f"{words[0]}.bash", *words)) == sorted(expected)


@pytest.mark.parametrize("program", ["sgp", "capture"])
@pytest.mark.parametrize("shell", SHELLS)
def test_the_shell_accepts_its_script(scripts, shell, program):
    if shutil.which(shell) is None:
        pytest.skip(f"requires {shell}")
    done = subprocess.run([shell, "-n", scripts / f"{program}.{shell}"], capture_output=True)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_know_the_whole_tree(scripts, shell):
    text = (scripts / f"sgp.{shell}").read_text()
    for word in ("selftest", "intensities", "retake-damaged", "led-count", "doctor", "json"):
        assert word in text
    offered = {"bash": '"--width"', "zsh": "'*--width[", "fish": "-l width"}
    assert offered[shell] not in text, "an earlier spelling"


def test_an_unknown_shell(sgp):
    assert 'Choose from: "bash", "zsh", "fish"' in sgp("completion", "tcsh").error_line(2)
