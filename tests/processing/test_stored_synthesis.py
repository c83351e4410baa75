"""Sheets in files, which are those in memory, also after interruptions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from acquisition import BandStore, DataError
from processing import NormalMap, synthesize, synthesize_on_disk
from processing._synthesis.spectrum_match import matching_kernel
from tests.quick_sample import quick

# Sizes of sheets and options; strips have 16 rows of patches.
CASES: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {
    "three strips, two bands": ((550, 130), {"patch": 16}),
    "for tiling": ((550, 120), {"patch": 16, "tileable": True}),
    "for tiling, one strip": ((150, 130), {"patch": 16, "tileable": True}),
    "turned and mirrored": ((300, 110), {"patch": 12, "rotate": True, "mirror": True}),
    "too small to be filtered": ((90, 70), {"patch": 16}),
    "one row": ((1, 70), {"patch": 16}),
}


@pytest.fixture(scope="module")
def exemplar() -> NormalMap:
    """Return smooth bumps, so that cuts between patches are seen."""
    height = cv2.GaussianBlur(np.random.default_rng(2).normal(size=(96, 90)), (0, 0), 2.0)
    dy, dx = np.gradient(height)
    return NormalMap.from_vectors(np.dstack([-8 * dx, 8 * dy, np.ones(height.shape)]))


@pytest.mark.parametrize(("size", "options"), quick(CASES.values(), every=2), ids=CASES)
def test_a_sheet_in_files_is_that_in_memory(
    exemplar: NormalMap, tmp_path: Path, size: tuple[int, int], options: dict[str, Any]
) -> None:
    whole = synthesize(exemplar, size, seed=4, **options)
    stored = synthesize_on_disk(
        exemplar, size, tmp_path / "out" / "map", identity={}, seed=4, **options
    )
    with stored.store:
        np.testing.assert_array_equal(stored.normals[:], whole.detail.normals)
        np.testing.assert_array_equal(stored.labels[:], whole.labels)
        np.testing.assert_equal(stored.steps, whole.steps)
        assert (stored.middle().normals == whole.detail.normals).all()
        assert f"{size[1]} x {size[0]} px" in repr(stored)
        stored.store.remove()


def test_cuts_and_spectrum_of_these_sheets_are_corrected(exemplar: NormalMap, monkeypatch) -> None:
    """Otherwise the cases above would not show that the corrections are equal."""
    quilting = "processing._synthesis.quilting."
    with monkeypatch.context() as patched:
        patched.setattr(f"{quilting}match_spectrum", lambda *_, **__: None)
        soft = synthesize(exemplar, (550, 130), patch=16).detail.normals
        patched.setattr(f"{quilting}soften_cuts", lambda *_, **__: None)
        plain = synthesize(exemplar, (550, 130), patch=16).detail.normals
    assert (soft != plain).any(axis=2).mean() > 0.02
    kernel = matching_kernel(soft, exemplar)
    assert kernel is not None
    assert np.abs(kernel).sum() > 1.01


@pytest.mark.parametrize(
    "options", quick([{"tileable": True}, {}], every=2), ids=["for tiling", ""]
)
def test_a_sheet_continues_after_each_step(
    exemplar: NormalMap, tmp_path: Path, monkeypatch, options: dict[str, Any]
) -> None:
    """Stopped before each step is named, which leaves its rows half written or complete."""
    given: dict[str, Any] = {"patch": 16, "seed": 1, **options}
    whole = synthesize(exemplar, (550, 120), **given)
    complete = BandStore.complete
    done: list[slice] = []

    def once(store: BandStore, rows: slice) -> None:
        if stopped:
            raise KeyboardInterrupt
        stopped.append(rows)
        complete(store, rows)
        done.append(rows)

    monkeypatch.setattr(BandStore, "complete", once)
    while True:
        stopped: list[slice] = []
        try:
            made = synthesize_on_disk(
                exemplar, (550, 120), tmp_path / "out" / "map", identity={}, **given
            )
            break
        except KeyboardInterrupt:
            assert stopped
    with made.store:
        np.testing.assert_array_equal(made.normals[:], whole.detail.normals)
        np.testing.assert_array_equal(made.labels[:], whole.labels)
    assert done == [slice(step, step + 1) for step in range(len(done))]
    assert len(done) > 7


def test_what_is_refused_in_memory_is_refused(exemplar: NormalMap, tmp_path: Path) -> None:
    cases: list[tuple[tuple[int, int], dict[str, Any]]] = [
        ((0, 9), {}),
        ((90, 90), {"patch": 200}),
        ((90, 90), {"overlap": 40}),
        ((20, 90), {"tileable": True}),
        ((90, 90), {"seed": -1}),
    ]
    for size, options in cases:
        with pytest.raises(DataError) as whole:
            synthesize(exemplar, size, **options)
        with pytest.raises(DataError) as stored:
            synthesize_on_disk(exemplar, size, tmp_path / "out" / "m", identity={}, **options)
        assert str(stored.value) == str(whole.value)
        assert not (tmp_path / "out").exists()
