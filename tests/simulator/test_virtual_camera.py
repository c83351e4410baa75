"""The virtual camera sees each LED for the time that it is on."""

import time

import numpy as np
import pytest
from scipy import optimize

from acquisition import NoiseModel
from rig import CameraError
from simulator.bench import BenchState, BenchWriter
from simulator.camera import VirtualCamera, fixed_pattern, virtual_sensor
from simulator.scene import Lamps
from tests.simulator.camera_options import grouped

SIZE = (3, 5)
US = 1000
# One electron per grey value, no noise: grey = black level + electrons.
NOISE = NoiseModel(1.0, 0.0, 20.0, 16)


def plane(led):
    """Ambient light: 0.125 electrons per microsecond; an LED: its number plus 1."""
    return np.full(SIZE, 0.125 if led is None else led + 1, np.float32)


class Room:
    def __init__(self, path):
        self.writer = BenchWriter(path)
        self.path = path
        self.cameras = []

    def camera(self, planes=plane, **options):
        options = {"size": SIZE, "noisy": False, "noise": NOISE, **options}
        camera = VirtualCamera(planes, **grouped(bench=BenchState(self.path), **options))
        self.cameras.append(camera)
        return camera

    def armed(self, exposure_us=1000, trigger="software", **options):
        camera = self.camera(**options)
        camera.configure(exposure_us=exposure_us)
        camera.arm(trigger)
        return camera

    def light(self, led, from_us, to_us):
        now = time.monotonic_ns()
        self.writer.light(led, now + from_us * US, now + to_us * US)


@pytest.fixture
def room(tmp_path):
    room = Room(tmp_path / "bench.state")
    yield room
    for camera in room.cameras:
        camera.close()
    room.writer.close()


def shoot(camera, exposure_us, **options):
    camera.configure(exposure_us=exposure_us, **options)
    camera.arm()
    return camera.fetch(camera.trigger(), 2.0)


def test_ambient_light_is_always_on(room):
    frame = shoot(room.camera(), 8000)
    assert frame.pixels.dtype == np.uint16
    assert frame.pixels.shape == SIZE
    assert (frame.pixels == 20 + 1000).all()


def test_an_led_that_is_on_throughout_counts_in_full(room):
    room.light(3, 0, 10**6)
    assert (shoot(room.camera(), 2000).pixels == 20 + 250 + 8000).all()


def test_gain_multiplies_the_signal_and_not_the_black_level(room):
    frame = shoot(room.camera(), 8000, gain_db=20.0)
    assert (frame.pixels == 20 + 10_000).all()
    assert frame.gain_db == 20.0


def test_an_led_that_turns_off_during_the_exposure_counts_for_its_time(room):
    camera = room.armed(40_000)
    frame_id = camera.trigger()
    start_ns = camera._started[frame_id].start_ns
    room.writer.light(0, start_ns - 5000 * US, start_ns + 10_000 * US)
    room.writer.light(1, start_ns + 30_000 * US, start_ns + 10**9)
    frame = camera.fetch(frame_id, 2.0)
    assert (frame.pixels == 20 + 5000 + 10_000 + 2 * 10_000).all()
    assert frame.timestamp_ns == start_ns


def test_light_before_and_after_the_exposure_does_not_count(room):
    camera = room.armed(4000)
    room.light(5, 0, 1)
    time.sleep(0.001)
    frame_id = camera.trigger()
    time.sleep(0.01)
    room.light(6, 0, 10**6)
    assert (camera.fetch(frame_id, 2.0).pixels == 20 + 500).all()


def test_exposures_take_time_only_in_real_time(room):
    start = time.monotonic()
    shoot(room.camera(), 200_000)
    assert time.monotonic() - start >= 0.2
    start = time.monotonic()
    shoot(room.camera(realtime=False), 10_000_000)
    assert time.monotonic() - start < 5


def test_without_real_time_the_light_counts_by_its_share(room):
    camera = room.camera(realtime=False)
    room.light(3, 0, 10**6)
    assert (shoot(camera, 2000).pixels == 20 + 250 + 8000).all()
    room.writer.put_out(time.monotonic_ns())
    assert (shoot(camera, 2000).pixels == 20 + 250).all()
    camera.arm()
    room.light(3, 0, 10**6)
    frame_id = camera.trigger()
    time.sleep(0.02)
    room.writer.put_out(time.monotonic_ns())
    time.sleep(0.02)
    # 270 in the dark, 8270 if the LED is on throughout.
    assert 300 < camera.fetch(frame_id, 1.0).pixels[0, 0] < 8200


def test_a_shot_whose_light_was_cut_off_is_the_same_when_it_is_taken_again(room):
    """A busy host loses shots, and the frames of a recording must not depend on that."""
    lamps = Lamps(warm_up=0.2, warm_up_s=0.01, flicker=0.1)
    options = {"realtime": False, "noisy": True, "lamps": lamps}
    room.light(3, 0, 10**7)
    undisturbed = room.camera(**options)
    first, second = (shoot(undisturbed, 2000).pixels for _ in range(2))
    camera = room.camera(**options)

    def cut_off(*shot):
        room.writer.put_out(time.monotonic_ns())
        return photons(*shot)

    photons, camera._sensor._photons = camera._sensor._photons, cut_off
    shoot(camera, 2000)
    camera._sensor._photons = photons
    room.light(3, 0, 10**7)
    np.testing.assert_array_equal(shoot(camera, 2000).pixels, first)
    np.testing.assert_array_equal(shoot(camera, 2000).pixels, second)
    assert (first != second).any()


def test_frame_ids_increase_and_older_frames_are_not_returned(room):
    camera = room.armed(1000)
    first = camera.trigger()
    second = camera.trigger()
    assert (first, second) == (0, 1)
    assert camera.fetch(second, 1.0).frame_id == second
    with pytest.raises(CameraError, match="no frame 0 is under way"):
        camera.fetch(first, 1.0)


def test_a_lost_frame_times_out_with_its_id(room):
    camera = room.camera(faults={0: "lost"})
    start = time.monotonic()
    camera.arm()
    with pytest.raises(CameraError, match=r"frame 0 did not come within 0\.05 s"):
        camera.fetch(camera.trigger(), 0.05)
    assert time.monotonic() - start >= 0.05


def test_a_late_frame_arrives_at_the_second_fetch(room):
    camera = room.camera(faults={0: "late"})
    camera.arm()
    frame_id = camera.trigger()
    with pytest.raises(CameraError, match="frame 0"):
        camera.fetch(frame_id, 0.01)
    assert camera.fetch(frame_id, 1.0).frame_id == 0


def test_a_timeout_shorter_than_the_exposure(room):
    camera = room.armed(10_000_000)
    with pytest.raises(CameraError, match="frame 0"):
        camera.fetch(camera.trigger(), 0.02)


def test_a_pulse_during_an_exposure_or_too_soon_after_it_is_missed(room):
    camera = room.armed(20_000, "line")
    ids = [camera.expect() for _ in range(3)]
    now = time.monotonic_ns()
    times = [now + after_us * US for after_us in (5000, 15_000, 25_000, 45_000)]
    for time_ns in times:
        room.writer.pulse(time_ns)
    taken = [camera.fetch(frame_id, 2.0).timestamp_ns for frame_id in ids]
    # The second pulse was during the first exposure.
    assert taken == [times[0], times[2], times[3]]


def test_exposures_are_recorded_in_the_bench_state(room):
    camera = room.camera()
    camera.configure(exposure_us=3000)
    starts = []
    for trigger in ("software", "line"):
        camera.arm(trigger)
        if trigger == "line":
            frame_id = camera.expect()
            room.writer.pulse(time.monotonic_ns() + 1000 * US)
        else:
            frame_id = camera.trigger()
        starts.append(camera.fetch(frame_id, 2.0).timestamp_ns)
    with BenchState(room.path) as bench:
        stated = [(exposure.start_ns, exposure.end_ns) for exposure in bench.exposures()]
    assert stated == [(start, start + 3000 * US) for start in starts]


def test_exposures_by_the_line_take_time_even_without_real_time(room):
    camera = room.armed(100_000, "line", realtime=False)
    frame_id = camera.expect()
    room.writer.pulse(time.monotonic_ns())
    frame = camera.fetch(frame_id, 2.0)
    assert time.monotonic_ns() - frame.timestamp_ns >= 100_000 * US


def test_all_methods_of_an_unplugged_camera_fail_except_close(room):
    camera = room.camera(faults={1: "unplug"}, name="cam-7")
    shoot(camera, 1000)
    for act in (
        camera.trigger,
        camera.arm,
        camera.disarm,
        lambda: camera.configure(exposure_us=100),
        lambda: camera.fetch(0, 1.0),
    ):
        with pytest.raises(CameraError, match=r"cam-7 .*unplugged"):
            act()
    camera.close()


@pytest.mark.parametrize("exposure_us", [9.0, 1e7 + 1, 0.0, -1.0, float("nan"), float("inf")])
def test_exposure_times_outside_the_range_are_refused(room, exposure_us):
    with pytest.raises(CameraError, match=r"10 to 1e\+07 us"):
        room.camera().configure(exposure_us=exposure_us)


def test_the_exposure_time_read_back_is_the_one_used(room):
    camera = room.camera()
    assert camera.configure(exposure_us=1000.4) == 1000.0
    camera.arm()
    frame = camera.fetch(camera.trigger(), 1.0)
    assert frame.exposure_us == 1000.0
    assert (frame.pixels == 20 + 125).all()


def test_a_trigger_before_arming(room):
    with pytest.raises(CameraError, match="before it was armed"):
        room.camera().trigger()


def test_a_plane_of_the_wrong_size_or_type_is_refused(room):
    for wrong in (np.zeros((4, 5), np.float32), np.zeros(SIZE)):
        with pytest.raises(CameraError, match="expected float32 of"):
            shoot(room.camera(lambda led, wrong=wrong: wrong), 100)


def test_noise_depends_on_the_shot_and_not_on_the_order(room):
    noise = NoiseModel(1.0, 5.0, 100.0, 12)

    def take(shots, seed=1):
        camera = room.camera(noise=noise, noisy=True, seed=seed, realtime=False)
        frames = {}
        for led, exposure_us in shots:
            room.writer.put_out(time.monotonic_ns())
            if led is not None:
                room.light(led, 0, 10**6)
            frames.setdefault((led, exposure_us), []).append(shoot(camera, exposure_us).pixels)
        return frames

    shots = [(0, 100), (1, 100), (None, 100), (0, 200), (0, 100)]
    one, other = take(shots), take(shots[::-1])
    for shot, frames in one.items():
        for frame, again in zip(frames, other[shot], strict=True):
            assert np.array_equal(frame, again)
    flat = [frame.tobytes() for frames in one.values() for frame in frames]
    assert len(set(flat)) == len(flat)
    assert not np.array_equal(take(shots, seed=2)[0, 100][0], one[0, 100][0])


@pytest.mark.parametrize(
    ("cfa", "bits", "name"),
    [
        pytest.param("RGGB", 12, "BayerRG12", id="RGGB"),
        pytest.param("GRBG", 8, "BayerGR8", id="GRBG"),
        pytest.param("GBRG", 10, "BayerGB10", id="GBRG"),
        pytest.param("BGGR", 16, "BayerBG16", id="BGGR"),
        pytest.param(None, 10, "Mono10", id="mono"),
    ],
)
def test_the_pixel_format_has_its_genicam_name(room, cfa, bits, name):
    info = room.camera(cfa=cfa, noise=NoiseModel(1.0, 0.0, 20.0, bits)).info
    assert (info.pixel_format, info.cfa, info.bit_depth) == (name, cfa, bits)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        pytest.param({"cfa": "RGB"}, "cfa 'RGB' is not one of RGGB", id="cfa"),
        pytest.param({"shake_px": -0.1}, "shake_px is -0.1", id="shake"),
        pytest.param({"shake_px": float("nan")}, "shake_px is nan", id="shake nan"),
    ],
)
def test_invalid_arguments_are_refused(room, options, message):
    with pytest.raises(CameraError, match=message):
        room.camera(**options)


def test_the_fixed_pattern_does_not_depend_on_the_seed_of_the_noise(room):
    noise = NoiseModel(1.0, 0.0, 500.0, 12, dsnu_e=20.0, hot_pixel_fraction=0.2,
                       hot_pixel_e_per_s=4e4)  # fmt: skip
    one = shoot(room.camera(noise=noise, seed=1), 1000).pixels
    assert np.array_equal(shoot(room.camera(noise=noise, seed=2), 1000).pixels, one)
    assert not np.array_equal(shoot(room.camera(noise=noise, sensor_seed=1), 1000).pixels, one)
    # Dark current and hot pixels increase with the exposure time, offsets do not.
    grown = shoot(room.camera(noise=noise), 11_000).pixels - one.astype(float) - 1250
    assert set(np.flatnonzero(grown > 1)) == set(np.flatnonzero(_hot(noise)))


def _hot(noise):
    return fixed_pattern(noise, SIZE).maps[2] > 100


class Picture:
    """A camera that sees a smooth picture in ambient light only."""

    SIZE = (48, 64)

    def __init__(self, room, **options):
        self.options = {"size": self.SIZE, "realtime": False, **options}
        self.room = room

    @staticmethod
    def value(x, y):
        return 30 + 8 * np.sin(2 * np.pi * (x + 0.5 * y) / 9) + 5 * np.cos(2 * np.pi * y / 7)

    def take(self, count):
        y, x = np.mgrid[: self.SIZE[0], : self.SIZE[1]]
        plane = self.value(x, y).astype(np.float32)
        camera = self.room.camera(lambda led: plane, **self.options)
        return [shoot(camera, 1000).pixels.astype(float) - 20 for _ in range(count)]

    def shift_of(self, frame):
        """The shift that fits the picture to a frame, and the residual."""
        y, x = (v[12:-12, 12:-12] for v in np.mgrid[: self.SIZE[0], : self.SIZE[1]])
        seen = frame[12:-12, 12:-12]

        def residual(shift):
            return (1000 * self.value(x - shift[0], y - shift[1]) - seen).ravel()

        result = optimize.least_squares(residual, (0.0, 0.0))
        return result.x, np.sqrt(np.mean(result.fun**2))


def test_shake_moves_frames_by_its_standard_deviation(room):
    picture = Picture(room, shake_px=0.1)
    shifts = []
    for frame in picture.take(60):
        shift, left = picture.shift_of(frame)
        # A thousandth of the range of 13 000.
        assert left < 13
        shifts.append(shift)
    spread = np.std(shifts)
    # Three standard deviations of an estimate from 120 numbers.
    assert spread == pytest.approx(0.1, rel=3 / np.sqrt(2 * 120))
    assert np.abs(np.mean(shifts, axis=0)).max() < 4 * 0.1 / np.sqrt(60)


def test_shake_depends_only_on_the_seed(room):
    one, other = (Picture(room, shake_px=0.1, seed=5).take(2) for _ in range(2))
    assert np.array_equal(one, other)
    assert not np.array_equal(one[0], one[1])
    still = Picture(room).take(2)
    assert np.array_equal(still[0], still[1])


def test_shake_does_not_mix_the_colours_of_a_mosaic(room):
    filters = np.tile(np.float32([[1, 2], [3, 60]]), (8, 8))
    camera = room.camera(lambda led: filters, size=(16, 16), cfa="RGGB", shake_px=0.3)
    np.testing.assert_allclose(shoot(camera, 1000).pixels, 20 + 1000 * filters, atol=1)


def test_a_frame_does_not_depend_on_the_bands_in_which_it_is_computed(room, monkeypatch):
    noise = NoiseModel(1.0, 2.0, 20.0, 16, prnu=0.1, dsnu_e=3.0)
    for shake_px in (0.0, 0.4):
        frames = []
        for band, kept in ((2**22, 2**25), (SIZE[1], 2**25), (SIZE[1], 0)):
            monkeypatch.setattr(virtual_sensor, "_BAND", band)
            monkeypatch.setattr(virtual_sensor, "_KEPT", kept)
            camera = room.camera(noise=noise, noisy=True, shake_px=shake_px, realtime=False)
            frames.append(shoot(camera, 8000).pixels)
        assert np.unique(frames[0]).size > 5
        np.testing.assert_array_equal(frames[1], frames[0])
        np.testing.assert_array_equal(frames[2], frames[0])
