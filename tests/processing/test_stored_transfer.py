"""Transfers of detail in bands of rows, which are those of the whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from acquisition import DataError
from processing import (
    NormalMap,
    ShapeFilter,
    TransferFigures,
    least_memory_of_transfer,
    read_normals,
    ssim,
    transfer,
    transfer_on_disk,
    write_normals,
)
from processing._detail import rows
from tests.quick_sample import quick

TARGET = (250, 90)
Mask = npt.NDArray[np.bool_]


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, and bands are small."""
    monkeypatch.setattr(rows, "_FIXED", 0)
    monkeypatch.setattr(rows, "_MOST_MARGINS", 0)
    monkeypatch.setattr(rows, "_MOST_ROWS", 40)


def rough(size: tuple[int, int], seed: int, mask: Mask | None = None) -> NormalMap:
    """Waves with noise."""
    y, x = np.mgrid[: size[0], : size[1]]
    noise = np.random.default_rng(seed).normal(0, 0.1, (2, *size))
    slopes = 0.4 * np.sin(x / 7) + noise[0], 0.3 * np.cos(y / 9) + noise[1]
    return NormalMap.from_vectors(np.dstack([*slopes, np.ones(size)]), mask)


def with_hole() -> Mask:
    """An ellipse with a hole; the first and last rows are empty."""
    y, x = np.mgrid[: TARGET[0], : TARGET[1]]
    ellipse = ((x - 45) / 43) ** 2 + ((y - 120) / 115) ** 2 < 1
    return np.asarray(ellipse & ((x - 40) ** 2 + (y - 110) ** 2 > 150))


def corner_missing(size: tuple[int, int]) -> Mask:
    mask = np.ones(size, np.bool_)
    mask[:5, :9] = mask[-3:, -5:] = False
    return mask


CASES: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {
    "cut both ways": ((61, 37), {}),
    "cut across": ((300, 37), {}),
    "cut downwards": ((40, 120), {}),
    "copies of more rows than a band": ((110, 60), {}),
    "plain": ((61, 37), {"tile": "plain"}),
    "mirrored": ((61, 37), {"tile": "mirror", "amplitude": -0.7}),
    "larger source": ((330, 130), {}),
    "no detail": ((61, 37), {"amplitude": 0.0}),
    "put above and left": ((100, 60), {"at": (-20, -30)}),
    "put at the end": ((100, 60), {"at": (50, 190), "keep_target_detail": True}),
    "one correction": ((61, 37), {"refine": 1}),
    "two corrections": ((61, 37), {"refine": 2, "at": (10, 30)}),
    "three corrections": ((61, 37), {"refine": 3, "keep_target_detail": True}),
    "paper's filter": ((61, 37), {"shape_filter": ShapeFilter(order=1)}),
    "box": ((61, 37), {"shape_filter": ShapeFilter("box", 1, 4), "refine": 1}),
    "guided": ((61, 37), {"shape_filter": ShapeFilter("guided", 1, 4)}),
    "bilateral": ((61, 37), {"shape_filter": ShapeFilter("bilateral", 1, 3), "refine": 1}),
}


@pytest.mark.parametrize(("size", "options"), quick(CASES.values(), every=6), ids=CASES)
def test_bands_are_the_whole(
    tmp_path: Path, size: tuple[int, int], options: dict[str, Any]
) -> None:
    given = {"shape_filter": ShapeFilter(order=2, w=3), **options}
    write_normals(tmp_path / "source", rough(size, 1, corner_missing(size)))
    write_normals(tmp_path / "target", rough(TARGET, 2, with_hole()))
    source, target = (read_normals(tmp_path / name).normal_map for name in ("source", "target"))
    whole = transfer(source, target, **given)
    least = least_memory_of_transfer(size, TARGET, given["shape_filter"])
    steps: list[int] = []
    stored = transfer_on_disk(
        tmp_path / "source", tmp_path / "target", tmp_path / "out" / "map",
        memory=least + 60_000 + 40 * size[0] * size[1], identity={},
        on_progress=lambda stage, done, total: steps.append(done), **given,
    )  # fmt: skip
    with stored.store:
        assert len(steps) > 10
        assert steps == sorted(steps)
        assert (stored.normals[:] == whole.normal_map.normals).all()
        assert (stored.target.mask == target.mask).all()
        own, paper = whole.fidelity, whole.fidelity_paper
        for name in ("shape_error_deg", "detail_error_deg"):
            found = getattr(stored, name)[:]
            np.testing.assert_array_equal(found, getattr(own, name))
        pairs = (own.result.shape, own.shape), (own.result.detail, own.detail)
        similar = [
            value
            for pair in pairs
            for value in (ssim(*pair, own.detail.mask), ssim(*pair, protocol="paper"))
        ]
        expected = TransferFigures(
            own.shape_mae_deg, own.detail_mae_deg, paper.shape_mae_deg, paper.detail_mae_deg,
            *similar, stored.figures.seam, int(own.detail.mask.sum()),
        )  # fmt: skip
        assert stored.figures == expected
        if whole.placement.tiles != (1, 1):
            assert stored.figures.seam == whole.seam
        window = stored.placement.source_window, stored.placement.tiles
        assert window == (whole.placement.source_window, whole.placement.tiles)
        stored.store.remove()


def test_what_the_whole_refuses_is_refused(tmp_path: Path) -> None:
    write_normals(tmp_path / "source", rough((61, 37), 1))
    write_normals(tmp_path / "target", rough(TARGET, 2))
    paths = tmp_path / "source", tmp_path / "target", tmp_path / "out" / "map"
    maps = [read_normals(path).normal_map for path in paths[:2]]
    for options in (
        {"at": (500, 0)}, {"refine": -1}, {"amplitude": float("inf")}, {"tile": "round"},
        {"shape_filter": ShapeFilter(w=30)},
    ):  # fmt: skip
        with pytest.raises(DataError) as whole:
            transfer(*maps, **options)  # type: ignore[arg-type]
        with pytest.raises(DataError) as banded:
            transfer_on_disk(*paths, memory=10**9, identity={}, **options)  # type: ignore[arg-type]
        assert str(banded.value) == str(whole.value)
        assert not (tmp_path / "out").exists()


def test_a_rectangle_that_is_too_large_to_be_cut(tmp_path: Path) -> None:
    write_normals(tmp_path / "source", rough((200, 80), 1))
    write_normals(tmp_path / "target", rough(TARGET, 2))
    paths = tmp_path / "source", tmp_path / "target", tmp_path / "out" / "map"
    by = ShapeFilter(order=1, w=1)
    least = least_memory_of_transfer((200, 80), TARGET, by)
    given: dict[str, Any] = {"memory": least, "identity": {}, "shape_filter": by}
    with pytest.raises(DataError, match="80 x 200 pixels that are joined along cuts need"):
        transfer_on_disk(*paths, **given)
    assert not (tmp_path / "out").exists()
    made = transfer_on_disk(*paths, tile="plain", **given)
    with made.store:
        assert "StoredTransfer(90 x 250 px" in repr(made)
