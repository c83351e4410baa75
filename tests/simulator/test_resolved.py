"""The normals that a lens resolves, against normals from blurred images without noise."""

import dataclasses

import numpy as np
import pytest

from acquisition import Lights, angle_deg
from simulator import Lens, Scene, bench_camera, bench_sensor, render, resolved_normals
from simulator.scene import Optics
from simulator.shapes import BandNoise, Checker

LIGHTS = Lights(directions=np.array([[0.4, 0.0, 1.0], [-0.2, 0.35, 1.0], [-0.2, -0.35, 1.0]]))


def rendered(**more):
    """Return a matte relief with a pattern, everywhere lit by three distant lights."""
    lens = Lens(bench_camera(96, 80), **{"sharp": False} | more)
    relief = BandNoise(200.0, rms_mm=0.8, wavelength_mm=30.0, seed=4)
    dark = {"ambient": 0.0, "surroundings": 0.0, "pattern": Checker(square_mm=25.0)}
    return render(Scene(relief, LIGHTS, lens, bench_sensor(), 1.0, **dark))


def seen_normals(rendering):
    """Return the normals that explain the images without noise."""
    vectors = np.moveaxis(rendering.planes, 0, -1) @ np.linalg.inv(LIGHTS.unit_directions).T
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


@pytest.mark.parametrize(
    ("optics", "limit_deg"),
    [
        pytest.param(Optics(f_number=8.0), 1.0, id="in focus"),
        pytest.param(Optics(f_number=0.5, focus_mm=500.0), 1.4, id="out of focus"),
    ],
)
def test_images_without_noise_have_the_resolved_normals(optics, limit_deg):
    rendering = rendered(optics=optics)
    truth = rendering.truth
    assert not truth.shadows[:, truth.mask].any()
    resolved, seen = resolved_normals(truth), seen_normals(rendering)
    assert resolved.dtype == np.float32
    assert not resolved[~truth.mask].any()
    np.testing.assert_allclose(np.linalg.norm(resolved[truth.mask], axis=1), 1, atol=1e-6)
    inside = np.zeros_like(truth.mask)
    inside[12:-12, 12:-12] = True
    inside &= truth.mask
    assert angle_deg(seen, truth.normals)[inside].mean() > limit_deg
    assert angle_deg(seen, resolved)[inside].max() < 1e-3


def test_a_sharp_lens_resolves_every_normal():
    rendering = rendered(sharp=True)
    truth = rendering.truth
    np.testing.assert_array_equal(resolved_normals(truth), truth.normals)
    nothing = dataclasses.replace(truth, mask=np.zeros_like(truth.mask), normals=0 * truth.normals)
    assert not resolved_normals(nothing).any()
