"""The proof of a frame: clocks, reports and signs of life, with a simulated clock."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rig import (
    BoardError,
    CameraError,
    CameraFrame,
    CameraInfo,
    FrameTimeoutError,
    RigConfig,
    RigError,
)
from rig.board import BoardIdentity, FlashReport
from rig.shooting import ShotTimes, Wires, frame_proof, shooting
from rig.shooting import keep_alive as alive
from rig.shooting.frame_proof import FlashChain, Spacing
from rig.shooting.keep_alive import SignOfLife
from rig.shooting.sequence import runs
from rig.shooting.shooting import Bench, check_light, hold_ms, try_wires
from rig.shooting.shot import led_name

IDENTITY = BoardIdentity("fake", 2, "1", 6, 10_000, 1000, 48)
INFO = CameraInfo("m", "e", "cam", 1, 1, "Mono8", 8, None, 1.0, 1e7)


class Clock:
    """A monotonic clock that advances only during sleep."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in (alive, frame_proof, shooting):
        monkeypatch.setattr(module, "clock", clock)
    return clock


def frame(time_us: float, frame_id: int = 0) -> CameraFrame:
    pixels = np.zeros((1, 1), np.uint16)
    return CameraFrame(pixels, frame_id, round((time_us + 1e6) * 1000), 1.0, 0.0, None)


def test_signs_of_life_are_sent_five_times_a_second(clock: Clock) -> None:
    sent_s: list[float] = []
    sign = SignOfLife(lambda: sent_s.append(clock.now_s))
    sign.sleep_until(101.01)
    assert clock.now_s == pytest.approx(101.01)
    assert max(clock.slept) <= 0.05
    np.testing.assert_allclose(np.diff([100.0, *sent_s]), 0.2, atol=0.051)
    assert len(sent_s) in (4, 5)
    # Until a time in the past, nothing is due and there is no wait.
    sent_s.clear()
    slept = len(clock.slept)
    SignOfLife(lambda: sent_s.append(clock.now_s)).sleep_until(50.0)
    assert (sent_s, len(clock.slept)) == ([], slept)


def test_an_unanswered_sign_of_life_ends_the_wait(clock: Clock) -> None:
    def unplugged() -> None:
        raise BoardError("unplugged")

    with pytest.raises(BoardError, match="unplugged"):
        SignOfLife(unplugged).sleep_until(200.0)
    assert clock.now_s < 100.3


# 300 us, and 1 % of the 50 ms between the triggers.
@pytest.mark.parametrize(
    ("off_us", "proven"), [(0, True), (800, True), (801, False), (-800, True), (-801, False)]
)
def test_the_tolerance_of_a_frame_of_a_run(off_us: float, proven: bool) -> None:
    spacing = Spacing("cam")
    spacing.check(frame(0), 0, 7000)
    with (
        nullcontext()
        if proven
        else pytest.raises(CameraError, match=r"frame 0, the step of LED 1,.* 50000 us apart")
    ):
        spacing.check(frame(50_000 + off_us), 1, 57_000)


@pytest.mark.parametrize(
    ("second_us", "third_us", "said"),
    [
        pytest.param(50_000, 100_000, None, id="as the board"),
        pytest.param(50_000, 100_700, None, id="off by less than one step allows"),
        # Off by 200 us from the first frame and by 900 us from the previous one.
        pytest.param(49_300, 100_200, r"50900 us after frame 1", id="off from the previous"),
        # Each of two steps of 0.79 ms is within its tolerance, but not both together.
        pytest.param(50_790, 101_580, r"101580 us after frame 0", id="off from the first"),
    ],
)
def test_a_frame_is_compared_with_the_previous_and_the_first_one(
    second_us: float, third_us: float, said: str | None
) -> None:
    spacing = Spacing("cam")
    spacing.check(frame(0, 0), 0, 0)
    spacing.check(frame(second_us, 1), 1, 50_000)
    with nullcontext() if said is None else pytest.raises(CameraError, match=said):
        spacing.check(frame(third_us, 2), 2, 100_000)


def test_other_earlier_frames_do_not_count() -> None:
    """It is off by 1350 us, more than the 1300 us of two steps; the first and last are close."""
    spacing = Spacing("cam")
    for number, off_us in enumerate((0, -700, 0, 650)):
        spacing.check(frame(50_000 * number + off_us, number), number, 50_000 * number)


EXPOSURE = ShotTimes(2000, 5000.0, 45_000.0, 50_000.0)  # a margin of 1400 us


# 300 us, and 1 % of the 50 ms between the triggers. After 200 ms the clocks are uncertain by
# 2300 us, but the margin of the light is 1400 us.
@pytest.mark.parametrize(
    ("after_us", "off_us", "proven"),
    [
        *((50_000, 0, True), (50_000, 800, True), (50_000, 801, False)),
        *((50_000, -800, True), (50_000, -801, False)),
        *((200_000, 1399, True), (200_000, 1401, False)),
    ],
)
def test_the_tolerance_of_the_second_flash(after_us: int, off_us: float, proven: bool) -> None:
    chain = FlashChain("cam")
    chain.begin(frame(0))
    with nullcontext() if proven else pytest.raises(CameraError, match="something else triggered"):
        chain.check(frame(after_us + off_us), 7, after_us, EXPOSURE)


def test_a_known_rate_narrows_the_tolerance() -> None:
    """After a minute of a clock 0.4 % fast the rate is known to 600 us in a minute, and 0.01 %."""
    chain, rate = FlashChain("cam"), 1.004
    chain.begin(frame(0))
    for k in range(1, 1201):
        chain.check(frame(k * rate * 50_000), 7, 50_000, EXPOSURE)
    open_us = 300 + 50_000 * (600 / (1200 * 50_000) + 1e-4)
    last_us = 1200 * rate * 50_000
    with pytest.raises(CameraError):
        chain.check(frame(last_us + rate * 50_000 + open_us + 2), 7, 50_000, EXPOSURE)
    chain.begin(frame(0))  # a new chain knows nothing of the rate
    chain.check(frame(50_000 + open_us + 2), 7, 50_000, EXPOSURE)


@pytest.mark.parametrize(("off_us", "proven"), [(334, True), (336, False), (-336, False)])
def test_the_tolerance_after_a_second_of_flashes(off_us: float, proven: bool) -> None:
    """300 us, 600 us in the second for which the rate is known, and 0.01 % of drift."""
    chain = FlashChain("cam")
    chain.begin(frame(0))
    for k in range(1, 21):
        chain.check(frame(k * 50_000), 7, 50_000, EXPOSURE)
    with nullcontext() if proven else pytest.raises(CameraError, match="something else triggered"):
        chain.check(frame(1_050_000 + off_us), 7, 50_000, EXPOSURE)


def test_a_rate_that_is_not_known_well_does_not_count() -> None:
    """The first flash is 800 us late and the second 800 us early: both are within 1 %."""
    chain = FlashChain("cam")
    chain.begin(frame(0))
    chain.check(frame(50_800), 7, 50_000, EXPOSURE)
    chain.check(frame(100_000), 7, 50_000, EXPOSURE)


def test_a_chain_reaches_exactly_as_far_as_the_margin(clock: Clock) -> None:
    """The margin is 300 us and 1 % of 105 ms: a pause of 62.5 ms and a period of 42.5 ms."""
    times = replace(EXPOSURE, period_us=42_500.0)
    chain = FlashChain("cam")
    chain.begin(frame(0))
    clock.now_s += 0.0625
    assert chain.reaches(times)


def test_a_chain_reaches_as_far_as_the_margin(clock: Clock) -> None:
    """The uncertainty reaches the margin of 1400 us after 110 ms, including one future period."""
    chain = FlashChain("cam")
    assert not chain.reaches(EXPOSURE)
    chain.begin(frame(0))
    clock.now_s += 0.064
    assert chain.reaches(EXPOSURE)
    clock.now_s += 0.002
    assert not chain.reaches(EXPOSURE)
    chain.begin(frame(0))
    chain.cut()
    assert not chain.reaches(EXPOSURE)
    with pytest.raises(CameraError, match="the board has restarted"):
        chain.check(frame(1), 7, 1, EXPOSURE)


@pytest.mark.parametrize(
    ("count", "most", "lengths"),
    [
        pytest.param(0, 48, [], id="no LED"),
        pytest.param(1, 48, [1], id="one"),
        pytest.param(48, 100, [48], id="the longest run"),
        pytest.param(49, 100, [24, 25], id="one more"),
        pytest.param(49, 48, [24, 25], id="one more than the board holds"),
        pytest.param(36, 10, [9, 9, 9, 9], id="a small board"),
        pytest.param(5, 2, [1, 2, 2], id="two at a time"),
        pytest.param(3, 0, [1, 1, 1], id="a board that reports 0 steps"),
    ],
)
def test_runs_are_few_and_even(count: int, most: int, lengths: list[int]) -> None:
    parts = list(runs(tuple(range(count)), most))
    assert [led for part in parts for led in part] == list(range(count))
    assert sorted(map(len, parts)) == sorted(lengths)


def test_the_first_gaps_of_a_run_are_longer() -> None:
    """The second by 5 % and at least 5 ms, the first by twice as much: of 60 ms and of 400 ms."""
    for run_us, longer_us in ((60_000.0, 5000), (400_000.0, 20_000)):
        exposure = ShotTimes(2000, 5000.0, 45_000.0, run_us)
        steps = list(exposure.steps((3, None, 5, 0)))
        lit_us = exposure.ahead_us + exposure.hold_us
        assert [step.led for step in steps] == [3, None, 5, 0]
        assert {(step.settle_us, step.hold_us) for step in steps} == {
            (exposure.ahead_us, exposure.hold_us)
        }
        gap_us = run_us - lit_us
        gaps_us = [gap_us + 2 * longer_us, gap_us + longer_us, gap_us, 0]
        assert [step.gap_us for step in steps] == gaps_us
    # A light longer than the period leaves no gap but the first two.
    longest = ShotTimes(2000, 90_000.0, 45_000.0, 50_000.0)
    assert [step.gap_us for step in longest.steps((1, 2, 3, 4))] == [10_000, 5000, 0, 0]


@pytest.mark.parametrize(("run_us", "slow"), [(905_000.0, False), (925_000.0, True)])
def test_a_camera_too_slow_for_a_sequence_is_refused(run_us: float, slow: bool) -> None:
    """A gap is at most a second, the first one 10 % longer than the later ones."""
    exposure = ShotTimes(0, 10.0, 20.0, run_us)
    if not slow:
        assert len(list(exposure.steps((0, 1)))) == 2
        return
    with pytest.raises(RigError, match=r"only one frame every 0.93 s, which is too slow"):
        list(exposure.steps((0, 1)))


@pytest.mark.parametrize(
    ("readout_us", "period_us", "config_ms", "expected"),
    [
        # Delay 100, exposure 1000: needed, period, and the time from trigger to trigger in a run.
        pytest.param(0, 0, 0, (1100, 1100, 101_100), id="nothing is stated"),
        pytest.param(5000, 0, 0, (6100, 6100, 106_100), id="a rolling shutter"),
        pytest.param(0, 40_000, 0, (1100, 40_000, 40_000), id="the camera states it"),
        pytest.param(0, 40_000, 55, (1100, 55_000, 55_000), id="the rig file is slower"),
        pytest.param(0, 40_000, 20, (1100, 40_000, 40_000), id="the camera is slower"),
        pytest.param(60_000, 40_000, 0, (61_100, 61_100, 61_100), id="the exposure is longer"),
    ],
)
def test_the_times_of_an_exposure(
    readout_us: float, period_us: float, config_ms: float, expected: tuple[float, float, float]
) -> None:
    info = CameraInfo(
        "m", "e", "cam", 1, 1, "Mono8", 8, None, 1.0, 1e7,
        readout_us=readout_us, trigger_delay_us=100.0, frame_period_us=period_us,
    )  # fmt: skip
    config = RigConfig(name="r", driver="fake", leds=1, settle_ms=3.2, frame_period_ms=config_ms)
    exposure = ShotTimes.of(info, config, 1000.0)
    needed_us, least_us, run_us = expected
    assert exposure.needed_us == needed_us
    assert exposure.period_us == least_us
    assert exposure.run_us == pytest.approx(1.01 * run_us + 300)
    assert exposure.settle_us == 3200
    assert exposure.ahead_us == max(3200, math.ceil(exposure.margin_us))
    assert ShotTimes(2_000_000, 1.0, 1.0, 1.0).ahead_us == 1_000_000
    # A margin of 1400.67 us, in whole microseconds.
    assert ShotTimes(0, 1.0, 45_033.3, 1.0).ahead_us == 1401


def test_a_flash_that_is_too_long_for_the_board_is_refused() -> None:
    exposure = ShotTimes(0, 9_000_000.0, 45_000.0, 50_000.0)
    most_ms = math.ceil((exposure.ahead_us + exposure.hold_us) / 1000)
    exposure.check(BoardIdentity("fake", 2, "1", 6, most_ms, 1000, 48))
    with pytest.raises(RigError, match=r"needs light for 9093 ms .* 9092 ms"):
        exposure.check(BoardIdentity("fake", 2, "1", 6, most_ms - 1, 1000, 48))


def bench(
    *, exposure_active: bool = False, shutter: str = "global", camera: object = None
) -> Bench:
    info = CameraInfo("m", "e", "cam", 1, 1, "Mono8", 8, None, 1.0, 1e7, shutter=shutter)  # type: ignore[arg-type]
    config = RigConfig(
        name="r", driver="fake", leds=6, exposure_active=exposure_active, frame_timeout_s=2.0
    )
    board = SimpleNamespace(port="fake", identity=IDENTITY)
    return Bench(board, camera or SimpleNamespace(info=info), config)  # type: ignore[arg-type]


LIT = EXPOSURE.ahead_us + 5000
GLOBAL = {"exposure_active": True}
ROLLING = {"exposure_active": True, "shutter": "rolling"}


@pytest.mark.parametrize(
    ("led", "report", "wired", "said"),
    [
        pytest.param(3, (3, LIT, None, False), {}, None, id="lit to the end"),
        pytest.param(3, (3, LIT - 1, None, False), {}, "for 4999 us of the 5000", id="too short"),
        pytest.param(3, (3, 100, None, False), {}, "for 0 us of the 5000 us", id="much too short"),
        pytest.param(3, (4, LIT, None, False), {}, "the board turned on LED 4", id="another LED"),
        pytest.param(3, (None, LIT, None, False), {}, "the board turned on no LED", id="no LED"),
        pytest.param(None, (3, LIT, None, False), {}, "the board turned on LED 3", id="not dark"),
        pytest.param(None, (None, 0, None, False), {}, None, id="dark"),
        pytest.param(3, (3, LIT, None, False), GLOBAL, "was not seen", id="a wire is off"),
        pytest.param(None, (None, 0, None, False), GLOBAL, "was not seen", id="in the dark too"),
        pytest.param(3, (3, LIT - 1, 4990, False), GLOBAL, None, id="seen to end in time"),
        pytest.param(3, (3, LIT, 4990, True), GLOBAL, "the LED was on", id="cut off"),
        pytest.param(3, (3, LIT - 1, 4990, False), ROLLING, "for 4999 us", id="a rolling shutter"),
        pytest.param(3, (3, LIT, 4990, False), ROLLING, None, id="rolling, long enough"),
        pytest.param(3, (3, LIT, None, True), {}, "the LED was on", id="cut off, not wired"),
    ],
)
def test_the_light_is_checked_by_the_boards_report(
    led: int | None,
    report: tuple[int | None, int, int | None, bool],
    wired: dict[str, object],
    said: str | None,
) -> None:
    lit, lit_us, active_us, cut_off = report
    flash = FlashReport(1, lit, 50_000, lit_us, active_us, cut_off)
    if said is None:
        check_light(bench(**wired), led, EXPOSURE, flash)  # type: ignore[arg-type]
        return
    with pytest.raises(BoardError, match=said) as caught:
        check_light(bench(**wired), led, EXPOSURE, flash, "the light")  # type: ignore[arg-type]
    assert "flash of the light" in str(caught.value)


def test_a_hold_that_is_too_long_for_the_board_is_refused() -> None:
    """Settling, 101 % of the exposure, 300 us for the clocks, and 4000 ms for repetitions."""
    longest_us = (10_000 - 4000 - 0.3 - 2) * 1000 / 1.01
    assert hold_ms(bench(), ShotTimes(2000, longest_us - 1, 1.0, 1.0)) == 10_000
    with pytest.raises(RigError, match=r"10000 ms, but the LED board on fake allows 10000"):
        hold_ms(bench(), ShotTimes(2000, longest_us + 1, 1.0, 1.0))
    assert hold_ms(bench(), ShotTimes(2000, 1000.0, 1.0, 1.0)) == math.ceil(
        2 + 1.01 + 0.3 + 4000 + 2000
    )


@pytest.mark.parametrize("comes", [True, False])
@pytest.mark.parametrize("active_us", [None, 4990])
def test_wires_are_tested_with_one_flash(clock: Clock, comes: bool, active_us: int | None) -> None:
    done: list[object] = []

    class Camera:
        info = INFO

        def expect(self) -> int:
            done.append(("expect", clock.now_s))
            return 7

        def fetch(self, frame_id: int, timeout_s: float) -> None:
            done.append(("fetch", frame_id, timeout_s))
            if not comes:
                raise FrameTimeoutError("no frame")

    def flash(led: int, ahead_us: int, hold_us: int) -> FlashReport:
        done.append(("flash", led, ahead_us, hold_us))
        clock.now_s += 0.5
        return FlashReport(1, led, None, LIT, active_us, False)

    tried = bench(camera=Camera())
    tried.board.flash = flash  # type: ignore[method-assign]
    tried.ready_s = 100.25
    assert try_wires(tried, 3, EXPOSURE) == Wires(comes, active_us is not None)
    assert done == [
        ("expect", 100.25),
        ("flash", 3, EXPOSURE.ahead_us, EXPOSURE.hold_us),
        ("fetch", 7, 2.0),
    ]
    assert tried.ready_s == pytest.approx(100.75 + 0.045)
    tried.board.identity = BoardIdentity("fake", 2, "1", 6, 5, 1000, 48)  # type: ignore[misc]
    with pytest.raises(RigError, match="longer than the 5 ms"):
        try_wires(tried, 3, EXPOSURE)


def test_names_of_leds() -> None:
    assert (led_name(0), led_name(35), led_name(None)) == ("LED 0", "LED 35", "no LED")


@pytest.mark.parametrize(("bits", "white_dn"), [(8, 255), (12, 4095), (16, 65_535)])
def test_the_white_value_follows_from_the_bits(bits: int, white_dn: int) -> None:
    assert replace(INFO, bit_depth=bits).white_dn == white_dn
