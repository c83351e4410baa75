"""Reference solutions of several pixels at once agree with those of single pixels."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import CameraModel, LightErrors, Lights
from calibration import StackNoise
from processing import photometric_stereo
from processing.noise.reference_solver import ReferenceSolver
from processing.noise.tile_reference import TILE
from processing.stereo.frames import Frames
from processing.stereo.light_model import LightModel
from tests.processing.scenes import dome

COUNT, SIZE = 14, (24, 3 * TILE + 5)
FLOOR, SLOPE = 1e-5, 1e-4


def lights_of(near):
    directions = dome(COUNT, 0.97, 0.4)
    if near:
        return Lights(positions_mm=directions * 400, mu=np.full(COUNT, 1.3))
    return Lights(directions)


def with_errors(lights):
    """Return lights that state errors of every kind, each light others."""
    rng = np.random.default_rng(5)
    size = 3 if lights.near else 2
    parts = rng.normal(size=(COUNT, size, size)) * (2.0 if lights.near else 0.005)
    errors = LightErrors(parts @ parts.transpose(0, 2, 1), rng.uniform(0.002, 0.01, COUNT))
    if lights.near:
        stds = rng.uniform(0.2, 2, COUNT), rng.uniform(0, 0.1, COUNT) * (np.arange(COUNT) % 3 > 0)
        errors = replace(errors, axis_std_deg=stds[0], mu_std=stds[1])
    return replace(lights, errors=errors)


def solver_of(near, errors=False):
    """Return a solver and what it solves: a relief with shadows, highlights and gaps."""
    lights, rng = lights_of(near), np.random.default_rng(17)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    points = np.stack([x - SIZE[1] / 2, SIZE[0] / 2 - y, 0 * x], axis=-1)
    normals = np.stack([0.9 * np.sin(x / 9), 0.9 * np.cos(y / 7), np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    vectors = lights.vectors_at(points.reshape(-1, 3)).reshape(COUNT, *SIZE, 3)
    images = rng.uniform(0.3, 0.9, SIZE) * np.clip(np.sum(vectors * normals, axis=-1), 0, None)
    images += rng.normal(size=images.shape) * np.sqrt(FLOOR + SLOPE * images)
    images[3:7, 4:8, 10:40] *= 0.2
    images[9, 12:14, 50:70] += 0.5
    images[2, 18:, 30:60] = np.nan
    mask = np.ones(SIZE, bool)
    mask[15, 5:90:3] = False
    images, place = images.astype(np.float32), points if near else None
    noise = StackNoise.of_one_exposure(SLOPE, FLOOR, COUNT)
    stereo = photometric_stereo(images, lights, mask, method="cauchy", points_mm=place, noise=noise)
    albedo = stereo.albedo.copy()
    albedo[1, 7] = 0
    matrix = np.array([[600.0, 0, 50], [0, 600, 12], [0, 0, 1]])
    camera = CameraModel(matrix, SIZE[1], SIZE[0], 600.0) if errors and near else None
    solver = ReferenceSolver(
        with_errors(lights) if errors else lights,
        (stereo.normal_map.normals, albedo), place, camera, 0.01 if camera else 0.0,
    )  # fmt: skip
    pixels = np.flatnonzero(mask)
    samples, vectors = LightModel(lights, place, mask).samples(Frames(images), pixels)
    law = np.zeros((1, 2, COUNT), np.float32)
    law[:, 0], law[:, 1] = FLOOR, SLOPE
    return solver, (pixels, samples, vectors, law)


@pytest.mark.parametrize("errors", [False, True], ids=["exact", "errors"])
@pytest.mark.parametrize("near", [False, True], ids=["distant", "near"])
def test_pixels_of_a_tile_have_the_solutions_of_single_pixels(near, errors):
    solver, given = solver_of(near, errors)
    kinds, counts, alone, parts = solver.solve(*given)
    none, together, of_tiles, parts_of_tiles = solver.solve(*given, keep_kinds=False)
    assert none.shape == (0, COUNT)
    assert np.array_equal(counts[:, 0], (kinds == 0).sum(axis=1))
    good = np.isfinite(alone[:, 0])
    assert np.array_equal(good, np.isfinite(of_tiles[:, 0]))
    assert 0.9 < good.mean() < 1
    same = (counts == together).all(axis=1)
    # A sample at the limit between two kinds may be either.
    assert same.mean() > 0.998
    length = np.linalg.norm(alone, axis=1, keepdims=True)
    off = np.abs(alone - of_tiles) / np.sqrt(parts[:, :1]) / length
    assert np.nanmax(off[same]) < 0.02
    # Tiles take the weights at the given normals, single pixels sometimes one step later.
    assert np.max(np.abs(parts_of_tiles[good, 0] / parts[good, 0] - 1)[same[good]]) < 0.01
    for column in (1, 2):
        off = np.abs(parts[:, column] - parts_of_tiles[:, column])
        assert np.max(off[same] / (parts[same, :3].sum(axis=1) + 1e-12)) < 0.01, column
        stated = errors and (near or column == 1)
        assert ((parts[good, column] > 0.01 * parts[good, 0]).mean() > 0.9) == stated
    for column, limit in ((4, 0.1), (5, 0), (6, 0.1), (8, 0)):
        off = np.abs(parts[:, column] - parts_of_tiles[:, column])
        # In one pixel, a sample changes between lit and attached shadow in the last step.
        assert np.quantile(off[same], 0.999) <= limit, column
    pairs = same & np.roll(same, 4)
    # Products of noise scatter by 3; those of shadows and highlights are large.
    assert np.max(np.abs(parts[pairs, 7] - parts_of_tiles[pairs, 7])) < 0.5
    # The tiles are used: float32 sums differ in the last digits.
    assert (parts[:, 4] != parts_of_tiles[:, 4]).mean() > 0.5


@pytest.mark.parametrize("errors", [False, True], ids=["exact", "errors"])
def test_a_pixel_has_the_same_bits_wherever_in_a_tile_it_is(errors):
    solver, (pixels, samples, vectors, law) = solver_of(near=False, errors=errors)
    _, counts, reference, parts = solver.solve(pixels, samples, vectors, law, keep_kinds=False)
    part = pixels % SIZE[1] >= 7
    of_part = solver.solve(pixels[part], samples[part], vectors, law, keep_kinds=False)
    own_law = solver.solve(
        pixels, samples, vectors, np.repeat(law, len(pixels), axis=0), keep_kinds=False
    )
    for chosen, found in ((part, of_part), (slice(None), own_law)):
        assert np.array_equal(found[1], counts[chosen])
        assert np.array_equal(found[2], reference[chosen], equal_nan=True)
        # The neighbours of the first pixels are not there.
        assert np.array_equal(found[3][:, :7], parts[chosen, :7])
