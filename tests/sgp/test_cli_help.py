"""Help pages, and messages about wrong command lines."""

import re
import shlex
import subprocess
import sys

import pytest

from sgp.app import build, words_of_help
from tests.quick_sample import quick

EXAMPLE_WIDTH = 76


def _pages(app, words=()):
    yield words
    for name in app:
        if not name.startswith("-"):
            yield from _pages(app[name], (*words, name))


PAGES = [pytest.param(words, id=" ".join(("sgp", *words))) for words in _pages(build())]


@pytest.fixture
def page(sgp, monkeypatch):
    """Return a help page as printed on a terminal of a given width."""

    def show(*words, width=80):
        monkeypatch.setenv("COLUMNS", str(width))
        answer = sgp(*words, "--help").ok()
        return answer.out

    return show


def _examples(text):
    block = text.partition("For example:\n\n")[2].partition("\n\n")[0]
    return [line.rstrip() for line in block.splitlines()]


@pytest.mark.parametrize("words", quick(PAGES, every=3))
def test_every_page_has_examples_that_fit_and_are_understood(page, words):
    lines = _examples(page(*words))
    assert lines
    for line in lines:
        assert len(line) <= EXAMPLE_WIDTH
    for command in "\n".join(lines).replace("\\\n", "").splitlines():
        tokens = shlex.split(command)
        tokens = tokens[1:] if tokens[0] == "sgp" else tokens
        assert tuple(tokens[: len(words)]) == words
        build(tokens).parse_args(tokens, print_error=False, exit_on_error=False)


def _entries(text):
    """Return the texts of commands and parameters, each in one line."""
    panels = re.sub(r"(?m)^\w+:\n", "Parameters:\n", text[text.index("Parameters:\n") :])
    if "Commands:\n" in text:
        panels = text[text.index("Commands:\n") :]
    entries = re.split(r"\n  (?=\S)", panels.replace("Parameters:\n", "\n").rstrip())
    return [" ".join(entry.split()) for entry in entries[1:]]


@pytest.mark.parametrize("words", PAGES)
@pytest.mark.parametrize("width", quick([60, 80, 400], every=3))
def test_texts_are_wrapped_and_empty_defaults_are_hidden(page, words, width):
    text = page(*words, width=width)
    _, *lines = text.replace(" \n", "\n").splitlines()
    allowed = min(width, 100)
    examples = set(_examples(text))
    assert [line for line in lines if len(line) > allowed and line not in examples] == []
    flowing = " ".join(text.split())
    assert re.search(r'\[default: (\(\)|""|False)\]|Default|default \d|\[ARGS', flowing) is None
    entries = _entries(text)
    assert len(entries) >= 2
    assert [entry for entry in entries if not entry.endswith((".", "]"))] == []


def test_optional_arguments_have_names(page):
    assert page("capture", "plan").startswith("Usage: sgp capture plan [OPTIONS] [PLAN]\n")
    usage = page("detail", "properties").splitlines()[0]
    assert usage.endswith("NORMALS [TARGETS...]")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        pytest.param(["nonsense"], r"sgp has no command nonsense: .* detail \(see `sgp --help`\)"),
        pytest.param(["nromals"], r"nromals, did you mean normals\? \(see `sgp --help`\)"),
        pytest.param(
            ["rig", "x"], r"sgp rig has no command x: .*selftest \(see `sgp rig --help`\)"
        ),
        pytest.param(["help", "nromals"], r"nromals, did you mean normals\? \(see `sgp --help`\)"),
        pytest.param(["help", "rig", "chek"], r"chek, did you mean check\? \(see `sgp rig --help`"),
        pytest.param(
            ["nromals", "--help"], r"nromals, did you mean normals\? \(see `sgp --help`\)"
        ),
        pytest.param(["--jsn", "demo"], r"sgp has no option --jsn \(see `sgp --help`\)"),
        pytest.param(["normals"], r"SOURCE is missing \(see `sgp normals --help`\)"),
        pytest.param(["capture", "run"], r"OUT is missing \(see `sgp capture run --help`\)"),
        pytest.param(["normals", "x"], r"--out is missing \(see `sgp normals --help`\)"),
        pytest.param(["normals", "x", "--out"], r"--out requires a value: .* normals --help`\)"),
        pytest.param(
            ["calibrate", "spheres", "x", "--out", "l.json", "--sphere", "-3,48,20"],
            r"--sphere requires a value: write one that begins with a minus as --sphere=VALUE \(",
            id="a value with a minus",
        ),
        pytest.param(
            ["detail", "combine", "x"], r"DETAIL is missing \(see `sgp detail combine --h"
        ),
    ],
)
def test_a_wrong_command_line_gets_one_line(sgp, words, message):
    assert re.search(message, sgp(*words_of_help(words)).error_line(2))


def test_a_mistyped_command_imports_no_library():
    code = (
        "import sys; from sgp.app import build, words_of_help, run; "
        "code = run(build(), ['nonsense']); sys.exit(code if 'numpy' not in sys.modules else 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 2


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_a_reader_that_has_exited_is_not_an_error(option):
    code = "import sgp; sgp.main()"
    program = subprocess.Popen(
        [sys.executable, "-c", code, option], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    program.stdout.close()
    assert program.stderr.read() == b""
    assert program.wait() == 0
    program.stderr.close()


def test_notes_come_before_the_summary(sgp, recording, monkeypatch):
    monkeypatch.setattr(sys, "stderr", sys.stdout)
    lights = recording.parent / "lights.json"
    output = sgp("normals", recording, "--lights", lights, "--out", recording.parent / "o").out
    lines = output.splitlines()
    assert any(line.startswith("note: ") for line in lines[:-1])
    assert "pixels solved" in lines[-2]
    assert lines[-1].startswith("good: ")


def test_options_of_long_pages_are_in_groups(page):
    text = page("run")
    titles = re.findall(r"(?m)^(\w+):$", text)
    assert titles == ["Parameters", "Lights", "Images", "Method", "Surface", "Mesh", "Output"]
    # Each option that is not of the output is named in its group.
    output = text[text.index("Output:\n") :]
    assert re.findall(r"(?m)^  (-\S+|[A-Z]+)", output) == [
        "--out", "--memory", "--green-out", "--strict", "--force", "--json", "--debug",
    ]  # fmt: skip
    assert text.index("--lights") < text.index("--rig")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["help"], ["--help"]),
        (["help", "rig", "light"], ["rig", "light", "--help"]),
        (["run", "help"], ["run", "help"]),
        ([], []),
    ],
)
def test_help_is_a_word_too(given, words):
    assert words_of_help(given) == words


@pytest.mark.parametrize("led", ["4", "04", "L4", "l04"])
def test_an_led_may_be_named_as_in_files(led):
    _, bound, _ = build(["rig", "light"]).parse_args(["rig", "light", led])
    assert bound.arguments["led"] == 4
