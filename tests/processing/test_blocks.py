"""Surfaces in blocks against those of the whole."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from acquisition import CameraModel, DataError
from acquisition.files import BandStore, DamagedMapsError
from calibration import EstimateError
from processing import NormalMap, integrate
from processing.surface import SurfaceStage, integrate_in_blocks
from processing.surface.blocks.block_files import BlockFiles
from processing.surface.blocks.block_solutions import Seam, Side
from processing.surface.blocks.local_parts import LocalParts, meeting_of
from processing.surface.blocks.plan import CELL, plan_blocks
from tests.processing.test_jumps import horn
from tests.processing.test_stages import deleted, flipped

LIMIT = 5e-4  # of the range
SIZE = (192, 80)


def waves(noise_deg: float = 0, mask=None, size=SIZE, seed: int = 7) -> NormalMap:
    row, x = np.mgrid[: size[0], : size[1]] / 40.0
    y = -row
    across = 0.3 * np.sin(3 * x + 2 * y)
    slopes = [0.4 * np.sin(5 * x) + 3 * across, 0.3 * np.cos(6 * y) + 2 * across, np.ones_like(x)]
    noise = np.radians(noise_deg) * np.random.default_rng(seed).normal(size=(*size, 3))
    return NormalMap.from_vectors(np.dstack(slopes) + noise, mask)


def compared(folder: Path, normal_map: NormalMap, *, rows: int = 48, sigma_deg=None, **options):
    """Return the surface in blocks, and its largest difference from that of the whole."""
    whole = integrate(normal_map, sigma_deg=sigma_deg, **options)
    with opened(folder, normal_map.size, **options) as store:
        found = integrate_in_blocks(normal_map, store, rows=rows, sigma_deg=sigma_deg, **options)
        height, parts, (lowest, highest) = found.height, found.parts, found.extremes
        assert found.part_count == whole.part_count
        assert found.blocks.number == len(plan_blocks(len(parts), rows).blocks)
    np.testing.assert_array_equal(parts, whole.parts)
    np.testing.assert_array_equal(np.isfinite(height), whole.mask)
    inside = whole.mask
    span = np.ptp(whole.height[inside])
    off = float(np.abs(height - whole.height)[inside].max())
    # The estimate does not contain the tolerance of both solutions.
    assert off <= found.blocks.error + 1e-6 * span
    assert highest - lowest == pytest.approx(span, rel=1e-3)
    return found, whole, off / span


def opened(folder: Path, size=SIZE, camera=None, **_) -> BandStore:
    return BandStore(folder / "surface", {}, SurfaceStage(camera is not None).forms(size))


def ring() -> np.ndarray:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    away = np.hypot((y - 96) / 2.4, x - 40)
    return (away < 39) & (away > 18)


def comb() -> np.ndarray:
    """Teeth that are connected only by the last rows: parts of blocks, but one surface."""
    mask = np.zeros(SIZE, bool)
    mask[:, ::16] = mask[:, 1::16] = mask[:, 2::16] = True
    mask[-6:] = True
    return mask


def two() -> np.ndarray:
    mask = np.ones(SIZE, bool)
    mask[:, 38:40] = False
    mask[90, 10] = mask[5:9, 3:7] = False
    return mask


@pytest.mark.parametrize(
    ("mask", "noise_deg", "limit", "rounds"),
    [
        (None, 0, 5e-5, 0),
        (comb(), 0, 5e-5, 0),
        (None, 2, LIMIT, 3),
        (ring(), 2, LIMIT, 6),
        (comb(), 1, LIMIT, 6),
        (two(), 1, LIMIT, 6),
    ],
    ids=["waves", "comb", "noise", "ring", "noisy comb", "two parts"],
)
def test_blocks_have_the_surface_of_the_whole(tmp_path, mask, noise_deg, limit, rounds):
    found, whole, error = compared(tmp_path, waves(noise_deg, mask))
    assert error < limit
    assert found.blocks.rounds <= rounds
    assert [n.code for n in found.warnings] == [n.code for n in whole.warnings]
    assert found.disagreement_deg == pytest.approx(whole.disagreement_deg, abs=0.05)
    assert found.curl == pytest.approx(whole.curl, abs=0.02)


def test_contradicting_normals_are_solved_too(tmp_path):
    # Mirrored: the free solutions of neighbouring blocks differ by half of the range.
    normals = waves()
    mirrored = NormalMap(normals.normals * np.float32([1, -1, 1]), normals.mask)
    found, _, error = compared(tmp_path, mirrored)
    assert error < LIMIT
    assert found.blocks.rounds >= 2
    assert "normals-mirrored" in [n.code for n in found.warnings]


def test_a_perspective_surface_has_depths(tmp_path):
    k = np.array([[150.0, 0, 39.5], [0, 150.0, 95.5], [0, 0, 1]])
    camera = CameraModel(k, SIZE[1], SIZE[0], 300.0)
    found, _, error = compared(tmp_path, waves(1), camera=camera)
    assert error < LIMIT
    assert "depth" in found.maps
    assert found.unit == "mm"


def test_deviations_of_normals_count(tmp_path):
    sigma = np.full(SIZE, 1, np.float32)
    sigma[60:90, 20:50] = 10
    sigma[100, 5] = np.nan
    normal_map = waves(1)
    found, _, error = compared(tmp_path, normal_map, sigma_deg=sigma)
    assert error < LIMIT
    with opened(tmp_path / "plain") as store:
        plain = integrate_in_blocks(normal_map, store, rows=48)
        assert plain.extremes != found.extremes


@pytest.mark.slow
def test_jumps_cross_the_borders_of_blocks(tmp_path):
    normal_map, truth = horn(240)
    whole = integrate(normal_map)
    with opened(tmp_path, normal_map.size) as store:
        found = integrate_in_blocks(normal_map, store, rows=32)
        assert found.blocks.number > 2
        errors = [
            np.abs(off - np.median(off)).mean()
            for off in (surface.height - truth for surface in (found, whole))
        ]
    assert errors[0] < errors[1] + 0.1
    assert found.jumps.pieces.max() == whole.jumps.pieces.max()
    # Nearly all jumps of the whole are within a pixel of one of the blocks.
    ours, theirs = (surface.jumps.right | surface.jumps.down for surface in (found, whole))
    near = binary_dilation(ours, np.ones((3, 3)))
    assert np.count_nonzero(theirs & near) > 0.95 * np.count_nonzero(theirs)


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(0.7, 0.98), st.sampled_from([32, 40, 64]))
def test_any_mask_has_the_surface_of_the_whole(tmp_path_factory, seed, share, rows):
    random = np.random.default_rng(seed)
    size = (136, 40)
    mask = random.random(size) < share
    normal_map = waves(0, mask, size)
    _, _, error = compared(tmp_path_factory.mktemp("mask"), normal_map, rows=rows)
    assert error < LIMIT


@given(st.integers(1, 5000), st.integers(1, 3000))
def test_blocks_cover_all_rows_once(height, rows):
    blocks, halo = plan_blocks(height, rows)
    assert [row for block in blocks for row in (block.core.start, block.core.stop)] == sorted(
        [0, height, *[block.core.start for block in blocks[1:]] * 2]
    )
    assert halo % CELL == 0
    assert all(block.core.start % CELL == 0 for block in blocks)
    for upper, lower in pairwise(blocks):
        assert upper.rows.stop == upper.core.stop + halo <= height
        assert lower.rows.start == lower.core.start - halo >= 0
        assert min(upper.core.stop - upper.core.start, lower.core.stop - lower.core.start) >= (
            2 * halo
        )


def test_the_residual_of_a_blend_is_that_of_its_laplacian():
    random = np.random.default_rng(5)
    share, down = np.linspace(1, 0, 16), random.random((16, 5)).astype(np.float32)
    upper, lower = random.normal(size=(2, 16, 5))
    seam = Seam(slice(0, 16), share, down, upper - lower)

    def laplacian(u):
        flow = down[:-1] * np.diff(u, axis=0)
        return np.pad(flow, ((1, 0), (0, 0))) - np.pad(flow, ((0, 1), (0, 0)))

    weight = share[:, None]
    blend = weight * upper + (1 - weight) * lower
    # Both solutions satisfy the equations of the whole: L upper = L lower = b.
    expected = weight * laplacian(upper) + (1 - weight) * laplacian(lower) - laplacian(blend)
    np.testing.assert_allclose(seam.residual(upper - lower), expected, atol=1e-12)


def test_constants_join_parts_of_blocks():
    upper = Side(np.array([[1.0, 5.0, 0]]), np.array([[0, 1, -1]], np.int32))
    lower = Side(np.array([[3.0, 3.0, 0]]), np.array([[2, 2, 3]], np.int32))
    parts = LocalParts(4, meeting_of(upper, lower))
    np.testing.assert_allclose(parts.constants(), [0, -4, -2, 0])
    joined, count = parts.joined()
    assert (list(joined), count) == ([0, 0, 0, 1], 2)


BAD: dict[str, tuple[Callable[[], dict], type[Exception], str]] = {
    "mask": (lambda: {"mask": np.zeros(SIZE, bool)}, DataError, "empty mask"),
    "depth": (lambda: {"depth_mm": np.ones(SIZE)}, DataError, "require a camera"),
    "no depth": (
        lambda: {"depth_mm": np.full(SIZE, np.nan), "pixel_mm": 1},
        DataError,
        "must be finite",
    ),
    "sigma": (lambda: {"sigma_deg": np.full(SIZE, -1.0)}, DataError, "negative or infinite"),
    "sigma size": (lambda: {"sigma_deg": np.ones((2, 2))}, DataError, "do not fit normals"),
    "edges": (lambda: {"mask": np.eye(*SIZE, dtype=bool)}, EstimateError, "face the camera"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_does_not_fit_is_refused(tmp_path, name):
    changed, kind, message = BAD[name]
    options = {"mask": np.ones(SIZE, bool), **changed()}
    mask = options.pop("mask")
    given = SimpleNamespace(normals=waves().normals * mask[..., None], mask=mask)
    with opened(tmp_path) as store, pytest.raises(kind, match=message):
        integrate_in_blocks(given, store, rows=48, **options)


def test_blocks_that_do_not_fit_together_are_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("processing.surface.blocks.corrections._MOST_ROUNDS", 0)
    mirrored = NormalMap(waves().normals * np.float32([1, -1, 1]), np.ones(SIZE, bool))
    with opened(tmp_path) as store:
        found = integrate_in_blocks(mirrored, store, rows=48)
        lowest, highest = found.extremes
    assert found.blocks.error > LIMIT * (highest - lowest)
    notice = next(n for n in found.warnings if n.code == "blocks-not-settled")
    assert "use more memory" in notice.text


def halved(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


@pytest.mark.parametrize("damage", [deleted, halved, flipped], ids=lambda one: one.__name__)
@pytest.mark.parametrize(
    "name", ["solution-0-1.raw", "labels-3.raw", "weights.raw", "step-free-2.npz"]
)
def test_a_part_that_was_changed_meanwhile_is_named(tmp_path, monkeypatch, name, damage):
    """The process is stopped in the first round."""
    normal_map, complete = waves(2), BlockFiles.complete

    def stopped(files, step, **record):
        if step == "change-0-1":
            raise KeyboardInterrupt
        return complete(files, step, **record)

    with monkeypatch.context() as patched, opened(tmp_path) as store:
        patched.setattr(BlockFiles, "complete", stopped)
        with pytest.raises(KeyboardInterrupt):
            integrate_in_blocks(normal_map, store, rows=48)
        damage(store.folder / name)
    with opened(tmp_path / "whole") as store:
        whole = integrate_in_blocks(normal_map, store, rows=48).height
    with opened(tmp_path) as store:
        if (name, damage) != ("step-free-2.npz", deleted):  # a step is repeated instead
            with pytest.raises(DamagedMapsError, match=f"{name}: "):
                integrate_in_blocks(normal_map, store, rows=48)
        again = integrate_in_blocks(normal_map, store, rows=48, replace=True)
        np.testing.assert_array_equal(again.height, whole)
