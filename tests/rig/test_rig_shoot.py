"""Board and camera as one rig: the LED of every frame is known, and no LED stays on."""

import contextlib
import random
from dataclasses import replace

import numpy as np
import pytest

import rig.shooting.shooting
from rig import Board, BoardError, CameraError, CameraFrame, FrameLostError, RigError
from rig.host import clock
from rig.shooting import ShotTimes
from rig.shooting.frame_proof import FlashChain
from simulator.camera import VirtualCamera
from simulator.led_board import BoardFault
from tests.cases import cases
from tests.rig.conftest import led_on, led_seen

EXPOSURE_US = 1000.0
TRIGGERS = pytest.mark.parametrize("trigger", ["software", "board"])


@TRIGGERS
@pytest.mark.parametrize("led", [0, 7, 35, None])
def test_a_shot_has_its_led(bench, trigger, led):
    with bench.rig(trigger=trigger) as rig:
        shot = rig.shoot(led, EXPOSURE_US)
        assert led_on(bench) is None
    assert shot.led == led
    assert shot.echo.led == led
    assert led_seen(shot.frame) == led
    assert (shot.frame.exposure_us, shot.frame.gain_db) == (EXPOSURE_US, 0.0)


@TRIGGERS
def test_a_dark_frame_turns_off_an_led_that_was_left_on(each_bench, trigger):
    with each_bench.rig(trigger=trigger) as rig:
        rig.board.on(5, 5000)
        assert led_seen(rig.shoot(None, EXPOSURE_US).frame) is None


@TRIGGERS
def test_the_light_has_settled_before_the_exposure(bench, trigger):
    with bench.rig(trigger=trigger, settle_ms=40) as rig:
        shot = rig.shoot(3, EXPOSURE_US)
    lit = bench.state.periods()[-1]
    assert shot.frame.timestamp_ns - lit.start_ns >= 40_000_000
    assert lit.end_ns >= shot.frame.timestamp_ns + EXPOSURE_US * 1000


def test_the_frame_is_discarded_if_the_led_turns_off_too_early(each_bench):
    with each_bench.rig() as rig:
        each_bench.virtual.set_faults(BoardFault(kind="goes-dark", verb="ON", value=20))
        with pytest.raises(BoardError, match="LED 6 was requested, but no LED was on"):
            rig.shoot(6, 60_000)
        each_bench.virtual.set_faults()
        assert led_seen(rig.shoot(6, EXPOSURE_US).frame) == 6


@pytest.mark.parametrize("stalled_at", ["fetch", "trigger"])
def test_a_computer_that_is_too_busy_is_reported_and_the_shot_can_be_repeated(
    bench, monkeypatch, stalled_at
):
    with bench.rig(frame_timeout_s=3.0) as rig:
        real = getattr(rig.camera, stalled_at)
        stalls = iter([1.2, 0.0])

        def stalled(*words):
            clock.sleep(next(stalls))
            return real(*words)

        monkeypatch.setattr(rig.camera, stalled_at, stalled)
        with pytest.raises(FrameLostError, match=r"LED 6 .* too busy .* for up to \d\.\d s"):
            rig.shoot(6, EXPOSURE_US)
        assert led_on(bench) is None
        assert led_seen(rig.shoot(6, EXPOSURE_US).frame) == 6


def late(rig, monkeypatch, seconds):
    """Delay frames by this time."""
    fetch = rig.camera.fetch

    def fetch_late(frame_id, timeout_s, waiting=None):
        ends = clock.monotonic() + seconds
        while clock.monotonic() < ends:
            clock.sleep(0.02)
            if waiting is not None:
                waiting()
        return fetch(frame_id, timeout_s, waiting)

    monkeypatch.setattr(rig.camera, "fetch", fetch_late)


def test_a_frame_may_be_as_late_as_the_rig_file_allows(bench, monkeypatch):
    with bench.rig(frame_timeout_s=2.0) as rig:
        late(rig, monkeypatch, 1.9)
        assert led_seen(rig.shoot(6, EXPOSURE_US).frame) == 6


@pytest.mark.parametrize(
    ("settle_ms", "exposure_us", "frame_timeout_s", "hold_ms"),
    [
        # The exposure and 1 % for the clocks; ON and OFF up to 8 times each, 250 ms per time.
        pytest.param(4, 20_000, 2.0, 4 + 20.5 + 2000 + 4000 + 0.5, id="all terms"),
        pytest.param(4.4, 20_500, 0.05, 4.4 + 21.005 + 50 + 4000 + 0.595, id="whole milliseconds"),
        pytest.param(0, 20_000, 60.0, 60_000, id="at most the board's limit"),
    ],
)
def test_the_hold_covers_the_complete_shot(
    bench, settle_ms, exposure_us, frame_timeout_s, hold_ms, monkeypatch
):
    with bench.rig(settle_ms=settle_ms, frame_timeout_s=frame_timeout_s) as rig:
        asked = []
        on = rig.board.on
        monkeypatch.setattr(rig.board, "on", lambda *args: asked.append(args) or on(*args))
        rig.shoot(6, exposure_us)
    assert asked == [(6, hold_ms)]


def test_a_hold_that_ends_before_the_frame_arrives_is_reported(bench, monkeypatch):
    with bench.rig(frame_timeout_s=2.0) as opened:
        monkeypatch.setattr(rig.shooting.shooting, "hold_ms", lambda *_: 150)
        late(opened, monkeypatch, 0.3)
        with pytest.raises(BoardError, match=r"the hold of LED 6 ended while .* awaited") as error:
            opened.shoot(6, EXPOSURE_US)
        assert "supply" not in str(error.value)


def test_the_frame_is_discarded_if_the_board_resets_during_the_exposure(bench):
    with bench.rig() as rig:
        bench.virtual.set_faults(BoardFault(kind="reset", verb="OFF"))
        with pytest.raises(BoardError, match="LED 6 was requested"):
            rig.shoot(6, EXPOSURE_US)


def test_the_frame_is_discarded_if_another_led_was_on(each_bench):
    with each_bench.rig() as rig:
        each_bench.virtual.set_faults(BoardFault(kind="wrong-led", verb="ON", value=8))
        with pytest.raises(BoardError, match=r"LED 6 .* the board did ON LED 8"):
            rig.shoot(6, EXPOSURE_US)
        assert led_on(each_bench) is None


@TRIGGERS
@pytest.mark.parametrize("fault", ["lost", "late", "unplug"])
def test_a_failing_camera_leaves_no_led_on(bench, trigger, fault):
    # The board's first flash is a dark one, with which the next is compared.
    faulty = 1 if trigger == "board" else 0
    rig = bench.rig(trigger=trigger, faults={faulty: fault})
    with contextlib.suppress(CameraError), rig:
        with pytest.raises(CameraError) as error:
            rig.shoot(9, EXPOSURE_US)
        assert bench.state.periods()[-1].led == 9
        assert led_on(bench) is None
        assert "\n" not in str(error.value)
        if fault != "unplug":
            assert f"frame {faulty}" in str(error.value)
            if trigger == "board":
                assert "Line0" in str(error.value)
                assert "LED 9: check the wire" in str(error.value)
            # The next frame is that of the next shot, not the abandoned one.
            assert led_seen(rig.shoot(10, EXPOSURE_US).frame) == 10
    assert led_on(bench) is None


@pytest.mark.parametrize("late_us", [2500, 5000, 9000])
def test_noise_on_the_trigger_line_discards_the_frame(bench, late_us):
    """A stray pulse produces a frame, and the busy camera misses the real trigger."""
    with bench.rig(trigger="board") as rig:
        assert led_seen(rig.shoot(3, EXPOSURE_US).frame) == 3
        bench.virtual.set_faults(BoardFault(kind="double-trigger", value=late_us))
        seen = []
        for led in (4, 5, 6, 7):
            with contextlib.suppress(CameraError):
                seen.append((led, led_seen(rig.shoot(led, EXPOSURE_US).frame)))
        assert len(seen) >= 2
        assert all(led == shown for led, shown in seen)


def frame_at(time_us, frame_id=0):
    return CameraFrame(
        np.zeros((1, 1), np.uint16), frame_id, (1_000_000 + time_us) * 1000, 1.0, 0.0, None
    )


FLASHES = {
    "correct": ([0, 50_000], [50_000], ""),
    "a slow clock": ([0, 50_250], [50_000], ""),
    "exposed later": ([0, 51_000], [50_000], "50000 us apart"),
    "exposed sooner": ([0, 49_000], [50_000], "something else triggered"),
    "the same again": ([0, 0], [50_000], "check the trigger wire"),
    "another board": ([0, 50_000], [None], "the board has restarted"),
    "a slow clock for long": ([k * 50_250 for k in range(30)], [50_000] * 29, ""),
    "strict, because the rate is well known": (
        [*(k * 50_250 for k in range(29)), 28 * 50_250 + 49_800],
        [50_000] * 29,
        "something else",
    ),
}


@pytest.mark.parametrize(("times_us", "since_us", "said"), FLASHES.values(), ids=FLASHES)
def test_flashes_are_compared_on_both_clocks(times_us, since_us, said):
    chain, exposure = FlashChain("c"), ShotTimes(2000, 5000.0, 45_000.0, 50_000.0)
    chain.begin(frame_at(times_us[0]))
    expected = pytest.raises(CameraError, match=said) if said else contextlib.nullcontext()
    with expected:
        for time_us, since in zip(times_us[1:], since_us, strict=True):
            chain.check(frame_at(time_us), 7, since, exposure)
    assert chain.reaches(exposure) == (not said)


def test_an_exposure_longer_than_the_watchdog_time_is_not_cut_off(bench):
    with bench.rig() as rig:
        shot = rig.shoot(0, 1_500_000)
    lit = bench.state.periods()[-1]
    assert lit.start_ns <= shot.frame.timestamp_ns
    assert lit.end_ns >= shot.frame.timestamp_ns + 1_500_000_000


@pytest.mark.parametrize("answer", ["resets", "is unplugged"])
def test_a_board_that_fails_while_a_frame_is_awaited_ends_the_wait(bench, answer):
    rig = bench.rig(frame_timeout_s=60.0, faults={0: "lost"})
    fault = BoardFault(kind="reset" if answer == "resets" else "die", verb="STATUS")
    bench.virtual.set_faults(fault)
    began = clock.monotonic()
    with pytest.raises(BoardError, match=r"LED 5 was requested|unplugged"):
        rig.shoot(5, EXPOSURE_US)
    assert clock.monotonic() - began < 20
    with contextlib.suppress(BoardError):
        rig.close()


def test_ctrl_c_during_the_exposure_leaves_no_led_on(each_bench, monkeypatch):
    with each_bench.rig() as rig:

        def interrupted(frame_id, timeout_s, waiting):
            assert led_on(each_bench) == 2
            raise KeyboardInterrupt

        monkeypatch.setattr(rig.camera, "fetch", interrupted)
        with pytest.raises(KeyboardInterrupt):
            rig.shoot(2, EXPOSURE_US)
        assert led_on(each_bench) is None


def test_a_frame_of_another_shot_is_refused(bench, monkeypatch):
    with bench.rig() as rig:
        earlier = rig.shoot(1, EXPOSURE_US).frame
        monkeypatch.setattr(rig.camera, "fetch", lambda *_: earlier)
        with pytest.raises(CameraError, match=r"frame 0 .* LED 2 instead of frame 1"):
            rig.shoot(2, EXPOSURE_US)
        assert led_on(bench) is None


def test_a_failing_off_does_not_hide_the_first_error(bench, monkeypatch):
    rig = bench.rig()

    def unplugged_too(frame_id, timeout_s, waiting):
        bench.virtual.unplug()
        raise CameraError("the first thing to go wrong")

    monkeypatch.setattr(rig.camera, "fetch", unplugged_too)
    with pytest.raises(CameraError, match="the first thing") as error, rig:
        rig.shoot(2, EXPOSURE_US)
    notes = [note.partition(": LED board on ")[0] for note in error.value.__notes__]
    assert notes[:2] == ["LEDs not confirmed off", "on closing"]
    assert "unplugged" in error.value.__notes__[0]


@cases(
    ("led", "exposure_us", "gain_db", "said"),
    {
        "LED too high": (36, EXPOSURE_US, 0, "no LED 36, only 0 to 35"),
        "LED negative": (-1, EXPOSURE_US, 0, "no LED -1"),
        "dead LED": (4, EXPOSURE_US, 0, "LED 4 .* listed as dead"),
        "exposure too short": (0, 9.0, 0, "range of 10 to 1e\\+07 us"),
        "exposure not a number": (0, float("nan"), 0, "range of 10 to"),
        "gain": (0, EXPOSURE_US, 25, "range of 0 to 24 dB"),
        "too long": (0, 9_500_000, 0, "9000 ms( that this LED board allows)?: expose shorter"),
    },
)
@TRIGGERS
def test_an_impossible_shot_is_refused_before_an_led_is_on(
    bench, trigger, led, exposure_us, gain_db, said
):
    with bench.rig(trigger=trigger, dead_leds=(4,)) as rig:
        rig.board.identity = replace(rig.board.identity, max_hold_ms=9000)
        before = bench.state.changes
        with pytest.raises(RigError, match=said) as error:
            rig.shoot(led, exposure_us, gain_db)
        assert bench.state.changes == before
        assert "\n" not in str(error.value)


def test_a_reset_while_the_port_opens_does_not_count_as_a_restart(bench):
    # Like boards of the Arduino family: the boot loader ignores commands, then the clock starts.
    bench.virtual.set_faults(BoardFault(kind="boot-loader", verb="ID", value=1500))
    with bench.rig() as rig:
        assert led_seen(rig.shoot(3, EXPOSURE_US).frame) == 3
        # A later reset counts.
        bench.virtual.set_faults(BoardFault(kind="reset", verb="STATUS"))
        clock.sleep(0.6)
        with pytest.raises(BoardError, match="restarted"):
            rig.board.ping()


def stamped(rig, monkeypatch, stamp_ns):
    """Replace the timestamps of the camera's frames."""
    fetch = rig.camera.fetch

    def fetched(*words, **named):
        frame = fetch(*words, **named)
        return replace(frame, timestamp_ns=stamp_ns(frame))

    monkeypatch.setattr(rig.camera, "fetch", fetched)


def test_the_exposure_may_change_if_the_camera_stamps_its_end(bench, monkeypatch):
    with bench.rig(trigger="board") as rig:
        stamped(
            rig, monkeypatch, lambda frame: frame.timestamp_ns + round(frame.exposure_us * 1000)
        )
        for led, exposure_us in enumerate((1000.0, 1000.0, 41_000.0, 1000.0, 41_000.0)):
            shot = rig.shoot(led, exposure_us)
            assert (shot.led, shot.frame.exposure_us) == (led, exposure_us)


def test_a_camera_without_timestamps_is_reported(bench, monkeypatch):
    with bench.rig(trigger="board") as rig:
        stamped(rig, monkeypatch, lambda _: 0)
        for shots in (
            lambda: rig.shoot(3, EXPOSURE_US),
            lambda: list(rig.sequence([3, 4, 5], EXPOSURE_US)),
        ):
            with pytest.raises(CameraError, match='reports no time: use trigger = "software"'):
                shots()
            assert led_on(bench) is None
        rig.shoot(3, EXPOSURE_US, trigger="software")


def test_opening_with_another_led_count_closes_everything(bench):
    closed = []
    with pytest.raises(BoardError, match="has 36 LEDs, but rig test is configured with 24"):
        bench.rig(leds=24, on_close=lambda: closed.append(True))
    assert closed == [True]
    Board(bench.virtual.port).close()


def test_opening_turns_off_an_led_that_an_earlier_program_left_on(bench):
    board = Board(bench.virtual.port)
    board.on(3, 5000)
    board.close()
    with bench.rig():
        assert led_on(bench) is None


def test_closing_turns_the_led_off_and_closes_everything_once(each_bench):
    closed = []
    rig = each_bench.rig(on_close=lambda: closed.append(True))
    rig.board.on(3, 5000)
    rig.close()
    assert led_on(each_bench) is None
    rig.close()
    assert closed == [True]
    Board(each_bench.virtual.port).close()
    with pytest.raises(CameraError, match="is closed"):
        rig.camera.arm()


def test_closing_an_unplugged_rig_closes_the_rest_and_raises(bench):
    closed = []
    rig = bench.rig(on_close=lambda: closed.append(True))
    bench.virtual.unplug()
    with pytest.raises(BoardError, match="unplugged"):
        rig.close()
    assert closed == [True]


def test_a_failing_step_of_closing_does_not_prevent_the_others(bench, monkeypatch):
    def broken(camera):
        raise ArithmeticError("a fault of the driver")

    monkeypatch.setattr(VirtualCamera, "close", broken)
    closed = []
    rig = bench.rig(on_close=lambda: closed.append(True))
    with pytest.raises(ArithmeticError):
        rig.close()
    assert closed == [True]
    Board(bench.virtual.port).close()


@TRIGGERS
def test_random_faults_never_give_a_frame_of_another_led(bench, trigger):
    draw = random.Random(1)
    kinds = ["drop-reply", "corrupt-reply", "delay-reply", "banner", "reset", "goes-dark"]
    kinds += ["wrong-led", "drop-command", "lose-byte-command", "double-command", "double-reply"]
    if trigger == "board":
        kinds += ["lose-trigger", "double-trigger", "reset-after"]
    faults = {frame: draw.choice(["lost", "late"]) for frame in range(3, 60, 11)}
    failed = 0
    with bench.rig(trigger=trigger, faults=faults, frame_timeout_s=0.05) as rig:
        for shot in range(60):
            if shot % 4 == 0:
                lit = "ON" if trigger == "software" else "FLASH"
                kind, verb = draw.choice(kinds), draw.choice([lit, "OFF"])
                value = {"delay-reply": 260, "goes-dark": 0, "wrong-led": 17}.get(kind, 0)
                if kind in ("goes-dark", "wrong-led"):
                    verb = lit
                if kind.endswith("trigger"):
                    verb = None
                bench.virtual.set_faults(BoardFault(kind=kind, verb=verb, value=value))
            led = draw.randrange(36)
            try:
                frame = rig.shoot(led, EXPOSURE_US).frame
            except RigError:
                failed += 1
            else:
                assert led_seen(frame) == led
            assert led_on(bench) is None
    assert 5 <= failed <= 25
