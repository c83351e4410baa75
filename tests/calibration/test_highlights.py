import numpy as np
import pytest

from calibration.spheres import Candidates, Ellipse, Highlights, find_highlights
from calibration.spheres.highlights.spot import weighted_centroid

OUTLINE = Ellipse.circle(60.0, 50.0, 40.0)


def spot(x, y, peak, sigma=0.8, shape=(100, 120)):
    """Return a Gaussian spot integrated over pixels by supersampling."""
    sub = (np.arange(9) + 0.5) / 9 - 0.5
    rows = (np.arange(shape[0])[:, None] + sub).ravel()
    columns = (np.arange(shape[1])[:, None] + sub).ravel()
    g = np.exp(-((rows[:, None] - y) ** 2 + (columns[None] - x) ** 2) / (2 * sigma**2))
    return peak * g.reshape(shape[0], 9, shape[1], 9).mean(axis=(1, 3))


def stack(places, peak=200.0, seed=0):
    rng = np.random.default_rng(seed)
    images = [spot(x, y, peak) + 0.2 + rng.normal(0, 0.01, (100, 120)) for x, y in places]
    return np.array(images, np.float32)


def centroid(image, region):
    sigma = np.sqrt(np.count_nonzero(region) / np.pi)
    return weighted_centroid(image.astype(np.float32), region, sigma)[0]


PLACES = np.array([[50.3, 44.1], [66.77, 38.42], [71.5, 57.25], [58.0, 66.9], [45.2, 55.6]])


def test_centroid_of_unsaturated_spots():
    result = find_highlights(stack(PLACES), OUTLINE)
    assert np.abs(result.pixels - PLACES).max() < 0.01
    assert not result.saturated.any()


def test_static_reflection_is_ignored():
    values = stack(PLACES) + spot(75.0, 40.0, 400.0).astype(np.float32)
    assert np.abs(find_highlights(values, OUTLINE).pixels - PLACES).max() < 0.02


def test_a_saturated_blob_is_located_at_its_centre():
    values = np.stack([spot(x, y, 50.0, sigma=2.0) for x, y in PLACES]).astype(np.float32)
    values[values >= 1] = np.nan
    result = find_highlights(values, OUTLINE)
    assert result.saturated.all()
    assert np.abs(result.pixels - PLACES).max() < 0.15


def clipped_with_rays():
    """Return images that are clipped at 1, with a ray of the star on one side of each core."""
    y, x = np.mgrid[:100, :120]
    images = []
    for at_x, at_y in PLACES:
        ray = 1.5 * np.exp(-np.abs(x - at_x - 6) / 5 - ((y - at_y) / 0.7) ** 2) * (x > at_x)
        images.append(np.minimum(spot(at_x, at_y, 50.0, sigma=1.5) + ray, 1))
    return np.array(images, np.float32)


def jpeg_like(values):
    rng = np.random.default_rng(0)
    return values - (0.01 * (rng.random(values.shape) < 0.5) * values).astype(np.float32)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda values: 0.3 * values, id="darker"),
        pytest.param(lambda values: values / np.arange(1, 6)[:, None, None], id="by strength"),
        pytest.param(lambda values: 0.3 * jpeg_like(values), id="ringing"),
    ],
)
def test_an_even_top_below_white_is_saturated(change):
    """Before, the ray moved these spots by .5 px and more, and .1 px was stated."""
    values = clipped_with_rays()
    marked = find_highlights(np.where(values >= 1, np.float32(np.nan), values), OUTLINE)
    result = find_highlights(change(values).astype(np.float32), OUTLINE)
    assert result.saturated.all()
    assert np.abs(result.pixels - marked.pixels).max() < 0.1
    assert np.abs(result.pixels - PLACES).max() < 0.25


@pytest.mark.parametrize(
    ("peak_dn", "sigma"),
    [
        pytest.param(12.0, 4.0, id="dark"),
        pytest.param(60.0, 3.0, id="half as bright"),
        pytest.param(250.0, 1.5, id="bright and small"),
        pytest.param(250.0, 3.0, id="bright and large"),
    ],
)
def test_a_peak_in_whole_numbers_is_not_saturated(peak_dn, sigma):
    values = np.stack([np.rint(spot(x, y, peak_dn, sigma=sigma)) for x, y in PLACES])
    result = find_highlights(values.astype(np.float32), OUTLINE)
    assert not result.saturated.any()
    assert np.abs(result.pixels - PLACES).max() < 0.1


def test_a_saturated_blob_on_a_reflection_next_to_a_brighter_area():
    """A brighter area outside the outline does not affect the position of the blob."""
    values = np.stack([spot(x, y, 10.0, sigma=2.0) for x, y in PLACES]).astype(np.float32)
    y, x = np.mgrid[:100, :120]
    values[:, np.hypot(x - 60, y - 50) < 40] += 0.6
    values[0, 8:12, 18:22] = 2.0
    values[values >= 1] = np.nan
    result = find_highlights(values, OUTLINE)
    assert result.saturated.all()
    assert np.abs(result.pixels - PLACES).max() < 0.2


@pytest.mark.parametrize(
    ("top", "bottom"),
    [
        pytest.param(44, 45, id="through its middle, into two parts"),
        pytest.param(39, 45, id="over its upper part"),
    ],
)
def test_a_reflection_does_not_cut_a_saturated_blob(top, bottom):
    """It is bright under all lights, so that it is subtracted from the images."""
    values = np.stack([spot(x, y, 50.0, sigma=2.0) for x, y in PLACES]).astype(np.float32)
    values[:, top:bottom, 30:90] += 0.8
    values[values >= 1] = np.nan
    result = find_highlights(values, OUTLINE)
    assert np.linalg.norm(result.pixels[0] - PLACES[0]) < min(3 * result.sigma_px[0], 0.5)


@pytest.mark.parametrize("at", [0.87, 0.93])
def test_secondary_reflection_near_the_rim_is_rejected(at):
    """The flank of the nearer one is within 0.85 of the radius, but not its centre."""
    values = stack(PLACES)
    values[2] = stack([(60 + 40 * at, 50.0)])[0]  # the light is hidden
    for saturation in (1e9, 20.0):
        clipped = np.where(values > saturation, np.float32(np.nan), values)
        result = find_highlights(clipped, OUTLINE)
        assert result.found.tolist() == [True, True, False, True, True]
        assert result.saturated.tolist() == (result.found & (saturation == 20)).tolist()


@pytest.mark.parametrize(("share", "found"), [(0.01, False), (0.028, False), (0.035, True)])
def test_a_spot_with_less_than_3_percent_of_the_usual_flux_is_a_reflection(share, found):
    values = stack(PLACES)
    values[1] = stack([(52.0, 60.0)], peak=200 * share, seed=5)[0]
    assert find_highlights(values, OUTLINE).found.tolist() == [True, found, True, True, True]


@pytest.mark.parametrize(("share", "found"), [(0.012, False), (0.03, True)])
def test_a_wide_spot_with_less_than_3_percent_of_the_usual_height_is_a_reflection(share, found):
    """Its flux is 10 % of the usual one or more: the height, smoothed over a pixel, decides."""
    values = stack(PLACES)
    height = float(values.max()) * share
    values[1] = stack([(0.0, 0.0)], peak=0.0)[0] + spot(52.0, 60.0, height, sigma=2.5)
    assert find_highlights(values, OUTLINE).found.tolist() == [True, found, True, True, True]


def test_the_flux_does_not_include_the_background():
    values = stack(PLACES[:2])
    values[1] = stack(PLACES[1:2], peak=2.0)[0] + 10
    assert find_highlights(values, OUTLINE).found.tolist() == [True, False]


@pytest.mark.parametrize(
    ("share", "found"), [(0.4, True), (0.5, True), (0.55, False), (1.0, False), (1.5, False)]
)
def test_a_rival_with_more_than_half_the_flux_is_ambiguous(share, found):
    values = dots((30, 40), (45, 55), (70, 45))
    values[1, 45, 70] += share
    assert find_highlights(values, OUTLINE).found.tolist() == [True, found, True]


def dots(*places, shape=(100, 120)):
    """Return one image with a bright pixel per place (x, y)."""
    values = np.zeros((len(places), *shape), np.float32)
    for image, (x, y) in zip(values, places, strict=True):
        image[y, x] = 1
    return values


@pytest.mark.parametrize(
    ("radius", "found"), [(4.0, True), (6.0, True), (7.6, False), (15.0, False)]
)
def test_a_disc_wider_than_0_35_of_the_radius_is_not_a_highlight(radius, found):
    y, x = np.mgrid[:100, :120]
    # An even disc would be saturated.
    matte = np.random.default_rng(0).uniform(0.9, 1, (100, 120))
    values = (matte * (np.hypot(x - 65, y - 45) < radius)).astype(np.float32)[None]
    assert find_highlights(values, OUTLINE).found.tolist() == [found]


@pytest.mark.parametrize(("sigma", "found"), [(3.5, True), (5.0, False)])
def test_the_width_of_a_spot_is_that_at_0_3_of_its_height(sigma, found):
    """The diameter is 3.1 sigma there; the limit is 14 px."""
    values = spot(65, 45, 1.0, sigma=sigma)[None].astype(np.float32)
    assert find_highlights(values, OUTLINE).found.tolist() == [found]


@pytest.mark.parametrize(("side", "found"), [(1, True), (3, False)])
def test_a_spot_of_up_to_3_px_is_compact_on_a_small_sphere(side, found):
    values = np.zeros((1, 30, 30), np.float32)
    values[0, 14 : 14 + side, 14 : 14 + side] = 1
    assert find_highlights(values, Ellipse.circle(15.0, 15.0, 6.0)).found.tolist() == [found]


@pytest.mark.parametrize("lights", [1, 2, 3, 5])
def test_the_shared_brightness_is_subtracted_from_three_lights_on(lights):
    static = spot(75.0, 40.0, 400.0).astype(np.float32)
    found = find_highlights(stack(PLACES[:lights]) + static, OUTLINE)
    expected = PLACES[:lights] if lights >= 3 else np.full((lights, 2), [75.0, 40.0])
    assert np.abs(found.pixels - expected).max() < 0.02


@pytest.mark.parametrize("lit", [3, 12, 24, 25, 31])
@pytest.mark.parametrize("brightness", [0.8, 2.0])
def test_a_lamp_that_shines_under_some_of_the_lights_is_no_highlight(lit, brightness):
    places = [(8 + 2 * (i % 8), 16 + 2 * (i // 8)) for i in range(32)]
    values = dots(*places, shape=(32, 32))
    values[:lit, 8, 16] = brightness
    result = find_highlights(values, Ellipse.circle(15.5, 15.5, 16.0))
    np.testing.assert_allclose(result.pixels, places, atol=0.05)


def test_lights_that_were_recorded_several_times_are_no_lamps():
    values = stack(np.repeat(PLACES, 4, axis=0))
    assert np.abs(find_highlights(values, OUTLINE).pixels - np.repeat(PLACES, 4, 0)).max() < 0.01


def test_a_rival_is_kept_as_a_candidate():
    values = dots((30, 40), (45, 55), (70, 45))
    values[1, 45, 70] += 0.7
    result = find_highlights(values, OUTLINE)
    assert result.ambiguous.tolist() == [False, True, False]
    np.testing.assert_allclose(result.candidates.pixels[1, :2], [(45, 55), (70, 45)], atol=0.02)
    assert result.candidates.share[1, 1] == pytest.approx(0.7, abs=0.02)
    chosen = result.chosen(np.array([0, 1, -1]))
    np.testing.assert_allclose(chosen.pixels[:2], [(30, 40), (70, 45)], atol=0.02)
    assert chosen.found.tolist() == [True, True, False]


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_the_scale_of_the_images_does_not_matter(scale):
    values = stack(PLACES)
    values[3] += spot(70.0, 45.0, 40.0).astype(np.float32)
    plain, scaled = find_highlights(values, OUTLINE), find_highlights(scale * values, OUTLINE)
    np.testing.assert_allclose(scaled.pixels, plain.pixels, atol=1e-4)


@pytest.mark.parametrize(("peak", "found"), [(0.09, False), (0.3, True)])
def test_a_spot_must_exceed_the_noise(peak, found):
    values = stack(PLACES, peak=0.0) + dots(*PLACES.astype(int)) * np.float32(peak)
    assert find_highlights(values[:2], OUTLINE).found.tolist() == [found] * 2


def test_a_spot_on_a_bright_reflection_with_a_dark_hole():
    values = np.full((1, 100, 120), 10, np.float32)
    values[0, 60:64, 40:44] = 0
    values += spot(71.5, 57.25, 1.0).astype(np.float32)
    assert np.abs(find_highlights(values, OUTLINE).pixels - (71.5, 57.25)).max() < 0.01


@pytest.mark.parametrize("size", [8, 40])
def test_the_long_axis_of_an_ellipse_is_in_reach(size):
    places = [(60 + size, 50), (60 - size, 50), (60, 50 + size // 2), (60, 50 - size // 2)]
    outline = Ellipse((60.0, 50.0), (1.225 * size, 0.8165 * size))
    found = find_highlights(dots(*places), outline)
    np.testing.assert_allclose(found.pixels, places, atol=1e-3)


@pytest.mark.parametrize(
    ("outline", "values"),
    [
        pytest.param(Ellipse.circle(-60.0, 50.0, 40.0), 0.0, id="left of the frame"),
        pytest.param(Ellipse.circle(60.0, 500.0, 40.0), 0.0, id="below the frame"),
        pytest.param(OUTLINE, np.nan, id="completely saturated"),
        pytest.param(Ellipse.circle(60.5, 50.5, 0.5), 1.0, id="between the pixels"),
    ],
)
def test_a_sphere_that_shows_nothing_has_no_highlights(outline, values):
    result = find_highlights(np.full((3, 100, 120), values, np.float32), outline)
    assert result.pixels.shape == (3, 2)
    assert not result.found.any()
    assert not result.saturated.any()


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.5])
def test_a_neighbour_at_five_sigma_has_little_weight(sigma):
    """The window of 1.55 sigma reduces its flux to 2.5 %; the shift is 0.032 sigma."""
    image = spot(40.3, 50.6, 1.0, sigma) + spot(40.3 + 5 * sigma, 50.6, 0.25, sigma)
    region = spot(40.3, 50.6, 1.0, sigma) > 0.3
    centre = centroid(image, region)
    assert centre == pytest.approx((40.3, 50.6), abs=0.045 * sigma)


@pytest.mark.parametrize("corner", [(5.3, 5.6), (113.4, 5.6), (5.3, 93.8), (113.4, 93.8)])
def test_a_bright_background_does_not_move_a_spot_in_a_corner(corner):
    """The window is cut off, so a background would move the centre away from the corner."""
    image = spot(*corner, 1.0, sigma=1.6)
    region = image > 0.3
    inner = np.where(np.array(corner) < 50, np.add(corner, 9), np.subtract(corner, 9)).astype(int)
    image[inner[1], inner[0]] = -0.5
    centre = centroid(image + 100, region)
    assert centre == pytest.approx(corner, abs=0.02)


def test_a_region_without_flux_keeps_its_centre():
    image = np.ones((20, 20), np.float32)
    region = np.zeros((20, 20), bool)
    region[7, 9] = True
    assert centroid(image, region).tolist() == [9, 7]


@pytest.mark.parametrize(("gap", "found"), [(1, False), (2, True)])
def test_a_spot_that_touches_the_frame_is_ignored(gap, found):
    """One bright pixel becomes a spot of 3 x 3 pixels."""
    places = [(gap, 15), (39 - gap, 14), (20, gap), (21, 29 - gap), (12, 12)]
    outline = Ellipse.circle(19.5, 14.5, 40.0)
    result = find_highlights(dots(*places, shape=(30, 40)), outline)
    assert result.found.tolist() == [found] * 4 + [True]


def test_a_spot_cut_off_by_the_frame_is_ignored():
    """The centre of the remaining part is wrong by up to 1.4 px, here 4 degrees of the light."""
    places = np.array([[50.3, 20.1], [66.8, 8.4], [71.5, 0.2], [58.0, -0.4], [45.2, -0.9]])
    values = np.stack([spot(x, y, 200.0, sigma=1.5) + 0.2 for x, y in places]).astype(np.float32)
    result = find_highlights(values, Ellipse.circle(60.0, 10.0, 40.0))
    assert result.found.tolist() == [True, True, False, False, False]
    assert np.abs(result.pixels[:2] - places[:2]).max() < 0.01


@pytest.mark.parametrize("kind", ["dark", "noise", "wide"])
def test_no_highlight(kind):
    rng = np.random.default_rng(4)
    values = {
        "dark": np.zeros((4, 100, 120)),
        "noise": rng.normal(0.2, 0.01, (4, 100, 120)),
        "wide": np.stack([spot(x, y, 1.0, sigma=15.0) for x, y in PLACES[:4]]),
    }[kind]
    assert not find_highlights(values.astype(np.float32), OUTLINE).found.any()


def test_highlights_of_some_lights_in_another_order():
    light = np.arange(6.0)
    spots = light[:, None] + 10 * np.arange(3)
    of_all = Highlights(
        np.column_stack([light, light + 0.5]),
        light % 2 == 0,
        light / 10,
        Candidates(np.stack([spots, spots + 1], -1), spots > 21, spots / 7, spots / 5, spots / 3),
        unlike=(2, 5),
        photon_px2=light / 9,
    )
    some = of_all.take([5, -1, 0])
    for part, of in (
        (some.pixels, of_all.pixels),
        (some.sigma_px, of_all.sigma_px),
        (some.photon_px2, of_all.photon_px2),
        (some.candidates.pixels, of_all.candidates.pixels),
        (some.candidates.sigma_px, of_all.candidates.sigma_px),
        (some.candidates.share, of_all.candidates.share),
        (some.candidates.photon_px2, of_all.candidates.photon_px2),
    ):
        np.testing.assert_array_equal(part[[0, 2]], of[[5, 0]])
        assert np.isnan(part[1]).all()
    assert some.found.tolist() == some.candidates.seen.tolist() == [True, False, True]
    assert some.saturated.tolist() == [False, False, True]
    assert some.candidates.saturated.tolist() == [[False, False, True], [False] * 3, [False] * 3]
    assert some.unlike == (0,)
    assert not some.ambiguous.any()
    without = Highlights(of_all.pixels, of_all.saturated, of_all.sigma_px).take([3])
    assert without.photon_px2 is None
    assert without.candidates.photon_px2 is None
    np.testing.assert_array_equal(without.pixels, of_all.pixels[3:4])
