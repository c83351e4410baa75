"""Super-resolution in bands of rows, in files: equal to that in memory."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from acquisition import BandStore, DataError, OtherMapsError
from processing import (
    NormalMap,
    least_memory_of_super_resolution,
    memory_of_super_resolution,
    read_superres_model,
    super_resolve,
    super_resolve_on_disk,
    write_normals,
)
from processing._superres import enlargement, median

SIZE = (80, 9)


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles as small as the halo of the network allows: three rows of them."""
    monkeypatch.setattr(enlargement, "TILE_PX", 16)


def rough(height: int, width: int) -> NormalMap:
    """Return rough waves with a hole, of which the first rows are empty."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    noise = np.random.default_rng(905).normal(0, 0.2, (2, height, width))
    slopes = np.sin(x / 3) * 0.4 + noise[0], np.cos(y / 5) * 0.3 + noise[1]
    mask = (y > height // 9) & ~((abs(x - 5) < 2) & (abs(y - 40) < 9))
    mask |= height * width < 99
    return NormalMap.from_vectors(np.dstack([*slopes, np.ones_like(x)]), mask)


def check_equal(found, expected) -> None:
    high = expected.normal_map
    np.testing.assert_array_equal(found.mask, high.mask)
    np.testing.assert_array_equal(found.normals[:], high.normals)
    np.testing.assert_array_equal(found.added_deg[:], expected.added_deg)
    np.testing.assert_array_equal(found.invented[:], expected.invented)
    if expected.sigma_deg is None:
        assert found.sigma_deg is None
        assert np.isnan(found.median_sigma_deg)
    else:
        np.testing.assert_array_equal(found.sigma_deg[:], expected.sigma_deg)
        assert found.median_sigma_deg == expected.median_sigma_deg
    for name in ("invented_share", "mean_added_deg", "method", "scale", "self_ensemble"):
        assert getattr(found, name) == getattr(expected, name), name


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"scale": 4}, id="eight copies"),
        pytest.param({"scale": 2, "sampling": "points"}, id="points"),
        pytest.param({"scale": 4, "method": "bicubic"}, id="bicubic"),
        pytest.param({"scale": 2, "domain": "normals"}, id="normals"),
    ],
)
def test_bands_are_equal_to_the_whole(tmp_path: Path, options) -> None:
    scale, low = options.pop("scale"), rough(*SIZE)
    if domain := options.pop("domain", None):
        options["model"] = dataclasses.replace(read_superres_model(None, scale), domain=domain)
    write_normals(tmp_path / "low", low)
    expected, steps = super_resolve(low, scale, **options), []
    found = super_resolve_on_disk(
        tmp_path / "low",
        tmp_path / "high",
        scale,
        identity={},
        on_progress=lambda *step: steps.append(step[1:]),
        **options,
    )
    with found.store:
        check_equal(found, expected)
        assert len(found.store.done) >= 3
        count = len(steps) - 1
        assert steps == [(done, count) for done in range(count + 1)]
        assert repr(found).startswith(f"StoredSuperResolution({9 * scale} x {80 * scale} px, ")


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 3)])
def test_maps_smaller_than_a_window(tmp_path: Path, size) -> None:
    low = rough(*size)
    write_normals(tmp_path / "low", low)
    found = super_resolve_on_disk(tmp_path / "low", tmp_path / "high", 2, identity={})
    with found.store:
        check_equal(found, super_resolve(low, 2))


def test_what_is_complete_is_not_computed_again(tmp_path: Path, monkeypatch) -> None:
    write_normals(tmp_path / "low", rough(*SIZE))
    given, target = tmp_path / "low", tmp_path / "out" / "high"
    options = {"identity": {"a": 1}, "method": "bicubic"}
    complete = BandStore.complete

    for wanted in (0, 2, 3):

        def stopped(store: BandStore, rows: slice, wanted: int = wanted) -> None:
            if len(store.done) == wanted:
                raise KeyboardInterrupt
            complete(store, rows)

        with monkeypatch.context() as patched:
            patched.setattr(BandStore, "complete", stopped)
            with pytest.raises(KeyboardInterrupt):
                super_resolve_on_disk(given, target, 2, **options)
        assert target.parent.exists() == bool(wanted)
    with pytest.raises(OtherMapsError, match="differs in a"):
        super_resolve_on_disk(given, target, 2, **options | {"identity": {"a": 2}})
    steps = []
    found = super_resolve_on_disk(
        given, target, 2, **options, on_progress=lambda *step: steps.append(step[1:])
    )
    with found.store:
        assert steps[0] == (3, steps[0][1])
        assert len(found.store.done) == len(set(map(str, found.store.done)))
        check_equal(found, super_resolve(rough(*SIZE), 2, method="bicubic"))


def test_a_result_that_is_too_large_leaves_nothing(tmp_path: Path) -> None:
    write_normals(tmp_path / "low", rough(*SIZE))
    with pytest.raises(DataError, match="18 x 160, 99 are allowed"):
        super_resolve_on_disk(
            tmp_path / "low", tmp_path / "out" / "high", 2, identity={}, most_enlarged=99
        )
    assert not (tmp_path / "out").exists()


def test_the_median_is_that_of_all_values(monkeypatch) -> None:
    monkeypatch.setattr(median, "_READ", 40)
    random = np.random.default_rng(906)
    for shape in ((1, 1), (1, 2), (9, 21), (30, 10)):
        for values in (random.lognormal(0, 3, shape), random.integers(0, 4, shape)):
            found, mask = values.astype(np.float32), random.random(shape) < 0.7
            mask[0, 0] = True
            found[~mask] = np.nan
            assert median.median_of_rows(found, mask) == float(np.median(found[mask]))


def test_files_need_less_memory_than_arrays() -> None:
    for size in ((3000, 4000), (10000, 2500)):
        for scale in (2, 4):
            least = least_memory_of_super_resolution(size, scale)
            assert least < memory_of_super_resolution(size, scale) / 2
