"""Distance of lights that have only directions, from images with a closed form."""

import re

import numpy as np
import pytest

from acquisition import DataError, Lights
from calibration import EstimateError
from processing.images.viewing_rays import Parallel
from processing.series.light_distance import LightDistance, find_light_distance
from tests.cases import cases

SIZE = (34, 40)
PIXEL_MM = 4.5
VIEW = Parallel(PIXEL_MM, SIZE, ((SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2))
ACROSS, UP, _ = np.moveaxis(VIEW.points_at(0.0), 2, 0)
MASK = (ACROSS / 85) ** 2 + (UP / 70) ** 2 < 1
HEIGHT = 4 + 1.5 * np.sin(ACROSS / 15) * np.cos(UP / 18)
NORMALS = np.dstack([
    -np.cos(ACROSS / 15) * np.cos(UP / 18) / 10,
    np.sin(ACROSS / 15) * np.sin(UP / 18) / 12,
    np.ones(SIZE),
])  # fmt: skip
NORMALS /= np.linalg.norm(NORMALS, axis=-1, keepdims=True)
ELEVATIONS = np.radians(np.repeat([30.0, 50, 70], [8, 6, 4]))
TURN = np.arange(18) * 2.4
LIGHTS = Lights(
    directions=np.stack(
        [np.cos(ELEVATIONS) * np.cos(TURN), np.cos(ELEVATIONS) * np.sin(TURN), np.sin(ELEVATIONS)],
        axis=1,
    )
)


def images(lights, seed=0):
    """Return images of the relief in a glossy paint, with 0.3 % noise."""
    points = VIEW.points_at(-HEIGHT)
    vectors = lights.vectors_at(points)
    shading = np.maximum(np.einsum("nhwc,hwc->nhw", vectors, NORMALS), 0)
    unit = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    half = unit + np.array([0, 0, 1.0])
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    gloss = np.maximum(np.einsum("nhwc,hwc->nhw", half, NORMALS), 0) ** 20
    paint = 0.5 + 0.2 * np.cos(UP / 9)
    noise = np.random.default_rng(seed).normal(1, 0.003, shading.shape)
    return (shading * (paint + 0.1 * gloss) * noise).astype(np.float32)


@cases(
    ("distance", "mu"),
    {
        "near": (280.0, 0.0),
        "Lambertian lamps": pytest.param(450.0, 1.0, marks=pytest.mark.slow),
        "far": pytest.param(800.0, 0.0, marks=pytest.mark.slow),
    },
)
def test_the_distance_is_within_its_deviation(distance, mu):
    truth = LIGHTS.at_distance(distance)
    lamps = Lights(positions_mm=truth.positions_mm, mu=np.full(len(LIGHTS), mu))
    found = find_light_distance(images(lamps), LIGHTS, MASK, VIEW)
    assert found.sigma_mm < 0.1 * distance
    assert found.distance_mm == pytest.approx(distance, abs=2 * found.sigma_mm)


@pytest.mark.slow
def test_distant_lights_have_no_distance():
    with pytest.raises(
        EstimateError, match="or at any larger distance; measure and state"
    ) as raised:
        find_light_distance(images(LIGHTS), LIGHTS, MASK, VIEW)
    least = re.search(r"from (\d+) mm", str(raised.value))
    assert float(least[1]) > 1000


@cases(
    ("lights", "mask", "error", "text"),
    {
        "positions": (LIGHTS.at_distance(400), MASK, DataError, "have positions"),
        "another count": (LIGHTS.take(range(9)), MASK, DataError, "18 images for 9 lights"),
        "a small object": (LIGHTS, MASK & (np.abs(ACROSS) < 3), EstimateError, "blocks"),
    },
)
def test_what_shows_no_distance_is_refused(lights, mask, error, text):
    with pytest.raises(error, match=text):
        find_light_distance(images(LIGHTS.at_distance(400)), lights, mask & (np.abs(UP) < 40), VIEW)


def test_the_error_of_the_distance_is_that_of_the_positions():
    lights = LightDistance(500, 20, 0.5, 0.1).lights(LIGHTS, (10, 0, 0))
    assert np.allclose(lights.positions_mm, 500 * LIGHTS.unit_directions + [10, 0, 0])
    for covariance, direction in zip(
        lights.errors.covariances, LIGHTS.unit_directions, strict=True
    ):
        assert np.allclose(covariance @ direction, 400 * direction)
    assert np.allclose(lights.errors.mu_std, 0.1)


@cases(
    ("sigma", "texts"),
    {
        "stated": (0.0, []),
        "certain": (45.0, []),
        "rough": (75.0, ["it is from 385 mm to 714 mm; measure and state it"]),
    },
)
def test_a_rough_distance_is_reported_with_its_range(sigma, texts):
    found = [notice.text.split(": ")[1] for notice in LightDistance(500.0, sigma).warnings]
    assert found == texts
