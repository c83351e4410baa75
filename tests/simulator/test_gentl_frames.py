"""Frames of the virtual GenICam camera, compared with the camera in Python and closed forms."""

import time

import numpy as np
import pytest

from acquisition import NoiseModel
from rig import CameraError
from simulator.bench import BenchState
from simulator.camera import GentlCamera, ImageFormation, VirtualCamera
from simulator.scene import Lamps
from tests.simulator import gentl_client as gentl
from tests.simulator.camera_options import grouped

SIZE = (96, 130)
LEDS = 3
PLAIN = NoiseModel(2.5, 4.0, 64.0, 12)
UNEVEN = NoiseModel(
    2.5, 4.0, 64.0, 12, quantum_efficiency=0.6, full_well_e=8000.0, dark_current_e_per_s=3000.0,
    dsnu_e=4.0, prnu=0.02, hot_pixel_fraction=0.01, hot_pixel_e_per_s=2e5,
)  # fmt: skip
LAMPS = Lamps(warm_up=0.1, warm_up_s=0.01, flicker=0.02, pwm_hz=500.0, pwm_duty=0.3, dead=(1,))
# LED, exposure in us, gain in dB; dark, dim, bright, saturated, and the same again.
SHOTS = [(0, 1000, 0.0), (1, 1000, 0.0), (1, 1000, 0.0), (None, 3000, 6.0), (2, 2000, 12.0),
         (2, 5000, 0.0), (0, 20, 0.0)]  # fmt: skip
S = 10**9


def plane(led):
    index = 0 if led is None else led + 1
    bright = np.random.default_rng(index).uniform(0, 2, SIZE)
    return (bright * (0.02, 1.0, 2.0, 5.0)[index]).astype(np.float32)


class Bench(gentl.Bench):
    def camera(self, planes=plane, *, exposure_us=1000.0, **options):
        # Shots may follow each other without a pause.
        usual = {"size": SIZE, "leds": LEDS, "noise": PLAIN, "frame_rate_hz": 1e5}
        device = self.open(planes, **usual | options)
        device.set("TriggerMode", "On")
        device.set("ExposureTime", exposure_us)
        device.start()
        return device

    def reference(self, **options):
        camera = VirtualCamera(plane, **grouped(size=SIZE, bench=BenchState(self.path), **options))
        camera.arm()
        return camera

    def light(self, led, for_s=10.0):
        now = time.monotonic_ns()
        self.writer.light(led, now, now + round(for_s * S))


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path / "bench.state")
    yield bench
    bench.close()


def both(bench, shots, noise, **options):
    """Frames of the Python camera and of the C camera for the same shots."""
    reference = bench.reference(noise=noise, **options)
    device = bench.camera(noise=noise, **options)
    for led, exposure_us, gain_db in shots:
        reference.configure(exposure_us=exposure_us, gain_db=gain_db)
        device.set("ExposureTime", exposure_us)
        device.set("Gain", gain_db)
        if led is not None:
            bench.light(led)
        frame_id = reference.trigger()
        device.execute("TriggerSoftware")
        yield reference.fetch(frame_id, 5.0).pixels.astype(int), device.fetch().pixels.astype(int)
        bench.writer.put_out(time.monotonic_ns())
    reference.close()


@pytest.mark.parametrize(
    ("noise", "options"),
    [
        pytest.param(PLAIN, {}, id="shot and read noise"),
        pytest.param(PLAIN, {"noisy": False}, id="no noise"),
        pytest.param(PLAIN, {"seed": 2**62 + 11}, id="another seed"),
        pytest.param(UNEVEN, {}, id="fixed pattern, dark current, full well"),
        pytest.param(UNEVEN, {"noisy": False, "sensor_seed": 5}, id="fixed pattern alone"),
        pytest.param(UNEVEN, {"lamps": LAMPS, "seed": 3}, id="lamps"),
        pytest.param(NoiseModel(1.0, 2.0, 0.0, 16), {"cfa": "GRBG"}, id="mosaic of 16 bits"),
        pytest.param(NoiseModel(40.0, 9.0, 2.0, 8), {}, id="8 bits"),
    ],
)
def test_frames_equal_those_of_the_camera_in_python(bench, noise, options):
    for expected, seen in both(bench, SHOTS, noise, **options):
        assert np.abs(seen - expected).max() <= 1
        assert np.mean(seen != expected) <= 1e-4


@pytest.mark.parametrize("cfa", [None, "RGGB"])
@pytest.mark.parametrize("shake_px", [0.1, 3.0])
def test_shaken_frames_equal_those_of_the_camera_in_python(bench, cfa, shake_px):
    """The interpolation sums in another order: 1 of 1000 pixels may differ by one grey value."""
    for expected, seen in both(bench, SHOTS[:4], PLAIN, noisy=False, cfa=cfa, shake_px=shake_px):
        assert np.abs(seen - expected).max() <= 1
        assert np.mean(seen != expected) <= 1e-3


def test_the_frames_of_the_reference_differ_as_expected(bench):
    frames = [seen for _, seen in both(bench, SHOTS, PLAIN)]
    assert not np.array_equal(frames[1], frames[2])
    assert frames[5].max() == 4095


EVEN = NoiseModel(1.0, 0.0, 20.0, 16)


def even(value, leds, size=(4, 6)):
    """Planes: LED number plus 1 photons per us for each LED, 0.125 for the ambient light."""

    def planes(led):
        return np.full(size, 0.125 if led is None else value * (led + 1), np.float32)

    return {"planes": planes, "size": size, "leds": leds, "noise": EVEN, "noisy": False}


def test_an_led_counts_for_the_time_it_is_on_during_the_exposure(bench):
    device = bench.camera(**even(1, 3), exposure_us=40_000.0)
    device.execute("TriggerSoftware")
    gentl.wait_for(lambda: BenchState(bench.path).exposures())
    start_ns = BenchState(bench.path).exposures()[0].start_ns
    bench.writer.light(0, start_ns - 5_000_000, start_ns + 10_000_000)
    bench.writer.light(1, start_ns + 30_000_000, start_ns + S)
    frame = device.fetch()
    assert (frame.pixels == 20 + 5000 + 10_000 + 2 * 10_000).all()
    assert frame.start_ns == start_ns


def test_two_leds_at_once_add_up_and_a_dimmed_one_counts_less(bench):
    device = bench.camera(**even(1, 3), exposure_us=4000.0)
    now = time.monotonic_ns()
    bench.writer.light(0, now, now + 10 * S)
    bench.writer.light(2, now, now + 10 * S, level=819)
    assert (device.shoot().pixels == 20 + 500 + 4000 + 3 * 800).all()


def test_leds_without_a_plane_are_dark(bench):
    options = even(1, 3)
    planes = options["planes"]
    options["planes"] = lambda led: None if led in (None, 1) else planes(led)
    device = bench.camera(**options)
    for led, value in ((1, 20), (2, 3020), (3, 20), (1000, 20)):
        bench.light(led)
        assert (device.shoot().pixels == value).all()
        bench.writer.put_out(time.monotonic_ns())


def test_an_exposure_with_more_led_changes_than_the_ring_gives_no_frame(bench):
    device = bench.camera(**even(1, 3), exposure_us=200_000.0)
    device.execute("TriggerSoftware")
    for _ in range(70):
        bench.light(0, 0.001)
    assert device.no_frame_arrives(0.4)
    assert bench.opened[0][1].counts().dropped == 1
    device.set("ExposureTime", 1000.0)
    assert device.shoot().block == 1


def test_rows_of_a_rolling_shutter_are_exposed_one_after_the_other(bench):
    rows, readout_us, exposure_us = 100, 20_000.0, 5000.0
    options = even(1, 1, (rows, 3))
    device = bench.camera(**options, shutter="rolling", readout_us=readout_us)
    assert device.get("SensorShutterMode") == "Rolling"
    assert device.get("SensorReadoutTime") == readout_us
    device.set("ExposureTime", exposure_us)
    device.execute("TriggerSoftware")
    exposure = BenchState(bench.path).exposures()[0]
    assert exposure.end_ns - exposure.start_ns == 25_000_000
    lit_us = np.array([6000.0, 17_000.0])
    bench.writer.light(0, *(exposure.start_ns + (lit_us * 1000).astype(int)))
    frame = device.fetch()
    start_us = readout_us * np.arange(rows) / rows
    overlap = np.minimum(start_us + exposure_us, lit_us[1]) - np.maximum(start_us, lit_us[0])
    expected = 20 + 0.125 * exposure_us + overlap.clip(0)
    np.testing.assert_allclose(frame.pixels, np.repeat(expected[:, None], 3, axis=1), atol=0.51)


def test_pwm_makes_bands_across_the_rows_of_a_rolling_shutter(bench):
    rows, readout_us = 200, 10_000.0
    lamps = Lamps(pwm_hz=400.0, pwm_duty=0.5)
    device = bench.camera(
        **even(8, 1, (rows, 2)), shutter="rolling", readout_us=readout_us, lamps=lamps
    )
    device.set("ExposureTime", 100.0)
    bench.light(0)
    bands = device.shoot().pixels[:, 0].astype(float) - 20 - 12.5
    # Four cycles during the readout, each a quarter of the rows: twice the mean or nothing.
    assert np.mean(bands > 800) == pytest.approx(0.5, abs=0.06)
    spectrum = np.abs(np.fft.rfft(bands - bands.mean()))
    assert spectrum.argmax() == 4


def test_a_precomposed_frame_is_that_of_the_led_that_was_on_longest(bench):
    frames = np.random.default_rng(1).integers(0, 4096, (4, *SIZE), np.uint16)
    device = bench.camera(
        lambda led: frames[0 if led is None else led + 1], leds=3, precomposed=True
    )
    assert (device.shoot().pixels == frames[0]).all()
    for led in (2, 0, 1):
        bench.light(led)
        assert (device.shoot().pixels == frames[led + 1]).all()
        bench.writer.put_out(time.monotonic_ns())


def test_white_balance_and_gamma_change_the_image_only_if_they_are_on(bench):
    filters = np.tile(np.float32([[1, 2], [2, 4]]), (8, 8))
    noise = NoiseModel(1.0, 0.0, 0.0, 12)
    options = {"size": (16, 16), "leds": 0, "noise": noise, "noisy": False, "cfa": "RGGB"}
    device = bench.camera(lambda led: filters, exposure_us=500.0, **options)
    linear = device.shoot().pixels
    assert (linear == filters * 500).all()
    device.set("BalanceWhiteAuto", "Continuous")
    assert (device.shoot().pixels == 1000).all()
    device.set("BalanceWhiteAuto", "Off")
    device.set("GammaEnable", 1)
    device.set("Gamma", 0.5)
    expected = np.rint(4095 * np.sqrt(linear / 4095))
    np.testing.assert_array_equal(device.shoot().pixels, expected)
    device.set("GammaEnable", 0)
    assert (device.shoot().pixels == linear).all()


def test_the_black_level_can_be_set(bench):
    device = bench.camera(**even(1, 1))
    assert device.get("BlackLevel") == 20.0
    device.set("BlackLevel", 300.0)
    device.set("ExposureTime", 8000.0)
    assert (device.shoot().pixels == 300 + 1000).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cfa": "RGB"}, "cfa 'RGB' is not one of RGGB"),
        ({"shake_px": 9.0}, "shake_px is 9.0"),
        ({"leds": 1025}, "leds is 1025"),
        ({"size": (0, 4)}, r"size is \(0, 4\)"),
        ({"frame_rate_hz": 1e-300}, "frame_rate_hz is 1e-300"),
        ({"without_nodes": ["x" * 255]}, "without_nodes is too long"),
        ({"readout_us": -1.0}, "readout_us is -1.0"),
        ({"serial": "x" * 64}, "1 to 63 characters"),
        ({"size": (4, 5)}, r"plane of LED None is float32 of shape"),
        ({"precomposed": True}, "expected uint16"),
    ],
)
def test_invalid_arguments_are_refused(options, message):
    options = {"size": SIZE, "leds": LEDS, "noise": PLAIN, **options}
    with pytest.raises(CameraError, match=message) as caught:
        GentlCamera(plane, **grouped(**options))
    assert "\n" not in str(caught.value)


def test_close_removes_the_folder_of_a_camera():
    camera = GentlCamera(plane, size=SIZE, leds=LEDS, formation=ImageFormation(PLAIN))
    folder = camera.cti.parent
    assert camera.cti.exists()
    camera.close()
    camera.close()
    assert not folder.exists()
    with pytest.raises(CameraError, match="is closed"):
        camera.counts()
