"""Board and camera as one: the light of every frame is known, and none is left burning."""

import contextlib
import random
import time

import numpy as np
import pytest

from rig import Board, BoardError, CameraError, RigError
from simulator._board_faults import BoardFault

EXPOSURE_US = 1000.0


def burning(bench):
    return bench.state.led(time.monotonic_ns())


def led_seen(frame):
    """What the pixels say: `code_plane` gives 100 DN per LED and 1000 us, 0 without light."""
    assert frame.pixels.dtype == np.uint16
    assert len(np.unique(frame.pixels)) == 1
    code, rest = divmod(int(frame.pixels[0, 0]), 100)
    assert rest == 0
    return code - 1 if code else None


@pytest.mark.parametrize("led", [0, 7, 35, None])
def test_a_shot_carries_its_light(bench, led):
    with bench.rig() as rig:
        shot = rig.shoot(led, EXPOSURE_US)
        assert burning(bench) is None
    assert shot.led == led
    assert shot.echo.led == led
    assert led_seen(shot.frame) == led
    assert (shot.frame.exposure_us, shot.frame.gain_db) == (EXPOSURE_US, 0.0)


def test_a_dark_frame_puts_out_a_light_that_was_left_on(bench):
    with bench.rig() as rig:
        rig.board.on(5, 5000)
        assert led_seen(rig.shoot(None, EXPOSURE_US).frame) is None


def test_the_light_has_settled_before_the_exposure(bench):
    with bench.rig(settle_ms=40) as rig:
        shot = rig.shoot(3, EXPOSURE_US)
    lit = bench.state.periods()[-1]
    assert shot.frame.timestamp_ns - lit.start_ns >= 40_000_000
    assert lit.end_ns >= shot.frame.timestamp_ns + EXPOSURE_US * 1000


def test_a_light_that_goes_dark_in_the_exposure_costs_the_frame(bench):
    with bench.rig() as rig:
        bench.virtual.set_faults(BoardFault(kind="goes-dark", verb="ON", value=20))
        with pytest.raises(BoardError, match=r"LED 6 was wanted, but .* no LED burned"):
            rig.shoot(6, 60_000)
        bench.virtual.set_faults()
        assert led_seen(rig.shoot(6, EXPOSURE_US).frame) == 6


def late(rig, monkeypatch, seconds):
    """Let frames come this much later than they do."""
    fetch = rig.camera.fetch

    def fetch_late(frame_id, timeout_s):
        time.sleep(seconds)
        return fetch(frame_id, timeout_s)

    monkeypatch.setattr(rig.camera, "fetch", fetch_late)


def test_a_frame_may_be_as_late_as_the_rig_file_allows(bench, monkeypatch):
    with bench.rig(frame_timeout_s=2.0) as rig:
        late(rig, monkeypatch, 1.9)
        assert led_seen(rig.shoot(6, EXPOSURE_US).frame) == 6


@pytest.mark.parametrize(
    ("settle_ms", "exposure_us", "frame_timeout_s", "hold_ms"),
    [
        # ON is sent up to 3 times and OFF 8 times, 250 ms each.
        pytest.param(4, 20_000, 2.0, 4 + 20 + 2000 + 2750, id="all that may come"),
        pytest.param(4, 20_500, 0.05, 4 + 20.5 + 50 + 2750 + 0.5, id="whole milliseconds"),
        pytest.param(0, 20_000, 60.0, 10_000, id="no more than the board gives"),
    ],
)
def test_the_hold_covers_the_whole_shot(
    bench, settle_ms, exposure_us, frame_timeout_s, hold_ms, monkeypatch
):
    with bench.rig(settle_ms=settle_ms, frame_timeout_s=frame_timeout_s) as rig:
        asked = []
        on = rig.board.on
        monkeypatch.setattr(rig.board, "on", lambda *args: asked.append(args) or on(*args))
        rig.shoot(6, exposure_us)
    assert asked == [(6, hold_ms)]


def test_a_hold_that_ends_while_the_frame_is_awaited_is_told(bench, monkeypatch):
    with bench.rig(frame_timeout_s=2.0) as rig:
        monkeypatch.setattr(rig, "_hold_ms", lambda: 150)
        late(rig, monkeypatch, 0.3)
        with pytest.raises(BoardError, match=r"the hold of LED 6 ended while .* awaited") as error:
            rig.shoot(6, EXPOSURE_US)
        assert "supply" not in str(error.value)


def test_a_reset_in_the_exposure_costs_the_frame(bench):
    with bench.rig() as rig:
        bench.virtual.set_faults(BoardFault(kind="reset", verb="OFF"))
        with pytest.raises(BoardError, match="LED 6 was wanted"):
            rig.shoot(6, EXPOSURE_US)


def test_another_led_costs_the_frame_and_is_put_out(bench):
    with bench.rig() as rig:
        bench.virtual.set_faults(BoardFault(kind="wrong-led", verb="ON", value=8))
        with pytest.raises(BoardError, match="LED 8"):
            rig.shoot(6, EXPOSURE_US)
        assert burning(bench) is None


@pytest.mark.parametrize("fault", ["lost", "late", "unplug"])
def test_a_failing_camera_leaves_no_light_on(bench, fault):
    rig = bench.rig(faults={0: fault})
    with contextlib.suppress(CameraError), rig:
        with pytest.raises(CameraError) as error:
            rig.shoot(9, EXPOSURE_US)
        assert bench.state.periods()[-1].led == 9
        assert burning(bench) is None
        assert "\n" not in str(error.value)
        if fault != "unplug":
            assert "frame 0" in str(error.value)
            # The next frame is the next shot's, not the one that was given up.
            assert led_seen(rig.shoot(10, EXPOSURE_US).frame) == 10
    assert burning(bench) is None


def test_ctrl_c_in_the_exposure_leaves_no_light_on(bench, monkeypatch):
    with bench.rig() as rig:

        def interrupted(frame_id, timeout_s):
            assert burning(bench) == 2
            raise KeyboardInterrupt

        monkeypatch.setattr(rig.camera, "fetch", interrupted)
        with pytest.raises(KeyboardInterrupt):
            rig.shoot(2, EXPOSURE_US)
        assert burning(bench) is None


def test_a_frame_of_another_shot_is_refused(bench, monkeypatch):
    with bench.rig() as rig:
        earlier = rig.shoot(1, EXPOSURE_US).frame
        monkeypatch.setattr(rig.camera, "fetch", lambda frame_id, timeout_s: earlier)
        with pytest.raises(CameraError, match=r"frame 0 .* LED 2, awaited was frame 1"):
            rig.shoot(2, EXPOSURE_US)
        assert burning(bench) is None


def test_a_failing_off_does_not_hide_what_went_wrong_first(own_bench, monkeypatch):
    rig = own_bench.rig()

    def unplugged_too(frame_id, timeout_s):
        own_bench.virtual.unplug()
        raise CameraError("the first thing to go wrong")

    monkeypatch.setattr(rig.camera, "fetch", unplugged_too)
    with pytest.raises(CameraError, match="the first thing") as error, rig:
        rig.shoot(2, EXPOSURE_US)
    told = [note.partition(": LED board on ")[0] for note in error.value.__notes__]
    assert told[:2] == ["LEDs not confirmed off", "on closing"]
    assert "unplugged" in error.value.__notes__[0]


@pytest.mark.parametrize(
    ("led", "exposure_us", "gain_db", "said"),
    [
        pytest.param(36, EXPOSURE_US, 0, "no LED 36, only 0 to 35", id="LED too high"),
        pytest.param(-1, EXPOSURE_US, 0, "no LED -1", id="LED negative"),
        pytest.param(4, EXPOSURE_US, 0, "LED 4 .* listed as dead", id="dead LED"),
        pytest.param(0, 9.0, 0, "range of 10 to 1e\\+07 us", id="exposure too short"),
        pytest.param(0, float("nan"), 0, "range of 10 to", id="exposure not a number"),
        pytest.param(0, EXPOSURE_US, 25, "range of 0 to 24 dB", id="gain"),
        pytest.param(0, 9_500_000, 0, "gives 10000: expose shorter", id="longer than the hold"),
    ],
)
def test_what_cannot_be_shot_is_refused_in_the_dark(bench, led, exposure_us, gain_db, said):
    with bench.rig(dead_leds=(4,)) as rig:
        before = bench.state.changes
        with pytest.raises(RigError, match=said) as error:
            rig.shoot(led, exposure_us, gain_db)
        assert bench.state.changes == before
        assert "\n" not in str(error.value)


def test_opening_with_another_led_count_closes_everything(bench):
    closed = []
    with pytest.raises(BoardError, match="has 36 LEDs, rig test is said to have 24"):
        bench.rig(leds=24, on_close=lambda: closed.append(True))
    assert closed == [True]
    Board(bench.virtual.port).close()


def test_opening_puts_out_a_light_that_an_earlier_program_left(bench):
    board = Board(bench.virtual.port)
    board.on(3, 5000)
    board.close()
    with bench.rig():
        assert burning(bench) is None


def test_closing_turns_off_and_gives_back_once(bench):
    closed = []
    rig = bench.rig(on_close=lambda: closed.append(True))
    rig.board.on(3, 5000)
    rig.close()
    assert burning(bench) is None
    rig.close()
    assert closed == [True]
    Board(bench.virtual.port).close()
    with pytest.raises(CameraError, match="is closed"):
        rig.camera.arm()


def test_closing_an_unplugged_rig_closes_the_rest_and_tells(own_bench):
    closed = []
    rig = own_bench.rig(on_close=lambda: closed.append(True))
    own_bench.virtual.unplug()
    with pytest.raises(BoardError, match="unplugged"):
        rig.close()
    assert closed == [True]


def test_no_frame_under_a_wrong_led_whatever_goes_wrong(bench):
    draw = random.Random(1)
    kinds = ["drop-reply", "corrupt-reply", "delay-reply", "banner", "reset", "goes-dark"]
    kinds += ["wrong-led", "drop-command"]
    faults = {frame: draw.choice(["lost", "late"]) for frame in range(3, 60, 11)}
    failed = 0
    with bench.rig(faults=faults, frame_timeout_s=0.02) as rig:
        for shot in range(60):
            if shot % 4 == 0:
                kind, verb = draw.choice(kinds), draw.choice(["ON", "OFF"])
                value = {"delay-reply": 260, "goes-dark": 0, "wrong-led": 17}.get(kind, 0)
                if kind in ("goes-dark", "wrong-led"):
                    verb = "ON"
                bench.virtual.set_faults(BoardFault(kind=kind, verb=verb, value=value))
            led = draw.randrange(36)
            try:
                frame = rig.shoot(led, EXPOSURE_US).frame
            except RigError:
                failed += 1
            else:
                assert led_seen(frame) == led
            assert burning(bench) is None
    assert 5 <= failed <= 20
