"""Surfaces with jumps in depth, against closed forms and against captured objects."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import CameraModel, DataError, read_camera, read_mask
from processing import HeightMap, HeightPrior, NormalMap, height_mesh, integrate, read_normals
from processing.meshes.face_kernels import faces_of
from rig.arrays import Bool, Float32, Float64
from tests.cases import cases
from tests.real_data import DATA, needs_data


def horn(size: int = 120) -> tuple[NormalMap, Float64]:
    """Return a tilted horn whose lower end is in the ground, and which hides ground elsewhere."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j] * (size / 2)
    across, along = y - 3, x + 0.45 * size
    squared = np.maximum((0.2 * size) ** 2 - across**2, 1e-9)
    ground = 0.03 * x
    horn = np.sqrt(squared) + 0.5 * along - 0.25 * size
    on_horn = (squared > 1) & (horn > ground) & (x < 0.3 * size)
    flat = np.dstack([0 * x - 0.03, 0 * x, 0 * x + 1])
    round_ = np.dstack([0 * x - 0.5, across / np.sqrt(squared), 0 * x + 1])
    normals = NormalMap.from_vectors(np.where(on_horn[..., None], round_, flat))
    return normals, np.where(on_horn, horn, ground)


def error(surface: HeightMap, truth: Float64) -> float:
    difference = (surface.height - truth)[surface.mask]
    return float(np.abs(difference - np.median(difference)).mean())


@pytest.fixture(scope="module")
def surfaces() -> tuple[HeightMap, HeightMap, Float64]:
    """Return the surface of the horn without and with jumps, and the truth."""
    normals, truth = horn()
    return integrate(normals, discontinuity=False), integrate(normals), truth


def test_a_horn_above_the_ground(surfaces: tuple[HeightMap, HeightMap, Float64]) -> None:
    plain, jumps, truth = surfaces
    assert error(jumps, truth) < 0.1 * error(plain, truth)
    assert plain.jumps is None
    found = jumps.jumps
    assert found is not None
    assert found.count > 50
    # A pixel at the rim may belong to either side.
    assert found.pieces.max() == 0
    true = np.zeros(truth.shape, bool)
    true[:-1] = np.abs(np.diff(truth, axis=0)) > 6
    near = found.down | np.roll(found.down, 1, axis=0) | np.roll(found.down, -1, axis=0)
    assert np.count_nonzero(near & true) > 0.9 * np.count_nonzero(true)
    # The mesh is cut there.
    for pair, step in ((found.right, 1), (found.down, truth.shape[1])):
        faces = height_mesh(jumps).faces
        ends = np.flatnonzero(pair)[:, None] + [0, step]
        for corners in (faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]):
            sides = {tuple(sorted(side)) for side in corners.tolist()}
            assert not sides & {tuple(end) for end in ends.tolist()}


def test_smooth_surfaces_have_no_jumps() -> None:
    y, x = np.mgrid[1:-1:80j, -1:1:100j]
    normals = NormalMap.from_vectors(np.dstack([np.sin(5 * x), np.cos(4 * y), 0 * x + 1]))
    plain, jumps = integrate(normals), integrate(normals, discontinuity=True)
    assert jumps.jumps is not None
    assert jumps.jumps.count == 0
    assert jumps.jumps.pieces.max() == 0
    assert jumps.warnings == ()
    scale = np.ptp(plain.height)
    assert np.abs(jumps.height - plain.height).max() < 0.01 * scale
    assert len(height_mesh(jumps).faces) == len(height_mesh(plain).faces)


@pytest.mark.parametrize("noise", ["squares", "blurred"])
@pytest.mark.parametrize("seed", range(3))
def test_noise_that_neighbours_share_is_no_jump(noise: str, seed: int) -> None:
    y, x = np.mgrid[1:-1:96j, -1:1:96j]
    wave = np.dstack([0.5 * np.sin(5 * x), 0.5 * np.cos(4 * y), 0 * x + 1])
    wave /= np.linalg.norm(wave, axis=2, keepdims=True)
    rng = np.random.default_rng([940, seed])
    if noise == "squares":
        errors = rng.normal(size=(12, 12, 3)).repeat(8, axis=0).repeat(8, axis=1)
    else:
        errors = cv2.GaussianBlur(rng.normal(size=wave.shape), (0, 0), 2.0)
    normals = NormalMap.from_vectors(wave + np.radians(3) * errors / errors.std())
    assert integrate(normals).jumps is None


def test_a_piece_whose_height_is_a_guess() -> None:
    """A ball hides all of its contact with the ground: no normal knows its height."""
    y, x = np.mgrid[50:-50:101j, -50:50:101j]
    squared = 30.0**2 - x**2 - y**2
    ball = np.dstack([x, y, np.sqrt(np.maximum(squared, 0.01))])
    normals = np.where((squared > 0)[..., None], ball, (0, 0, 1))
    surface = integrate(NormalMap.from_vectors(normals), discontinuity=True)
    assert surface.jumps is not None
    pieces = surface.jumps.pieces
    assert pieces.max() == 1
    assert pieces[50, 50] == 1  # the ground is larger
    assert pieces[0, 0] == 0
    assert [notice.code for notice in surface.warnings] == ["height-guessed"]


def test_a_guessed_height_has_a_large_deviation() -> None:
    """A ball hides its contact with the ground: its height may be wrong by the jumps around it."""
    y, x = np.mgrid[50:-50:101j, -50:50:101j]
    squared = 30.0**2 - x**2 - y**2
    ball = np.dstack([x, y, np.sqrt(np.maximum(squared, 0.01))])
    normals = NormalMap.from_vectors(np.where((squared > 0)[..., None], ball, (0, 0, 1)))
    sigma = np.full((101, 101), 0.5, np.float32)
    surface = integrate(normals, sigma_deg=sigma, height_errors=True)
    assert surface.uncertainty is not None
    assert surface.jumps is not None
    guessed = surface.jumps.pieces == 1
    top = np.nanmedian(surface.uncertainty.sigma[guessed])
    assert top > 3  # px, of a radius of 30
    # A known height on it ends the guess.
    prior = HeightPrior.from_points([[50, 50], [2, 2]], [30, 0], 0.01, (101, 101))
    fixed = integrate(normals, sigma_deg=sigma, height_errors=True, prior=prior)
    assert fixed.uncertainty is not None
    assert np.nanmedian(fixed.uncertainty.sigma[guessed]) < 0.1 * top


SMOOTH = {
    "waves": (0.0, False),
    "waves with noise": (4.0, False),
    "horn": (0.0, True),
    "horn with noise": (3.0, True),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_steps_that_bend_a_smooth_surface_are_reported(name: str) -> None:
    noise_deg, bent = SMOOTH[name]
    y, x = np.mgrid[1:-1:120j, -1:1:120j]
    waves = NormalMap.from_vectors(np.dstack([np.sin(5 * x), np.cos(4 * y), 0 * x + 1]))
    normals = horn()[0] if bent else waves
    noise = np.random.default_rng(3).normal(scale=np.radians(noise_deg), size=(120, 120, 3))
    given = NormalMap.from_vectors(normals.normals + noise, normals.mask)
    surface = integrate(given, discontinuity=False)
    assert [notice.code for notice in surface.warnings] == ["surface-differs"] * bent
    by_default = integrate(given)
    assert (by_default.jumps is not None) == bent
    assert "surface-differs" not in [notice.code for notice in by_default.warnings]


def test_perspective_and_orthographic_views_find_the_same_jumps() -> None:
    normals, truth = horn()
    far = 1e5
    K = np.array([[far, 0, 59.5], [0, far, 59.5], [0, 0, 1]])
    surface = integrate(normals, camera=CameraModel(K, 120, 120), discontinuity=True)
    assert surface.jumps is not None
    assert integrate(normals, discontinuity=True).jumps is not None
    assert error(surface, truth) < 2


def test_normals_that_jump_everywhere_are_reported() -> None:
    vectors = np.random.default_rng(0).normal(size=(80, 80, 3))
    vectors[..., 2] = np.abs(vectors[..., 2]) + 0.1
    surface = integrate(NormalMap.from_vectors(vectors))
    assert "normals-inconsistent" in [notice.code for notice in surface.warnings]


def test_a_mask_that_cuts_every_contact_leaves_parts() -> None:
    normals, _ = horn()
    cut = np.ones(normals.mask.shape, bool)
    cut[:, 30:33] = cut[60:63] = False
    surface = integrate(NormalMap.from_vectors(normals.normals, cut))
    assert surface.part_count == 4
    assert "surface-in-parts" in [notice.code for notice in surface.warnings]


@pytest.mark.parametrize("k", [0.0, -1.0, np.nan, np.inf])
def test_a_sharpness_that_is_not_positive(k: float) -> None:
    with pytest.raises(DataError, match="sharpness"):
        integrate(horn(20)[0], discontinuity=True, k=k)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 6))
def test_cuts_remove_the_triangles_that_span_them(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    parts = rng.integers(-1, 2, (rows, columns)).astype(np.int32)
    inside = parts >= 0
    vertices = rng.normal(size=(np.count_nonzero(inside), 3)).astype(np.float32)
    right, down = rng.random((2, rows, columns)) < 0.3
    number = np.full((rows, columns), -1)
    number[inside] = np.arange(len(vertices))
    cut = {frozenset(number[r, c : c + 2]) for r, c in np.argwhere(right[:, :-1])}
    cut |= {frozenset(number[r : r + 2, c]) for r, c in np.argwhere(down[:-1])}
    expected = [
        face
        for face in faces_of(parts, vertices).tolist()
        if not any(frozenset((face[i], face[i - 1])) in cut for i in range(3))
    ]
    assert faces_of(parts, vertices, right, down).tolist() == expected


# Mean errors in mm that must not be exceeded: 15 % or .05 mm above the authors' code; harvest, the
# object with most pieces, has 0.65 mm.
CAPTURED = {
    "bear": 0.384,
    "buddha": 1.263,
    "cat": 0.124,
    "cow": 0.108,
    "goblet": 10.373,
    "harvest": 1.4,
}
NOISY = ("bear", "cat", "goblet")


def depth_error(
    vectors: Float32, mask: Bool, camera: CameraModel, depth: Float64, *, jumps: bool = True
) -> float:
    """Return the mean error of the depths of a surface from normals."""
    normals = NormalMap.from_vectors(vectors, mask)
    surface = integrate(normals, camera=camera, discontinuity=jumps)
    assert surface.depth is not None
    known = surface.mask
    scale = np.median(depth[known] / surface.depth[known])
    return float(np.abs(depth - scale * surface.depth)[known].mean())


@needs_data
@pytest.mark.slow
def test_captured_objects() -> None:
    errors = {}
    for name in CAPTURED:
        folder = DATA / "normals" / "diligent" / name
        read = read_normals(folder / "normal_map.png").normal_map
        mask = read_mask(folder / "mask.png", read.size)
        truth = np.load(folder / "depth_gt.npz")
        depth = truth[truth.files[0]].astype(np.float64)
        known = mask, read_camera(folder / "K.txt", read.size), depth
        # Of many layers, rounding errors decide where some are: the median of several inputs.
        rounded = [
            depth_error(read.normals + np.float32(1e-6 * n), *known)
            for n in range(5 if name == "harvest" else 1)
        ]
        errors[name] = np.median(rounded)
        assert errors[name] < CAPTURED[name]
        if name in NOISY:  # every second object
            # Not the seed of the noise with which the mode was developed.
            noise = np.random.default_rng(11).normal(scale=np.radians(3), size=(*mask.shape, 3))
            noisy, smooth = (
                depth_error(read.normals + noise, *known, jumps=jumps) for jumps in (True, False)
            )
            assert noisy < smooth
    four = [errors[name] for name in ("bear", "buddha", "cat", "cow")]
    assert np.mean(four) < 0.24


def floating_caps(side: int) -> tuple[Float64, NormalMap]:
    """Return heights and normals of two caps of balls that float over a plane."""
    y, x = np.mgrid[:side, :side] / side
    height, normals = np.zeros((side, side)), np.zeros((side, side, 3))
    normals[..., 2] = 1
    for across, down, radius, above in ((0.3, 0.35, 0.16, 0.1), (0.68, 0.62, 0.2, 0.21)):
        rim2, ball = radius**2, 1.3 * radius
        vector = np.dstack([x - across, down - y, 0 * x])
        away2 = (vector**2).sum(axis=2)
        vector[..., 2] = np.sqrt(np.maximum(ball**2 - away2, 0))
        cap = away2 < rim2
        height[cap] = (vector[..., 2] - np.sqrt(ball**2 - rim2) + above)[cap]
        normals[cap] = vector[cap] / ball
    return side * height, NormalMap.from_vectors(normals)


@cases(
    "places",
    {
        "one on each": [(0.05, 0.05), (0.3, 0.35), (0.68, 0.62)],
        "two": [(0.05, 0.05), (0.9, 0.1), (0.3, 0.4), (0.35, 0.3), (0.6, 0.62), (0.75, 0.6)],
    },
)
@pytest.mark.parametrize("sigma", [0.5, 0.01])
def test_known_heights_move_what_floats(places: list[tuple[float, float]], sigma: float) -> None:
    """The normals show most of the rim, but not where it follows a row or a column."""
    height, normals = floating_caps(160)
    at = np.round(160 * np.array(places)).astype(int)
    known = height[at[:, 1], at[:, 0]]
    prior = HeightPrior.from_points(at, known, sigma, height.shape)
    surface = integrate(normals, prior=prior)
    assert np.abs(surface.height - height).mean() < 0.3
    assert [notice.code for notice in surface.warnings] == []


@cases("places", {"both caps": [(0.3, 0.35), (0.68, 0.62)], "one cap": [(0.3, 0.35)]})
def test_a_piece_beyond_a_rim_without_a_known_height_is_a_guess(
    places: list[tuple[float, float]],
) -> None:
    """The rims have gaps, through which the ground seems to hang together with a cap."""
    height, normals = floating_caps(160)
    at = np.round(160 * np.array(places)).astype(int)
    prior = HeightPrior.from_points(at, height[at[:, 1], at[:, 0]], 0.1, height.shape)
    surface = integrate(normals, prior=prior)
    assert [notice.code for notice in surface.warnings] == ["height-guessed"]
    assert surface.jumps is not None
    pieces = surface.jumps.pieces
    held = np.isin(pieces, pieces[at[:, 1], at[:, 0]])
    assert np.abs(surface.height - height)[held].max() < 0.3
    assert not held[height == 0].any()
