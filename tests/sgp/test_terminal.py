"""Names and contents of files and folders cannot control the terminal that shows them."""

from __future__ import annotations

import json
import re

import pytest

from acquisition import CapturePlan, Labels
from acquisition.session import Manifest, SessionWriter
from sgp.cli.terminal import printable, printable_json, printable_lines

STEERING = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp.exe\u2066\r\nerror: all is well"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain text, Größe 3 µm 木", "plain text, Größe 3 µm 木"),
        ("\x1b[31mred", r"\x1b[31mred"),
        ("\x9b31m", r"\x9b31m"),
        ("a\tb\r\nc", r"a\tb\r\nc"),
        ("\u202eexe.png", r"\u202eexe.png"),
        ("a\u2028b", r"a\u2028b"),
        ("caf\udce9", r"caf\udce9"),
        ("\x00\x7f", r"\x00\x7f"),
    ],
)
def test_one_line(text, shown):
    assert printable(text) == shown
    assert not STEERING.search(printable(text))


def test_several_lines():
    assert printable_lines("a\x1b\nb\x07\n") == "a\\x1b\nb\\x07\n"


def test_json_stays_json():
    text = json.dumps({"a": EVIL + "\udce9", EVIL: 1}, ensure_ascii=False)
    shown = printable_json(text)
    assert json.loads(shown) == json.loads(text)
    assert not STEERING.search(shown)
    shown.encode()


@pytest.fixture
def session(tmp_path):
    folder = tmp_path / "session"
    manifest = Manifest.begin(
        folder,
        plan=CapturePlan(repeat=False, leds=(0,), exposures_us=(5000.0,), dark=False),
        camera={"width": 4, "height": 3, "bit_depth": 12, "model": EVIL},
        labels=Labels(operator=EVIL, object_name=f"vase {EVIL}", notes=EVIL),
    )
    with SessionWriter.create(folder, manifest):
        pass
    return folder


def test_a_session_is_shown_without_its_commands(sgp, session):
    answer = sgp("capture", "info", session)
    assert "owned" in answer.out + answer.err
    assert not STEERING.search(answer.out + answer.err)
    assert not any(line.startswith("error") for line in answer.err.splitlines())


def test_json_of_a_session(sgp, session):
    answer = sgp("capture", "info", session, "--json")
    assert not STEERING.search(answer.out + answer.err)
    report = json.loads(answer.out)
    assert report["ok"]


@pytest.mark.parametrize("name", ["\x1b[2Jnowhere", "\u202egnp", "\x9b31m.toml", "caf\udce9"])
@pytest.mark.parametrize("command", ["normals", "rig check --rig", "capture verify", "compare a"])
def test_errors_name_files_without_their_commands(sgp, tmp_path, monkeypatch, command, name):
    monkeypatch.chdir(tmp_path)
    more = ["--out", "o"] if command == "normals" else []
    assert not STEERING.search(sgp(*command.split(), name, *more).error_line(2))


def test_the_stack_trace_of_debug_too(sgp, tmp_path):
    answer = sgp("normals", tmp_path / "\x1b[2J", "--out", tmp_path / "o", "--debug")
    assert "Traceback" in answer.err
    assert not STEERING.search(answer.err)


def test_a_file_that_names_itself_in_an_error(sgp, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(f'"{chr(0x202E)}leds\\u001b[2J" = 3\n', encoding="utf-8")
    assert not STEERING.search(sgp("rig", "check", "--rig", path).error_line(3))


def test_names_of_emoji_stay_text(sgp, tmp_path, monkeypatch):
    """The console would replace the name of an emoji by the emoji."""
    monkeypatch.chdir(tmp_path)
    assert ":smile:" in sgp("compare", "a:smile:", "b").err
