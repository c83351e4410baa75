"""Sequences: every yielded frame is proven, and a frame that cannot be proven ends the run."""

import contextlib
import itertools
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import BoardError, CameraError, CameraFrame, CameraInfo, RigConfig, RigError
from rig.host import clock
from rig.shooting import ShotTimes
from rig.shooting.frame_proof import Spacing
from rig.shooting.sequence import runs
from simulator.led_board import BoardFault
from tests.cases import cases
from tests.rig.conftest import led_on, led_seen

EXPOSURE_US = 1000.0
FAST = {"frame_period_ms": 20.0, "frame_timeout_s": 0.3, "settle_ms": 1.0}


def taken(rig, leds, into):
    for shot in rig.sequence(leds, EXPOSURE_US):
        into.append(shot)


def test_every_shot_of_a_sequence_has_its_led(each_bench):
    leds = [*range(0, 36, 3), None, 7, 7]
    with each_bench.rig(**FAST) as rig:
        shots = list(rig.sequence(leds, EXPOSURE_US))
        assert led_on(each_bench) is None
        after = rig.shoot(4, EXPOSURE_US)
    assert [shot.led for shot in shots] == leds
    assert [led_seen(shot.frame) for shot in shots] == leds
    assert [shot.echo.led for shot in shots] == leds
    ids = [shot.frame.frame_id for shot in shots]
    assert ids == list(range(ids[0], ids[0] + len(leds)))
    assert led_seen(after.frame) == 4


@pytest.mark.parametrize("leds", [[], [5], [None], [5, 6]])
def test_short_sequences(bench, leds):
    with bench.rig(**FAST) as rig:
        shots = list(rig.sequence(leds, EXPOSURE_US))
    assert [led_seen(shot.frame) for shot in shots] == leds


def test_two_frames_do_not_prove_each_other(bench):
    """A lost first trigger and a stray pulse after the first gap look like a run of two."""
    with bench.rig(**FAST) as rig:
        list(rig.sequence([1, 2, 3], EXPOSURE_US))
        first, second = (pulse.time_ns for pulse in bench.state.triggers()[-3:-1])
        bench.virtual.set_faults(
            BoardFault(kind="lose-trigger"),
            BoardFault(kind="double-trigger", skip=1, value=(second - first) // 1000),
        )
        shots = []
        with contextlib.suppress(RigError):
            taken(rig, [5, 9], shots)
    assert [led_seen(shot.frame) for shot in shots] == [5, 9][: len(shots)]


def test_a_board_with_few_steps_runs_in_parts(bench):
    leds = list(range(11))
    with bench.rig(**FAST) as rig:
        rig.board.identity = replace(rig.board.identity, max_steps=4)
        assert [led_seen(shot.frame) for shot in rig.sequence(leds, EXPOSURE_US)] == leds


@cases(
    ("fault", "proven"),
    {
        "first trigger lost": (BoardFault(kind="lose-trigger"), 0),
        "a trigger lost": (BoardFault(kind="lose-trigger", skip=3), 3),
        "last trigger lost": (BoardFault(kind="lose-trigger", skip=9), 9),
        "first trigger twice": (BoardFault(kind="double-trigger", value=5000), 0),
        "trigger twice": (BoardFault(kind="double-trigger", skip=3, value=5000), 4),
        "other LED": (BoardFault(kind="wrong-led", verb="STEP", skip=2, value=30), 0),
        "dark too early": (BoardFault(kind="goes-dark", verb="RUN", value=1), 0),
        "reset": (BoardFault(kind="reset", verb="DID", skip=4), 4),
        "reset at the start": (BoardFault(kind="reset", verb="RUN"), 0),
    },
)
def test_a_fault_of_the_board_ends_the_run_after_the_proven_frames(bench, fault, proven):
    shots = []
    leds = list(range(10))
    with bench.rig(**FAST) as rig:
        bench.virtual.set_faults(fault)
        with pytest.raises(RigError) as error:
            taken(rig, leds, shots)
        bench.virtual.set_faults()
        assert led_on(bench) is None
        assert "\n" not in str(error.value)
        assert [led_seen(shot.frame) for shot in shots] == leds[: len(shots)]
        assert len(shots) <= proven
        # The third frame proves the first two; a step may be queried more than once.
        assert len(shots) >= (proven - 1 if fault.verb != "DID" else 0)
        # Remaining frames are not mistaken for those of the next run.
        assert [led_seen(s.frame) for s in rig.sequence([20, 21, 22], EXPOSURE_US)] == [20, 21, 22]


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(BoardFault(kind=kind, verb=verb, skip=skip, times=times), id=f"{kind} {verb}")
        for kind, verb, skip, times in [
            ("drop-command", "STEP", 1, 1),
            ("drop-reply", "RUN", 0, 1),
            ("double-command", "RUN", 0, 1),
            ("corrupt-reply", "DID", 2, 2),
            ("drop-reply", "DID", 1, 1),
            ("double-reply", None, 2, 3),
            ("banner", "STATUS", 0, 1),
        ]
    ],
)
def test_a_noisy_serial_line_loses_no_frame(bench, fault):
    leds = list(range(8))
    with bench.rig(**{**FAST, "frame_period_ms": 60.0, "frame_timeout_s": 2.0}) as rig:
        bench.virtual.set_faults(fault)
        assert [led_seen(shot.frame) for shot in rig.sequence(leds, EXPOSURE_US)] == leds


@pytest.mark.parametrize("fault", ["lost", "late", "unplug"])
@pytest.mark.parametrize("at", [0, 1, 5])
def test_a_fault_of_the_camera_names_led_and_frame(bench, fault, at):
    shots = []
    leds = list(range(10, 18))
    with contextlib.suppress(CameraError), bench.rig(faults={at: fault}, **FAST) as rig:
        with pytest.raises(CameraError) as error:
            taken(rig, leds, shots)
        assert led_on(bench) is None
        assert [led_seen(shot.frame) for shot in shots] == leds[: max(0, at if at > 1 else 0)]
        if fault != "unplug":
            assert f"frame {at} " in str(error.value)
            assert f"LED {leds[at]}" in str(error.value)
            assert [led_seen(s.frame) for s in rig.sequence([3, 4], EXPOSURE_US)] == [3, 4]


def test_closing_the_iterator_turns_the_led_off(each_bench):
    with each_bench.rig(**FAST) as rig:
        shots = rig.sequence(range(36), EXPOSURE_US)
        next(shots)
        shots.close()
        assert led_on(each_bench) is None
        before = each_bench.state.changes
        clock.sleep(0.1)
        assert each_bench.state.changes == before
        assert rig.board.status().state == "IDLE"
        assert led_seen(rig.shoot(3, EXPOSURE_US).frame) == 3


def test_a_caller_that_pauses_too_long_stops_the_run(bench):
    with bench.rig(**{**FAST, "frame_period_ms": 200.0}) as rig:
        shots = rig.sequence(range(20), EXPOSURE_US)
        next(shots)
        clock.sleep(2.0)
        with pytest.raises(RigError, match=r"stopped by itself, because .* sign of life"):
            list(shots)
        assert led_on(bench) is None


def test_an_impossible_sequence_is_refused_before_an_led_is_on(bench):
    with bench.rig(dead_leds=(4,), **FAST) as rig:
        before = bench.state.changes
        for leds, exposure_us, said in [
            ([3, 4], EXPOSURE_US, "LED 4 .* dead"),
            ([3, 36], EXPOSURE_US, "no LED 36"),
            ([3, 5], 1.0, "range of"),
        ]:
            with pytest.raises(RigError, match=said):
                list(rig.sequence(leds, exposure_us))
        rig.board.identity = replace(rig.board.identity, max_hold_ms=500)
        with pytest.raises(RigError, match="500 ms that this LED board allows"):
            list(rig.sequence([3, 5], 600_000))
        assert bench.state.changes == before


@given(st.integers(0, 300), st.integers(1, 100))
def test_runs_are_complete_and_avoid_single_shots(count, most):
    leds = tuple(range(count))
    parts = list(runs(leds, most))
    assert sum(parts, ()) == leds
    assert all(len(part) <= min(most, 48) for part in parts)
    if most >= 3 and count >= 2:
        assert all(len(part) >= 2 for part in parts)


@given(
    st.floats(0, 1000),
    st.floats(10, 1e6),
    st.floats(0, 2e5),
    st.integers(2, 48),
)
def test_the_first_gaps_are_longer_on_any_clock(settle_ms, exposure_us, period_us, count):
    exposure = ShotTimes(
        round(settle_ms * 1000), exposure_us, period_us, max(period_us, exposure_us) * 1.01 + 300
    )
    steps = list(exposure.steps(tuple(range(count))))
    spacing = [step.settle_us + step.hold_us + step.gap_us for step in steps[:-1]]
    assert all(each >= exposure.run_us - 1 for each in spacing)
    for one, other in (*pairwise(spacing[:3]), *((spacing[0], later) for later in spacing[1:])):
        # Twice the tolerance of the clocks, so that one is not mistaken for the other.
        assert one - other >= 2 * (300 + 0.01 * one) or one - other >= 4990


@given(
    st.floats(10, 5e6),
    st.floats(0, 1e6),
    st.floats(0, 1e5),
    st.floats(0, 1000),
    st.sampled_from([-0.01, -0.005, 0.0, 0.005, 0.01]),
)
def test_the_light_outlasts_the_exposure_on_any_clock(
    exposure_us, frame_period_us, delay_us, settle_ms, rate
):
    """The board's clock may be 1 % off; an exposure is accepted up to the margin from its trigger.

    Times are on the camera's clock: a board with a fast clock turns its LED off early.
    """
    info = CameraInfo(
        "m", "e", "1", 8, 8, "Mono8", 8, None, 1.0, 1e7,
        trigger_delay_us=delay_us, readout_us=30_000.0, frame_period_us=frame_period_us,
    )  # fmt: skip
    config = RigConfig(name="r", driver="fake", leds=1, settle_ms=settle_ms)
    exposure = ShotTimes.of(info, config, exposure_us)
    last_row_us = delay_us + exposure_us + 30_000.0
    lit_us = exposure.hold_us / (1 + rate)
    # Clocks that differ by 1 % change the margin itself by 1 %.
    assert lit_us >= last_row_us + 0.99 * exposure.margin_us
    # The jitter of the clocks, and 1 % of two periods and the time between two flashes.
    period_us = max(frame_period_us, last_row_us)
    assert exposure.margin_us == pytest.approx(300 + 0.01 * (2 * period_us + 20_000))
    assert exposure.ahead_us >= min(max(settle_ms * 1000, exposure.margin_us), 1e6)
    # Triggers of a sequence are not faster than the camera, even if the board's clock is fast.
    assert exposure.run_us / (1 + rate) >= period_us


def frame(number, time_us):
    return CameraFrame(np.zeros((1, 1), np.uint16), number, round(time_us * 1000), 1.0, 0.0, None)


PULSES_US = [2000, 62_000, 117_000, 167_000, 217_000, 267_000]


@pytest.mark.parametrize("rate", [0.995, 1.0, 1.005])
@pytest.mark.parametrize("offset_us", [0.0, 1e9])
def test_clocks_of_other_rates_agree(rate, offset_us):
    spacing = Spacing("cam")
    for number, pulse_us in enumerate(PULSES_US):
        spacing.check(frame(number, offset_us + rate * pulse_us), number, pulse_us)


@pytest.mark.parametrize("missed", range(5))
def test_a_missed_trigger_is_detected_at_any_place(missed):
    """There are frames for all pulses but one; the counts do not show this."""
    spacing = Spacing("cam")
    seen = [pulse for index, pulse in enumerate(PULSES_US) if index != missed]
    # One frame alone does not show the loss of the first.
    wrong = max(1, missed)
    for number in range(wrong):
        spacing.check(frame(number, seen[number]), number, PULSES_US[number])
    with pytest.raises(CameraError, match="the camera missed a trigger"):
        spacing.check(frame(wrong, seen[wrong]), wrong, PULSES_US[wrong])


@pytest.mark.parametrize(
    "seen",
    [
        pytest.param((PULSES_US[0] - 60_000, *PULSES_US), id="before the first"),
        pytest.param((PULSES_US[2] - 60_000, *PULSES_US[2:]), id="instead of the second"),
    ],
)
def test_the_third_frame_shows_a_stray_one_at_the_distance_of_the_first(seen):
    spacing = Spacing("cam")
    for number in range(2):
        spacing.check(frame(number, seen[number]), number, PULSES_US[number])
    with pytest.raises(CameraError, match="saw an extra one"):
        spacing.check(frame(2, seen[2]), 2, PULSES_US[2])


def test_one_frame_alone_is_not_proven():
    spacing = Spacing("cam")
    for number, pulse_us in itertools.islice(enumerate(PULSES_US), 1):
        spacing.check(frame(number, pulse_us), number, pulse_us)
    with pytest.raises(CameraError, match=r"exposed 0 us after frame 0, .* 60000 us apart"):
        spacing.check(frame(1, PULSES_US[0]), 1, PULSES_US[1])


def test_a_missing_report_of_the_board_is_an_error(bench, monkeypatch):
    with bench.rig(**FAST) as rig:
        monkeypatch.setattr(rig.board, "step_report", lambda index: None)
        with pytest.raises(BoardError, match="has not done step 0"):
            list(rig.sequence([1, 2, 3], EXPOSURE_US))
        assert led_on(bench) is None


def test_the_camera_paces_the_run_if_its_line_is_wired(bench):
    leds = list(range(6))
    with bench.rig(exposure_active=True, **FAST) as rig:
        shots = list(rig.sequence(leds, 5000.0))
    lit = bench.state.periods()[-6:]
    assert [period.led for period in lit] == leds
    for shot, period in zip(shots, lit, strict=True):
        end_ns = shot.frame.timestamp_ns + 5_000_000
        # The LED turned off at the end of the exposure, not of the hold.
        assert end_ns <= period.end_ns
        assert [led_seen(replace_pixels(shot)) for shot in shots] == leds


def replace_pixels(shot):
    """Return the frame as if it had been exposed for 1000 us."""
    return replace(shot.frame, pixels=shot.frame.pixels // 5)


def test_a_missing_wire_is_reported(bench):
    with bench.rig(exposure_active=True, **FAST) as rig:
        bench.virtual.set_faults(BoardFault(kind="lose-trigger"))
        with pytest.raises(RigError, match="LED 3") as error:
            list(rig.sequence([3, 4, 5], EXPOSURE_US))
        assert "Line0" in str(error.value)
        assert "the board stopped by itself" in str(error.value)
