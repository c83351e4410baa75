"""Lights from exact highlights on marked or found spheres, and the doubts that are reported."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError, angle_deg
from calibration import EstimateError, Stack, calibrate_spheres
from calibration.spheres import Ellipse, Highlights, SphereImage, recording
from calibration.spheres import position_calibration as positioned_lights
from calibration.spheres.solve.sphere_calibration import rms_deg
from rig import Notice
from tests.calibration.conftest import Bench, codes, dome

BENCH = Bench(focal_px=1200.0, width=420, height=330)
TWO = [((-80.0, 0.0, 20.0), 20.0), ((80.0, 0.0, 20.0), 20.0)]
THREE = [*TWO, ((0.0, 60.0, 16.0), 16.0)]
FOUR = [*THREE, ((10.0, -60.0, 16.0), 16.0)]
LIGHTS = dome(10)
VALUES = np.zeros((10, 330, 420), np.float32)
MARK = [np.zeros((330, 420), bool)]


@pytest.fixture(autouse=True)
def certain_enough(monkeypatch):
    """With 1200 px of focal length, the positions are uncertain by some mm, which is reported."""
    monkeypatch.setattr(positioned_lights, "_UNCERTAIN_MM", np.inf)


@pytest.mark.parametrize(("limit_mm", "reported"), [(5.5, True), (9.0, False)])
def test_uncertain_positions_are_reported(monkeypatch, limit_mm, reported):
    monkeypatch.setattr(positioned_lights, "_UNCERTAIN_MM", limit_mm)
    # Highlights that are exact would show that their errors are smaller than stated.
    images = [seen(sphere, LIGHTS, noise_px=0.05, seed=k) for k, sphere in enumerate(TWO)]
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=20.0)
    codes = [warning.code for warning in result.warnings]
    assert codes == (["lights-uncertain"] if reported else [])


def seen(sphere, lights, noise_px=0.0, seed=0):
    """Return a sphere as the camera sees it, with exact outline and highlights."""
    outline_px = BENCH.outline(*sphere)
    x, y = outline_px.mean(axis=0)
    radius = float(np.linalg.norm(outline_px - (x, y), axis=1).mean())
    pixels = np.array([BENCH.highlight(*sphere, light) for light in lights])
    pixels += np.random.default_rng(seed).normal(0, noise_px, pixels.shape)
    highlights = Highlights(pixels, np.zeros(len(lights), bool), np.full(len(lights), 0.05))
    return SphereImage(Ellipse.circle(x, y, radius), outline_px, 1.0, highlights)


def moved(image, count, shift_px):
    """Return a sphere of which the first highlights are wrong."""
    pixels = image.highlights.pixels.copy()
    pixels[:count] += shift_px
    return replace(image, highlights=replace(image.highlights, pixels=pixels))


def calibrated(monkeypatch, images, *, found=False, left_out=(), **options):
    """Calibrate with these spheres, as if they were marked or found."""
    monkeypatch.setattr(recording, "masked_spheres", lambda *_: list(images))
    monkeypatch.setattr(recording, "searched_spheres", lambda *_: (list(images), list(left_out)))
    values = VALUES[: len(images[0].highlights.found)]
    return calibrate_spheres(values, masks=None if found else MARK, **options)


@pytest.mark.parametrize("spheres", [TWO[:1], TWO, FOUR], ids=["one", "two", "four"])
def test_distant_lights_have_the_same_direction_on_all_spheres(monkeypatch, spheres):
    lights = LIGHTS * 1e5
    images = [seen(sphere, lights) for sphere in spheres]
    result = calibrated(monkeypatch, images, camera=BENCH.camera)
    assert angle_deg(result.lights.unit_directions, LIGHTS).max() < 0.001
    assert result.warnings == ()
    assert result.used.shape == (10, len(spheres))
    assert result.used.all()
    if len(spheres) == 1:
        assert np.isnan(result.residuals_deg).all()
    else:
        assert result.residuals_deg.max() < 0.001
    assert [sphere.radius_mm for sphere in result.spheres] == [None] * len(spheres)


def test_a_direction_from_one_of_two_spheres_has_no_residual(monkeypatch):
    lights = LIGHTS * 1e5
    first, second = (seen(sphere, lights) for sphere in TWO)
    second.highlights.pixels[3] = np.nan
    result = calibrated(monkeypatch, [first, second], camera=BENCH.camera)
    assert np.flatnonzero(np.isnan(result.residuals_deg)).tolist() == [3]
    assert np.argwhere(~result.used).tolist() == [[3, 1]]
    assert angle_deg(result.lights.unit_directions, LIGHTS).max() < 0.001


@pytest.mark.parametrize(("height_mm", "near"), [(1300.0, True), (2000.0, False)])
def test_lights_are_near_if_the_directions_differ_by_three_degrees(monkeypatch, height_mm, near):
    """At two spheres 160 mm apart, a light differs from the mean by atan(80 / height)."""
    lights = np.array([[0.0, 0.0, height_mm], [0.0, 0.0, 1e7]])
    images = [seen(sphere, lights) for sphere in TWO]
    result = calibrated(monkeypatch, images, camera=BENCH.camera)
    off_deg = np.degrees(np.arctan2(80, height_mm))
    assert result.residuals_deg == pytest.approx([off_deg, 0], rel=0.05, abs=0.001)
    assert codes(result) == (["lights-near"] if near else [])
    if near:
        assert "(light L00), which the stated errors do not contain" in str(result.warnings[0])
        assert f"differ by up to {result.residuals_deg[0]:.1f} degrees" in result.warnings[0].text


def test_an_orthographic_view_without_a_camera(monkeypatch):
    """A highlight half-way to the rim shows a light at 60 degrees."""
    x = y = np.zeros(3)
    pixels = np.array([[100.0, 100], [120, 100], [100, 80]])
    outline = Ellipse.circle(100.0, 100.0, 40.0)
    image = SphereImage(
        outline,
        outline.point(np.arange(6.0)),
        1.0,
        Highlights(pixels, x > y, np.full(len(x), 0.05)),
    )
    result = calibrated(monkeypatch, [image])
    s, c = np.sin(np.pi / 3), 0.5
    np.testing.assert_allclose(
        result.lights.unit_directions, [[0, 0, 1], [s, 0, c], [0, s, c]], atol=1e-12
    )
    assert result.highlights_px.shape == (3, 1, 2)


@pytest.mark.parametrize("options", [{}, {"camera": BENCH.camera}])
def test_a_highlight_outside_its_sphere_is_named(monkeypatch, options):
    lights = LIGHTS * 1e5
    images = [seen(sphere, lights) for sphere in TWO]
    for image in images:
        image.highlights.pixels[4] = 0.0
    images[0].highlights.pixels[2] = 0.0
    with pytest.raises(EstimateError, match="highlight under light L04 is outside the sphere"):
        calibrated(monkeypatch, images, **options)


def test_lights_without_highlights_are_named(monkeypatch):
    images = [seen(sphere, LIGHTS) for sphere in TWO]
    images[0].highlights.pixels[1] = np.nan
    for image in images:
        image.highlights.pixels[[2, 5]] = np.nan
    with pytest.raises(EstimateError, match=r"no highlight under light L02, L05 \(2 of 10 lights"):
        calibrated(monkeypatch, images)


@pytest.mark.parametrize("spheres", [TWO, FOUR], ids=["two", "four"])
def test_exact_highlights_give_exact_positions(monkeypatch, spheres):
    images = [seen(sphere, LIGHTS) for sphere in spheres]
    radii = [radius for _, radius in spheres]
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=radii)
    assert np.linalg.norm(result.lights.positions_mm - LIGHTS, axis=1).max() < 0.01
    assert angle_deg(result.lights.unit_directions, LIGHTS).max() < 0.001
    np.testing.assert_allclose(
        [sphere.centre_mm for sphere in result.spheres], [c for c, _ in spheres], atol=1e-3
    )
    assert [sphere.radius_mm for sphere in result.spheres] == radii
    assert result.residuals_deg.max() < 1e-3
    assert result.warnings == ()


def test_one_sphere_of_known_radius_gives_directions_and_its_position(monkeypatch):
    image = seen(TWO[0], LIGHTS * 1e5)
    result = calibrated(monkeypatch, [image], camera=BENCH.camera, radius_mm=20.0)
    assert codes(result) == ["one-sphere"]
    assert angle_deg(result.lights.unit_directions, LIGHTS).max() < 0.001
    assert result.spheres[0].centre_mm == pytest.approx(TWO[0][0], abs=1e-3)
    notice = Notice("sphere-blurred", "another sphere was left out")
    with pytest.raises(EstimateError, match="another sphere was left out; positions require two"):
        calibrated(
            monkeypatch,
            [image],
            camera=BENCH.camera,
            radius_mm=20.0,
            found=True,
            left_out=[notice],
        )


def test_spheres_off_the_plane_are_reported(monkeypatch):
    images = [seen(((x, 0.0, 80.0), 20.0), LIGHTS) for x in (-60, 60)]
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=20.0)
    assert codes(result) == ["spheres-off-the-plane"]
    # A radius of 20 mm at 80 mm looks like a larger one on the plane.
    assert "60 mm above the working plane" in result.warnings[0].text
    assert "radius 22.22 mm" in result.warnings[0].text
    assert "working distance 540.0 mm" in result.warnings[0].text


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_stated_errors_contain_a_radius_that_the_images_contradict(monkeypatch, factor):
    """Before, 0.3 mm were stated for lights that are wrong by a tenth of their distance."""
    images = [seen(sphere, LIGHTS, noise_px=0.05, seed=k) for k, sphere in enumerate(FOUR)]
    radii = [factor * radius for _, radius in FOUR]
    lights = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=radii).lights
    off = lights.positions_mm - LIGHTS
    assert np.median(np.linalg.norm(off, axis=1)) > 40
    chi_square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(lights.errors.covariances), off)
    assert chi_square.max() < 9


@pytest.mark.parametrize(
    ("radius_mm", "refused"),
    [
        pytest.param(20.0, False, id="on the plane"),
        pytest.param(18.0, False, id="on a pedestal"),
        pytest.param(22.0, False, id="on a plane that is 60 mm deeper"),
        pytest.param(27.0, True, id="the border of what it mirrors"),
    ],
)
def test_a_circle_much_too_small_for_its_radius_is_refused(monkeypatch, radius_mm, refused):
    image = seen(TWO[0], LIGHTS)
    monkeypatch.setattr(recording, "circled_spheres", lambda *_: [image])
    options = {"circles": [image.outline.circle_px], "camera": BENCH.camera, "radius_mm": radius_mm}
    if not refused:
        assert len(calibrate_spheres(VALUES, **options).spheres) == 1
        return
    x, y, size = image.outline.circle_px
    text = rf"\({x:.0f}, {y:.0f}\) px has the size of one of 20.* mm, not of 27 mm.* circle of "
    with pytest.raises(EstimateError, match=text + f"{27 / 20 * size:.0f} px"):
        calibrate_spheres(VALUES, **options)


@pytest.mark.parametrize(
    ("spheres", "wrong", "found", "left_out"),
    [
        pytest.param(FOUR, 6, True, True, id="most highlights contradict"),
        pytest.param(FOUR, 4, True, False, id="some highlights contradict"),
        pytest.param(FOUR, 6, False, False, id="marked spheres are kept"),
        pytest.param(THREE, 6, True, True, id="one of three"),
    ],
)
def test_a_found_sphere_that_contradicts_is_left_out(monkeypatch, spheres, wrong, found, left_out):
    images = [seen(sphere, LIGHTS) for sphere in spheres]
    images[1] = moved(images[1], wrong, (9.0, -7.0))
    radii = [radius for _, radius in spheres]
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=radii, found=found)
    np.testing.assert_allclose(result.lights.positions_mm, LIGHTS, atol=0.5)
    assert len(result.spheres) == len(spheres) - left_out
    (notice,) = result.warnings
    if left_out:
        x, y = images[1].outline.centre_px
        assert notice.code == "sphere-contradicts"
        assert f"the sphere at ({x:.0f}, {y:.0f}) px was left out: only 4 of its 10" in notice.text
        assert result.used.all()
    else:
        assert notice.code == "highlights-left-out"
        assert notice.text.startswith(f"{wrong} highlights disagree")
        assert np.argwhere(~result.used).tolist() == [[k, 1] for k in range(wrong)]


def test_two_found_spheres_are_kept(monkeypatch):
    """It is unknown which of two is wrong."""
    images = [seen(TWO[0], LIGHTS), moved(seen(TWO[1], LIGHTS), 6, (0.5, -0.5))]
    options = {"camera": BENCH.camera, "radius_mm": 20.0, "found": True}
    assert len(calibrated(monkeypatch, images, **options).spheres) == 2


@pytest.mark.parametrize(
    ("noise_px", "code"),
    [(0.1, []), (0.25, ["spheres-disagree"]), (0.5, ["lights-untrusted"])],
)
def test_the_disagreement_of_spheres_is_reported(monkeypatch, noise_px, code):
    """The median light is off by 1.25 degrees per pixel; the limits are 0.2 and 0.5 degrees."""
    images = [seen(sphere, LIGHTS, noise_px, seed) for seed, sphere in enumerate(TWO)]
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=20.0)
    middle = float(np.median(result.residuals_deg))
    assert codes(result) == code
    assert middle == pytest.approx(1.25 * noise_px, rel=0.05)
    if code:
        assert f" {middle:.1f} degrees" in result.warnings[0].text


def test_the_rms_of_the_used_angles():
    angles = np.array([[3.0, 4.0, 100.0], [3.0, np.nan, np.nan], [np.nan, np.nan, np.nan]])
    use = np.array([[True, True, False], [True, False, False], [False, False, False]])
    assert rms_deg(angles, use) == pytest.approx([np.sqrt(12.5), 3, 0])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        pytest.param({"camera": replace(BENCH.camera, width=400)}, "400 x 330", id="width"),
        pytest.param({"camera": replace(BENCH.camera, height=400)}, "420 x 400", id="height"),
        pytest.param({"circles": [(9, 9, 9)]}, "both masks and circles", id="two kinds of marks"),
        *(
            pytest.param(
                {"radius_mm": radius, "camera": BENCH.camera}, "positive lengths", id=f"{radius} mm"
            )
            for radius in (0.0, -1.0, np.inf, np.nan, [], [20.0, 0.0])
        ),
    ],
)
def test_options_that_contradict_are_refused(options, says):
    with pytest.raises(DataError, match=says):
        calibrate_spheres(VALUES, masks=MARK, **options)


def test_a_small_radius_is_valid(monkeypatch):
    image = seen(((0.0, 0.0, 0.5), 0.5), LIGHTS * 1e3)
    result = calibrated(monkeypatch, [image], camera=BENCH.camera, radius_mm=0.5)
    assert result.spheres[0].radius_mm == 0.5


@pytest.mark.parametrize(
    ("stack", "says"),
    [
        pytest.param(VALUES[0], "must have the shape", id="one image"),
        pytest.param(VALUES[:0], "must have the shape", id="no image"),
        pytest.param(VALUES[:, :, :0], "must have the shape", id="no pixel"),
        pytest.param(np.zeros((1, 2, 9, 9, 3)), "must have the shape", id="five axes"),
        pytest.param(Stack(VALUES, ("a", "b"), None), "2 lights for 10 images", id="names"),
    ],
)
def test_a_stack_of_another_shape_is_refused(stack, says):
    with pytest.raises(DataError, match=says):
        calibrate_spheres(stack, masks=MARK)


def test_colour_images_count_by_their_mean(monkeypatch):
    given = []
    image = seen(TWO[0], LIGHTS)
    monkeypatch.setattr(
        recording, "masked_spheres", lambda values, *_: given.append(values) or [image]
    )
    colour = np.zeros((10, 330, 420, 3), np.float32)
    colour[3, 5, 7] = 0.1, 0.2, 0.6
    colour[3, 5, 8, 2] = np.nan
    names = tuple(f"led{i}" for i in range(10))
    result = calibrate_spheres(Stack(colour, names, None), masks=MARK)
    assert given[0].shape == (10, 330, 420)
    assert given[0][3, 5, 7] == pytest.approx(0.3)
    assert np.isnan(given[0][3, 5, 8])
    assert result.lights.ids == names


def test_masks_and_circles_may_be_arrays():
    with pytest.raises(EstimateError, match="a sphere mask is empty"):
        calibrate_spheres(VALUES, masks=np.stack(MARK))
    circles = np.array([[200.0, 150.0, 40.0]])
    with pytest.raises(EstimateError, match="\\(200, 150\\)"):
        calibrate_spheres(VALUES, circles=circles)


def with_rival(image, light, shift_px, share):
    """Return a sphere with a second bright spot under a light."""
    candidates = image.highlights.candidates
    candidates.pixels[light, 1] = candidates.pixels[light, 0] + shift_px
    candidates.sigma_px[light, 1], candidates.share[light, 1] = 0.05, share
    pixels = image.highlights.pixels.copy()
    pixels[light] = np.nan
    several = replace(image.highlights, pixels=pixels, several=candidates)
    return replace(image, highlights=several)


def test_a_second_spot_is_decided_by_the_other_sphere(monkeypatch):
    images = [seen(sphere, LIGHTS) for sphere in TWO]
    right = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=20.0)
    images[0] = with_rival(images[0], 3, (2.0, 6.0), 0.9)
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=20.0)
    np.testing.assert_allclose(result.lights.positions_mm, right.lights.positions_mm)
    assert codes(result) == codes(right)


def test_a_light_with_two_spots_on_one_sphere_is_left_out_by_name(monkeypatch):
    image = seen(TWO[0], LIGHTS)
    others = np.delete(np.arange(len(LIGHTS)), 3)
    text = "left out light L03: several bright spots on the sphere at "
    for options in ({}, {"camera": BENCH.camera}, {"camera": BENCH.camera, "radius_mm": 20.0}):
        whole = calibrated(monkeypatch, [image], **options).lights
        rival = with_rival(image, 3, (2.0, 6.0), 0.9)
        result = calibrated(monkeypatch, [rival], **options)
        assert [notice.text.startswith(text) for notice in result.warnings].count(True) == 1
        assert result.lights.ids == tuple(whole.ids[k] for k in others)
        np.testing.assert_array_equal(result.lights.directions, whole.directions[others])
        kept = whole.errors.covariances[others]
        np.testing.assert_array_equal(result.lights.errors.covariances, kept)


@pytest.mark.parametrize(
    ("lights", "several", "refused"),
    [
        pytest.param(10, 1, False, id="one of ten"),
        pytest.param(10, 2, True, id="two of ten"),
        pytest.param(7, 1, False, id="one of seven"),
        pytest.param(6, 1, True, id="one of six"),
    ],
)
def test_too_few_lights_are_refused_by_name(monkeypatch, lights, several, refused):
    image = seen(TWO[0], LIGHTS[:lights])
    for k in range(several):
        image = with_rival(image, k, (2.0, 6.0), 0.9)
    if not refused:
        found = calibrated(monkeypatch, [image]).lights
        assert found.ids == tuple(f"L{k:02d}" for k in range(several, lights))
        return
    text = r"lights? L00.*: several bright spots on the sphere at .* px may be the highlight"
    with pytest.raises(EstimateError, match=text):
        calibrated(monkeypatch, [image])


def test_a_light_whose_two_highlights_disagree_is_named(monkeypatch):
    images = [seen(sphere, LIGHTS) for sphere in TWO]
    pixels = images[0].highlights.pixels.copy()
    pixels[4, 1] += 4
    images[0] = replace(images[0], highlights=replace(images[0].highlights, pixels=pixels))
    result = calibrated(monkeypatch, images, camera=BENCH.camera, radius_mm=20.0)
    [notice] = [notice for notice in result.warnings if notice.code == "light-doubtful"]
    assert notice.text.startswith("light L04: the highlights on the spheres disagree by up to ")
    deviation = np.sqrt(np.trace(result.lights.errors.covariances, axis1=1, axis2=2))
    off = np.linalg.norm(result.lights.positions_mm - LIGHTS, axis=1)
    assert deviation[4] > 5 * np.median(deviation)
    assert off[4] < 3 * deviation[4]
