"""Light above a matte surface, compared with the lobe of a glossy coat."""

import numpy as np
import pytest

from acquisition import DataError, Lights
from calibration import StackNoise
from processing import photometric_stereo
from processing.colour import specular_residual
from simulator.scene import Ggx
from simulator.scene.reflectance import reflectance

SLOPE, FLOOR = 1e-4, 2.5e-7
COUNT = 36
NOISE = StackNoise.of_one_exposure(SLOPE, FLOOR, COUNT)
Z = np.linspace(0.98, 0.35, COUNT)
TURN = np.arange(COUNT) * np.pi * (3 - np.sqrt(5))
WAYS = np.stack([np.sqrt(1 - Z * Z) * np.cos(TURN), np.sqrt(1 - Z * Z) * np.sin(TURN), Z], axis=1)
LIGHTS = Lights(directions=WAYS)
Y, X = np.mgrid[1:-1:51j, -1:1:51j]
MASK = np.hypot(X, Y) < 0.9
NORMALS = np.stack([X, Y, np.sqrt(np.clip(1 - X * X - Y * Y, 0.0, None))], axis=-1)
LIT = np.clip(np.einsum("nc,hwc->nhw", WAYS, NORMALS), 0, None)


def coated(roughness, albedo):
    """Return images of a ball without its coat, and what the coat adds to them."""
    eye, to_light = np.array([0.0, 0.0, 1.0]), WAYS[:, None, None]
    whole, coat = (
        LIT * reflectance(Ggx(roughness, 0.04), value, NORMALS, to_light, eye)
        for value in (albedo, 0.0)
    )
    return whole - coat, coat


def found(values, noise=NOISE, method="best"):
    rng = np.random.default_rng(23)
    noisy = values + rng.normal(size=values.shape) * np.sqrt(FLOOR + SLOPE * values)
    stereo = photometric_stereo(noisy, LIGHTS, MASK, method=method, noise=noise)
    return specular_residual(noisy, LIGHTS, stereo, noise=noise)


def test_a_matte_ball_has_none():
    residual = found(0.5 * LIT)
    assert residual[MASK].mean() < 1e-4 * 0.5
    # Without the law, half of the noise is above the prediction.
    unknown = found(0.5 * LIT, noise=None, method="cauchy")[MASK].mean()
    assert unknown == pytest.approx(0.4 * np.sqrt(FLOOR + SLOPE * 0.5 * LIT).mean(), rel=0.3)


@pytest.mark.parametrize(
    ("roughness", "albedo", "least", "alike"),
    [(0.1, 0.05, 0.85, 0.99), (0.15, 0.5, 0.6, 0.98), (0.3, 0.05, 0.4, 0.95)],
)
def test_the_gloss_of_a_coat(roughness, albedo, least, alike):
    """The map has the form of the coat's light; a broad lobe is in part taken for albedo."""
    matte, coat = coated(roughness, albedo)
    residual, truth = found(matte + coat)[MASK], coat.mean(axis=0)[MASK]
    assert least < residual.mean() / truth.mean() < 1.02
    assert np.corrcoef(residual, truth)[0, 1] > alike


def test_shadows_and_unmeasured_samples_do_not_count():
    values = (0.5 * LIT).astype(np.float32)
    stereo = photometric_stereo(values, LIGHTS, MASK)
    values[:9] = 0
    values[9:18] = np.nan
    values[20, 25, 25] += 0.3
    residual = specular_residual(values, LIGHTS, stereo)
    assert residual[25, 25] == pytest.approx(0.3 / 27, rel=1e-4)
    residual[25, 25] = 0
    assert residual.max() < 1e-6


def test_colours_count_by_their_luma_and_near_lights_at_the_surface():
    near = Lights(positions_mm=450 * WAYS, axes=-WAYS, mu=np.ones(COUNT))
    points = np.stack([40 * X, 40 * Y, 5 * NORMALS[..., 2]], axis=-1)
    vectors = near.vectors_at(points)
    shade = np.clip(np.einsum("nhwc,hwc->nhw", vectors, NORMALS), 0, None)
    stereo = photometric_stereo(0.4 * shade, near, MASK, points_mm=points)
    colours = 0.4 * shade[..., None] * np.ones(3)
    colours[5, 20, 20] += [0.2, 0.0, 0.1]
    residual = specular_residual(colours, near, stereo, points_mm=points)
    assert residual[20, 20] == pytest.approx((0.2989 * 0.2 + 0.114 * 0.1) / COUNT, rel=2e-2)
    residual[20, 20] = 0
    assert residual.max() < 1e-4


def test_shapes_that_do_not_fit_are_refused():
    stereo = photometric_stereo(0.5 * LIT, LIGHTS, MASK)
    for values in (LIT[:5], LIT[:, :9], LIT[..., None]):
        with pytest.raises(DataError, match="do not fit 36 lights and normals of shape"):
            specular_residual(values, LIGHTS, stereo)
