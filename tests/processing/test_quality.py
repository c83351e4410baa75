"""Agreement of images, lights and normals: mistakes are named, correct recordings are quiet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from acquisition import CameraModel, DataError, Lights
from processing import NormalMap, integrate
from processing.checks import image_quality
from processing.surface import integrability
from simulator import SCENES, render, scene_named
from tests.processing.scenes import bumpy_dome, sunflower
from tests.quick_sample import quick

SIZE = 96
COUNT = 12
FLAT = ("plane", "tilted-plane", "white-plane", "charuco", "step-gauge")


def relief(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    waves = gaussian_filter(np.random.default_rng(seed).normal(size=(SIZE, SIZE)), 6)
    return bumpy_dome(waves, 0.08)


def images(lights: Lights, seed: int = 0, noise: float = 0.003) -> np.ndarray:
    """Return images of the dome with texture, a weak gloss and noise."""
    normals, mask = relief(seed)
    rng = np.random.default_rng(seed)
    albedo = np.exp(gaussian_filter(rng.normal(size=mask.shape), 4) * 4)
    cosine = np.clip(np.einsum("hwc,nc->nhw", normals, lights.unit_directions), 0, None)
    shade = 0.5 * albedo / albedo.max() * (cosine + 0.2 * cosine**12)
    return np.where(mask, shade * rng.normal(1, noise, shade.shape), 0).astype(np.float32)


MASK = relief()[1]
LIGHTS = Lights(sunflower(COUNT, 0.9))
IMAGES = images(LIGHTS)


def codes(values: np.ndarray, lights: Lights) -> list[str]:
    return [cause.name for cause in image_quality(values, lights, MASK).causes]


def reordered(order: object) -> Lights:
    return LIGHTS.take([int(i) for i in np.asarray(order)])


def test_a_correct_recording_is_quiet_and_has_small_figures() -> None:
    found = image_quality(IMAGES, LIGHTS, MASK)
    assert found.causes == ()
    assert found.residual < 0.05
    assert found.consistency <= found.residual
    assert found.used > 0.9
    assert found.light_error_deg.max() < 3
    np.testing.assert_allclose(found.light_gain, 1, atol=0.1)
    assert found.image_residual.shape == (COUNT,)
    assert found.curl < 0.3


@pytest.mark.slow
@settings(max_examples=6, suppress_health_check=[HealthCheck.too_slow])
@given(st.permutations(range(COUNT)))
def test_shuffled_lights_are_named(order: list[int]) -> None:
    moved = sum(i != k for i, k in enumerate(order))
    if moved > 6:
        assert codes(IMAGES, reordered(order)) == ["lights-shuffled"]


TEXT = sorted(range(COUNT), key=str)
ORDERS = {
    "in reverse order": np.arange(COUNT)[::-1],
    "shifted by 1 place": np.roll(np.arange(COUNT), 1),
    "shifted by 3 places": np.roll(np.arange(COUNT), 3),
    "sorted as text": TEXT,
}


@pytest.mark.parametrize("name", quick(ORDERS, every=2))
def test_the_usual_orders_are_named(name: str) -> None:
    (cause,) = image_quality(IMAGES, reordered(ORDERS[name]), MASK).causes
    assert cause.name == "lights-shuffled"
    assert name in cause.text


@pytest.mark.parametrize(("one", "other"), quick([(2, 7), (0, 11), (4, 5)], every=3))
def test_swapped_images_are_named(one: int, other: int) -> None:
    order = np.arange(COUNT)
    order[[one, other]] = other, one
    (cause,) = image_quality(IMAGES, reordered(order), MASK).causes
    assert cause.name == "images-swapped"
    names = {reordered(order).ids[i] for i in (one, other)}
    assert set(cause.where.split(", ")) == names


@pytest.mark.parametrize("apart_deg", quick([8.0, 11.0], every=2))
def test_swapped_neighbours_are_named(apart_deg: float) -> None:
    """Their lights are closer together than a light that is said to have moved."""
    directions = LIGHTS.unit_directions.copy()
    middle, aside = directions[2], np.cross(directions[2], [0.3, 0.5, 1.0])
    turn = np.radians(apart_deg)
    directions[7] = middle * np.cos(turn) + aside / np.linalg.norm(aside) * np.sin(turn)
    lights = Lights(directions=directions)
    values = images(lights)
    assert codes(values, lights) == []
    order = [7 if i == 2 else 2 if i == 7 else i for i in range(COUNT)]
    (cause,) = image_quality(values, lights.take(order), MASK).causes
    assert cause.name == "images-swapped"
    assert set(cause.where.split(", ")) == {"L02", "L07"}


def test_a_doubled_image_is_named() -> None:
    values = IMAGES.copy()
    values[3] = values[8]
    (cause,) = image_quality(values, LIGHTS, MASK).causes
    assert (cause.name, cause.where) == ("image-duplicate", "L03")
    assert "L08" in cause.text


@pytest.mark.parametrize("turn", quick(["upside down", "left to right", "top to bottom"], every=3))
def test_a_turned_image_is_named(turn: str) -> None:
    values = IMAGES.copy()
    rows = slice(None, None, 1 if turn == "left to right" else -1)
    columns = slice(None, None, 1 if turn == "top to bottom" else -1)
    values[3] = values[3][rows, columns]
    (cause,) = image_quality(values, LIGHTS, MASK).causes
    assert cause.where == "L03"
    assert cause.name in ("image-turned", "image-disagrees")
    if cause.name == "image-turned":
        assert turn in cause.text


def test_a_lamp_that_changed_or_moved_is_named() -> None:
    values = IMAGES.copy()
    values[3] *= 0.6
    (cause,) = image_quality(values, LIGHTS, MASK).causes
    assert (cause.name, cause.where) == ("light-brightness", "L03")
    assert "0.62 times as bright" in cause.text  # as the mean of all, which is 3 % darker
    vectors = LIGHTS.unit_directions.copy()
    vectors[5] = vectors[5][[1, 0, 2]] * [-1, 1, 1]  # turned about z
    (cause,) = image_quality(IMAGES, replace(LIGHTS, directions=vectors, axes=None), MASK).causes
    assert cause.where == "L05"
    assert cause.name in ("light-moved", "image-disagrees")


AXES = {
    "mirrored left to right": np.diag([-1.0, 1, 1]),
    "top to bottom": np.diag([1.0, -1, 1]),
    "turned by 90 degrees": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "x and y swapped": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("name", quick(AXES, every=4))
def test_wrong_axes_are_named(name: str) -> None:
    wrong = replace(LIGHTS, directions=LIGHTS.unit_directions @ AXES[name].T, axes=None)
    (cause,) = image_quality(IMAGES, wrong, MASK).causes
    assert cause.name == "lights-mirrored"
    assert name in cause.text


def test_a_turn_by_180_degrees_is_seen_at_a_steep_outline_only() -> None:
    turned = replace(LIGHTS, directions=LIGHTS.unit_directions * [-1, -1, 1], axes=None)
    (cause,) = image_quality(IMAGES, turned, MASK).causes
    assert cause.name == "images-turned"
    assert "point inward" in cause.text
    flat = np.zeros_like(MASK)
    flat[36:60, 36:60] = True
    found = image_quality(IMAGES, turned, flat)
    assert found.causes == ()
    assert "images-turned" in found.explanation.not_excluded


def test_uncertain_normals_are_not_good() -> None:
    found = image_quality(IMAGES, LIGHTS, MASK)
    assert [found.verdict(sigma).answer for sigma in (0.5, 7.5, 9.0)] == ["good", "good", "check"]


def test_too_few_images_or_pixels_are_not_judged() -> None:
    found = image_quality(IMAGES[:4], LIGHTS.take(range(4)), MASK)
    assert found.causes == ()
    assert np.isnan(found.light_error_deg).all()
    small = np.zeros_like(MASK)
    small[40:46, 40:46] = True
    assert image_quality(IMAGES, LIGHTS, small).causes == ()
    with pytest.raises(DataError, match="mask is empty"):
        image_quality(IMAGES, LIGHTS, np.zeros_like(MASK))


def test_saturated_samples_and_large_images_change_little() -> None:
    large = np.repeat(np.repeat(IMAGES, 4, axis=1), 4, axis=2)
    large[:, 100:120, 100:120] = np.nan
    found = image_quality(large, LIGHTS, np.repeat(np.repeat(MASK, 4, axis=0), 4, axis=1))
    assert found.causes == ()
    assert found.residual == pytest.approx(image_quality(IMAGES, LIGHTS, MASK).residual, rel=0.1)


@pytest.mark.slow
def test_lights_along_an_axis_without_relief_are_not_judged() -> None:
    """Blurred edges of shadows are a third component of steps, which has no second slope."""
    rendering = render(scene_named("step-gauge", width=160, height=128, leds=36))
    truth = rendering.truth
    values = (rendering.planes / rendering.planes[:, truth.mask].max()).astype(np.float32)
    points = truth.points_mm
    quality = image_quality(values, truth.lights, truth.mask, points_mm=points)
    assert quality.verdict(0.5).answer == "good"
    # Lights in another order are found nevertheless.
    order = [(5 * i) % 36 for i in range(36)]
    changed = image_quality(values, truth.lights.take(order), truth.mask, points_mm=points)
    assert [cause.name for cause in changed.causes] == ["lights-shuffled"]


@pytest.mark.slow
@pytest.mark.parametrize("leds", [8, 12, 36])
@pytest.mark.parametrize("name", sorted(set(SCENES) - {"spheres"}))
def test_simulated_scenes_are_quiet_and_shuffled_ones_are_found(name: str, leds: int) -> None:
    rendering = render(scene_named(name, width=160, height=128, leds=leds))
    truth = rendering.truth
    rng = np.random.default_rng(77)
    full = np.quantile(rendering.planes[:, truth.mask], 0.999) / 0.8
    counted = rng.poisson(np.clip(rendering.planes / full, 0, 1) * 1e4) / 1e4
    values = (counted / truth.lights.intensities[:, :1, None]).astype(np.float32)
    # At the surface: near lights are brighter on high objects than on the plane z = 0.
    points = truth.points_mm
    quality = image_quality(values, truth.lights, truth.mask, points_mm=points)
    assert quality.verdict(0.5).harmful == ()
    if name in FLAT:
        return
    order = [int(i) for i in rng.permutation(leds)]
    changed = image_quality(values, truth.lights.take(order), truth.mask, points_mm=points)
    assert [cause.name for cause in changed.causes] == ["lights-shuffled"]


def surface_codes(normals: np.ndarray, camera: CameraModel | None = None) -> list[str]:
    surface = integrate(NormalMap.from_vectors(normals, MASK), camera=camera)
    return [notice.code for notice in surface.warnings]


CAMERA = CameraModel(np.array([[400.0, 0, 47.5], [0, 400, 47.5], [0, 0, 1]]), SIZE, SIZE, 300.0)


@pytest.mark.parametrize("camera", [None, CAMERA])
def test_normals_with_wrong_axes_are_reported_by_the_integration(
    camera: CameraModel | None,
) -> None:
    normals, _ = relief()
    assert surface_codes(normals, camera) == []
    for matrix in AXES.values():
        assert surface_codes(normals @ matrix.T, camera) == ["normals-mirrored"]
    assert surface_codes(normals * [-1, -1, 1], camera) == []


def test_normals_of_no_surface_are_reported_and_noise_is_not() -> None:
    normals, _ = relief()
    rng = np.random.default_rng(4)
    assert surface_codes(normals + rng.normal(0, 0.07, normals.shape)) == []
    rows, columns = np.mgrid[:SIZE, :SIZE] / SIZE - 0.5
    # The slopes circulate about the centre, so that every way round it climbs.
    stairs = np.dstack([rows * 2, columns * 2, np.ones_like(rows)])
    surface = integrate(NormalMap.from_vectors(stairs, MASK))
    assert surface.disagreement_deg > 10
    (notice,) = surface.warnings
    assert notice.code in ("normals-inconsistent", "normals-mirrored")
    assert f"{surface.disagreement_deg:.1f} degrees" in notice.text


def test_a_step_between_parts_is_quiet() -> None:
    """The normals of a step are those of its two sides; only the height of one is lost."""
    normals, _ = relief()
    other, _ = relief(5)
    normals[:, 48:] = other[:, 48:]
    assert surface_codes(normals) == []


def test_the_curl_of_a_surface_its_mirror_image_and_noise() -> None:
    normals = relief()[0].astype(np.float32)
    mirrored = normals * np.float32([1, -1, 1])
    assert integrability(normals, MASK).curl < 0.1
    assert integrability(mirrored, MASK).curl > 0.9
    noise = np.random.default_rng(1).normal(size=normals.shape) * [0.1, 0.1, 0] + [0, 0, 1]
    found = integrability(noise.astype(np.float32), MASK)
    assert found.curl == pytest.approx(0.7, abs=0.1)
    assert found.axes == "right"
    assert np.isnan(integrability(normals, MASK & False).curl)
