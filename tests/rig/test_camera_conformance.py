"""Requirements for every camera, with each implementation."""

from itertools import pairwise

import pytest

from rig import CameraError
from rig.host import clock
from tests.rig.camera_benches import (
    EXPOSURE_US,
    SIZE,
    AwaitedTime,
    GenICamBench,
    InsideBench,
    IsolatedBench,
    grey,
)

BENCHES = [
    pytest.param(InsideBench, id="inside"),
    pytest.param(GenICamBench, id="genicam"),
    # The camera of the bench before, so the quick tests are those of what goes between processes.
    pytest.param(IsolatedBench, id="isolated", marks=pytest.mark.slow),
]
BETWEEN_PROCESSES = pytest.mark.parametrize(
    "bench", [*BENCHES[:2], pytest.param(IsolatedBench, id="isolated")], indirect=True
)


@pytest.fixture(params=BENCHES)
def bench(request, tmp_path):
    if request.param is InsideBench:
        request.getfixturevalue("world")
    bench = request.param(tmp_path)
    yield bench
    bench.close()


@pytest.fixture
def camera(bench):
    camera = bench.open()
    camera.configure(exposure_us=EXPOSURE_US)
    return camera


def seen(frame):
    """Return the grey value of a uniform frame."""
    assert (frame.pixels == frame.pixels[0, 0]).all()
    return frame.pixels[0, 0]


def shoot(bench, camera, led):
    """Take a shot under an LED and check that the frame shows this LED."""
    bench.light(led)
    frame_id = camera.trigger()
    frame = camera.fetch(frame_id, 5.0)
    bench.dark()
    assert frame.frame_id == frame_id
    assert seen(frame) == grey(led)
    return frame


@BETWEEN_PROCESSES
def test_a_frame_shows_its_led(bench, camera):
    camera.arm()
    frames = [shoot(bench, camera, led) for led in (3, 0, 7)]
    assert all(frame.pixels.shape == SIZE and frame.pixels.dtype == "uint16" for frame in frames)
    assert [seen(frame) for frame in frames] == [grey(led) for led in (3, 0, 7)]


@BETWEEN_PROCESSES
def test_ids_count_from_0_and_never_restart(bench, camera):
    ids = []
    for trigger in ("software", "software", "line"):
        camera.arm(trigger)
        for _ in range(2):
            ids.append(camera.trigger() if trigger == "software" else camera.expect())
            if trigger == "line":
                bench.pulse(0.01)
            assert camera.fetch(ids[-1], 5.0).frame_id == ids[-1]
        camera.disarm()
    assert ids == list(range(6))


def test_the_cameras_clock_runs_forward(bench, camera):
    camera.arm()
    times = [shoot(bench, camera, 0).timestamp_ns for _ in range(4)]
    assert all(later - earlier >= EXPOSURE_US * 1000 for earlier, later in pairwise(times))


@BETWEEN_PROCESSES
def test_a_frame_has_the_settings_that_were_read_back(bench, camera):
    camera.arm()
    read_back = camera.configure(exposure_us=2000.4, gain_db=6.0)
    assert read_back == pytest.approx(2000.4, abs=1)
    bench.light(1)
    frame = camera.fetch(camera.trigger(), 5.0)
    assert frame.exposure_us == read_back
    assert frame.gain_db == 6.0
    assert seen(frame) == pytest.approx(20 + 200 * 2000 / 1000 * 10 ** (6 / 20), abs=2)


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        pytest.param({"exposure_us": 1.0}, "c7, ExposureTime: 1 us .* of 10 to 1e", id="short"),
        pytest.param({"exposure_us": 1e9}, "1e.09 us is outside its range", id="long"),
        pytest.param({"exposure_us": float("nan")}, "nan us is outside its range", id="nan"),
        pytest.param({"exposure_us": 100, "gain_db": 99.0}, "Gain: 99 dB .* 0 to 24 dB", id="gain"),
    ],
)
def test_a_setting_out_of_range_is_refused_with_the_range(camera, wish, message):
    with pytest.raises(CameraError, match=message):
        camera.configure(**wish)
    assert camera.info.exposure_min_us == 10
    assert camera.info.exposure_max_us == 10_000_000


def test_a_trigger_before_arming_is_refused(camera):
    for act in (camera.trigger, camera.expect):
        with pytest.raises(CameraError, match="c7 was triggered before it was armed"):
            act()


def test_a_trigger_of_the_other_kind_is_refused(camera):
    camera.arm()
    with pytest.raises(CameraError, match="armed for triggers by software, not line"):
        camera.expect()
    camera.arm("line")
    with pytest.raises(CameraError, match="armed for triggers by line, not software"):
        camera.trigger()


def test_frames_that_were_not_announced_cannot_be_fetched(bench, camera):
    camera.arm()
    with pytest.raises(CameraError, match="no frame 0 is under way"):
        camera.fetch(0, 0.1)
    frame_id = shoot(bench, camera, 0).frame_id
    with pytest.raises(CameraError, match="no frame 0 is under way"):
        camera.fetch(frame_id, 0.1)


def test_arming_discards_pending_frames(bench, camera):
    camera.arm()
    bench.light(2)
    forgotten = camera.trigger()
    clock.sleep(0.05)
    bench.dark()
    camera.arm()
    with pytest.raises(CameraError, match=f"no frame {forgotten} is under way"):
        camera.fetch(forgotten, 0.1)
    shoot(bench, camera, 5)


def test_fetching_the_newer_frame_discards_the_older(bench, camera):
    camera.arm()
    bench.light(2)
    older = camera.trigger()
    clock.sleep(0.1)
    bench.light(6)
    newer = camera.trigger()
    assert seen(camera.fetch(newer, 5.0)) == grey(6)
    with pytest.raises(CameraError, match=f"no frame {older} is under way"):
        camera.fetch(older, 0.1)
    shoot(bench, camera, 0)


def test_a_frame_does_not_change_once_it_is_there(bench, camera):
    camera.arm()
    first = shoot(bench, camera, 1)
    before = first.pixels.copy()
    for led in range(10):
        shoot(bench, camera, led)
    assert (first.pixels == before).all()


@BETWEEN_PROCESSES
def test_the_message_of_a_lost_frame_states_the_time_waited(bench, camera):
    bench.fault(1, "lost")
    camera.arm()
    shoot(bench, camera, 0)
    bench.light(4)
    began = clock.monotonic()
    with pytest.raises(CameraError, match=r"c7: frame 1 did not come within 0\.1 s of waiting"):
        camera.fetch(camera.trigger(), 0.1)
    assert clock.monotonic() - began >= 0.1
    shoot(bench, camera, 9)


@BETWEEN_PROCESSES
def test_a_late_frame_is_not_mistaken_for_the_next_one(bench, camera):
    bench.fault(1, "late", late_s=0.2)
    camera.arm()
    shoot(bench, camera, 0)
    bench.light(4)
    with pytest.raises(CameraError, match="frame 1 did not come"):
        camera.fetch(camera.trigger(), 0.03)
    for led in (8, 3):
        shoot(bench, camera, led)
    clock.sleep(0.2)
    shoot(bench, camera, 5)


def test_a_late_frame_can_be_fetched_again(bench, camera):
    bench.fault(0, "late", late_s=0.2)
    camera.arm()
    bench.light(4)
    frame_id = camera.trigger()
    with pytest.raises(CameraError, match="frame 0 did not come"):
        camera.fetch(frame_id, 0.03)
    assert seen(camera.fetch(frame_id, 5.0)) == grey(4)
    shoot(bench, camera, 7)


@BETWEEN_PROCESSES
def test_waiting_is_called_at_least_every_200_ms(bench, camera, monkeypatch):
    inside = isinstance(bench, InsideBench)
    monotonic = clock.monotonic if inside else AwaitedTime(monkeypatch, 10).of(camera).monotonic
    calls = []

    def waiting():
        calls.append(monotonic())
        # The frame comes when this was called often enough.
        if len(calls) == 6:
            bench.pulse()

    camera.arm("line")
    frame_id = camera.expect()
    calls.append(monotonic())
    camera.fetch(frame_id, 600.0, waiting)
    calls.append(monotonic())
    assert max(later - earlier for earlier, later in pairwise(calls)) < 0.2


@BETWEEN_PROCESSES
def test_an_exception_from_waiting_ends_the_wait(bench, camera):
    def fail():
        raise RuntimeError("the board is gone")

    camera.configure(exposure_us=5_000_000)
    camera.arm()
    bench.light(2)
    began = clock.monotonic()
    with pytest.raises(RuntimeError, match="the board is gone"):
        camera.fetch(camera.trigger(), 20.0, fail)
    assert clock.monotonic() - began < 3
    camera.configure(exposure_us=EXPOSURE_US)
    shoot(bench, camera, 5)


def test_every_pulse_on_the_line_gives_a_frame(bench, camera):
    camera.arm("line")
    ids = [camera.expect() for _ in range(3)]
    pulses = []
    for led in (4, 0, 9):
        bench.light(led)
        pulses.append(bench.pulse(0.001))
        clock.sleep(0.05)
    frames = [camera.fetch(frame_id, 5.0) for frame_id in ids]
    assert [frame.frame_id for frame in frames] == ids
    assert [seen(frame) for frame in frames] == [grey(led) for led in (4, 0, 9)]
    for (one, other), (pulse, next_pulse) in zip(pairwise(frames), pairwise(pulses), strict=True):
        assert other.timestamp_ns - one.timestamp_ns == pytest.approx(next_pulse - pulse, abs=2e5)


def test_pulses_before_arming_give_no_frames(bench, camera):
    camera.arm("line")
    camera.disarm()
    bench.light(1)
    bench.pulse()
    clock.sleep(0.02)
    camera.arm("line")
    frame_id = camera.expect()
    bench.light(6)
    bench.pulse(0.01)
    assert seen(camera.fetch(frame_id, 5.0)) == grey(6)


def test_a_withdrawn_pulse_gives_no_frame(bench, camera):
    camera.arm("line")
    frame_id = camera.expect()
    bench.light(1)
    bench.pulse(0.2)
    bench.dark()
    with pytest.raises(CameraError, match=f"frame {frame_id} did not come"):
        camera.fetch(frame_id, 0.3)


def test_a_line_without_pulses_is_named(bench, camera):
    camera.arm("line")
    with pytest.raises(
        CameraError, match=r"c7, armed on Line0, frame 0 did not come within 0\.1 s"
    ):
        camera.fetch(camera.expect(), 0.1)
    # This frame belongs to no trigger.
    bench.light(1)
    bench.pulse()
    clock.sleep(0.1)
    frame_id = camera.expect()
    bench.light(8)
    bench.pulse(0.01)
    assert seen(camera.fetch(frame_id, 5.0)) == grey(8)


@BETWEEN_PROCESSES
def test_an_unplugged_camera_only_closes(bench, camera):
    bench.fault(1, "unplug")
    camera.arm()
    shoot(bench, camera, 0)
    with pytest.raises(CameraError, match="c7"):
        camera.fetch(camera.trigger(), 0.1)
    for act in (
        camera.trigger,
        camera.arm,
        lambda: camera.arm("line"),
        lambda: camera.configure(exposure_us=500),
        lambda: camera.fetch(1, 0.1),
    ):
        with pytest.raises(CameraError, match="c7"):
            act()
    camera.close()


@BETWEEN_PROCESSES
def test_a_closed_camera_only_closes_again(camera):
    camera.arm()
    camera.close()
    camera.close()
    for act in (
        camera.arm,
        camera.trigger,
        camera.expect,
        camera.disarm,
        lambda: camera.configure(exposure_us=500),
        lambda: camera.fetch(0, 0.1),
    ):
        with pytest.raises(CameraError, match="c7 is closed"):
            act()


def test_disarming_twice_does_no_harm(bench, camera):
    camera.disarm()
    camera.arm()
    camera.disarm()
    camera.disarm()
    camera.arm()
    shoot(bench, camera, 3)
