"""The verdict that ends a command, on the terminal, in JSON and in records."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import pytest

from acquisition import DataError, Session
from processing.checks import Cause, Verdict
from rig import MAX_PIXELS
from sgp.report import make_report, read_folder
from sgp.results import (
    Result,
    dumps,
    good_result,
    read_record,
    recorded_verdict,
    verdict_record,
    write_record,
)
from sgp.results.verdict import verdict_line
from sgp.sessions import judge_frames
from sgp.stages import with_options
from tests.cases import cases
from tests.sgp.small_rig import capture

pty = pytest.importorskip("pty")
termios = pytest.importorskip("termios")

LIGHT = Cause(
    "ambient-light", "room light reaches 15 % of the albedo", 0.15, "", 0.006, 6.25, 12.3,
    "repeat in the dark",
)  # fmt: skip
GAIN = Cause("light-gains", "strengths differ by 5 %", 0.05, "", 0.01, 1.52, nan, "calibrate again")
UNKNOWN = Cause("transfer-curve", "the curve is doubtful", nan, "", nan, nan, nan, "")
MIRRORED = Cause("lights-mirrored", "axes are mirrored", nan, "", nan, nan, nan, "", inverts=True)
TIE = Cause("offset", "an offset", 0.1, "", 0.1, 2.0, nan, "", alternatives=("ambient-light",))


def verdict(*causes: Cause, **stated: Any) -> Verdict:
    figures = {"sigma_deg": 0.3, "residual": 0.26, "noise": 0.02, "tried": ("gain",), **stated}
    return Verdict(causes, **figures)


LINES = {
    "good": (verdict(), "good: nothing was found that changes the normals by more than 1 deg"),
    "small causes": (
        verdict(GAIN, sigma_deg=1.6),
        "good: nothing was found that changes the normals by more than 1.6 deg; their standard "
        "deviation is 1.6 deg",
    ),
    "nothing tried": (
        verdict(tried=(), sigma_deg=nan),
        "good: but too little data: neither lights nor normals could be tested",
    ),
    "one": (verdict(GAIN), "check: strengths differ by 5 % (normals change by 1.5 deg)"),
    "alternative": (
        verdict(TIE),
        "check: an offset, or room light (normals change by 2 deg)",
    ),
    "effect unknown": (verdict(UNKNOWN), "check: the curve is doubtful"),
    "two": (
        verdict(LIGHT, GAIN),
        "do not use: room light reaches 15 % of the albedo (normals change by 6.2 deg, heights "
        "change by 12 mm); strengths differ by 5 % (normals change by 1.5 deg)",
    ),
    "more": (
        verdict(MIRRORED, UNKNOWN, GAIN, TIE),
        "do not use: axes are mirrored (the relief is inverted); the curve is doubtful; "
        "2 more above",
    ),
    "less than three sigma": (
        verdict(LIGHT, sigma_deg=2.2),
        "check: room light reaches 15 % of the albedo (normals change by 6.2 deg, heights change "
        "by 12 mm)",
    ),
    # A mistake enlarges the stated standard deviation, too: it excuses at most 5 deg.
    "a large sigma": (
        verdict(Cause("lights-shuffled", "wrong order", nan, "", nan, 40.0, nan, ""), sigma_deg=42),
        "do not use: wrong order (normals change by 40 deg)",
    ),
    "no normals": (
        verdict(Cause("frames-dark", "dark", 3, "", nan, 90, nan, "")),
        "do not use: dark (too few images for normals)",
    ),
    "unexplained": (
        verdict(unexplained_deg=3.04),
        "check: a residual of 26.0% of the signal is not explained (normals may change by 3 deg)",
    ),
}


@cases(("found", "line"), LINES)
def test_the_last_line(found: Verdict, line: str) -> None:
    assert verdict_line(found, good_result(found)) == line


@cases(("found", "line"), LINES)
def test_a_verdict_survives_json(found: Verdict, line: str) -> None:
    stored = dumps(verdict_record(found))
    read = recorded_verdict(json.loads(stored))
    assert verdict_line(read, good_result(read)) == line
    assert dumps(verdict_record(read)) == stored


GOLDEN = """{
  "verdict": "check",
  "causes": [
    {
      "name": "light-gains",
      "text": "strengths differ by 5 %",
      "size": 0.05,
      "unit": "",
      "sigma": 0.01,
      "normals_deg": 1.52,
      "height_mm": null,
      "remedy": "calibrate again",
      "inverts": false,
      "alternatives": [
        "ambient-light"
      ],
      "where": "",
      "share": null
    }
  ],
  "tested": {
    "sigma_deg": 0.3,
    "residual": 0.26,
    "noise": 0.02,
    "unexplained_deg": 0.0,
    "tried": [
      "gain"
    ],
    "not_excluded": [
      "half-turn"
    ],
    "least": {
      "gain": "1.2 %"
    }
  }
}"""


def test_json_and_records_have_the_verdict_like_this(tmp_path: Path) -> None:
    cause = replace(GAIN, alternatives=("ambient-light",))
    found = verdict(cause, not_excluded=("half-turn",), least={"gain": "1.2 %"})
    assert dumps(verdict_record(found)) == GOLDEN
    printed = json.loads(Result(verdict=found).to_json())
    path = tmp_path / "normals.json"
    write_record(path, "sgp test", {}, Result(verdict=found))
    for written in (printed, json.loads(path.read_text())):
        assert {name: written[name] for name in json.loads(GOLDEN)} == json.loads(GOLDEN)
    assert dumps(verdict_record(read_record(path).judged)) == GOLDEN
    assert "verdict" not in Result().to_json()


WRONG = {
    "another answer": {"verdict": "perfect"},
    "a cause without a name": {"causes": [{"text": "x"}]},
    "no table": {"tested": 3},
}


@cases("change", WRONG)
def test_a_record_with_a_wrong_verdict_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "normals.json"
    write_record(path, "sgp test", {}, Result(verdict=verdict(GAIN)))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DataError, match=next(iter(change))):
        read_record(path)


def test_causes_are_notices_with_their_effects() -> None:
    few = [str(one) for one in verdict(LIGHT, UNKNOWN, TIE).notices]
    assert few == [
        "room light reaches 15 % of the albedo (normals change by 6.2 deg, heights change by "
        "12 mm); repeat in the dark",
        "the curve is doubtful",
        "an offset, or room light (normals change by 2 deg)",
    ]
    severities = [one.severity for one in verdict(LIGHT, GAIN, UNKNOWN, sigma_deg=2).notices]
    assert severities == ["warning", "info", "warning"]
    (left,) = verdict(unexplained_deg=3).notices
    assert left.code == "residual-unexplained"
    assert "26.0% of the signal is not explained" in left.text


HEADS = {
    "good": (
        verdict(),
        '<div class="verdict good"><p><strong>Good</strong>: nothing was found that changes the '
        "normals by more than 1 deg</p></div>",
    ),
    "check": (
        verdict(replace(GAIN, text="<b>")),
        '<div class="verdict check"><p><strong>Check</strong></p><ul><li>&lt;b&gt; (normals change '
        'by 1.5 deg)<span class="remedy">calibrate again</span></li></ul></div>',
    ),
    "unexplained": (
        verdict(replace(GAIN, normals_deg=0.2), unexplained_deg=3),
        '<div class="verdict check"><p><strong>Check</strong></p><ul><li>a residual of 26.0% '
        "of the signal is not explained (normals may change by 3 deg)</li></ul>"
        "</div>",
    ),
}


@cases(("found", "head"), HEADS)
def test_the_head_of_a_report_has_the_verdict(found: Verdict, head: str, tmp_path: Path) -> None:
    write_record(tmp_path / "normals.json", "sgp test", {}, Result(verdict=found))
    assert head in make_report([tmp_path], max_pixels=MAX_PIXELS).html


def test_a_result_without_a_verdict_has_no_head(tmp_path: Path) -> None:
    write_record(tmp_path / "normals.json", "sgp test", {}, Result())
    assert read_folder(tmp_path).verdict is None
    assert '<div class="verdict' not in make_report([tmp_path], max_pixels=MAX_PIXELS).html


PLAN = "leds = [0, 1, 2, 3, 4, 5]\nexposures_us = [{us}]\ndark = {dark}\n"
FRAMES = {
    "good": (5000, "true", "good: all frames are there, and none is dark or saturated"),
    "dark": (50, "true", "do not use: 6 lights are hardly visible: L00, "),
    "saturated": (200_000, "true", "do not use: "),
    "no dark frame": (5000, "false", "check: there is no frame without light at 5000 us"),
}


@cases(("us", "dark", "line"), FRAMES)
def test_a_recording_ends_with_a_verdict_on_its_frames(
    sgp: Any, rig: Path, tmp_path: Path, us: int, dark: str, line: str
) -> None:
    plan = tmp_path / "p.toml"
    plan.write_text(PLAN.format(us=us, dark=dark), encoding="utf-8")
    answer = capture(sgp, tmp_path / "s", "--rig", rig, "--plan", plan).ok()
    assert answer.out.splitlines()[-1].startswith(line), answer.out


def test_lost_shots_are_named_and_counted(recorded: Path) -> None:
    session = Session.open(recorded)
    lights = [frame for frame in session.frames if frame.role == "light"]
    shots = [frame.line.shot for frame in lights]
    few = replace(session, frames=tuple(lights[4:]), missing=tuple(shots[:3]), left_out=(shots[3],))
    found = judge_frames(Result(), few).verdict
    assert found is not None
    lost, bare = found.causes
    assert lost.text == "4 shots are missing: LED 0, LED 1, LED 2, LED 3"
    assert lost.normals_deg == 90
    assert bare.name == "dark-frames-missing"
    assert found.answer == "do-not-use"
    one = replace(session, left_out=(shots[0],))
    assert conclusion(one) == ["check: 1 shot is missing: LED 0"]


def conclusion(session: Session) -> list[str]:
    return judge_frames(Result(), session).conclusion


SHOWN = """
from math import nan
from processing.checks import Cause, Verdict
from rig import Notice
from sgp.app import _show
from sgp.results import Result
notices = [
    Notice("a", "no mask", severity="info"), Notice("b", "shifted", "L07"),
    Notice("c", "damaged", severity="error"), Notice("b", "shifted", "L07"),
]
cause = Cause("x", "wrong", nan, "", nan, {effect}, nan, "")
verdict = Verdict((cause,), 0.3, 0.1, 0.1)
_show(Result(warnings=notices, summary=["3 images"], verdict=verdict), False)
"""
PLAIN = ["note: no mask", "warning: L07: shifted", "error: damaged", "3 images"]
ENDS = {
    "good": (0.5, "good: "),
    "check": (2.0, "check: wrong (normals change by 2 deg)"),
    "do not use": (9.0, "do not use: wrong (normals change by 9 deg)"),
}


def on_terminal(code: str, **changed: str) -> str:
    """Run a program on a terminal, and return what it prints there."""
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    environment = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    subprocess.run(
        [sys.executable, "-c", code], stdout=theirs, stderr=theirs, check=True, timeout=120,
        env=environment | {"TERM": "xterm-256color", **changed},
    )  # fmt: skip
    os.close(theirs)
    parts = []
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:
            break
        if not part:
            break
        parts.append(part)
    os.close(ours)
    return b"".join(parts).decode().replace("\r\n", "\n")


@cases(("effect", "line"), ENDS)
def test_severities_and_the_verdict_are_in_colour_on_a_terminal(effect: float, line: str) -> None:
    lines = on_terminal(SHOWN.format(effect=effect)).splitlines()
    codes = {"good": "32", "check": "33", "do not use": "1;31"}
    word = line.partition(":")[0]
    assert lines == [
        "\x1b[36mnote\x1b[0m: no mask",
        "\x1b[33mwarning\x1b[0m: L07: shifted",
        "\x1b[1;31merror\x1b[0m: damaged",
        "3 images",
        f"\x1b[{codes[word]}m{word}\x1b[0m{line[len(word) :]}",
    ]


PLAIN_WAYS = {"NO_COLOR": {"NO_COLOR": "1"}, "a dumb terminal": {"TERM": "dumb"}}


@cases("changed", PLAIN_WAYS)
def test_a_terminal_that_wants_no_colour_gets_none(changed: dict[str, str]) -> None:
    assert on_terminal(SHOWN.format(effect=2.0), **changed).splitlines() == [
        *PLAIN,
        ENDS["check"][1],
    ]


def test_a_pipe_gets_no_colour_and_a_repeated_notice_once() -> None:
    code = SHOWN.format(effect=2.0)
    both = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert [*both.stderr.splitlines(), *both.stdout.splitlines()] == [*PLAIN, ENDS["check"][1]]


SWAPPED = Cause("images-swapped", "L01 shows the light of L02", remedy="check the order")
CURVE = Cause("transfer-curve-doubtful", "read as linear", remedy="state the transfer curve: sRGB")


@cases(
    ("found", "remedies"),
    {
        "one cause": (verdict(LIGHT), ["repeat in the dark (--ambient estimate)"]),
        "a single image first": (
            verdict(LIGHT, SWAPPED),
            ["repeat in the dark", "check the order"],
        ),
        "something unknown first": (
            verdict(LIGHT, unexplained_deg=3, sigma_deg=1),
            ["repeat in the dark"],
        ),
        "a curve": (verdict(CURVE), ["state the transfer curve: sRGB (--gamma srgb)"]),
        "a curve without effect": (verdict(replace(CURVE, remedy="")), [""]),
        "without an option": (verdict(GAIN), ["calibrate again"]),
    },
)
def test_remedies_name_options_unless_something_else_comes_first(found, remedies) -> None:
    answered, notices = with_options(found, found.notices)
    assert [cause.remedy for cause in answered.causes] == remedies
    assert len(notices) == len(found.notices)
