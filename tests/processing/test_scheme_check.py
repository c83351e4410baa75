"""Images that the others contradict are named with kind and size; correct recordings are quiet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from acquisition import Lights
from processing.checks import SchemeCheck, image_quality
from processing.checks.scheme_check import check_scheme, scheme_notices
from processing.images.block_means import cells_of
from tests.processing.scenes import bumpy_dome, dome
from tests.quick_sample import quick

SIZE = 100
COUNT = 24


def images(
    lights: Lights, bumps: float = 1.0, shine: float = 0.1, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return images of a bumpy dome with texture, gloss and noise, and its mask."""
    rng = np.random.default_rng(seed)
    waves = gaussian_filter(rng.normal(size=(SIZE, SIZE)), 5)
    normals, mask = bumpy_dome(waves, 0.05, bumps)
    albedo = np.exp(3 * gaussian_filter(rng.normal(size=mask.shape), 4))
    cosine = np.clip(np.einsum("hwc,nc->nhw", normals, lights.unit_directions), 0, None)
    half = lights.unit_directions + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gloss = np.clip(np.einsum("hwc,nc->nhw", normals, half), 0, None) ** 40
    shade = 0.3 * albedo * cosine + shine * gloss * (cosine > 0)
    values = rng.normal(1, 0.005, shade.shape) * shade
    return np.where(mask, values, 0).astype(np.float32), mask


LIGHTS = Lights(dome(COUNT, 0.95, 0.5))
IMAGES, MASK = images(LIGHTS)


def checked(values: np.ndarray, lights: Lights = LIGHTS) -> SchemeCheck:
    return check_scheme(cells_of(values, MASK, None), lights)


def brighter(values: np.ndarray) -> None:
    values[5] *= 1.12


def darker(values: np.ndarray) -> None:
    values[5] *= 0.85


def swapped(values: np.ndarray) -> None:
    values[[5, 9]] = values[[9, 5]]


def shifted(values: np.ndarray) -> None:
    values[5] = np.roll(values[5], (2, -3), axis=(0, 1))


def torn(values: np.ndarray) -> None:
    values[5, 30:42] = 2 * values[16, 30:42]


def noise(values: np.ndarray) -> None:
    values[5] = np.random.default_rng(1).permutation(values[5].ravel()).reshape(SIZE, SIZE)


def clipped(values: np.ndarray) -> None:
    values[5] = np.minimum(values[5], np.quantile(values[5][MASK], 0.7))


FAULTS: dict[str, tuple[Callable[[np.ndarray], None], str, list[int], float]] = {
    "12 % brighter": (brighter, "brightness", [5], 1.12),
    "15 % darker": (darker, "brightness", [5], 0.85),
    "two swapped": (swapped, "swapped", [5, 9], 9),
    "shifted by (-3, 2)": (shifted, "shifted", [5], np.hypot(2, 3)),
    "rows of another image": (torn, "striped", [5], 12),
    "noise": (noise, "foreign", [5], 0.4),
    "clipped": (clipped, "clipped", [5], 0.8),
}


def test_a_correct_recording_is_quiet() -> None:
    found = checked(IMAGES)
    assert found.checked
    assert not found.undecided
    assert found.found == ()
    assert found.agreeing(COUNT) == list(range(COUNT))
    assert scheme_notices(found, LIGHTS.ids) == []


@pytest.mark.parametrize("name", quick(FAULTS, every=3))
def test_a_fault_is_named_with_its_kind_and_size(name: str) -> None:
    plant, kind, wrong, size = FAULTS[name]
    values = IMAGES.copy()
    plant(values)
    found = checked(values)
    assert [one.image for one in found.found] == wrong
    assert {one.kind for one in found.found} == {kind}
    assert found.found[0].size == pytest.approx(size, rel=0.3 if size < 1 and size != 0.85 else 0.1)
    assert found.agreeing(COUNT) == [i for i in range(COUNT) if i not in wrong]
    (notice,) = scheme_notices(found, LIGHTS.ids)
    assert notice.where == ", ".join(LIGHTS.ids[i] for i in wrong)


def test_a_moved_light_is_named_in_degrees() -> None:
    turn = np.radians(10)
    vectors = LIGHTS.unit_directions.copy()
    across = np.cross(vectors[7], [0, 0, 1.0])
    vectors[7] = vectors[7] * np.cos(turn) + across / np.linalg.norm(across) * np.sin(turn)
    (one,) = checked(IMAGES, Lights(directions=vectors)).found
    assert (one.image, one.kind) == (7, "moved")
    assert one.size == pytest.approx(10, abs=2)


def test_many_bright_images_do_not_hide_one_another() -> None:
    values = IMAGES.copy()
    values[1::4] *= 1.25
    found = checked(values)
    assert [one.image for one in found.found] == list(range(1, COUNT, 4))
    assert not found.undecided
    assert {one.kind for one in found.found} == {"brightness"}


@pytest.mark.slow
def test_half_of_the_images_are_not_left_out() -> None:
    values = IMAGES.copy()
    values[::2] *= np.random.default_rng(3).uniform(0.6, 1.6, (COUNT // 2, 1, 1))
    found = checked(values)
    assert found.undecided
    assert 2 < len(found.found) <= COUNT // 2
    assert found.agreeing(COUNT) == list(range(COUNT))
    (notice,) = image_quality(values, LIGHTS, MASK).warnings
    assert notice.code == "images-undecided"


def test_a_flat_object_shows_brightness_but_no_directions() -> None:
    flat, _ = images(LIGHTS, bumps=0.02, shine=0)
    brighter(flat)
    turned = LIGHTS.unit_directions.copy()
    turned[7] = turned[8]
    (one,) = checked(flat).found
    assert (one.image, one.kind) == (5, "brightness")
    assert "moved" not in {one.kind for one in checked(flat, Lights(directions=turned)).found}


def test_few_images_or_pixels_are_not_checked() -> None:
    few = check_scheme(cells_of(IMAGES[:5], MASK, None), LIGHTS.take(range(5)))
    small = np.zeros_like(MASK)
    small[40:48, 40:48] = True
    tiny = check_scheme(cells_of(IMAGES, small, None), LIGHTS)
    assert not few.checked
    assert not tiny.checked
    assert few.agreeing(5) == list(range(5))


@pytest.mark.slow
def test_correct_recordings_are_quiet() -> None:
    """At most 2 % of the images of other objects and few lights are named."""
    named = total = 0
    for count in (6, 8, 12, 36):
        lights = Lights(dome(count, 0.95, 0.5))
        for seed in range(20, 26):
            values, mask = images(lights, seed=seed)
            named += len(check_scheme(cells_of(values, mask, None), lights).found)
            total += count
    assert named <= 0.02 * total
