"""Least squares in tiles against numpy, and images that are read in place."""

import tracemalloc
from functools import partial

import numpy as np
import pytest

from acquisition import Lights
from processing import StereoMaps, photometric_stereo
from processing.stereo import METHODS
from processing.stereo.frames import TILE, Frames
from processing.stereo.light_model import LightModel
from processing.stereo.solve import solve_maps
from rig import no_progress
from tests.processing.scenes import dome

_dome = partial(dome, highest=0.97, lowest=0.5)


def _points(height, width):
    y, x = np.mgrid[40 : -40 : height * 1j, -60 : 60 : width * 1j]
    return np.stack([x, y, 5 + 0.1 * x], axis=2)


def _solved(values, vectors):
    """Return scaled normals and rms residuals of float64 least squares, pixel by pixel."""
    found = np.zeros((*values.shape[1:], 4))
    for at in np.ndindex(*values.shape[1:]):
        of = vectors if vectors.ndim == 2 else vectors[(slice(None), *at)]
        lit = np.isfinite(values[(slice(None), *at)]) & of.any(axis=1)
        v = values[(slice(None), *at)][lit].astype(np.float64)
        m = np.linalg.lstsq(of[lit], v, rcond=None)[0]
        found[at] = [*m, np.sqrt(np.mean((v - of[lit] @ m) ** 2))]
    return found[..., :3], found[..., 3]


@pytest.mark.parametrize("near", [False, True], ids=["distant", "near"])
def test_tiles_agree_with_float64(near):
    rng = np.random.default_rng(41)
    for count in (3, 5, 8, 13):
        lights = Lights(directions=_dome(count))
        points = _points(6, 9) if near else None
        if near:
            mu = rng.choice([0.0, 1.0, 1.7], count)
            lights = Lights(positions_mm=300 * _dome(count), mu=mu)
        values = rng.uniform(0.1, 1, (count, 6, 9)).astype(np.float32)
        if count > 5:
            values[rng.uniform(size=values.shape) < 0.1] = np.nan
            values[2, 3, 3] = np.inf
        mask = rng.uniform(size=(6, 9)) < 0.8
        result = photometric_stereo(values, lights, mask, method="ls", points_mm=points)
        vectors = lights.vectors_at(points) if near else lights.unit_directions
        scaled, rms = _solved(values, vectors)
        length = np.linalg.norm(scaled, axis=2)
        normals = scaled / length[..., None]
        np.testing.assert_allclose(result.normal_map.normals[mask], normals[mask], atol=3e-6)
        np.testing.assert_allclose(result.albedo[mask], length[mask], rtol=3e-6)
        np.testing.assert_allclose(result.residual[mask], rms[mask], atol=1e-6)
        assert np.array_equal(result.used, np.isfinite(values).sum(axis=0) * mask)


def test_bands_and_regions_have_the_bytes_of_the_whole():
    rng = np.random.default_rng(42)
    values = rng.uniform(0.1, 1, (7, 30, 2 * TILE // 30 + 3)).astype(np.float32)
    values[rng.uniform(size=values.shape) < 0.001] = np.nan
    mask = rng.uniform(size=values.shape[1:]) < 0.9
    lights = Lights(_dome(7))
    whole = photometric_stereo(values, lights, mask, method="ls")
    for rows, columns in ((slice(3, 4), slice(None)), (slice(9, 30), slice(5, 60))):
        part = photometric_stereo(
            values[:, rows, columns], lights, mask[rows, columns], method="ls"
        )
        for name in ("albedo", "residual", "used"):
            assert np.array_equal(getattr(part, name), getattr(whole, name)[rows, columns])
        normals = whole.normal_map.normals[rows, columns]
        assert np.array_equal(part.normal_map.normals, normals)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.float64, ">u2"])
def test_images_of_any_type_and_strides_are_read_in_place(kind):
    raw = np.random.default_rng(43).integers(20, 250, (9, 12, 14, 2)).astype(kind)
    dark = np.linspace(1, 9, 12 * 14).reshape(12, 14)
    gain = np.linspace(0.5, 2, 9)
    views = {
        "contiguous": np.ascontiguousarray(raw[..., 0]),
        "channels": raw[..., 0],
        "rows backwards": raw[:, ::-1, :, 0],
        "every second image": np.ascontiguousarray(raw[..., 0])[::2],
        "region": np.ascontiguousarray(raw[..., 0])[:, 2:9, 3:11],
    }
    for name, images in views.items():
        shape = images.shape[1:]
        of_dark = dark[: shape[0], : shape[1]]
        used = gain[: len(images)]
        frames = Frames(images, gain=used, dark=of_dark, limit=240)
        linear = (images.astype(np.float32) - of_dark.astype(np.float32)) * used.astype(np.float32)[
            :, None, None
        ]
        linear[images >= 240] = np.nan
        lights, mask = Lights(_dome(len(images))), np.ones(shape, bool)
        model = LightModel(lights, None, mask)
        for method in METHODS[:2]:
            found, expected = StereoMaps.empty(shape), StereoMaps.empty(shape)
            solve_maps(frames, model, mask, None, method, found, None, no_progress)
            solve_maps(Frames(linear), model, mask, None, method, expected, None, no_progress)
            assert np.array_equal(found.normals, expected.normals), name
            assert np.array_equal(found.residual, expected.residual), name


@pytest.mark.parametrize(
    "conversion", [{}, {"gain": np.arange(1.0, 6.0)}, {"dark": 0.1}, {"limit": 0.95}]
)
def test_complete_tiles_are_converted_where_necessary(conversion):
    shape = (2, TILE)
    values = np.random.default_rng(44).uniform(0.2, 1, (5, *shape)).astype(np.float32)
    gain = conversion.get("gain", np.ones(5)).astype(np.float32)
    linear = (values - np.float32(conversion.get("dark", 0))) * gain[:, None, None]
    linear[values >= conversion.get("limit", np.inf)] = np.nan
    mask, found = np.ones(shape, bool), StereoMaps.empty(shape)
    model = LightModel(Lights(_dome(5)), None, mask)
    solve_maps(Frames(values, **conversion), model, mask, None, "ls", found, None, no_progress)
    vectors = _dome(5)
    for at in ((0, 0), (0, TILE - 1), (1, TILE // 2)):
        scaled, rms = _solved(linear[:, at[0], at[1]].reshape(5, 1, 1), vectors)
        np.testing.assert_allclose(found.albedo[at], np.linalg.norm(scaled), rtol=3e-6)
        np.testing.assert_allclose(found.residual[at], rms[0, 0], atol=1e-6)


def test_a_region_is_not_copied():
    whole = np.random.default_rng(45).uniform(0.2, 1, (36, 100, 200)).astype(np.float32)
    region, lights = whole[:, 5:95, 10:190], Lights(_dome(36))
    mask = np.ones(region.shape[1:], bool)
    tracemalloc.start()
    try:
        photometric_stereo(region, lights, mask, method="ls")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < region.nbytes / 2
