"""The parts of a calibration separately, and the complete calibration on rendered spheres."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError
from calibration import EstimateError, Stack, calibrate_spheres, find_spheres
from calibration.spheres import Ellipse, Highlights, KnownSpheres, SphereImage, fit_cone
from calibration.spheres.outline.sphere_image import (
    missing_highlights_warning,
    partial_outline_warning,
    places,
    saturation_warning,
)
from calibration.spheres.propose.sphere_marks import circled_spheres, masked_spheres
from calibration.spheres.solve.sphere_calibration import SeenTogether
from calibration.spheres.solve.sphere_positions import one_radius_each, place
from tests.calibration.conftest import Bench, dome
from tests.quick_sample import quick

SMALL = Bench(focal_px=1200.0, width=420, height=330)
SPHERES = [((-55.0, 20.0, 20.0), 20.0), ((50.0, 35.0, 16.0), 16.0), ((10.0, -45.0, 20.0), 20.0)]
LIGHTS = dome(14)


def image_of(x=10.0, y=20.0, radius=30.0, *, found=5, saturated=0, scatter=0.0):
    outline = Ellipse.circle(x, y, radius)
    angles = np.linspace(0, 6, 50)
    offsets = scatter * np.where(np.arange(50) % 2, 1, -1)
    pixels = np.full((5, 2), np.nan)
    pixels[:found] = [x, y]
    clipped = np.arange(5) < saturated
    points = outline.point(angles, 1 + offsets / radius)
    return SphereImage(
        outline, points, 0.75, Highlights(pixels, clipped, np.full(len(pixels), 0.05))
    )


def test_an_outline_that_is_mostly_hidden_is_reported():
    seen, hidden = image_of(50, 60), replace(image_of(50, 60), coverage=0.45)
    assert partial_outline_warning([seen, replace(seen, coverage=0.6)], (100, 90)) == []
    (warning,) = partial_outline_warning([seen, hidden], (100, 90))
    assert warning.code == "outline-partly-seen"
    assert "is visible over only 45 % of its length, so it" in warning.text


@pytest.mark.parametrize(
    ("coverage", "cut"),
    [pytest.param(0.5, True, id="visible inside"), pytest.param(0.2, False, id="faint inside")],
)
def test_a_frame_that_cuts_off_a_sphere_is_the_reason(coverage, cut):
    """Half of the outline is inside of the frame."""
    (warning,) = partial_outline_warning([replace(image_of(0, 50), coverage=coverage)], (100, 90))
    assert ("because the frame cuts it off" in warning.text) == cut
    assert warning.text.endswith("move it inside") == cut


def test_a_sphere_from_its_image():
    image = image_of(scatter=0.2)
    assert image.rms_px == pytest.approx(1.4826 * 0.2, rel=0.02)
    shown = SeenTogether(("L00",), np.zeros((1, 3)), [image], [1], ("", "b"), [True])
    (sphere,) = shown.spheres()
    assert (sphere.outline, sphere.coverage, sphere.rms_px) == (image.outline, 0.75, image.rms_px)
    assert (sphere.centre_mm, sphere.radius_mm, sphere.recording) == (None, None, 1)
    at = KnownSpheres(np.array([[1.0, 2.0, 3.0]]), np.array([4.0]), np.eye(3))
    (placed,) = shown.spheres(at)
    assert (placed.centre_mm, placed.radius_mm) == ((1.0, 2.0, 3.0), 4.0)
    assert replace(placed, centre_mm=None, radius_mm=None) == sphere


def test_spheres_are_named_by_their_positions():
    assert places([image_of(9.6, 20.4)]) == "the sphere at (10, 20) px"
    assert places([image_of(), image_of(300, 4)]) == "the spheres at (10, 20), (300, 4) px"


@pytest.mark.parametrize(
    ("found", "named"),
    [((5, 5), None), ((3, 1), None), ((0, 5), "the sphere"), ((0, 0), "the spheres")],
)
def test_spheres_without_highlights_are_reported(found, named):
    warnings = missing_highlights_warning([image_of(found=count) for count in found])
    assert (
        (warnings == [])
        if named is None
        else (f"under any light on {named} at (10, 20)" in str(warnings[0]))
    )


@pytest.mark.parametrize(
    ("saturated", "said"), [((0, 0), None), ((1, 0), "10 %"), ((5, 5), "100 %")]
)
def test_saturated_highlights_are_reported_with_their_share(saturated, said):
    warnings = saturation_warning([image_of(saturated=count) for count in saturated])
    assert (
        (warnings == [])
        if said is None
        else str(warnings[0]).startswith(f"{said} of the highlights")
    )


def test_missing_highlights_do_not_count_as_saturated():
    assert saturation_warning([image_of(found=2, saturated=5)])[0].text.startswith("100 %")


@pytest.mark.parametrize(
    ("radii", "sizes", "found", "expected"),
    [
        pytest.param([20.0], (30, 50, 40), True, [20, 20, 20], id="one for all"),
        pytest.param([20.0, 30.0, 25.0], (30, 50, 40), True, [20, 30, 25], id="by size"),
        pytest.param([30.0, 20.0, 25.0], (50, 40, 30), True, [30, 25, 20], id="by size again"),
        pytest.param([30.0, 20.0, 25.0], (30, 50, 40), False, [30, 20, 25], id="in their order"),
    ],
)
def test_each_sphere_has_one_radius(radii, sizes, found, expected):
    images = [image_of(radius=size) for size in sizes]
    assert one_radius_each(np.array(radii), images, found=found).tolist() == expected


@pytest.mark.parametrize(("found", "error"), [(True, EstimateError), (False, DataError)])
def test_another_number_of_radii_is_refused(found, error):
    with pytest.raises(error, match="radii"):
        one_radius_each(np.array([1.0, 2.0]), [image_of()] * 3, found=found)


def test_spheres_are_placed_by_their_radius(bench):
    """The covariance includes a systematic outline error of 0.03 px, sideways and in depth."""
    spheres = [((30.0, -20.0, 12.0), 12.0), ((-100.0, 60.0, 30.0), 30.0)]
    cones = [fit_cone(bench.camera.rays(bench.outline(*s)), 1 / bench.focal_px)[0] for s in spheres]
    placed = place(cones, np.array([12.0, 30.0]), bench.camera)
    np.testing.assert_allclose(placed.centres_mm, [c for c, _ in spheres], atol=1e-5)
    assert placed.radii_mm.tolist() == [12.0, 30.0]
    # The distances have most of their systematic errors in common, in the same direction.
    shared = placed.covariance_mm2[:3, 3:]
    depths = [
        np.linalg.norm(np.asarray(c) - bench.eye) ** 2 / r * 0.03 / bench.focal_px
        for c, r in spheres
    ]
    assert cones[0].axis @ shared @ cones[1].axis == pytest.approx(0.5 * np.prod(depths), rel=0.01)
    for k, (cone, (centre, radius)) in enumerate(zip(cones, spheres, strict=True)):
        own = placed.covariance_mm2[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        systematic = own - radius**2 * cone.covariance
        distance = np.linalg.norm(np.asarray(centre) - bench.eye)
        angle, half = 0.03 / bench.focal_px, np.arcsin(radius / distance)
        sideways, depth = distance * angle, distance * angle / np.tan(half)
        along = cone.axis @ systematic @ cone.axis
        assert along == pytest.approx(sideways**2 + depth**2, rel=1e-3)
        assert np.trace(systematic) == pytest.approx(3 * sideways**2 + depth**2, rel=1e-3)


def share(centre, radius):
    """Return the share of each pixel that a sphere covers, from 8 x 8 lines of sight."""
    axis = np.asarray(centre) - SMALL.eye
    cosine = np.sqrt(1 - (radius / np.linalg.norm(axis)) ** 2)
    fine = (np.arange(8) + 0.5) / 8 - 0.5
    y = (np.arange(SMALL.height)[:, None] + fine).ravel()[:, None]
    x = (np.arange(SMALL.width)[:, None] + fine).ravel()
    right, up = x - (SMALL.width - 1) / 2, (SMALL.height - 1) / 2 - y
    along = right * axis[0] + up * axis[1] - SMALL.focal_px * axis[2]
    length = np.sqrt(right**2 + up**2 + SMALL.focal_px**2) * np.linalg.norm(axis)
    met = along > cosine * length
    return met.reshape(SMALL.height, 8, SMALL.width, 8).mean(axis=(1, 3))


@pytest.fixture(scope="module")
def drawn():
    """Return 14 images of three mirror spheres on a grey card, and the masks of the spheres."""
    size = (SMALL.height, SMALL.width)
    masks = [share(*sphere) for sphere in SPHERES]
    rows, columns = np.mgrid[: size[0], : size[1]]
    values = np.zeros((len(LIGHTS), *size))
    values += 0.5 - 0.4 * np.max(masks, axis=0)
    for image, light in zip(values, LIGHTS, strict=True):
        for sphere in SPHERES:
            x, y = SMALL.highlight(*sphere, light)
            image += 50 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2)
    return values.astype(np.float32), masks


RADII = [radius for _, radius in SPHERES]


def error_mm(calibration):
    return np.linalg.norm(calibration.lights.positions_mm - LIGHTS, axis=1).max()


@pytest.mark.parametrize("marked", quick(["found", "masks", "one mask", "circles"], every=4))
def test_rendered_spheres_give_the_positions(drawn, marked):
    values, masks = drawn
    circles = [(*SMALL.project(np.array(c)), 1200 * r / 590 + 1.5) for c, r in SPHERES]
    options = {
        "masks": {"masks": masks},
        "one mask": {"masks": [np.max(masks, axis=0)]},
        "circles": {"circles": circles},
        "found": {},
    }[marked]
    radii = RADII
    if marked == "one mask":  # regions are numbered from the top
        radii = [16.0, 20.0, 20.0]
    calibration = calibrate_spheres(values, camera=SMALL.camera, radius_mm=radii, **options)
    # Few pixels: the stated uncertainty is next to its limit.
    assert {notice.code for notice in calibration.warnings} <= {"lights-uncertain"}
    assert calibration.lights.ids[:3] == ("L00", "L01", "L02")
    assert error_mm(calibration) < (2.0 if "mask" in marked else 6.0)
    assert calibration.used.all()
    assert calibration.residuals_deg.max() < 0.2
    assert calibration.highlights_px.shape == (14, 3, 2)
    if marked == "masks":
        for sphere, (centre, radius) in zip(calibration.spheres, SPHERES, strict=True):
            assert np.linalg.norm(np.subtract(sphere.centre_mm, centre)) < 0.5
            assert sphere.radius_mm == radius
            assert sphere.coverage > 0.95


@pytest.mark.parametrize(
    ("copies", "named"),
    quick(
        [
            pytest.param({3: 8, 1: 0}, ["L00 and L01; L03 and L08"], id="two"),
            pytest.param({}, [], id="none"),
            pytest.param({3: 8}, ["L03 and L08"], id="one"),
        ],
        every=3,
    ),
)
def test_copies_of_an_image_are_named(drawn, copies, named):
    """The light of a copy is that of another LED, and nothing else shows it."""
    values, masks = drawn
    values = values.copy()
    for of, image in copies.items():
        values[of] = values[image]
    calibration = calibrate_spheres(values, masks=masks, camera=SMALL.camera, radius_mm=RADII)
    texts = [one.text for one in calibration.warnings if one.code == "image-duplicate"]
    assert [text.split("images of ")[1].split(" are the same")[0] for text in texts] == named


def test_a_mask_gives_outline_and_highlights(drawn):
    values, masks = drawn
    images = masked_spheres(values, masks)
    for image, sphere in zip(images, SPHERES, strict=True):
        expected = [SMALL.highlight(*sphere, light) for light in LIGHTS]
        np.testing.assert_allclose(image.highlights.pixels, expected, atol=0.02)
        assert np.abs(image.outline.distance_px(SMALL.outline(*sphere))).max() < 0.05


def test_a_rough_circle_is_refined(drawn):
    values, _ = drawn
    x, y = SMALL.project(np.array(SPHERES[0][0]))
    (image,) = circled_spheres(values, [(x + 3, y - 2, 43.0)])
    assert np.abs(image.outline.distance_px(SMALL.outline(*SPHERES[0]))).max() < 0.4


@pytest.mark.parametrize(
    ("size", "says"),
    [
        ((60, 44), None),
        ((60, 36), "not the disc of a sphere: its ellipse has semi-axes"),
        ((36, 60), "not the disc of a sphere: its ellipse has semi-axes"),
    ],
)
def test_a_long_mask_is_not_a_sphere(size, says):
    rows, columns = np.mgrid[:200, :200]
    mask = ((columns - 100) / size[0]) ** 2 + ((rows - 100) / size[1]) ** 2 < 1
    values = np.zeros((2, 200, 200), np.float32)
    if says is None:
        assert len(masked_spheres(values, [mask])) == 1
        return
    with pytest.raises(EstimateError, match=says):
        masked_spheres(values, [mask])


def test_directions_of_one_sphere_without_and_with_a_camera(drawn):
    values, masks = drawn
    centre, _ = SPHERES[0]
    toward = LIGHTS - centre
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    # Without a camera, the directions of a sphere 55 mm off the axis are rotated by 5 degrees.
    for options, most_deg in (({"camera": SMALL.camera, "radius_mm": 20.0}, 3.0), ({}, 9.0)):
        calibration = calibrate_spheres(values, masks=masks[:1], **options)
        assert calibration.lights.positions_mm is None
        assert np.isnan(calibration.residuals_deg).all()
        off = np.linalg.norm(np.cross(calibration.lights.unit_directions, toward), axis=1)
        assert np.degrees(np.arcsin(off)).max() < most_deg
        codes = [notice.code for notice in calibration.warnings]
        assert codes.count("one-sphere") == bool(options)


def test_colour_counts_as_grey_and_the_stack_names_the_lights(drawn):
    values, masks = drawn
    names = tuple(f"led{k}" for k in range(len(values)))
    stack = Stack(np.repeat(values[..., None], 3, axis=3), names, None)
    options = {"masks": masks, "camera": SMALL.camera, "radius_mm": RADII}
    calibration = calibrate_spheres(stack, **options)
    assert calibration.lights.ids == names
    assert error_mm(calibration) < 2.0


@pytest.mark.slow
def test_search_sorts_from_the_left_and_skips_known_spheres(drawn):
    values, _ = drawn
    spheres = find_spheres(values)
    centres = [sphere.outline.centre_px for sphere in spheres]
    assert len(spheres) == 3
    assert centres == sorted(centres)
    others = find_spheres(values, excluded=spheres[:1])
    np.testing.assert_allclose([sphere.outline.centre_px for sphere in others], centres[1:])
    assert len(find_spheres(values, [spheres[1].outline.radius_px])) == 2
    assert find_spheres(values, [20.0]) == []
