"""The station of the screen: live frames, tasks one at a time, and darkness without an operator."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from acquisition import CapturePlan, DataError, Session, verify_session
from acquisition.engine import StopRequest
from rig import BoardError, Rig, RigConfig
from sgp.screen import Desk, Light, PlanSheet, Screen, Station, station
from sgp.screen.actions import ACTION
from sgp.screen.plan_sheet import plan_from, text_of
from sgp.screen.station import BusyError
from sgp.sessions import Order, StoredOptions
from simulator import open_rig_seeing, render, scene_named
from tests.cases import cases

VIEW = render(scene_named("coin", width=64, height=52, leds=6))
PLAN = CapturePlan(leds="0-5", exposures_us=(20_000.0,))
FIRST = Light("one", (0,), 20_000.0)
LIMIT_S = 120.0


class Bench:
    """Opens small rigs, and notes what is shot with them."""

    def __init__(self) -> None:
        self.shots: list[int | None] = []
        self.opened: list[Rig] = []
        self.failure: Exception | None = None
        self.exposed = threading.Event()

    def open(self) -> Rig:
        if self.failure is not None:
            raise self.failure
        rig = open_rig_seeing(VIEW, realtime=False, camera="inside", noisy=False)
        shoot = rig.shoot

        def noted(led: int | None, *values: float, **more: Any) -> Any:
            if self.failure is not None:
                raise self.failure
            self.shots.append(led)
            return shoot(led, *values, **more)

        rig.shoot = noted
        self.opened.append(rig)
        return rig


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def desk(bench: Bench) -> Desk:
    with bench.open() as rig:
        config = rig.config
    return Desk(PlanSheet(PLAN, config))


@contextmanager
def running(made: Station) -> Iterator[Station]:
    thread = threading.Thread(target=made.run)
    thread.start()
    try:
        yield made
    finally:
        made.close()
        thread.join(LIMIT_S)
        assert not thread.is_alive()


@pytest.fixture
def open_station(bench: Bench, desk: Desk) -> Iterator[Station]:
    with running(Station(bench.open, desk, FIRST)) as made:
        until(lambda: made.state()["live"]["frame"])
        yield made


def until(holds: Callable[[], object], limit_s: float = LIMIT_S) -> None:
    ends_s = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < ends_s
        time.sleep(0.01)


def lit(made: Station) -> list[int]:
    return made.state()["live"]["frame"]["leds"]


def test_a_live_frame_shows_the_chosen_led(open_station: Station) -> None:
    open_station.attend()
    open_station.light(replace(FIRST, leds=(3,)))
    until(lambda: lit(open_station) == [3])
    frame = open_station.frame
    assert frame is not None
    assert frame.leds == (3,)
    state = open_station.state()
    assert state["rig"]["leds"] == 6
    assert sum(state["live"]["frame"]["histogram"]) == 64 * 52


def test_a_cycle_shows_each_led_in_turn(open_station: Station, bench: Bench) -> None:
    open_station.light(Light("cycle", (1, 4, 5), 20_000.0))
    start = len(bench.shots) + 2
    until(lambda: len(bench.shots) > start + 6)
    taken = bench.shots[start : start + 6]
    assert sorted(taken[:3]) == [1, 4, 5]
    assert taken[:3] == taken[3:]


def test_all_leds_are_the_mean_of_a_cycle(open_station: Station) -> None:
    open_station.light(Light("all", (0, 2, 4), 20_000.0))
    until(lambda: lit(open_station) == [0, 2, 4])


def test_without_leds_the_frame_is_dark(open_station: Station) -> None:
    open_station.light(replace(FIRST, leds=()))
    until(lambda: lit(open_station) == [])
    frame = open_station.frame
    assert frame is not None
    assert frame.pixels.max() < 0.1 * frame.white_dn


@cases(
    ("light", "text"),
    {
        "no such LED": (replace(FIRST, leds=(6,)), "LED 6 does not exist"),
        "exposure": (replace(FIRST, exposure_us=1e12), "the camera exposes for"),
    },
)
def test_a_light_that_is_not_possible_is_refused(
    open_station: Station, light: Light, text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        open_station.light(light)
    assert open_station.current_light == FIRST


def test_paused_or_left_nothing_is_lit(
    open_station: Station, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_station.pause(True)
    time.sleep(0.2)
    count = len(bench.shots)
    time.sleep(0.2)
    assert len(bench.shots) == count
    monkeypatch.setattr(station, "AWAY_S", 0.2)
    open_station.pause(False)
    time.sleep(0.5)
    count = len(bench.shots)
    time.sleep(0.2)
    assert len(bench.shots) == count
    open_station.attend()
    until(lambda: len(bench.shots) > count)


def test_a_rig_that_fails_is_opened_again(
    open_station: Station, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "_REOPEN_S", 0.05)
    bench.failure = BoardError("LED board on /dev/x: unplugged")
    until(lambda: open_station.state()["rig"] is None)
    assert open_station.state()["trouble"] == "LED board on /dev/x: unplugged"
    with pytest.raises(BusyError, match="unplugged"):
        open_station.light(FIRST)
    bench.failure = None
    open_station.attend()
    until(lambda: open_station.state()["rig"] is not None)
    number = open_station.state()["live"]["frame"]["number"]
    until(lambda: open_station.state()["live"]["frame"]["number"] > number)
    assert open_station.state()["trouble"] == ""


def test_one_task_at_a_time_and_a_stop_ends_it(open_station: Station, bench: Bench) -> None:
    begun = threading.Event()

    def task(rig: Rig, desk: Desk) -> None:
        begun.set()
        while True:
            open_station.attend()
            desk.progress("waiting", 0, 1)
            time.sleep(0.01)

    open_station.request("waiting", task)
    assert begun.wait(LIMIT_S)
    with pytest.raises(BusyError, match="waiting is running"):
        open_station.request("another", task)
    open_station.stop("the page")
    until(lambda: open_station.state()["task"] is None)
    assert open_station.state()["failure"] == "stopped by the page"


def test_a_task_that_fails_is_shown_and_the_picture_goes_on(
    open_station: Station, bench: Bench
) -> None:
    def task(rig: Rig, desk: Desk) -> None:
        raise DataError("plan: wrong")

    open_station.request("failing", task)
    until(lambda: open_station.state()["failure"] == "plan: wrong")
    count = len(bench.shots)
    open_station.attend()
    until(lambda: len(bench.shots) > count)


def test_a_question_is_answered_once(open_station: Station, desk: Desk) -> None:
    answers: list[bool] = []

    def task(rig: Rig, desk: Desk) -> None:
        answers.append(desk.ask("Continue?"))

    for yes in (True, False):
        open_station.request("asking", task)
        until(lambda: open_station.state()["question"])
        question = open_station.state()["question"]
        assert question["text"] == "Continue?"
        desk.answer(question["id"] + 1, True)  # of another question
        desk.answer(question["id"], yes)
        until(lambda: open_station.state()["task"] is None)
    assert answers == [True, False]


# The page's actions.


@pytest.fixture
def order(monkeypatch: pytest.MonkeyPatch) -> Order:
    return Order("small", StoredOptions(), "Ada", None, None)


@pytest.fixture
def screen(open_station: Station, desk: Desk, order: Order, tmp_path: Path) -> Screen:
    return Screen(open_station, desk, order, tmp_path)


def do(screen: Screen, **action: Any) -> None:
    screen.perform(ACTION.validate_python(action))


def finished(made: Station) -> dict[str, Any]:
    def over() -> bool:
        made.attend()
        return made.state()["task"] is None

    until(over)
    return made.state()


def test_a_recording_is_that_of_the_engine(
    open_station: Station, screen: Screen, tmp_path: Path
) -> None:
    do(screen, do="record", object="coin 7", check=False)
    state = finished(open_station)
    session = Session.open(tmp_path / "coin 7")
    assert session.complete
    assert verify_session(session.folder).ok
    assert session.manifest.object == "coin 7"
    assert session.manifest.operator == "Ada"
    shown = state["recording"]
    assert shown["state"] == "complete"
    assert [one["file"] for one in shown["frames"]] == [one.path.name for one in session.frames]
    assert shown["verdict"].startswith("good")
    for one in shown["frames"]:
        picture = screen.picture(one["file"])
        assert picture is not None
        assert picture.shape[1] == 96
    assert screen.picture("../session.toml") is None


def test_a_stopped_recording_is_resumed(
    open_station: Station, screen: Screen, bench: Bench, tmp_path: Path
) -> None:
    start = len(bench.shots)
    do(screen, do="plan", text='leds = "0-5"\nexposures_us = [20000.0]\nrepeats = 9\n')
    do(screen, do="record", object="owl", check=False)
    until(lambda: len(bench.shots) > start + 3)
    do(screen, do="stop")
    state = finished(open_station)
    session = Session.open(tmp_path / "owl")
    assert not session.complete
    assert state["recording"]["state"] == "incomplete"
    assert state["failure"] == "stopped by the page"
    assert session.events[-1].event == "interrupted"
    do(screen, do="resume")
    finished(open_station)
    assert Session.open(tmp_path / "owl").complete


def test_metering_and_checks(open_station: Station, screen: Screen) -> None:
    do(screen, do="meter", each=True)
    state = finished(open_station)
    assert len(state["metered"]) == 6
    assert len(set(plan_from(state["plan"]["text"]).exposures_by_led)) > 0
    do(screen, do="check")
    names = [one["name"] for one in finished(open_station)["checks"]]
    assert names[:3] == ["disk", "board", "camera"]


def test_normals_without_lights_say_what_is_missing(open_station: Station, screen: Screen) -> None:
    with pytest.raises(ValueError, match="nothing has been recorded yet"):
        do(screen, do="look")
    do(screen, do="record", object="owl", check=False)
    finished(open_station)
    do(screen, do="look")
    state = finished(open_station)
    assert state["look"]["verdict"], state["failure"]
    picture = screen.picture("look")
    assert picture is not None
    assert picture.shape == (52, 64, 3)


@cases(
    ("name", "text"),
    {
        "empty": ("  ", "needs a name"),
        "a path": ("a/b", "cannot name a folder"),
        "the folder above": ("..", "cannot name a folder"),
        "a control character": ("a\nb", "cannot name a folder"),
        "too long": ("x" * 300, "too long"),
    },
)
def test_a_name_that_cannot_be_a_folder_is_refused(screen: Screen, name: str, text: str) -> None:
    with pytest.raises(Exception, match=text):
        do(screen, do="record", object=name)


def test_the_remaining_time_is_that_of_the_task(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    for began_s in (0.0, 1000.0):
        desk.begin(StopRequest(), lambda: None)
        for step in range(3):
            monkeypatch.setattr(time, "monotonic", lambda now_s=began_s + 2 * step: now_s)
            desk.progress("recording", step, 10)
        assert desk.state()["progress"]["left_s"] == 16.0
        desk.end()


# The plan.


@cases(
    "plan",
    {
        "plain": PLAN,
        "other order": PLAN.changed(leds=(3, 0, 1, 2)),
        "by LED": PLAN.changed(exposures_by_led={2: (1000.0,), 4: (7.5,)}),
        "all values": CapturePlan(
            leds=(5,), exposures_us=(10.0, 1000.0), repeats=2, dark=False, flats=3, gain_db=1.5
        ),
    },
)
def test_the_text_of_a_plan_is_that_plan(plan: CapturePlan) -> None:
    assert plan_from(text_of(plan)) == plan


def test_a_wrong_text_is_kept_with_its_error() -> None:
    sheet = PlanSheet(PLAN, RigConfig(name="desk", driver="simulated", leds=6))
    for text, error in (
        ("leds = ", "is not TOML"),
        ('leds = "0-9"\nexposures_us = [1.0]', "LED 6 does not exist"),
        ("leds = [0]\nexposure = 1", "exposure"),
    ):
        sheet.write(text)
        assert error in sheet.state()["error"]
        assert sheet.state()["text"] == text
        with pytest.raises(DataError):
            _ = sheet.plan
    sheet.write(text_of(PLAN))
    assert sheet.plan == PLAN
