"""Near lights of a recording in which the camera, or the object, moved."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquisition import LightErrors, Lights
from calibration import EstimateError, Stack
from processing.images.recorded_images import RecordedImages
from processing.images.viewing_rays import Parallel
from processing.recording.alignment import lights_of_moved
from rig.arrays import Float64

SIDE, PIXEL_MM, COUNT = 80, 1.0, 12
VIEW = Parallel(PIXEL_MM, (SIDE, SIDE), ((SIDE - 1) / 2, (SIDE - 1) / 2))
MASK = np.ones((SIDE, SIDE), bool)


def lights() -> Lights:
    around = np.linspace(0, 2 * np.pi, COUNT, endpoint=False)
    places = np.stack([250 * np.cos(around), 250 * np.sin(around), np.full(COUNT, 300)], axis=1)
    return Lights(positions_mm=places)


def images(seen: Lights, steep: float, noise: float = 0.005) -> RecordedImages:
    """Return images of a rough card under lights of other strengths."""
    rng = np.random.default_rng(5)
    height = cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE)), (0, 0), 4) * steep
    down, right = np.gradient(height)
    normals = np.stack([-right, down, np.ones_like(height)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    points = VIEW.points_of(np.arange(SIDE), 0.0)
    shade = (seen.vectors_at(points) * normals).sum(axis=3).clip(0)
    noisy = shade * rng.normal(1, noise, shade.shape)
    strengths = rng.uniform(0.8, 1.2, COUNT)[:, None, None]
    return RecordedImages(Stack(np.float32(0.4 * noisy * strengths), seen.ids, None))


def shifts(pixels: float) -> dict[str, tuple[float, float]]:
    by = np.random.default_rng(2).uniform(-pixels, pixels, (COUNT, 2))
    return {name: (right, down) for name, (right, down) in zip(lights().ids, by, strict=True)}


def moved(by: dict[str, tuple[float, float]]) -> Float64:
    """Return the positions relative to an object that moved."""
    right_down = np.array([by[name] for name in lights().ids]) * PIXEL_MM
    return np.asarray(lights().positions_mm) - np.column_stack(
        [right_down[:, 0], -right_down[:, 1], np.zeros(COUNT)]
    )


def usual(by: dict[str, tuple[float, float]]) -> Float64:
    """Return the positions relative to an object that the camera sees at the median place."""
    right, down = np.median(list(by.values()), axis=0) * PIXEL_MM
    return np.asarray(lights().positions_mm) - (right, -down, 0)


def test_lights_stay_with_the_object_if_the_camera_moved() -> None:
    by = shifts(12)
    true = Lights(positions_mm=usual(by), ids=lights().ids)
    found, notices = lights_of_moved(images(true, 30.0), lights(), MASK, VIEW, by)
    np.testing.assert_allclose(found.positions_mm, usual(by), atol=0.2)
    assert notices == []


def test_lights_move_against_an_object_that_moved() -> None:
    by = shifts(12)
    true = Lights(positions_mm=moved(by), ids=lights().ids)
    found, notices = lights_of_moved(images(true, 30.0), lights(), MASK, VIEW, by)
    np.testing.assert_allclose(found.positions_mm, moved(by), atol=0.2)
    assert [one.code for one in notices] == ["object-moved"]
    # A light that comes nearer is brighter at the origin.
    near = np.linalg.norm(moved(by), axis=1)
    before = np.linalg.norm(np.asarray(lights().positions_mm), axis=1)
    assert found.intensities is not None
    np.testing.assert_allclose(found.intensities[:, 0], (before / near) ** 2, rtol=1e-3)


def test_noisy_images_of_a_flat_card_do_not_show_which_moved() -> None:
    known = lights()
    flat = images(known, 0.0, noise=0.2)
    found, notices = lights_of_moved(flat, known, MASK, VIEW, shifts(4))
    np.testing.assert_allclose(found.positions_mm, usual(shifts(4)), atol=0.2)
    assert [one.code for one in notices] == ["lights-may-have-moved"]
    with pytest.raises(EstimateError, match="do not show which"):
        lights_of_moved(flat, known, MASK, VIEW, shifts(20))


def test_shifts_within_the_errors_of_the_lights_change_nothing() -> None:
    known, by = lights(), shifts(3)
    flat = images(known, 0.0)
    uncertain = Lights(
        positions_mm=known.positions_mm,
        ids=known.ids,
        errors=LightErrors(covariances=np.tile(8.0**2 * np.eye(3), (COUNT, 1, 1))),
    )
    assert lights_of_moved(flat, uncertain, MASK, VIEW, by) == (uncertain, [])
    assert lights_of_moved(flat, known, MASK, VIEW, shifts(0.5)) == (known, [])
