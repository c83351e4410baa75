"""The real chrome ball of the University of Washington: 8-bit, saturated highlights, half dark."""

import cv2
import numpy as np
import pytest

from acquisition import angle_deg, read_source
from calibration import EstimateError, calibrate_spheres, linear_stack
from calibration.spheres import sphere_candidates
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data

pytestmark = needs_data


@pytest.fixture(scope="module")
def stack(chrome):
    return linear_stack(chrome)


@pytest.fixture(scope="module")
def masked(stack, chrome):
    return calibrate_spheres(stack, masks=[chrome.mask])


@pytest.fixture(scope="module")
def found(stack):
    return calibrate_spheres(stack)


def test_every_light_is_above_and_named_after_its_image(masked, found):
    for calibration in (masked, found):
        assert len(calibration.spheres) == 1
        assert np.all(calibration.lights.directions[:, 2] > 0.7)
        assert calibration.lights.ids == tuple(f"chrome.{i}" for i in range(12))
        assert "saturated" in str(calibration.warnings[0])


def test_mask_and_search_agree(masked, found):
    # The mask is drawn by hand, 1.1 px off the edge in the images (1 deg); it is refined.
    assert angle_deg(masked.lights.directions, found.lights.directions).mean() < 0.05
    assert "mask-refined" in {notice.code for notice in masked.warnings}


@pytest.mark.slow
@pytest.mark.parametrize(
    "circle", [(285, 148, 119), pytest.param((253, 148, 60), marks=pytest.mark.slow)]
)
def test_a_circle_that_is_no_outline_is_refused(stack, circle):
    with pytest.raises(EstimateError, match="do not determine the outline"):
        calibrate_spheres(stack, circles=[circle])


def test_an_approximate_circle_gives_the_same_outline(stack, found):
    circled = calibrate_spheres(stack, circles=[(249.0, 151.0, 114.0)])
    assert angle_deg(circled.lights.directions, found.lights.directions).max() < 0.05


@pytest.mark.slow
def test_six_images_that_show_the_outline_only_together(stack, found):
    """Before, refused: the steepest edges of their mean image are those of the room."""
    some = [0, 1, 10, 11, 2, 3]
    few = calibrate_spheres(np.array(stack.values[some]))
    assert angle_deg(few.lights.directions, found.lights.directions[some]).max() < 0.4


@pytest.mark.slow
def test_the_first_candidate_is_the_ball_whose_outline_too_few_edges_support(stack, found):
    """Before, a circle of 190 px radius, because more edges of the room are on it."""
    few = np.array(stack.values[:6])
    with pytest.raises(EstimateError, match=r"move with the light near .* no outline of a mirror"):
        calibrate_spheres(few)
    first = sphere_candidates(few)[0]
    outline = found.spheres[0].outline
    assert first.circle_px == pytest.approx((*outline.centre_px, outline.radius_px), abs=3)


@pytest.mark.parametrize(("scale", "limit_deg"), quick([(1.0, 0.3), (1.6, 0.2)], every=2))
def test_a_circle_around_a_ball_with_jpeg_noise_is_not_refused(stack, found, scale, limit_deg):
    """One picture shows no sharp outline; the edges of all images together determine it."""
    values = []
    for image in np.nan_to_num(stack.values, nan=1.0):
        large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LANCZOS4)
        samples = np.clip(np.rint(255 * large), 0, 255).astype(np.uint8)
        coded = cv2.imencode(".jpg", samples, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        values.append(cv2.imdecode(coded, cv2.IMREAD_COLOR).astype(np.float32) / 255)
    noisy = np.array(values)
    noisy[noisy >= 0.99] = np.nan
    circle = (254.0 * scale, 147.0 * scale, 119.0 * scale)
    circled = calibrate_spheres(noisy, circles=[circle])
    off = angle_deg(circled.lights.directions, found.lights.directions)
    assert np.median(off) < limit_deg
    variances = np.trace(circled.lights.errors.covariances, axis1=1, axis2=2)
    assert np.all(off < 3 * np.degrees(np.sqrt(variances)))


# Parts of the images, x, y, width and height. Less than half of the outline is seen in most.
PARTS = [
    (134, 27, 240, 240),
    *(
        pytest.param(part, marks=pytest.mark.slow)
        for part in ((170, 0, 342, 340), (0, 0, 340, 340), (0, 60, 512, 280))
    ),
]


def part_of(values, x, y, width, height):
    return values[..., y : y + height, x : x + width]


@pytest.mark.parametrize("part", PARTS, ids=str)
def test_a_circle_in_a_part_of_the_images_is_not_a_border(stack, found, part):
    x, y = part[:2]
    circle = (254.0 - x, 147.0 - y, 119.0)
    circled = calibrate_spheres(part_of(stack.values, *part), circles=[circle])
    off = angle_deg(circled.lights.directions, found.lights.directions)
    variances = np.trace(circled.lights.errors.covariances, axis1=1, axis2=2) / 2
    assert np.all(off < 0.2)
    assert np.all(off < 3 * np.degrees(np.sqrt(variances)))
    assert "outline-partly-seen" in {notice.code for notice in circled.warnings}


@pytest.mark.parametrize("part", PARTS, ids=str)
def test_a_mask_in_a_part_of_the_images_is_refined(stack, chrome, found, part):
    """Before, it stayed 1.1 to 1.2 degrees off with .1 stated."""
    masks = [part_of(chrome.mask, *part)]
    masked = calibrate_spheres(part_of(stack.values, *part), masks=masks)
    off = angle_deg(masked.lights.directions, found.lights.directions)
    variances = np.trace(masked.lights.errors.covariances, axis1=1, axis2=2) / 2
    # The edges support 56 % of the outline, so that the mask counts as well.
    assert np.all(off < 0.35)
    assert np.all(off < 3 * np.degrees(np.sqrt(variances)))
    assert {"mask-refined", "mask-unconfirmed"} & {notice.code for notice in masked.warnings}


@pytest.mark.parametrize(("quality", "scale"), quick([(75, 1.0), (60, 1.6)], every=2))
def test_blocks_of_compression_are_named(stack, chrome, found, quality, scale):
    values = []
    for image in np.nan_to_num(stack.values, nan=1.0):
        large = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        samples = np.rint(255 * np.clip(large, 0, 1) ** (1 / 2.2)).astype(np.uint8)
        coded = cv2.imencode(".jpg", samples, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        values.append((cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE) / 255) ** 2.2)
    noisy = np.array(values, np.float32)
    noisy[noisy >= 0.98] = np.nan
    mask = cv2.resize(chrome.mask.astype(np.float32), noisy.shape[:0:-1]) > 0.5
    masked = calibrate_spheres(noisy, masks=[mask])
    assert "images-compressed" in {notice.code for notice in masked.warnings}
    off = angle_deg(masked.lights.directions, found.lights.directions)
    variances = np.trace(masked.lights.errors.covariances, axis1=1, axis2=2) / 2
    assert np.all(off < 3 * np.degrees(np.sqrt(variances)))


@pytest.mark.parametrize("part", PARTS, ids=str)
def test_a_circle_of_what_the_ball_mirrors_is_refused_in_a_part(stack, part):
    x, y = part[:2]
    with pytest.raises(EstimateError):
        calibrate_spheres(part_of(stack.values, *part), circles=[(254.0 - x, 147.0 - y, 89.0)])


def test_the_distance_to_the_published_lights_is_as_expected(masked):
    # Not a ground truth: the published file is known to be about 3.1 degrees off its images.
    shipped = np.loadtxt(DATA / "uw" / "lights_shipped_unreliable.txt", skiprows=1)
    assert angle_deg(masked.lights.directions, shipped).mean() == pytest.approx(2.9, abs=0.2)


def shading_correlation(directions):
    """Return the correlation of the gray ball's images with a Lambertian ball under the lights."""
    source = read_source(DATA / "uw" / "gray")
    values = linear_stack(source).values
    y, x = np.nonzero(source.mask)
    radius = (np.ptp(x) + np.ptp(y) + 2) / 4
    x, y = (x - (x.min() + x.max()) / 2) / radius, -(y - (y.min() + y.max()) / 2) / radius
    normals = np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, 1))], axis=1)
    result = []
    for image, direction in zip(values, directions, strict=True):
        seen = image[source.mask]
        good = np.isfinite(seen)
        shaded = np.clip(normals @ direction, 0, None)
        result.append(np.corrcoef(seen[good], shaded[good])[0, 1])
    return np.array(result)


def test_lights_explain_the_shading_of_another_ball(masked, found):
    for calibration in (masked, found):
        directions = calibration.lights.directions
        right = shading_correlation(directions)
        assert right.min() > 0.93
        assert right.mean() > 0.98
        for flip in ([-1, 1, 1], [1, -1, 1]):
            flipped = shading_correlation(directions * flip)
            # Lights near the plane of the flip hardly change, so compare the mean.
            assert flipped.mean() < 0.8
            assert flipped.min() < 0.3
            assert np.all(flipped < right)
