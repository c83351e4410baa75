"""Output on a terminal of 80 columns and 24 lines: no line is longer, and no word is broken."""

from __future__ import annotations

import io
import os
import re
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from processing import NormalMap, write_normals
from sgp.cli.terminal import fitted
from tests.quick_sample import quick
from tests.sgp.conftest import ball

pty = pytest.importorskip("pty")
fcntl = pytest.importorskip("fcntl")
termios = pytest.importorskip("termios")

COLUMNS, ROWS = 80, 24
PROGRAMS = {
    "sgp": "from sgp.app import main; main()",
    "capture": "from sgp import capture; capture()",
}
# Names of files and folders may be longer than a line.
LONG = re.compile(r"\S*[/\\]\S*")


class Terminal:
    """A stream that is a terminal of some width."""

    def __init__(self, columns: int) -> None:
        self.columns = columns

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return 1


@pytest.fixture
def terminal(monkeypatch):
    def of(columns: int) -> Terminal:
        size = os.terminal_size((columns, ROWS))
        monkeypatch.setattr(os, "get_terminal_size", lambda _: size)
        return Terminal(columns)

    return of


def test_lines_are_broken_between_words_below_the_last_column(terminal) -> None:
    line = f"ok        disk        {'a word ' * 12}end"
    lines = fitted(line, terminal(COLUMNS)).split("\n")
    assert lines[0].startswith("ok        disk        a word")
    assert lines[1].startswith(" " * 22 + "word")
    assert [len(each) <= COLUMNS for each in lines] == [True] * len(lines)
    assert fitted("short", terminal(COLUMNS)) == "short"
    assert fitted(line, io.StringIO()) == line


def test_a_command_in_backticks_is_not_broken(terminal) -> None:
    """It is pasted into a shell."""
    command = f"`capture resume {'x' * 20}/owl --rig bench.toml --retake-damaged`"
    lines = fitted(f"error: something is missing; {command} takes the frames", terminal(COLUMNS))
    assert command in lines
    assert max(map(len, lines.split("\n"))) <= COLUMNS


@given(st.lists(st.text("ab`: -", min_size=1, max_size=30), max_size=20).map(" ".join))
def test_no_word_is_lost(text: str) -> None:
    stream = Terminal(COLUMNS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "get_terminal_size", lambda _: os.terminal_size((COLUMNS, ROWS)))
        shown = fitted(text, stream)
    assert shown.split() == text.split()


def on_terminal(program: str, *words: object, folder: Path) -> list[str]:
    """Run a command on a terminal of 80 x 24 and return the lines that remain on it."""
    child, terminal = pty.fork()
    if child == 0:  # the program
        os.chdir(folder)
        os.environ["TERM"] = "xterm"
        os.environ.pop("COLUMNS", None)
        sys.stdin = None
        size = ROWS.to_bytes(2, sys.byteorder) + COLUMNS.to_bytes(2, sys.byteorder) + bytes(4)
        fcntl.ioctl(1, termios.TIOCSWINSZ, size)
        code = [sys.executable, "-c", PROGRAMS[program], *map(str, words)]
        os.execv(sys.executable, code)
    text = b""
    while True:
        try:
            part = os.read(terminal, 65536)
        except OSError:
            break
        if not part:
            break
        text += part
    os.close(terminal)
    os.waitpid(child, 0)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.decode())
    lines = [line.split("\r")[-1].rstrip() for line in plain.replace("\r\n", "\n").split("\n")]
    return [line for line in lines if line]


def check(lines: list[str]) -> None:
    assert lines
    for line in lines:
        assert len(LONG.sub("", line)) <= COLUMNS, line


COMMANDS = [
    pytest.param("capture", ["info", "{recording}"], id="info"),
    pytest.param("capture", ["plan", "--rig", "simulated"], id="plan"),
    *(
        pytest.param(program, words, id="-".join(words[:2]).strip("{}"), marks=pytest.mark.slow)
        for program, words in (
            ("capture", ["info", "{recording}", "--frames"]),
            ("capture", ["verify", "{recording}"]),
            ("capture", ["check", "new", "--rig", "simulated"]),
            ("capture", ["run", "new", "--rig", "simulated", "--meter", "one"]),
            ("capture", ["export", "{recording}", "--format", "exr", "--out", "exported"]),
            ("capture", ["resume", "{recording}", "--rig", "simulated"]),
            ("capture", ["import", "{recording}", "--out", "imported"]),
            ("sgp", ["simulate", "list"]),
            ("sgp", ["simulate", "coin", "--size", "64x52", "--out", "coin"]),
            ("sgp", ["rig", "list"]),
            ("sgp", ["rig", "check", "--rig", "simulated"]),
            ("sgp", ["rig", "selftest", "--rig", "simulated"]),
            ("sgp", ["rig", "snap", "--rig", "simulated", "--out", "snap.tif"]),
            ("sgp", ["doctor"]),
            ("sgp", ["calibrate", "spheres", "{recording}", "--out", "lights.json"]),
            ("sgp", ["normals", "{recording}", "--out", "normals"]),
        )
    ),
]


@pytest.mark.parametrize(("program", "words"), quick(COMMANDS, every=2))
def test_commands_fit_a_terminal(program: str, words: list[str], recording, tmp_path) -> None:
    given_words = [word.format(recording=recording) for word in words]
    lines = on_terminal(program, *given_words, folder=tmp_path)
    check(lines)
    # A list grows with what it lists: frames here, the ports and drivers of the computer there.
    if "--frames" not in words and words != ["doctor"]:
        assert len(lines) <= ROWS, lines


SPHERES = ["simulate", "spheres", "--size", "320x256", "--led-count", "6", "--out", "spheres"]
CARD = ["simulate", "white-plane", "--size", "160x128", "--led-count", "6", "--out", "card"]
TRUTH = "{}/derived/truth/{}.json"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "words"),
    [
        ([], ["inspect", "ball", "--lights", "lights.json"]),
        ([], ["normals", "ball", "--lights", "lights.json", "--out", "out"]),
        ([], ["run", "ball", "--lights", "lights.json", "--out", "out", "--glb"]),
        ([], ["surface", "map", "--out", "out", "--pixel-mm", "0.1", "--stl"]),
        ([], ["detail", "separate", "map", "--out", "out"]),
        ([], ["detail", "transfer", "map", "map", "--out", "out", "--profile"]),
        ([], ["detail", "transfer", "map", "map", "--scale", "0.9", "--out", "out"]),
        ([], ["detail", "properties", "map", "map", "--out", "out"]),
        ([], ["compare", "map", "map"]),
        ([], ["project", "mesh.obj", "--size", "40x30", "--out", "out"]),
        (SPHERES, ["calibrate", "spheres", "spheres", "--out", "found.json"]),
        (
            CARD,
            ["calibrate", "intensities", "card", "--lights", TRUTH.format("card", "lights"),
             "--camera", TRUTH.format("card", "camera"), "--out", "found.json"],
        ),
    ],
    ids=lambda words: "-".join(words[:2]),
)  # fmt: skip
def test_processing_fits_a_terminal(before, words, recording, tmp_path) -> None:
    write_normals(tmp_path / "map", NormalMap.from_vectors(*ball()))
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    if before:
        check(on_terminal("sgp", *before, folder=tmp_path))
    lines = on_terminal("sgp", *words, folder=tmp_path)
    check(lines)
    # A bar is erased when its stage ends.
    lines = [line for line in lines if "━" not in line]
    assert 0 < len(lines) <= ROWS, lines
    assert not any(line.startswith("error:") for line in lines), lines
