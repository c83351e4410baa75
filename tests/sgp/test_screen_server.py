"""The station behind its server: light, stop, control, absence, failures and recordings."""

from __future__ import annotations

import json
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, Session, read_image, verify_session
from acquisition.preview import Region
from rig import BoardError, Rig
from sgp.screen import Desk, Light, station
from sgp.screen import screen as screens
from sgp.screen import server as servers
from sgp.screen.station import BusyError
from tests.sgp.screen_rig import FIRST, LIMIT_S, LitRig, RigFile, Served, served, until
from tests.sgp.small_rig import RIG, capture

LONG_US = 3e6
NINE = 'leds = "0-5"\nexposures_us = [5000.0]\nrepeats = 9\n'
WHOLE = "frame?left=0&top=0&width=64&height=52&columns=64&rows=52&clipped=0&peaking=0&after="


@pytest.fixture
def rig() -> Iterator[LitRig]:
    made = LitRig()
    yield made
    made.close()


@pytest.fixture
def slow_rig() -> Iterator[LitRig]:
    """A rig whose exposures take their time."""
    made = LitRig(realtime=True)
    yield made
    made.close()


@pytest.fixture
def page(rig: LitRig, tmp_path: Path) -> Iterator[Served]:
    with served(rig, tmp_path / "recordings") as made:
        shown(made)
        yield made
    assert made.errors == []
    assert rig.lit() is None


def shown(made: Served) -> dict[str, Any]:
    """Wait for a live frame, with the operator there, and return the state."""
    number = made.station.frame.number if made.station.frame else 0

    def newer() -> bool:
        made.station.attend()
        return made.station.frame is not None and made.station.frame.number > number

    until(newer)
    return made.station.state()


def light(made: Served, *leds: int, mode: str = "one", **more: float) -> tuple[int, str]:
    values = {"exposure_us": 5000.0, "gain_db": 0.0, **more}
    return made.do(do="light", mode=mode, leds=list(leds), **values)


# Light.


def test_the_chosen_led_is_on_at_the_board(page: Served, rig: LitRig) -> None:
    start_ns = time.monotonic_ns()
    assert light(page, 3) == (200, "")
    until(lambda: shown(page)["live"]["frame"]["leds"] == [3])
    assert rig.lit_since(start_ns) <= {0, 3}
    start_ns = time.monotonic_ns()
    shown(page)
    assert rig.lit_since(start_ns) == {3}
    light(page)
    until(lambda: shown(page)["live"]["frame"]["leds"] == [])
    start_ns = time.monotonic_ns()
    shown(page)
    assert rig.lit_since(start_ns) == set()


def test_a_light_that_the_rig_refuses_is_taken_back(page: Served) -> None:
    assert light(page, 2, gain_db=90.0) == (200, "")  # only the camera knows its range
    until(lambda: "Gain" in shown(page)["trouble"])
    state = shown(page)
    assert (state["live"]["leds"], state["live"]["gain_db"]) == ((0,), 0.0)
    light(page, 2)
    assert shown(page)["trouble"] == ""


def test_a_light_of_the_plan_that_the_rig_refuses_pauses(rig: LitRig, tmp_path: Path) -> None:
    with served(rig, tmp_path, light=Light("one", (1,), 5000.0, 90.0)) as made:
        until(lambda: made.station.state()["live"]["paused"])
        assert "Gain" in made.station.state()["trouble"]
        until(lambda: light(made, 1) == (200, ""))  # the rig is opened again
        assert shown(made)["live"]["frame"]["leds"] == [1]


def test_a_stop_ends_a_long_exposure_and_the_light_stays_off(
    slow_rig: LitRig, tmp_path: Path
) -> None:
    with served(slow_rig, tmp_path) as made:
        shown(made)
        light(made, 4, exposure_us=LONG_US)
        until(lambda: slow_rig.lit() == 4)
        time.sleep(0.2)
        start_ns = time.monotonic_ns()
        assert made.do(do="stop") == (200, "")
        ended_ns = time.monotonic_ns()
        (period,) = (one for one in slow_rig.state.periods() if one.end_ns > start_ns)
        assert period.end_ns - start_ns < LONG_US * 1000 / 2
        time.sleep(0.5)
        assert slow_rig.lit_since(ended_ns) == set()
        state = made.station.state()
        assert state["live"]["paused"]
        assert (state["trouble"], state["failure"]) == ("", "")
        made.do(do="pause", paused=False)
        until(lambda: made.station.attend() or slow_rig.lit() == 4)
        assert len(slow_rig.opened) == 1


def test_a_stop_at_any_moment_is_final(page: Served, rig: LitRig) -> None:
    moments = random.Random(1)
    for _ in range(20):
        page.station.attend()
        page.do(do="pause", paused=False)
        time.sleep(moments.uniform(0, 0.05))
        page.do(do="stop")
        stopped_ns = time.monotonic_ns()
        time.sleep(0.05)
        assert rig.lit_since(stopped_ns) == set()


def test_a_stop_ends_a_task_in_a_long_exposure(slow_rig: LitRig, tmp_path: Path) -> None:
    plan = CapturePlan(leds="0-5", exposures_us=(LONG_US,), dark=False)
    with served(slow_rig, tmp_path, plan=plan) as made:
        shown(made)
        made.do(do="record", object="owl", check=False)
        until(lambda: made.station.attend() or slow_rig.lit() is not None)
        while all(one.end_ns - one.start_ns < 1e9 for one in slow_rig.state.periods()):
            time.sleep(0.01)
        start_ns = time.monotonic_ns()
        made.do(do="stop")
        (period,) = (one for one in slow_rig.state.periods() if one.end_ns > start_ns)
        assert period.end_ns - start_ns < LONG_US * 1000 / 2
        state = made.finished()
        assert state["failure"] == "stopped by the page"
        assert state["recording"]["state"] == "incomplete"


# Who is there.


def test_the_first_page_controls_and_another_one_watches(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(servers, "_CONTROL_S", 1.0)
    assert page.do("first", do="region", left=0, top=0, width=9, height=9)[0] == 200
    with page.watched("second") as second:
        with page.watched("first") as first:
            assert next(first)["controls"]
            until(lambda: not next(second)["controls"])
            for action in ({"do": "stop"}, {"do": "pause", "paused": True}, {"do": "check"}):
                code, error = page.do("second", **action)
                assert (code, error) == (409, "another page controls the rig: close it first")
            assert not page.station.state()["live"]["paused"]
            assert page.do("first", do="pause", paused=True)[0] == 200
        with page.watched("first") as reloaded:
            assert next(reloaded)["controls"]
            assert not next(second)["controls"]
        until(lambda: next(second)["controls"])
        assert page.do("second", do="pause", paused=False)[0] == 200


def test_a_page_without_a_name_controls_nothing(page: Served) -> None:
    assert page.do("", do="pause", paused=True)[0] == 409


def test_without_a_page_nothing_is_lit(
    page: Served, rig: LitRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "AWAY_S", 0.4)
    with page.watched() as states:
        for _ in range(30):
            next(states)
        assert rig.lit_since(time.monotonic_ns() - 10**8) == {0}
    time.sleep(0.7)
    start_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert rig.lit_since(start_ns) == set()
    with page.watched() as states:
        until(lambda: next(states) and rig.lit_since(start_ns))


def test_an_exposure_ends_when_the_page_has_been_gone_for_long(
    slow_rig: LitRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "AWAY_S", 0.6)
    with served(slow_rig, tmp_path) as made:
        with made.watched() as states:
            until(lambda: next(states)["rig"])
            light(made, 4, exposure_us=LONG_US)
            until(lambda: next(states) and slow_rig.lit() == 4)
        closed_ns = time.monotonic_ns()
        until(lambda: slow_rig.lit() is None)
        # Another exposure may have ended just after the page was closed; the last one was cut.
        period = max(slow_rig.state.periods(), key=lambda one: one.end_ns)
        assert period.end_ns > closed_ns
        assert period.end_ns - period.start_ns < LONG_US * 1000 / 2
        time.sleep(0.5)
        assert slow_rig.lit_since(period.end_ns) == set()
        assert made.station.state()["trouble"] == ""
        with made.watched() as states:
            until(lambda: next(states) and slow_rig.lit() == 4)
        assert len(slow_rig.opened) == 1


def test_a_recording_stops_when_the_page_has_been_gone_for_long(
    slow_rig: LitRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "AWAY_S", 0.6)
    plan = CapturePlan(leds="0-5", exposures_us=(LONG_US / 2,), dark=False)
    with served(slow_rig, tmp_path, plan=plan) as made:
        with made.watched() as states:
            until(lambda: next(states)["rig"])
            made.do(do="record", object="owl", check=False)
            until(lambda: (next(states)["recording"] or {}).get("frames") and slow_rig.lit())
        closed_ns = time.monotonic_ns()
        until(lambda: made.station.state()["task"] is None)
        # On a slow machine, earlier shots may have ended after that, too: the last one is cut off.
        *_, period = (one for one in slow_rig.state.periods() if one.end_ns > closed_ns)
        assert period.end_ns - period.start_ns < LONG_US * 1000 / 2
        assert made.station.state()["failure"] == "stopped by the closing of the page"
        session = Session.open(tmp_path / "owl")
        assert not session.complete
        assert session.events[-1].event == "interrupted"
        assert session.events[-1].details["reason"].startswith("stopped by the closing of the page")
        with made.watched() as states:
            made.do(do="plan", text=NINE)
            made.do(do="resume")
            until(lambda: next(states)["recording"]["state"] == "complete")
    assert verify_session(tmp_path / "owl").ok


def test_metering_ends_if_the_page_is_closed(
    page: Served, rig: LitRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    with page.watched() as states:
        next(states)
        page.do(do="meter", each=True)
        monkeypatch.setattr(station, "AWAY_S", 0.0)
    until(lambda: page.station.state()["task"] is None)
    assert page.station.state()["failure"] == "stopped by the closing of the page"
    assert rig.lit() is None


def test_a_page_that_does_not_read_delays_nothing(page: Served, rig: LitRig) -> None:
    with page.watched() as states, page.watched("second"):  # the second reads nothing
        links = []
        for number in range(20):
            link = socket.create_connection(("127.0.0.1", page.port), timeout=LIMIT_S)
            host = f"Host: 127.0.0.1:{page.port}\r\n\r\n"
            link.sendall(f"GET {page.path}{WHOLE}{number} HTTP/1.1\r\n{host}".encode())
            links.append(link)
        before = page.station.frame
        assert before is not None
        until(lambda: next(states)["live"]["frame"]["number"] > before.number + 30)
        assert page.get(f"{WHOLE}0")[0] == 200
        for link in links:
            link.close()


def test_a_frame_is_sent_once_it_is_newer(page: Served) -> None:
    page.station.pause(True)
    frame = page.station.frame
    assert frame is not None
    code, picture = page.get(f"{WHOLE}0")
    assert (code, picture[:2]) == (200, b"BM")
    found: list[int] = []

    def ask() -> None:
        found.append(page.get(f"{WHOLE}{frame.number + 1}")[0])

    thread = threading.Thread(target=ask)
    thread.start()
    time.sleep(0.2)
    assert found == []
    page.station.attend()
    page.station.pause(False)
    thread.join(LIMIT_S)
    assert found == [200]


# Failures.


def test_an_error_in_a_task_is_a_line_and_the_page_goes_on(
    page: Served, rig: LitRig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(folder: Path) -> Callable[[Rig, Desk], None]:
        def task(rig: Rig, desk: Desk) -> None:
            rig.board.on(2, 5000)
            raise RuntimeError("boom")

        return task

    monkeypatch.setattr(screens, "check", broken)
    page.do(do="check")
    state = page.finished()
    assert state["failure"].startswith("RuntimeError: boom")
    assert rig.lit() != 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: checking: RuntimeError: boom")
    shown(page)


def test_an_error_while_an_action_is_carried_out_is_an_answer(
    page: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(light: Light) -> None:
        raise RuntimeError("boom")

    monkeypatch.setattr(page.station, "light", broken)
    code, error = light(page, 1)
    assert code == 500
    assert error.startswith("RuntimeError: boom")
    shown(page)


def test_board_and_camera_may_disappear_and_return(
    page: Served,
    rig: LitRig,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(station, "_REOPEN_S", 0.05)
    light(page, 2)
    rig.unplug()
    until(lambda: page.station.attend() or page.station.state()["rig"] is None)
    until(lambda: "cannot be opened" in page.station.state()["trouble"])
    assert light(page, 3)[0] == 409
    assert page.do(do="record", object="owl")[0] == 409
    rig.connect()
    assert shown(page)["live"]["frame"]["leds"] == [2]
    camera = rig.opened[-1].camera
    camera.faults = dict.fromkeys(range(100_000), "unplug")
    until(lambda: page.station.attend() or rig.opened[-1].camera is not camera)
    assert shown(page)["live"]["frame"]["leds"] == [2]
    assert page.station.state()["trouble"] == ""
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith("error: ") for line in lines)
    assert 2 <= len(lines) <= 4


def test_a_recording_whose_board_disappears_is_resumed(
    page: Served, rig: LitRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "_REOPEN_S", 0.05)
    page.do(do="plan", text=NINE)
    page.do(do="record", object="owl", check=False)
    until(lambda: (page.station.state()["recording"] or {}).get("frames"))
    rig.unplug()

    def waits() -> bool:
        page.station.attend()
        lines = page.station.state()["recording"]["lines"]
        return any("waiting for the board" in line["text"] for line in lines)

    until(waits)
    page.do(do="stop")  # the board will be back at another port
    state = page.finished()
    assert state["recording"]["state"] == "incomplete"
    before = [one["file"] for one in state["recording"]["frames"]]
    rig.connect()
    page.do(do="pause", paused=False)
    shown(page)
    page.do(do="resume")
    state = page.finished()
    assert state["recording"]["state"] == "complete", state["failure"]
    files = [one["file"] for one in state["recording"]["frames"]]
    assert files[: len(before)] == before
    assert len(files) == len(set(files)) == len(Session.open(page.out / "owl").frames)
    assert verify_session(page.out / "owl").ok


def test_a_rig_that_does_not_open_is_said_once(
    rig: LitRig,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(station, "_REOPEN_S", 0.05)
    rig.failure = BoardError("LED board on /dev/x: unplugged")
    with served(rig, tmp_path) as made, made.watched() as states:
        until(lambda: next(states)["trouble"] == "LED board on /dev/x: unplugged")
        time.sleep(0.3)
        assert made.do(do="check") == (
            409, "the rig is not open: LED board on /dev/x: unplugged"
        )  # fmt: skip
        rig.failure = None
        until(lambda: next(states)["rig"])
    assert capsys.readouterr().err == "error: LED board on /dev/x: unplugged\n"


# Recordings.


def samples(folder: Path) -> dict[str, bytes]:
    frames = Session.open(folder).frames
    return {one.path.name: np.ascontiguousarray(read_image(one.path)).tobytes() for one in frames}


def test_a_recording_has_the_frames_of_capture_run(sgp: Any, tmp_path: Path) -> None:
    file, plan = tmp_path / "rig.toml", tmp_path / "plan.toml"
    file.write_text(RIG + 'camera = "inside"\nrealtime = false\nnoise = false\n')
    plan.write_text('leds = "0-5"\nexposures_us = [3000.0, 9000.0]\n')
    with served(RigFile(file), tmp_path / "recordings") as made:
        shown(made)
        assert made.do(do="plan", text=plan.read_text())[0] == 200
        assert made.do(do="record", object="coin 7", notes="two\nlines", check=True)[0] == 200
        state = made.finished()
        assert state["recording"]["state"] == "complete", state
        again = made.do(do="record", object="coin 7")
        assert again[0] == 422
        assert "already contains files" in again[1]
    capture(sgp, tmp_path / "run", "--rig", file, "--plan", plan, check=True).ok()
    recorded = made.out / "coin 7"
    assert verify_session(recorded).ok
    assert samples(recorded) == samples(tmp_path / "run")
    manifest = Session.open(recorded).manifest
    assert (manifest.object, manifest.notes) == ("coin 7", "two\nlines")


def test_an_object_may_have_a_name_in_any_script(page: Served) -> None:
    for name in ("Βάζο 3", "壺", "a b.c (1)", "x" * 200):
        assert page.do(do="record", object=f"  {name} ", check=False) == (200, "")
        assert page.finished()["recording"]["state"] == "complete"
        assert Session.open(page.out / name).manifest.object == name
        (first, *_) = page.station.state()["recording"]["frames"]
        code, picture = page.get(f"picture?name={first['file']}")
        assert (code, picture[1:4]) == (200, b"PNG")


def test_flats_wait_for_the_card(page: Served, rig: LitRig) -> None:
    page.do(do="plan", text=NINE.replace("repeats = 9", "flats = 2"))
    page.do(do="record", object="vase", check=False)
    until(lambda: page.station.attend() or page.station.state()["question"])
    start_ns = time.monotonic_ns()
    time.sleep(0.2)
    assert rig.lit_since(start_ns) == set()
    question = page.station.state()["question"]
    assert "white card" in question["text"]
    page.do(do="answer", question=question["id"], yes=False)
    state = page.finished()
    assert (state["failure"], state["recording"]["state"]) == ("stopped by the page", "incomplete")
    page.do(do="resume")
    until(lambda: page.station.attend() or page.station.state()["question"])
    page.do(do="answer", question=page.station.state()["question"]["id"], yes=True)
    assert page.finished()["recording"]["state"] == "complete"


def test_leds_that_are_listed_as_dead_are_left_out(tmp_path: Path) -> None:
    rig = LitRig(dead=(2,))
    with served(rig, tmp_path) as made:
        shown(made)
        assert light(made, 2) == (422, "LED 2 is listed as dead in the rig file")
        made.do(do="record", object="owl", check=False)
        state = made.finished()
        assert state["recording"]["state"] == "complete"
        assert any("LED 2 skipped" in line["text"] for line in state["recording"]["lines"])
    events = Session.open(tmp_path / "owl").events
    assert [one.details["leds"] for one in events if one.event == "left_out"] == [[2]]
    rig.close()


# Any thread at any time.


def hammered(made: Served, random_: random.Random) -> None:
    """Do something that a page or a program may do at any time."""
    leds = [random_.randrange(6) for _ in range(random_.randrange(4))]
    mode = random_.choice(("one", "cycle", "all"))
    exposure_us = random_.choice((100.0, 5000.0, 20_000.0, 1e12))

    def patience(rig: Rig, desk: Desk) -> None:
        for step in range(random_.randrange(5)):
            rig.shoot(random_.randrange(6), 1000.0)
            desk.progress("waiting", step, 5)

    actions: list[Callable[[], object]] = [
        made.station.attend,
        lambda: made.station.light(Light(mode, tuple(leds), exposure_us)),
        lambda: made.station.look_at(Region(*(random_.randrange(1, 80) for _ in range(4)))),
        lambda: made.station.look_at(None),
        lambda: made.station.pause(random_.random() < 0.3),
        lambda: made.station.stop("a test"),
        lambda: made.station.request("waiting", patience),
        lambda: made.desk.answer(random_.randrange(5), random_.random() < 0.5),
        lambda: made.desk.sheet.write(random_.choice((NINE, "leds = ", ""))),
        lambda: made.do(do="meter", each=random_.random() < 0.5),
        lambda: made.do(do="check"),
        lambda: made.do(do="record", object=str(random_.randrange(100)), check=False),
        lambda: made.do(do="resume"),
        lambda: json.dumps(made.station.state(), allow_nan=False),
        lambda: made.get(f"{WHOLE}0"),
    ]
    with suppress(BusyError, ValueError):  # refusals are answers
        random_.choice(actions)()


def test_any_thread_may_do_anything_at_any_time(rig: LitRig, tmp_path: Path) -> None:
    errors: list[BaseException] = []
    ends_s = time.monotonic() + 3

    def hammer(seed: int) -> None:
        random_ = random.Random(seed)
        try:
            while time.monotonic() < ends_s:
                hammered(made, random_)
                time.sleep(random_.uniform(0, 0.02))
        except BaseException as error:  # noqa: BLE001 - the test looks at it
            errors.append(error)

    with served(rig, tmp_path) as made:
        shown(made)
        threads = [threading.Thread(target=hammer, args=(seed,)) for seed in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(LIMIT_S)
        made.station.stop("a test")
        made.finished()
        stopped_ns = time.monotonic_ns()
        time.sleep(0.2)
        assert rig.lit_since(stopped_ns) == set()
        assert light(made, 5) == (200, "")
        until(lambda: shown(made)["live"]["frame"]["leds"] == [5])
    assert made.errors == errors == []
    assert rig.lit() is None
    assert made.station.current_light == Light("one", (5,), FIRST.exposure_us)
