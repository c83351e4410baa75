"""What single shots and sequences do when: board and camera on a simulated clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig import (
    BoardError,
    CameraError,
    CameraFrame,
    FrameLostError,
    FrameTimeoutError,
    RigConfig,
    RigError,
)
from rig.board import BoardEcho, FlashReport, Step, StepReport
from rig.shooting import ShotTimes, frame_proof, sequence, shooting
from rig.shooting import keep_alive as alive
from rig.shooting.frame_proof import time_ns
from rig.shooting.sequence import run
from rig.shooting.shooting import Bench, by_board, by_software, hold_ms
from tests.cases import cases
from tests.rig.test_shooting_values import IDENTITY, INFO, Clock, frame

# The LED is on for 2000 us before the trigger of a flash and 6450 us after it.
TIMES = ShotTimes(2000, 5000.0, 45_000.0, 50_000.0)
UNDERRUN = {"underrun": 1}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in (alive, frame_proof, sequence, shooting):
        monkeypatch.setattr(module, "clock", clock)
    return clock


class Devices:
    """Board and camera in one, with a log: what was done, when, and with which values."""

    port = "fake"
    identity = IDENTITY
    info = INFO

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.log: list[tuple[Any, ...]] = []
        self.ids = 0
        self.lit: int | None = None
        # Deviations of a test.
        self.seen_lit: Callable[[int | None], int | None] = lambda led: led
        self.waiting: Callable[[Callable[[], None]], None] = lambda alive: None
        self.failure: dict[int, Exception] = {}
        self.report: dict[str, Any] = {}
        self.frame: dict[str, Any] = {}
        self.state: Any = SimpleNamespace(led=None, state="RUN", done=2)
        self.unreported = 0
        # Times of the last trigger pulse and of a run.
        self.pulse_s: float | None = None
        self.began_s = 0.0
        self.steps: tuple[Step, ...] = ()

    def note(self, what: str, *values: Any) -> None:
        self.log.append((what, round(self.clock.now_s, 6), *values))

    def ping(self) -> None: ...

    def status(self) -> Any:
        if isinstance(self.state, Exception):
            raise self.state
        return replace_led(self.state, self.lit)

    def on(self, led: int, length_ms: int) -> None:
        self.note("on", led, length_ms)
        self.lit = led

    def off(self) -> BoardEcho:
        self.note("off")
        was_on, self.lit = self.lit, None
        return BoardEcho(9, self.seen_lit(was_on))

    def flash(self, led: int | None, ahead_us: int, hold_us: int) -> FlashReport:
        self.note("flash", led, ahead_us, hold_us)
        pulse_s = self.clock.now_s + ahead_us / 1e6
        since_us = None if self.pulse_s is None else round((pulse_s - self.pulse_s) * 1e6)
        self.pulse_s = pulse_s
        self.clock.now_s += (ahead_us + hold_us) / 1e6
        report = FlashReport(7, led, since_us, ahead_us + hold_us, None, False)
        return replace(report, **self.report)

    def load(self, steps: Iterable[Step]) -> None:
        self.steps = tuple(steps)
        self.note("load", len(self.steps))

    def run(self, count: int, pace: str) -> Any:
        self.note("run", count, pace)
        self.began_s = self.clock.now_s
        return SimpleNamespace(seq=7)

    def _pulse_us(self, index: int) -> int:
        before = sum(step.settle_us + step.hold_us + step.gap_us for step in self.steps[:index])
        return before + self.steps[index].settle_us

    def step_report(self, index: int) -> StepReport | None:
        if self.unreported:
            self.unreported -= 1
            return None
        step = self.steps[index]
        lit_us = step.settle_us + step.hold_us
        report = StepReport(index, step.led, self._pulse_us(index), lit_us, None, False)
        return replace(report, **self.report)

    def expect(self) -> int:
        self.ids += 1
        self.note("expect")
        return self.ids

    def trigger(self) -> int:
        self.note("trigger")
        self.ids += 1
        self.pulse_s = self.clock.now_s
        return self.ids

    def fetch(
        self, frame_id: int, timeout_s: float, alive: Callable[[], None] | None = None
    ) -> CameraFrame:
        self.note("fetch", frame_id, round(timeout_s, 6))
        if frame_id in self.failure:
            raise self.failure[frame_id]
        if self.steps:
            self.pulse_s = self.began_s + self._pulse_us(frame_id - 1) / 1e6
            self.clock.now_s = max(self.clock.now_s, self.pulse_s + 0.005)
        if alive is not None:
            self.waiting(alive)
        assert self.pulse_s is not None
        taken = frame(self.pulse_s * 1e6, frame_id)
        return replace(taken, **self.frame)


def replace_led(state: Any, led: int | None) -> Any:
    return SimpleNamespace(**{**vars(state), "led": led})


@pytest.fixture
def devices(clock: Clock) -> Devices:
    return Devices(clock)


def bench_of(devices: Devices, **changed: Any) -> Bench:
    config = RigConfig(name="r", driver="fake", leds=6, frame_timeout_s=2.0, **changed)
    return Bench(devices, devices, config)  # type: ignore[arg-type]


# ---------------------------------------------------------------- triggered by software


@pytest.mark.parametrize(
    ("now_s", "ready_s", "on_s", "trigger_s"),
    [
        pytest.param(100.0, 99.0, 100.0, 100.002, id="the camera is ready"),
        pytest.param(100.0, 100.001, 100.0, 100.002, id="ready before the light has settled"),
        pytest.param(100.0, 100.0015, 100.0, 100.002, id="ready almost with the light"),
        pytest.param(100.0, 100.5, 100.498, 100.5, id="ready later"),
        pytest.param(0.25, None, 0.25, 0.252, id="a new bench, just after the computer's start"),
    ],
)
@pytest.mark.parametrize("led", [3, None])
def test_a_shot_by_software(
    devices: Devices,
    now_s: float,
    ready_s: float | None,
    on_s: float,
    trigger_s: float,
    led: int | None,
) -> None:
    devices.clock.now_s, bench = now_s, bench_of(devices)
    if ready_s is not None:
        bench.ready_s = ready_s
    shot = by_software(bench, led, TIMES)
    assert devices.log == [
        # Settling, the exposure and 1 %, 300 us for the clocks, repetitions and the frame.
        ("off", on_s) if led is None else ("on", on_s, 3, 6008),
        ("trigger", trigger_s),
        ("fetch", trigger_s, 1, 2.005),
        ("off", trigger_s),
    ]
    assert bench.ready_s == pytest.approx(trigger_s + 0.045)
    assert (shot.led, shot.frame.frame_id, shot.echo) == (led, 1, BoardEcho(9, led))


HOLD_ENDS_S = 100.0 + 6006 / 1000


@pytest.mark.parametrize(
    ("alive_s", "until_s", "lit", "said"),
    [
        pytest.param([100.9], 101.8, 3, None, id="on all the time"),
        pytest.param([], 100.9995, None, "but no LED was on", id="off at once"),
        pytest.param([], 101.0, None, "too busy .* for up to 1.0 s", id="a second of silence"),
        pytest.param([101.0], 101.1, None, "too busy .* for up to 1.0 s", id="silence before"),
        pytest.param([100.9], 101.9, None, "too busy .* for up to 1.0 s", id="silence after"),
        pytest.param([], 102.0, 4, "LED 3 was requested, but LED 4 was on", id="other LED"),
        pytest.param("often", 106.0055, None, "but no LED was on", id="off before the hold ends"),
        pytest.param("often", HOLD_ENDS_S, None, "the hold of LED 3 ended", id="the hold ended"),
        pytest.param("often", 106.1, 4, "but LED 4 was on", id="other LED after the hold"),
    ],
)
def test_an_led_that_was_not_on_until_the_frame(
    devices: Devices, alive_s: Any, until_s: float, lit: int | None, said: str | None
) -> None:
    def waiting(alive: Callable[[], None]) -> None:
        often = [100 + tenth / 10 for tenth in range(1, 61)]
        for at_s in often if alive_s == "often" else alive_s:
            devices.clock.now_s = at_s
            alive()
        devices.clock.now_s = until_s

    devices.waiting, devices.seen_lit = waiting, lambda led: lit
    bench, times = bench_of(devices), replace(TIMES, settle_us=0)
    if said is None:
        assert by_software(bench, 3, times).led == 3
        return
    with pytest.raises(BoardError if "busy" not in said else FrameLostError, match=said):
        by_software(bench, 3, times)


def test_an_led_that_turns_off_ends_the_wait(devices: Devices) -> None:
    def waiting(alive: Callable[[], None]) -> None:
        devices.clock.now_s += 0.3
        devices.lit = None
        alive()
        raise AssertionError("waited on")

    devices.waiting = waiting
    with pytest.raises(BoardError, match="LED 3 was requested, but no LED was on"):
        by_software(bench_of(devices), 3, TIMES)


@pytest.mark.parametrize("shoot", [by_software, by_board])
def test_the_frame_of_another_trigger_is_refused(
    devices: Devices, shoot: Callable[..., object]
) -> None:
    devices.frame = {"frame_id": 5}
    with pytest.raises(FrameLostError, match=r"frame 5 for the shot with .* instead of frame 1"):
        shoot(bench_of(devices), 3, TIMES)


def test_the_longest_hold() -> None:
    bench = Bench(SimpleNamespace(identity=IDENTITY, port="fake"), Devices(Clock()), CONFIG)  # type: ignore[arg-type]
    assert hold_ms(bench, ShotTimes(2000, 1e6, 1.0, 1.0)) == 7013
    # Exactly as long as the board allows, and one microsecond more.
    assert hold_ms(bench, ShotTimes(5_998_690, 1000.0, 1.0, 1.0)) == 10_000
    with pytest.raises(RigError, match="expose shorter"):
        hold_ms(bench, ShotTimes(5_998_691, 1000.0, 1.0, 1.0))


CONFIG = RigConfig(name="r", driver="fake", leds=6, frame_timeout_s=2.0)


# ---------------------------------------------------------------- triggered by the board


def test_shots_by_the_board(devices: Devices) -> None:
    """A dark flash before the first one and after a pause, each as soon as the camera is ready."""
    bench = bench_of(devices)
    bench.ready_s = 100.25
    shots = [by_board(bench, 3, TIMES), by_board(bench, 4, TIMES)]
    # Each flash takes 8.45 ms, and at worst its trigger was 5 ms before its end.
    ready_s = [100.25 + k * (0.00845 - 0.005 + 0.045 - 0.002) for k in range(4)]
    lit = [None, 3, 4]
    for k, led in enumerate(lit):
        begin_s = ready_s[k] - 0.002
        assert devices.log[3 * k : 3 * k + 3] == [
            ("expect", pytest.approx(begin_s, abs=2e-6)),
            ("flash", pytest.approx(begin_s, abs=2e-6), led, 2000, 6450),
            ("fetch", pytest.approx(begin_s + 0.00845, abs=2e-6), k + 1, 2.0),
        ]
    assert len(devices.log) == 9
    assert bench.ready_s == pytest.approx(ready_s[3])
    assert [shot.led for shot in shots] == [3, 4]
    assert shots[0].echo == BoardEcho(7, 3, 8450, None)
    devices.clock.now_s += 10
    by_board(bench, 5, TIMES)
    assert [entry[2] for entry in devices.log if entry[0] == "flash"] == [None, 3, 4, None, 5]


@cases(
    ("failure", "said"),
    {
        "lost": (FrameTimeoutError("late"), r"^late; .* for LED 3: check the wire"),
        "computer too slow": (FrameTimeoutError("late", UNDERRUN), r"^late; [^:]* for LED 3$"),
        "camera": (CameraError("bad"), r"^bad; .* for LED 3: check the wire"),
    },
)
def test_a_failing_camera_is_reported_with_its_trigger(
    devices: Devices, failure: CameraError, said: str
) -> None:
    devices.failure = {2: failure}
    with pytest.raises(CameraError, match=said) as caught:
        by_board(bench_of(devices), 3, TIMES)
    assert type(caught.value) is type(failure)
    # The first flash, in the dark, is reported as such.
    devices.failure, devices.ids = {1: failure}, 0
    with pytest.raises(CameraError, match="for no LED, before LED 3"):
        by_board(bench_of(devices), 3, TIMES)


def test_an_unproven_flash_gives_no_frame(devices: Devices) -> None:
    bench = bench_of(devices)
    by_board(bench, 3, TIMES)
    for report, said in [
        ({"since_us": 60_000}, "something else triggered the camera"),
        ({"since_us": None}, "the board has restarted"),
        ({"led": 5}, "flash of no LED, before LED 3: the board turned on LED 5"),
    ]:
        devices.report = report
        with pytest.raises(RigError, match=said):
            by_board(bench, 3, TIMES)
    devices.identity = replace(IDENTITY, max_hold_ms=8)
    devices.log.clear()
    with pytest.raises(RigError, match="longer than the 8 ms"):
        by_board(bench, 3, TIMES)
    assert devices.log == []


def test_frames_need_a_time() -> None:
    assert time_ns(replace(frame(0.0), timestamp_ns=1), "cam") == 1
    with pytest.raises(CameraError, match="camera cam: frame 4 arrived without a time"):
        time_ns(CameraFrame(np.zeros((1, 1), np.uint16), 4, 0, 1.0, 0.0, None), "cam")


# ---------------------------------------------------------------- sequences

LEDS = (3, None, 5)
# 8.45 ms of light, and gaps of 51.55 and 46.55 ms.
LIT_S = [0.00845, 0.06845, 0.12345]
FRAME_S = [0.007, 0.067, 0.122]


def test_a_sequence(devices: Devices) -> None:
    bench = bench_of(devices)
    bench.ready_s = 100.5
    for shot in run(bench, LEDS, TIMES):
        devices.note("yields", shot.led, shot.frame.frame_id)
        assert shot.echo == BoardEcho(7, shot.led, 8450, None)
    start_s = 100.498
    timeouts_s = [LIT_S[0] + 2, LIT_S[1] - FRAME_S[0] + 2, LIT_S[2] - FRAME_S[1] + 2]
    entries = [
        ("load", -0.498, 3),
        *[("expect", 0.0)] * 3,
        ("run", 0.0, 3, "time"),
        ("fetch", 0.0, 1, timeouts_s[0]),
        # The first two frames are proven by the third.
        ("fetch", FRAME_S[0], 2, timeouts_s[1]),
        ("fetch", FRAME_S[1], 3, timeouts_s[2]),
        ("yields", FRAME_S[2], 3, 1),
        ("yields", FRAME_S[2], None, 2),
        ("yields", FRAME_S[2], 5, 3),
    ]
    assert [(what, round(at_s - start_s, 6), *rest) for what, at_s, *rest in devices.log] == [
        (what, round(at_s, 6), *(round(v, 6) if type(v) is float else v for v in rest))
        for what, at_s, *rest in entries
    ]
    # The last trigger was the complete exposure ago, at the latest.
    assert bench.ready_s == pytest.approx(start_s + FRAME_S[2] - 0.005 + 0.045)


def test_a_frame_may_be_awaited_after_a_pause(devices: Devices) -> None:
    for _ in run(bench_of(devices), (*LEDS, 7), TIMES):
        devices.clock.now_s += 0.5
    assert devices.log[-1][2:] == (4, 2.0)


@pytest.mark.parametrize(
    ("wired", "shutter", "pace"),
    [
        (False, "global", "time"),
        (False, "rolling", "time"),
        (True, "rolling", "time"),
        (True, "global", "exposure"),
    ],
)
def test_what_paces_a_sequence(devices: Devices, wired: bool, shutter: Any, pace: str) -> None:
    devices.info = replace(INFO, shutter=shutter)
    devices.report = {"active_us": 4990}
    list(run(bench_of(devices, exposure_active=wired), LEDS, TIMES))
    assert [entry[3] for entry in devices.log if entry[0] == "run"] == [pace]


@pytest.mark.parametrize("late_s", [0.0, 0.004])
def test_the_report_of_a_step_is_awaited_for_a_second(devices: Devices, late_s: float) -> None:
    """From the end of its light, or from its frame if that is later."""
    devices.unreported = 20
    assert len(list(run(bench_of(devices), LEDS, TIMES))) == 3
    devices.unreported, start_s = 10**6, devices.clock.now_s + 0.043
    bench = bench_of(devices)
    bench.ready_s, devices.ids = start_s + 0.002, 0
    devices.waiting = lambda alive: devices.clock.sleep(late_s)
    with pytest.raises(BoardError, match=r"not done step 0 .* continues after 2 steps; take"):
        list(run(bench, LEDS, TIMES))
    waited_s = devices.clock.now_s - start_s - max(LIT_S[0], FRAME_S[0] + late_s)
    assert 1.0 <= round(waited_s, 6) <= 1.002


FAILURES = {
    "lost": (
        FrameTimeoutError("late"),
        SimpleNamespace(state="HALT", done=1),
        (
            r"^late; it is step 1 of a sequence, with no LED; the board stopped by itself, .* "
            r"missing, after 1 step: check the wire"
        ),
    ),
    "computer too slow": (
        FrameTimeoutError("late", UNDERRUN),
        SimpleNamespace(state="IDLE", done=2),
        r"^late; it is step 1 [^:]*; the board is IDLE after 2 steps$",
    ),
    "camera and board": (
        CameraError("bad"),
        BoardError("gone"),
        r"^bad; it is step 1 .* with no LED, and the board does not answer \(gone\): check",
    ),
}


@pytest.mark.parametrize(("failure", "state", "said"), FAILURES.values(), ids=FAILURES)
def test_a_failing_camera_is_reported_with_its_step(
    devices: Devices, failure: CameraError, state: Any, said: str
) -> None:
    devices.failure, devices.state = {2: failure}, state
    with pytest.raises(CameraError, match=said) as caught:
        list(run(bench_of(devices), LEDS, TIMES))
    assert type(caught.value) is type(failure)


@pytest.mark.parametrize(
    ("frame_changed", "report_changed", "said"),
    [
        pytest.param({"frame_id": 9}, {}, "frame 9 for the step of LED 3 inst.* frame 1", id="id"),
        pytest.param({"timestamp_ns": 5}, {}, "the camera missed a trigger", id="time"),
        pytest.param({}, {"led": 1}, "flash of LED 3: the board turned on LED 1", id="light"),
        pytest.param({}, {"lit_us": 6999}, "for 4999 us of the 5000 us", id="dark too early"),
    ],
)
def test_an_unproven_step_ends_the_run(
    devices: Devices, frame_changed: dict[str, Any], report_changed: dict[str, Any], said: str
) -> None:
    devices.frame, devices.report = frame_changed, report_changed
    shots = run(bench_of(devices), LEDS, TIMES)
    with pytest.raises(RigError, match=said):
        next(shots)


def test_a_sequence_that_the_board_cannot_light_is_refused(devices: Devices) -> None:
    devices.identity = replace(IDENTITY, max_hold_ms=8)
    with pytest.raises(RigError, match="longer than the 8 ms"):
        list(run(bench_of(devices), LEDS, TIMES))
    assert devices.log == []
