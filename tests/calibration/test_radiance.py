from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    LINEAR,
    SRGB,
    DataError,
    Frame,
    Lights,
    Source,
    TransferCurve,
    crop,
    downscale,
)
from calibration import EstimateError, linear_stack
from tests.cases import cases

pytestmark = pytest.mark.usefixtures("paths_exist")

BLACK, WHITE = 64.0, 4095.0


def frame(name, pixels, role="light", exposure_us=None, bracket=0, light_id=None):
    pixels = np.asarray(pixels)
    return Frame(
        Path(f"/nowhere/{name}.tif").with_suffix(".tif"),
        light_id or name,
        pixels.shape,
        role,
        bracket,
        exposure_us,
        _Held(pixels, name),
    )


class _Held:
    """Pixels without a file; they replace `Frame.read`, which requires an existing path."""

    def __init__(self, pixels, name):
        self.pixels, self.name = pixels, name

    def __call__(self):
        return self.pixels


def source(frames, lights=None, black=BLACK, white=WHITE, cfa=None, transfer=LINEAR):
    return Source(
        Path("/nowhere"),
        "images",
        tuple(frames),
        lights,
        black_level=black,
        white_level=white,
        cfa=cfa,
        transfer=transfer,
    )


def dn(radiance, exposure_us, offset=BLACK, rate=0.1):
    """Return the clipped grey values of a radiance for a noiseless 12-bit sensor."""
    grey = offset + rate * np.asarray(radiance, float) * exposure_us
    return np.minimum(np.round(grey), WHITE).astype(np.uint16)


def test_brackets_merge_from_the_longest_that_is_not_saturated():
    radiance = np.array([[0.5, 1.0], [10.0, 400.0]])
    frames = [
        frame(f"L00_E{b}", dn(radiance, t), exposure_us=t, bracket=b, light_id="L00")
        for b, t in enumerate((20000.0, 40.0))
    ]
    stack = linear_stack(source(frames))
    # 1 is the white level at 20 ms: radiance * .1 * 20000 / (4095 - 64).
    scale = 0.1 * 20000 / (WHITE - BLACK)
    rounding = [0.5 / (WHITE - BLACK), 0.5 * 500 / (WHITE - BLACK)]
    assert stack.ids == ("L00",)
    assert np.abs(stack.values[0, 0] - radiance[0] * scale).max() <= rounding[0] * 1.01
    assert np.abs(stack.values[0, 1] - radiance[1] * scale).max() <= rounding[1] * 1.01


def test_sample_saturated_in_every_bracket_is_nan():
    radiance = np.array([[1.0, 1e6]])
    frames = [
        frame(f"a{t}", dn(radiance, t), exposure_us=t, bracket=b, light_id="L00")
        for b, t in enumerate((20000.0, 40.0))
    ]
    values = linear_stack(source(frames)).values
    assert np.isfinite(values[0, 0, 0])
    assert np.isnan(values[0, 0, 1])


@cases(
    ("roles", "expected_offset"),
    {
        "black-level": ((), BLACK),
        "dark": (("dark",), 90.0),
        "ambient-before-dark": (("dark", "ambient"), 120.0),
    },
)
def test_offset(roles, expected_offset):
    light = np.full((2, 3), 1000, np.uint16)
    level = {"dark": 90, "ambient": 120}
    extra = [
        frame(f"{role}{i}", np.full((2, 3), level[role] + d, np.uint16), role, 100.0)
        for role in roles
        for i, d in enumerate((-2, 2))
    ]
    values = linear_stack(source([frame("L00", light, exposure_us=100.0), *extra])).values
    assert values == pytest.approx((1000 - expected_offset) / (WHITE - BLACK), rel=1e-6)


def test_a_dark_frame_of_another_exposure_is_not_used_and_is_reported():
    frames = [
        frame("L00", np.full((2, 2), 1000, np.uint16), exposure_us=100.0),
        frame("D", np.full((2, 2), 500, np.uint16), "dark", 200.0),
    ]
    stack = linear_stack(source(frames))
    assert stack.values == pytest.approx((1000 - BLACK) / (WHITE - BLACK), rel=1e-6)
    assert "100 us" in str(stack.warnings[0])


def test_dark_frames_are_not_used_without_exposure_times_of_the_images():
    frames = [
        frame("L00", np.full((2, 2), 1000, np.uint16)),
        frame("D", np.full((2, 2), 500, np.uint16), "dark", 200.0),
    ]
    stack = linear_stack(source(frames))
    assert stack.values == pytest.approx((1000 - BLACK) / (WHITE - BLACK), rel=1e-6)
    assert [notice.code for notice in stack.warnings] == ["dark-frames-unused"]


def test_intensities_divide_each_channel_before_gray():
    image = np.array([[[0.2, 0.4, 0.8]]], np.float32)
    lights = Lights(directions=[[0, 0, 1]], intensities=[[0.5, 2.0, 4.0]], ids=("a",))
    one = source([frame("a", image)], lights, 0.0, 1.0)
    assert linear_stack(one).values.item() == pytest.approx(
        0.2989 * 0.4 + 0.587 * 0.2 + 0.114 * 0.2, rel=1e-6
    )
    assert linear_stack(one, channel="rgb").values.ravel() == pytest.approx([0.4, 0.2, 0.2])


def test_single_channel_divides_by_the_mean_intensity():
    lights = Lights(directions=[[0, 0, 1]], intensities=[[1.0, 2.0, 6.0]], ids=("a",))
    image = np.full((1, 2), 0.6, np.float32)
    values = linear_stack(source([frame("a", image)], lights, 0.0, 1.0)).values
    assert values == pytest.approx(0.2, rel=1e-6)


def test_any_saturated_channel_makes_gray_nan():
    image = np.array([[[10, 255, 10], [10, 20, 30]]], np.uint8)
    values = linear_stack(source([frame("a", image)], None, 0.0, 255.0)).values
    assert np.isnan(values[0, 0, 0])
    assert np.isfinite(values[0, 0, 1])


@cases(
    ("transfer", "light"),
    {
        "linear": (LINEAR, 0.5),
        "power": (TransferCurve.power(2.2), 0.5**2.2),
        "sRGB": (SRGB, ((0.5 + 0.055) / 1.055) ** 2.4),
        "table": (TransferCurve.table([[0, 0], [4, 1], [8, 10]]), 0.1),
    },
)
@pytest.mark.parametrize("kind", [np.float32, np.uint16])
def test_the_curve_of_the_source_is_applied_relative_to_white(transfer, light, kind):
    """0.5 of the range from black to white, as a float and as a whole number."""
    image = np.array([[64 + 500, 64 + 1000, 64, 0]]).astype(kind)
    one = source([frame("a", image)], None, 64.0, 1064.0, transfer=transfer)
    values = linear_stack(one).values[0, 0]
    assert values[0] == pytest.approx(light, rel=1e-6)
    assert np.isnan(values[1]), "the white level is saturated under any curve"
    assert values[2] == 0
    assert values[3] == (0 if transfer != LINEAR else pytest.approx(-0.064))


def test_the_curve_is_undone_of_light_and_dark_before_the_difference():
    """Images with a display curve give the radiance of the light without the room light."""
    light, room, gamma = np.array([[0.02, 0.3]]), 0.1, 2.2

    def encoded(radiance):
        return (radiance ** (1 / gamma)).astype(np.float32)

    frames = [
        frame("L00", encoded(light + room), exposure_us=10.0),
        frame("A", encoded(np.full((1, 2), room)), "ambient", 10.0),
    ]
    curve = TransferCurve.power(gamma)
    values = linear_stack(source(frames, black=0.0, white=np.inf, transfer=curve)).values
    assert values[0] == pytest.approx(light, rel=1e-5)


def test_float_images_never_saturate_and_keep_their_scale():
    image = np.array([[0.5, 1.0], [3.0, 65504.0]], np.float32)
    values = linear_stack(source([frame("a", image)], black=0.0, white=np.inf)).values
    np.testing.assert_array_equal(values[0], image)


def test_the_first_image_may_be_completely_saturated():
    white = np.full((2, 2), 4095, np.uint16)
    values = linear_stack(source([frame("a", white), frame("b", white // 2)])).values
    assert np.isnan(values[0]).all()
    assert values[1] == pytest.approx((4095 // 2 - BLACK) / (WHITE - BLACK), rel=1e-6)


def test_repeats_with_slightly_different_exposures_are_averaged():
    """The radiance is constant; each frame has a slightly longer exposure and its own rounding."""
    exposures = (10_000.0, 10_000.5, 10_001.0, 10_002.0)
    noise = (-30, 10, 40, -20)
    frames = [
        frame(
            f"r{repeat}",
            np.full((2, 2), BLACK + 0.1 * exposure + error, np.float32),
            exposure_us=exposure,
            light_id="L00",
        )
        for repeat, (exposure, error) in enumerate(zip(exposures, noise, strict=True))
    ]
    dark = frame("D", np.full((2, 2), BLACK, np.float32), "dark", 10_001.0)
    stack = linear_stack(source([*frames, dark]))
    # The errors cancel in the mean; a single frame would have an error of 1 % or more.
    expected = 0.1 * exposures[-1] / (WHITE - BLACK)
    assert stack.values == pytest.approx(expected, rel=1e-5)
    assert stack.warnings == ()


def test_each_repeat_is_divided_by_its_exposure():
    frames = [
        frame("r0", np.full((1, 1), BLACK + 100, np.float32), exposure_us=1000.0, light_id="L00"),
        frame("r1", np.full((1, 1), BLACK + 200, np.float32), exposure_us=2000.0, light_id="L00"),
    ]
    assert linear_stack(source(frames)).values.item() == pytest.approx(200 / (WHITE - BLACK))


def test_repeats_are_averaged():
    frames = [
        frame(f"r{v}", np.full((1, 1), v, np.uint16), exposure_us=10.0, light_id="L00")
        for v in (1000, 1100)
    ]
    values = linear_stack(source(frames)).values
    assert values.item() == pytest.approx((1050 - BLACK) / (WHITE - BLACK), rel=1e-6)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_bayer_mosaic_of_a_linear_ramp_is_exact_inside(pattern):
    y, x = np.mgrid[:12, :14].astype(np.float32)
    truth = np.stack([0.1 + 0.01 * x, 0.2 + 0.02 * y, 0.5 - 0.01 * x + 0.005 * y], axis=-1)
    mosaic = np.zeros((12, 14), np.float32)
    for site, colour in enumerate(pattern):
        rows, columns = slice(site // 2, None, 2), slice(site % 2, None, 2)
        mosaic[rows, columns] = truth[rows, columns, "RGB".index(colour)]
    one = source([frame("a", mosaic)], None, 0.0, 1.0, cfa=pattern)
    values = linear_stack(one, channel="rgb").values[0]
    assert values[1:-1, 1:-1] == pytest.approx(truth[1:-1, 1:-1], abs=1e-6)


def test_saturated_bayer_sample_does_not_bleed():
    mosaic = np.full((8, 8), 0.25, np.float32)
    mosaic[4, 4] = 1.0  # a red site of RGGB
    values = linear_stack(
        source([frame("a", mosaic)], None, 0.0, 1.0, cfa="RGGB"), channel="rgb"
    ).values[0]
    assert np.argwhere(np.isnan(values)).tolist() == [[4, 4, 0]]
    assert np.nanmax(np.abs(values - 0.25)) < 1e-6


def test_order_and_progress():
    frames = [frame(f"L{i:02d}", np.full((2, 2), 100 + i, np.uint16)) for i in range(9)]
    calls = []
    stack = linear_stack(source(frames), on_progress=lambda *report: calls.append(report))
    assert stack.ids == tuple(f"L{i:02d}" for i in range(9))
    assert stack.values[:, 0, 0] == pytest.approx(
        (np.arange(9) + 100 - BLACK) / (WHITE - BLACK), rel=1e-6
    )
    assert calls == [("reading", i + 1, 9) for i in range(9)]


@cases(
    ("frames", "options", "error", "says"),
    {
        "nan-in-float-image": (
            [("a", np.array([[0.1, np.nan]], np.float32), 1.0)],
            {"black": 0.0, "white": 1.0},
            DataError,
            "a.tif: contains values that are not finite",
        ),
        "exposure-missing": (
            [("a", np.full((2, 2), 9, np.uint16), 1.0), ("b", np.full((2, 2), 9, np.uint16), None)],
            {},
            DataError,
            "b.tif: no valid exposure time",
        ),
        "not-bayer": (
            [("a", np.full((2, 2), 99, np.uint16), 1.0)],
            {"cfa": "RGBG"},
            DataError,
            "RGBG",
        ),
        "all-black": ([("a", np.full((2, 2), 64, np.uint16), 1.0)], {}, EstimateError, "black"),
        "all-saturated": (
            [("a", np.full((2, 2), 4095, np.uint16), 1.0)],
            {},
            EstimateError,
            "saturated",
        ),
        "white-below-black": (
            [("a", np.full((2, 2), 9, np.uint16), 1.0)],
            {"white": 10.0},
            DataError,
            "white level",
        ),
    },
)
def test_bad_input(frames, options, error, says):
    built = [frame(name, pixels, exposure_us=t) for name, pixels, t in frames]
    with pytest.raises(error, match=says) as caught:
        linear_stack(source(built, **options))
    assert "\n" not in str(caught.value)


def test_rgb_of_a_mono_image_is_refused():
    with pytest.raises(DataError, match="one channel"):
        linear_stack(source([frame("a", np.full((2, 2), 99, np.uint16))]), channel="rgb")


@pytest.mark.parametrize("channel", ["gray", "rgb"])
def test_a_region_of_a_mosaic_equals_the_region_of_the_stack(channel):
    rng = np.random.default_rng(5)
    pixels = rng.integers(64, 4096, (2, 12, 14)).astype(np.uint16)
    whole = source([frame("L00", pixels[0]), frame("L01", pixels[1])], cfa="GRBG")
    part = crop(whole, 3, 1, 8, 7)
    expected = linear_stack(whole, channel=channel).values[:, 1:8, 3:11]
    np.testing.assert_allclose(linear_stack(part, channel=channel).values, expected, rtol=1e-6)


def test_blocks_are_averages_of_light_and_saturated_ones_are_not_measured():
    pixels = np.array([[64, 164, 264, 364, 900], [264, 464, 564, WHITE, 900], [900] * 5], np.uint16)
    curve = TransferCurve.power(2.0)
    reduced = downscale(source([frame("L00", pixels, light_id="L00")], transfer=curve), 2)
    values = linear_stack(reduced).values
    light = ((pixels[:2, :2].astype(float) - BLACK) / (WHITE - BLACK)) ** 2
    assert values.shape == (1, 1, 2)
    assert values[0, 0, 0] == pytest.approx(light.mean(), rel=1e-5)
    assert np.isnan(values[0, 0, 1])
