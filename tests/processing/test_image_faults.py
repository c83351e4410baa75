"""Images that the others contradict are named with kind and size; correct recordings are quiet."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from acquisition import Lights
from processing.checks import ImageQuality, image_quality
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


def checked(values: np.ndarray, lights: Lights = LIGHTS, mask: np.ndarray = MASK) -> ImageQuality:
    return image_quality(values, lights, mask)


def numbers(found: ImageQuality) -> list[int]:
    """Return the images that the others contradict, in their order."""
    return sorted(LIGHTS.ids.index(name) for name in found.explanation.disagreeing)


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


FAULTS: dict[str, tuple[Callable[[np.ndarray], None], str, list[int]]] = {
    "12 % brighter": (brighter, "light-brightness", [5]),
    "15 % darker": (darker, "light-brightness", [5]),
    "two swapped": (swapped, "images-swapped", [5, 9]),
    "shifted by (-3, 2)": (shifted, "image-shifted", [5]),
    "rows of another image": (torn, "image-striped", [5]),
    "noise": (noise, "image-disagrees", [5]),
    "clipped": (clipped, "image-clipped", [5]),
}


def test_a_correct_recording_is_quiet() -> None:
    found = checked(IMAGES)
    assert found.causes == ()
    assert numbers(found) == []
    assert found.verdict(0.5).answer == "good"


@pytest.mark.parametrize("name", quick(FAULTS, every=3))
def test_a_fault_is_named_with_its_images(name: str) -> None:
    plant, code, wrong = FAULTS[name]
    values = IMAGES.copy()
    plant(values)
    found = checked(values)
    assert numbers(found) == wrong
    (cause,) = found.causes
    assert cause.name == code
    assert cause.where == ", ".join(LIGHTS.ids[i] for i in wrong)


def test_the_size_of_a_wrong_brightness_is_found() -> None:
    values = IMAGES.copy()
    brighter(values)
    (factor,) = checked(values).explanation.disagreeing.values()
    assert factor == pytest.approx(1.12, abs=0.01)


def test_a_moved_light_is_named_in_degrees() -> None:
    turn = np.radians(10)
    vectors = LIGHTS.unit_directions.copy()
    across = np.cross(vectors[7], [0, 0, 1.0])
    vectors[7] = vectors[7] * np.cos(turn) + across / np.linalg.norm(across) * np.sin(turn)
    (cause,) = checked(IMAGES, Lights(directions=vectors)).causes
    assert (cause.name, cause.where) == ("light-moved", "L07")
    (stated,) = re.findall(r"([0-9.]+) degrees", cause.text)
    assert float(stated) == pytest.approx(10, abs=2)


def test_many_bright_images_do_not_hide_one_another() -> None:
    values = IMAGES.copy()
    values[1::4] *= 1.25
    found = checked(values)
    assert numbers(found) == list(range(1, COUNT, 4))
    (cause,) = found.causes
    assert cause.name == "light-brightness"


@pytest.mark.slow
def test_half_of_the_images_are_not_left_out() -> None:
    values = IMAGES.copy()
    values[::2] *= np.random.default_rng(3).uniform(0.6, 1.6, (COUNT // 2, 1, 1))
    found = checked(values)
    assert numbers(found) == []
    assert found.causes[0].name == "light-brightness"
    assert found.verdict(0.5).answer != "good"


def test_a_flat_object_shows_brightness_but_no_directions() -> None:
    flat, _ = images(LIGHTS, bumps=0.02, shine=0)
    brighter(flat)
    turned = LIGHTS.unit_directions.copy()
    turned[7] = turned[8]
    (cause,) = checked(flat).causes
    assert (cause.name, cause.where) == ("light-brightness", "L05")
    others = checked(flat, Lights(directions=turned)).causes
    assert "light-moved" not in {cause.name for cause in others}


def test_few_images_or_pixels_are_not_checked() -> None:
    small = np.zeros_like(MASK)
    small[40:48, 40:48] = True
    few = image_quality(IMAGES[:4], LIGHTS.take(range(4)), MASK)
    for found in (few, checked(IMAGES, mask=small)):
        assert found.causes == ()
        assert found.explanation.tried == ()


@pytest.mark.slow
def test_correct_recordings_are_quiet() -> None:
    """At most 2 % of the images of other objects and few lights are named."""
    named = total = 0
    for count in (6, 8, 12, 36):
        lights = Lights(dome(count, 0.95, 0.5))
        for seed in range(20, 26):
            values, mask = images(lights, seed=seed)
            named += len(image_quality(values, lights, mask).explanation.disagreeing)
            total += count
    assert named <= 0.02 * total
