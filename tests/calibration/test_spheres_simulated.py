"""Four chrome spheres on a card, rendered by the simulator, found and calibrated."""

import re
from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError, angle_deg
from calibration import EstimateError, Stack, calibrate_spheres, find_spheres
from calibration.spheres.propose import sphere_selection as search
from calibration.spheres.propose.sphere_marks import masked_spheres
from simulator import render, scene_named
from simulator.camera import sensor_image
from tests.cases import cases
from tests.quick_sample import quick

EXPOSURES_US = (20000.0, 40.0)


def capture(seed, name="spheres", leds=36):
    """Return a noisy stack, merged from brackets by taking the longest unsaturated sample."""
    rendering = render(scene_named(name, seed=seed, leds=leds))
    noise = rendering.truth.noise
    images = []
    for led in range(len(rendering.planes)):
        rate = rendering.planes[led] + rendering.ambient
        merged = None
        for bracket, exposure_us in enumerate(EXPOSURES_US):
            electrons = (rate * exposure_us).astype(np.float32)
            dn = sensor_image(electrons, noise, key=(seed, led, bracket)).astype(np.float32)
            span = noise.white_level_dn - noise.black_level_dn
            value = (dn - noise.black_level_dn) / span * EXPOSURES_US[0] / exposure_us
            value[dn >= noise.white_level_dn] = np.nan
            merged = value if merged is None else np.where(np.isnan(merged), value, merged)
        images.append(merged)
    return np.array(images, np.float32), rendering.truth


@pytest.fixture(
    scope="module", params=[3, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (4, 5))]
)
def scene(request):
    return capture(request.param)


@pytest.fixture(scope="module")
def one():
    return capture(6)


@pytest.fixture(scope="module")
def few():
    """Return what needs a third of the lights only: messages, sizes, and which spheres are used."""
    return capture(6, leds=12)


@pytest.mark.slow
def test_positions_without_masks(scene):
    values, truth = scene
    result = calibrate_spheres(values, camera=truth.camera, radius_mm=(20, 20, 16, 14))
    assert len(result.spheres) == 4
    error_mm = np.linalg.norm(result.lights.positions_mm - truth.lights.positions_mm, axis=1)
    error_deg = angle_deg(result.lights.unit_directions, truth.lights.unit_directions)
    assert error_mm.mean() < 1.5
    assert error_mm.max() < 3.0
    assert error_deg.mean() < 0.15
    for sphere in result.spheres:
        gap = np.linalg.norm(truth.sphere_centres_mm - sphere.centre_mm, axis=1)
        assert gap.min() < 0.8
        assert sphere.radius_mm == truth.sphere_radii_mm[int(np.argmin(gap))]
    assert result.warnings == ()
    assert result.residuals_deg.max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 13])
def test_faint_outlines_on_velvet_next_to_an_object(seed):
    """On velvet the mirrored horizon is much stronger than the outline: the known size decides.

    Noise may hide one of the four spheres; this is reported and does not affect the lights.
    """
    values, truth = capture(seed, "coin-with-spheres")
    result = calibrate_spheres(values, camera=truth.camera, radius_mm=12.0)
    assert len(result.spheres) >= 3
    left_out = [w for w in map(str, result.warnings) if "was left out" in w]
    assert len(result.spheres) + len(left_out) == 4
    error_mm = np.linalg.norm(result.lights.positions_mm - truth.lights.positions_mm, axis=1)
    assert error_mm.mean() < 4.0
    assert angle_deg(result.lights.unit_directions, truth.lights.unit_directions).mean() < 0.4


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22])
def test_one_radius_for_three_sizes_selects_spheres_of_that_size(seed):
    """Round outlines of the right size around the smaller spheres are rejected and reported."""
    values, truth = capture(seed)
    result = calibrate_spheres(values, camera=truth.camera, radius_mm=20.0)
    error_mm = np.linalg.norm(result.lights.positions_mm - truth.lights.positions_mm, axis=1)
    assert error_mm.mean() < 1.5
    large = truth.sphere_centres_mm[truth.sphere_radii_mm == 20]
    for sphere in result.spheres:
        assert np.linalg.norm(large - sphere.centre_mm, axis=1).min() < 0.8
    assert len(result.spheres) == 2
    (warning,) = result.warnings
    text = r"outlines there fit about 14\.\d, 16\.\d mm, not 20 mm: give the radius of each sphere"
    assert re.search(text, warning.text)


@pytest.mark.slow
def test_a_warning_if_spheres_contradict_each_other(one):
    """With one radius for three sizes, some spheres are above the plane and others below it."""
    values, truth = one
    found = calibrate_spheres(values, camera=truth.camera, radius_mm=16.0)
    assert any("so are the positions of the lights" in warning.text for warning in found.warnings)
    masks = list(truth.sphere_masks)
    marked = calibrate_spheres(values, masks=masks, camera=truth.camera, radius_mm=16.0)
    codes = {warning.code for warning in marked.warnings}
    assert codes >= {"spheres-off-the-plane", "spheres-disagree"}


@pytest.mark.slow
def test_spheres_of_another_size_are_left_out(one):
    values, truth = one
    with pytest.raises(
        EstimateError, match=r"left out: .* fit about 20\.2, 16\.\d, 20\.2 mm, not 14"
    ):
        calibrate_spheres(values, camera=truth.camera, radius_mm=14.0)


@pytest.mark.slow
def test_a_radius_that_places_the_spheres_off_the_plane_is_reported(few):
    """Two spheres with the same wrong radius agree; only their height shows the error."""
    values, truth = few
    two = [truth.sphere_masks[k] for k in np.flatnonzero(truth.sphere_radii_mm == 20)]
    result = calibrate_spheres(values, masks=two, camera=truth.camera, radius_mm=18.0)
    assert np.median(result.residuals_deg) < 0.1
    assert "the radius places the spheres 60 mm above the working plane" in str(result.warnings[0])
    right = calibrate_spheres(values, masks=two, camera=truth.camera, radius_mm=20.0)
    # Two spheres of this size are not enough for certain positions.
    assert {warning.code for warning in right.warnings} <= {"lights-uncertain"}


def found_images(values, truth):
    """Return the result of a search, made from masks so that a test can modify it."""
    return masked_spheres(values, list(truth.sphere_masks))


@pytest.mark.slow
def test_a_sphere_that_contradicts_the_others_is_left_out(few, monkeypatch):
    values, truth = few
    images = found_images(values, truth)
    wrong = images[0].highlights
    order = np.random.default_rng(0).permutation(len(values))
    images[0] = replace(
        images[0], highlights=replace(wrong, pixels=wrong.pixels[order], saturated=wrong.saturated)
    )
    monkeypatch.setattr(
        search, "find_spheres", lambda *_, excluded=(), **_more: [] if excluded else images
    )
    result = calibrate_spheres(values, camera=truth.camera, radius_mm=(20, 16, 14, 20))
    assert len(result.spheres) == 3
    assert "(112, 125) px was left out" in str(result.warnings[0])
    error_mm = np.linalg.norm(result.lights.positions_mm - truth.lights.positions_mm, axis=1)
    assert error_mm.mean() < 1.5


@pytest.mark.slow
def test_one_sharp_sphere_among_blurred_ones_gives_no_positions(few, monkeypatch):
    values, truth = few
    draw = np.random.default_rng(1)
    images = found_images(values, truth)
    images[1:] = [
        replace(
            image,
            points_px=image.points_px + draw.normal(0, 1, image.points_px.shape),
            covariance_px2=None,
        )
        for image in images[1:]
    ]
    monkeypatch.setattr(
        search, "find_spheres", lambda *_, excluded=(), **_more: [] if excluded else images
    )
    with pytest.raises(EstimateError, match="positions require two spheres"):
        calibrate_spheres(values, camera=truth.camera, radius_mm=20.0)
    directions = calibrate_spheres(values, camera=truth.camera)
    assert len(directions.spheres) == 1


@pytest.mark.slow
def test_the_message_names_the_sizes_if_no_sphere_fits(one):
    values, truth = one
    with pytest.raises(EstimateError, match=r"no sphere of 2.6 mm .* px of about 20.\d, 14.\d, "):
        calibrate_spheres(values, camera=truth.camera, radius_mm=2.6)
    nothing = np.where(truth.sphere_masks.any(axis=0), np.float32(0.5), values)
    with pytest.raises(EstimateError, match=r"\d+ round .*, 0 of them with a radius near 6 px"):
        calibrate_spheres(nothing, camera=truth.camera, radius_mm=2.6)


@pytest.mark.slow
def test_each_found_sphere_has_the_radius_that_fits_its_size(few):
    values, truth = few
    result = calibrate_spheres(values, camera=truth.camera, radius_mm=(40, 20, 20))
    assert [sphere.radius_mm for sphere in result.spheres] == [20, 20]
    assert "sphere-of-another-size" in [warning.code for warning in result.warnings]


@pytest.mark.slow
def test_wrong_radius_of_one_sphere_is_noticed(few):
    values, truth = few
    result = calibrate_spheres(
        values,
        masks=list(truth.sphere_masks),
        camera=truth.camera,
        radius_mm=[20.0, 16.0, 14.0, 17.0],
    )
    assert any("agree" in w or "disagree" in w for w in map(str, result.warnings))


@pytest.mark.slow
def test_positions_from_masks(few):
    values, truth = few
    result = calibrate_spheres(
        values,
        masks=list(truth.sphere_masks),
        camera=truth.camera,
        radius_mm=list(truth.sphere_radii_mm),
    )
    error_mm = np.linalg.norm(result.lights.positions_mm - truth.lights.positions_mm, axis=1)
    assert error_mm.mean() < 1.5


@pytest.mark.slow
def test_highlights_are_found_to_a_fiftieth_of_a_pixel(few):
    values, truth = few
    for sphere in find_spheres(values):
        x, y = sphere.outline.centre_px
        index = next(i for i, m in enumerate(truth.sphere_masks) if m[round(y), round(x)])
        gap = np.linalg.norm(sphere.highlights.pixels - truth.highlights_px[index], axis=1)
        assert gap.max() < 0.04
        assert np.median(gap) < 0.02


@pytest.mark.slow
def test_one_mask_may_contain_all_spheres(few):
    values, truth = few
    assert len(calibrate_spheres(values, masks=[truth.sphere_masks.any(axis=0)]).spheres) == 4


def test_one_sphere_gives_the_directions_at_its_position(few):
    values, truth = few
    result = calibrate_spheres(
        values, masks=[truth.sphere_masks[0]], camera=truth.camera, radius_mm=20.0
    )
    assert result.lights.positions_mm is None
    toward = truth.lights.positions_mm - truth.sphere_centres_mm[0]
    # The mirror point is up to one radius from the centre, 2 degrees as seen from the light.
    assert angle_deg(result.lights.directions, toward).max() < 3.0
    assert any("one sphere" in warning for warning in map(str, result.warnings))


@pytest.mark.slow
def test_spheres_of_a_near_light_disagree_and_this_is_reported(one):
    values, truth = one
    result = calibrate_spheres(values, camera=truth.camera)
    assert result.lights.positions_mm is None
    assert any("near" in warning for warning in map(str, result.warnings))


@pytest.mark.slow
def test_names_come_from_the_stack(one):
    values, _ = one
    names = tuple(f"led{i}" for i in range(len(values)))
    assert calibrate_spheres(Stack(values, names, None)).lights.ids == names
    assert calibrate_spheres(values).lights.ids[7] == "L07"
    with pytest.raises(DataError, match="2 lights for 36"):
        calibrate_spheres(Stack(values, ("a", "b"), None))


@pytest.mark.parametrize(
    ("off", "says"),
    quick(
        [
            ({7: 0.03}, "left out light L07: no highlight on the spheres at"),
            ({7: 0.0}, "light L07: the image is black; the light is left out"),
        ],
        every=2,
    ),
    ids=["in a lit room", "in the dark"],
)
def test_a_light_that_was_off_is_left_out_and_named(few, off, says):
    values, truth = few
    values = values.copy()
    for k, value in off.items():
        values[k] = value
    result = calibrate_spheres(values, masks=list(truth.sphere_masks))
    assert says in " ".join(map(str, result.warnings))
    assert "L07" not in result.lights.ids
    assert len(result.lights) == len(values) - 1


@pytest.mark.slow
def test_two_lights_of_twelve_that_were_off_are_refused(few):
    values, truth = few
    values = values.copy()
    values[[2, 7]] = 0.03
    with pytest.raises(EstimateError, match=r"light L02, L07 \(2 of 12 lights\)") as caught:
        calibrate_spheres(values, masks=list(truth.sphere_masks))
    assert caught.value.lights == ("L02", "L07")


@pytest.mark.slow
def test_a_light_hidden_on_three_spheres_is_named(few):
    values, truth = few
    values = values.copy()
    for mask in truth.sphere_masks[1:]:
        values[5][mask] = 0.02
    with pytest.raises(EstimateError, match="light L05: highlights on fewer than 2 of 4 spheres"):
        calibrate_spheres(
            values,
            masks=list(truth.sphere_masks),
            camera=truth.camera,
            radius_mm=list(truth.sphere_radii_mm),
        )


def test_no_sphere_in_images_of_the_coin():
    values = render(scene_named("coin", width=320, height=256, leds=8)).planes
    values = (values / values.max()).astype(np.float32)
    with pytest.raises(EstimateError, match="no mirror sphere found"):
        calibrate_spheres(values)


@cases(
    ("options", "error", "says"),
    {
        "mask-size": ({"masks": [np.ones((5, 5), bool)]}, DataError, "does not fit"),
        "mask-empty": ({"masks": [np.zeros((512, 640), bool)]}, EstimateError, "empty"),
        "negative-circle": ({"circles": [(9, 9, -4)]}, DataError, "is invalid"),
        "endless-circle": ({"circles": [(9, 9, np.inf)]}, DataError, "is invalid"),
        "circle-nowhere": ({"circles": [(np.nan, 9, 9)]}, DataError, "is invalid"),
        "masks-and-circles": (
            {"circles": [(9, 9, 9)], "masks": [np.ones((512, 640), bool)]},
            DataError,
            "give one of the two",
        ),
        "circle-on-nothing": (
            {"circles": [(320, 256, 30)]},
            EstimateError,
            r"(320, 256|no highlight)",
        ),
    },
)
def test_bad_input(few, options, error, says):
    with pytest.raises(error, match=says) as caught:
        calibrate_spheres(few[0], **options)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_radii_must_fit_the_spheres(few):
    values, truth = few
    with pytest.raises(DataError, match="3 radii for 4 spheres"):
        calibrate_spheres(
            values,
            masks=list(truth.sphere_masks),
            camera=truth.camera,
            radius_mm=[20, 16, 14],
        )
    for radius_mm in (-1.0, 0.0, np.nan, []):
        with pytest.raises(DataError, match="positive"):
            calibrate_spheres(values, camera=truth.camera, radius_mm=radius_mm)


@pytest.mark.slow
@pytest.mark.parametrize("distortion", [0.0, 1e-9], ids=["pinhole", "distorted"])
def test_a_marked_sphere_without_highlights_is_reported_and_harmless(few, distortion):
    values, truth = few
    values = values.copy()
    values[:, truth.sphere_masks[1]] = 0.3
    camera = replace(truth.camera, distortion=np.array([distortion]))
    options = {"masks": list(truth.sphere_masks), "camera": camera}
    result = calibrate_spheres(values, **options, radius_mm=list(truth.sphere_radii_mm))
    error_mm = np.linalg.norm(result.lights.positions_mm - truth.lights.positions_mm, axis=1)
    assert error_mm.mean() < 1.5
    assert "no highlight under any light on the sphere at (508, 108) px" in str(result.warnings[0])
    assert result.warnings[0] in calibrate_spheres(values, **options).warnings


@pytest.mark.slow
def test_the_scale_of_the_images_does_not_matter(one):
    values, _ = one
    for sphere, scaled in zip(find_spheres(values), find_spheres(1000 * values), strict=True):
        assert scaled.outline.circle_px == pytest.approx(sphere.outline.circle_px, abs=0.1)


def test_no_sphere_in_an_image_of_one_row():
    strip = np.random.default_rng(1).random((3, 1, 3000), np.float32)
    assert find_spheres(strip) == []


def test_a_masked_sphere_cut_off_by_the_frame_keeps_its_position():
    """A third of a circumference does not determine an ellipse; its error was 2.7 px."""
    x, y = np.arange(300), np.arange(300)[:, None]
    mask = np.hypot(x + 40.15, y - 150.2) < 80.3
    (image,) = masked_spheres(np.zeros((3, 300, 300), np.float32), [mask])
    assert image.coverage == pytest.approx(0.34, abs=0.02)
    assert image.outline.circle_px == pytest.approx((-40.15, 150.2, 80.3), abs=0.3)
