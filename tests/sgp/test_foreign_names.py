"""Files in the user's folder that have the names of modules are never executed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sgp
from rig.processes import module_command
from sgp.cli.entry import PACKAGES
from tests.cases import cases

pytest_plugins = ["pytester"]

ROOT = Path(sgp.__file__).parents[1]
# Our packages, libraries that we use, and modules of Python that a new process imports.
NAMES = (
    *PACKAGES,
    *(
        "numpy",
        "numba",
        "scipy",
        "cv2",
        "serial",
        "genicam",
        "harvesters",
        "pydantic",
        "matplotlib",
    ),
    *("json", "tempfile", "runpy", "select", "tty", "subprocess", "multiprocessing", "argparse"),
    *("sitecustomize", "usercustomize", "gentl", "board", "_entry"),
)
DECOY = """
import os
with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "EXECUTED"), "a") as file:
    file.write(__name__ + "\\n")
raise SystemExit(77)
"""
RIG = "--rig", "small.toml"


@pytest.fixture
def decoys(tmp_path: Path) -> Path:
    """A folder with a decoy for every name that a process may import."""
    folder = tmp_path / "work"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text(DECOY)
    (folder / "small.toml").write_text(
        'name = "small"\ndriver = "simulated"\nleds = 4\n'
        "[options]\nwidth = 64\nheight = 48\nrealtime = false\n"
    )
    return folder


def executed(folder: Path) -> list[str]:
    marker = folder / "EXECUTED"
    return marker.read_text().split() if marker.exists() else []


def run(folder: Path, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=250,
    )


def script(name: str) -> str:
    found = shutil.which(name, path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip(f"the command {name} is not installed next to {sys.executable}")
    return found


@pytest.mark.slow
@cases(
    "words",
    {
        "help": ["sgp", "--help"],
        "rig off": ["sgp", "rig", "off", *RIG],
        "rig check": ["sgp", "rig", "check", *RIG],
        "rig list": ["sgp", "rig", "list"],
        "capture run": ["capture", "run", "session", *RIG, "--skip-check"],
        "simulate, through the GenTL producer": [
            "sgp",
            "simulate",
            "coin",
            "--led-count",
            "3",
            "--size",
            "32x32",
            "--out",
            "coin",
        ],
        "demo": pytest.param(["sgp", "demo"], marks=pytest.mark.slow),
    },
)
def test_no_command_executes_files_in_the_working_directory(decoys, words):
    done = run(decoys, script(words[0]), *words[1:])
    assert executed(decoys) == []
    assert done.returncode in ((0, 3) if words[-1] == "list" else (0,)), done.stderr


@pytest.mark.slow
def test_the_build_of_the_virtual_camera_executes_no_decoy(decoys, tmp_path):
    if shutil.which("cc") is None:
        pytest.skip("the virtual camera needs a C compiler")
    done = run(decoys, *module_command("simulator.gentl"), XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert executed(decoys) == []
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "cache")


def test_python_m_sgp_works_from_anywhere(decoys):
    # `python -m` would run this file, as requested.
    (decoys / "sgp.py").unlink()
    done = run(decoys, sys.executable, "-m", "sgp", "rig", "off", *RIG)
    assert (done.returncode, executed(decoys)) == (0, []), done.stderr


def test_a_checkout_that_is_not_installed_starts_its_own_processes(tmp_path):
    """The child imports the packages of its parent, with and without the working directory."""
    checkout = copied(tmp_path / "checkout")
    (checkout / "simulator" / "board.py").write_text("raise SystemExit('the copy of the board')")
    program = "import simulator; simulator.led_board.VirtualBoard()"
    for folder, path in ((checkout, ""), (tmp_path, str(checkout))):
        done = run(folder, sys.executable, "-c", program, PYTHONPATH=path)
        assert "the virtual board did not start: the copy of the board" in done.stderr


def copied(folder: Path) -> Path:
    for name in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    return folder


@pytest.mark.parametrize("name", [name for name in PACKAGES if name != "sgp"])
@pytest.mark.parametrize("kind", ["module", "package"])
def test_a_package_that_hides_ours_is_reported_and_not_run(tmp_path, name, kind):
    other = tmp_path / (f"{name}.py" if kind == "module" else f"{name}/__init__.py")
    other.parent.mkdir(exist_ok=True)
    other.write_text(DECOY)
    done = run(tmp_path, script("sgp"), "--version", PYTHONPATH=str(tmp_path))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: the package {name} of sgp is hidden by another one, {tmp_path}")
    assert "pipx" in line
    assert executed(other.parent) == []


def test_a_missing_package_is_reported(tmp_path):
    installed = copied(tmp_path)
    shutil.rmtree(installed / "processing")
    program = f"import sys; sys.path.remove({str(ROOT)!r}); sys.path.insert(0, {str(installed)!r})"
    done = run(tmp_path, sys.executable, "-P", "-c", f"{program}; import sgp; sgp.main()")
    assert done.returncode == 2
    assert "the package processing of sgp is missing" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_package_that_was_overwritten_is_reported(tmp_path):
    installed = copied(tmp_path)
    (installed / "rig" / "__init__.py").write_text('"""Another package."""\n')
    program = f"import sys; sys.path.insert(0, {str(installed)!r}); import sgp; sgp.main()"
    done = run(tmp_path, sys.executable, "-P", "-c", program, "rig", "list")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "the package rig in" in line
    assert "pipx" in line


def test_the_report_is_json_too(tmp_path):
    (tmp_path / "rig.py").write_text(DECOY)
    done = run(tmp_path, script("sgp"), "compare", "--json", PYTHONPATH=str(tmp_path))
    assert done.returncode == 2
    assert '"exit_code": 2' in done.stdout


@pytest.mark.slow
def test_the_pytest_plugin_reports_it(pytester):
    pytester.makepyfile(rig=DECOY, test_it="def test_it(simulated_rig): pass")
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*the package rig of sgp is hidden by another one*"])
    assert executed(pytester.path) == []
