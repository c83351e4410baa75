"""Showing a plan without hardware, and checking a rig for it, as an operator does."""

import json
from itertools import pairwise
from pathlib import Path

import pytest

RIG = """
name = "small"
driver = "simulated"
leds = 8
settle_ms = 5
dead_leds = [7]
[options]
scene = "coin"
width = 96
height = 80
seed = 3
camera = "inside"
realtime = false
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG, encoding="utf-8")
    return path


@pytest.fixture
def plan(tmp_path: Path):
    def write(text: str = "leds = [0,1,2,3,7]\nexposures_us = [20000, 1000]\n") -> Path:
        path = tmp_path / "plan.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_plan_is_shown_without_hardware(sgp, plan):
    metrics = sgp("capture", "plan", plan(), "--size", "100x50", "--json").figures()
    assert metrics["shots"][:2] == ["D_20000us.tif", "D_1000us.tif"]
    assert metrics["shots"][-2:] == ["L07_E1.tif", "R_L00_E0.tif"]
    assert metrics["counts"] == {"light": 10, "dark": 2, "ambient": 0, "repeat": 1, "flat": 0}
    assert metrics["bytes"] == 13 * 100 * 50 * 2
    assert metrics["exposure_seconds"] == pytest.approx(6 * 0.021 + 0.02)
    # 70 ms for each frame, and 2 ms for settling of the light.
    assert metrics["seconds"] == pytest.approx(6 * 0.021 + 0.02 + 13 * 0.072)


def test_time_and_dead_leds_are_those_of_the_rig_file(sgp, plan, rig):
    answer = sgp("capture", "plan", plan(), "--rig", rig, "--frame-ms", 10).ok()
    assert "LEDs 7 skipped: listed in dead_leds" in answer.err
    assert "L07" not in answer.out
    assert "11 shots: 8 light, 2 dark, 1 repeat" in answer.out
    assert "15 ms per frame" in answer.out
    shown = json.loads(sgp("capture", "plan", plan(), "--rig", rig, "--json").out)
    assert shown["metrics"]["left_out"] == [7]
    assert list(shown["metrics"]["exposures_us"]) == ["0", "1", "2", "3"]


def test_the_default_plan_lights_every_working_led(sgp, rig):
    assert "38 shots: 36 light, 1 dark, 1 repeat" in sgp("capture", "plan").out
    assert "9 shots: 7 light, 1 dark, 1 repeat" in sgp("capture", "plan", "--rig", rig).out


def shots(answer):
    assert answer.code == 0, answer.err
    return json.loads(answer.out)["metrics"]["shots"]


def test_ranges_of_leds(sgp, plan):
    ranges = sgp("capture", "plan", plan("leds = '0-2, 8-7'\nexposures_us = [5]\n"), "--json")
    listed = ["D_5us.tif", *(f"L0{led}_E0.tif" for led in (0, 1, 2, 8, 7)), "R_L00_E0.tif"]
    assert shots(ranges) == listed
    listed[0] = "D_20000us.tif"
    assert shots(sgp("capture", "plan", "--leds", "0-2,8-7", "--json")) == listed


def test_the_rig_of_a_plan_may_be_a_name_or_the_configured_one(sgp, rig, monkeypatch):
    assert len(shots(sgp("capture", "plan", "--rig", "simulated", "--json"))) == 38
    monkeypatch.setenv("SGP_RIG", str(rig))
    assert len(shots(sgp("capture", "plan", "--json"))) == 9
    assert len(shots(sgp("capture", "plan", "--led-count", 12, "--json"))) == 14


def test_earlier_spellings_still_work(sgp):
    sizes = [
        json.loads(sgp("capture", "plan", *words, "--json").out)["metrics"]["bytes"]
        for words in (("--size", "100x50"), ("--width", 100, "--height", 50))
    ]
    assert sizes == [38 * 100 * 50 * 2] * 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        pytest.param(["--leds", "36"], "--led-count 36 for 36 LEDs, or --leds 36-36", id="number"),
        pytest.param(["--leds", "1,x"], "'x' is neither an LED number nor a range", id="text"),
        pytest.param(["--leds", "0-3,2"], "LED 2 is listed twice", id="twice"),
        pytest.param(["--leds", "0-40"], "--leds: the plan's LED 36", id="LED of the board"),
        pytest.param(["--leds", "70000-70001"], "no LED 70001", id="LED"),
        pytest.param(["--leds", "0-5", "--led-count", "3"], "--leds: ", id="count"),
        pytest.param(["{plan}", "--leds", "0-3"], "leave out --leds", id="plan and LEDs"),
        pytest.param(["--rig", "simulated", "--led-count", "3"], "leave out", id="rig and count"),
        pytest.param(["--size", "8x8", "--width", "8"], "--size gives width and", id="two sizes"),
        pytest.param(["--size", "100"], "for example 640x512", id="half a size"),
    ],
)
def test_options_of_a_plan_that_contradict(sgp, plan, words, message):
    path = plan()
    assert message in sgp("capture", "plan", *(w.format(plan=path) for w in words)).error_line(2)


def test_exposures_are_shown_by_groups_of_leds(sgp, plan):
    text = "leds = [0,1,2,3,4,9]\nexposures_us = [20000]\n[exposures_by_led]\n"
    shown = sgp("capture", "plan", plan(text + "3 = [30000]\n9 = [30000]\n")).out.splitlines()
    assert shown[1].split() == ["20000", "0-2,", "4"]
    assert shown[2].split() == ["30000", "3,", "9"]


def test_many_exposures_take_few_lines(sgp, plan):
    own = "".join(f"{led} = [{1000 + led}, {10 + led}]\n" for led in range(300))
    text = f"leds = {list(range(300))}\nexposures_us = [5, 6]\n[exposures_by_led]\n{own}"
    shown = sgp("capture", "plan", plan(text), "--led-count", 300).out.splitlines()
    assert len(shown) < 20
    assert shown[1].split("  ")[0] == "1000 to 1024, 10 to 34"
    assert shown[1].endswith(" 0-24")
    assert shown[12].endswith(" 275-299")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param(
            "leds=[36]\nexposures_us=[5]", "LED 36 does not exist", id="led-36-of-0-to-35"
        ),
        pytest.param("leds=[0]\nexposures_us=[0]", "exposures_us.0", id="exposure-0"),
        pytest.param("leds=[0,0]\nexposures_us=[5]", "0 appears twice", id="led-twice"),
        pytest.param("leds=[0]\nexposures_us=[5,5]", "5 appears twice", id="exposure-twice"),
        pytest.param("leds=[0]\nexposures_us=[5]\nflat=2", "unknown key 'flat'", id="key"),
    ],
)
def test_plans_that_are_refused(sgp, plan, text, message):
    line = sgp("capture", "plan", plan(text)).error_line(4)
    assert message in line
    assert "plan.toml: " in line


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(("no-such-plan.toml",), id="plan"),
        pytest.param(("--rig", "no-such-rig.toml"), id="rig"),
        pytest.param(("--frame-ms", -1), id="negative-time"),
    ],
)
def test_missing_files_are_wrong_usage(sgp, words):
    assert sgp("capture", "plan", *words).code == 2


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize(
    ("place", "message"),
    [
        pytest.param("old", "already contains files: choose another folder", id="session"),
        pytest.param("old/new", "is inside the session", id="in a session"),
        pytest.param("old/frames", "is inside the session", id="frames of a session"),
        pytest.param("rig.toml", "is a file: choose a folder", id="file"),
        pytest.param("rig.toml/new", "cannot be below it: choose a folder", id="below a file"),
    ],
)
def test_places_where_no_session_can_be_recorded(sgp, rig, tmp_path, command, place, message):
    (tmp_path / "old" / "frames").mkdir(parents=True)
    (tmp_path / "old" / "session.toml").write_text("")
    assert message in sgp("capture", command, tmp_path / place, "--rig", rig).error_line(2)


def test_a_working_rig_is_ready(sgp, rig, plan, tmp_path):
    answer = sgp("capture", "check", tmp_path / "new", "--rig", rig, "--plan", plan()).ok()
    assert answer.out.splitlines()[-1] == "ready to record"
    lines = [line for line in answer.out.splitlines()[:-1] if not line.startswith(" ")]
    rows = [line.split()[:2] for line in lines]
    assert rows[0] == ["ok", "disk"]
    assert rows[-1] == ["ok", "LEDs"]
    assert "LEDs 7" in answer.err
    assert not (tmp_path / "new").exists()


def test_a_rig_that_is_not_ready_gives_exit_3_and_says_why(sgp, rig, plan, tmp_path):
    short = plan("leds = [0,1]\nexposures_us = [2]\n")
    answer = sgp("capture", "check", tmp_path / "new", "--rig", rig, "--plan", short, "--quick")
    assert answer.code == 3
    assert "NOT READY: camera" in answer.out
    assert "not done  focus" in answer.out
    assert "LEDs " not in answer.out.partition("NOT READY")[2]
    found = sgp(
        "capture", "check", tmp_path / "new", "--rig", rig, "--plan", short, "--quick", "--json"
    )
    assert found.code == 3
    report = json.loads(found.out)
    assert report["ok"] is False
    assert report["metrics"]["ready"] is False
    states = {check["name"]: check["state"] for check in report["metrics"]["checks"]}
    assert states["camera"] == "failed"
    assert "LEDs" not in states


def test_help_is_wrapped_by_paragraphs(sgp, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    shown = sgp("capture", "import", "--help").out.partition("For example:")
    lines = [line for line in shown[0].splitlines()[3:] if line]
    # Each line except the last of a paragraph has no room for the first word of the next line.
    short = [one for one, next_one in pairwise(lines) if len(f"{one} {next_one.split()[0]}") <= 60]
    assert len(lines) >= 4
    assert short == []
    assert len(shown[2].partition("Parameters")[0].splitlines()) > 4, "examples are not joined"
