"""Images on disk that are solved in bands give the maps of images in memory, bit by bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from acquisition import Frame, read_source
from processing import Reconstruction, reconstruct
from processing.images import recorded_images
from processing.recording import pipeline as source_to_normals
from rig.arrays import AnyArray
from tests.processing.test_colours import recording
from tests.processing.test_reconstruct import session  # noqa: F401
from tests.quick_sample import quick


def arrays(result: Reconstruction) -> dict[str, Any]:
    """Return all maps of a reconstruction."""
    return {
        "mask": result.mask,
        "preview": result.previews[0],
        **{name: rows[:] for name, rows in result.maps.items()},
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distant", "law", "rows_of_sample"),
    [
        pytest.param(
            False, True, 10_000, id="near lights, all rows in the sample", marks=pytest.mark.slow
        ),
        pytest.param(True, False, 4, id="distant lights, unknown noise, some rows in the sample"),
    ],
)
def test_maps_do_not_depend_on_the_bands(
    session,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
    distant: bool,
    law: bool,
    rows_of_sample: int,
) -> None:
    source = read_source(session)
    if not law:
        source = replace(source, noise=None, mask=None)
    rows, columns = source.size
    of_row = 4 * len(source.light_ids) * columns
    sample = min(rows, 8 * rows_of_sample) * columns
    monkeypatch.setattr(recorded_images, "_SAMPLE", sample)
    whole = reconstruct(source, distant=distant, surface=False)
    monkeypatch.setattr(source_to_normals, "_IN_MEMORY", 0)
    for band in (rows, 50, 7):
        monkeypatch.setattr(recorded_images, "_BAND", band * of_row)
        banded = reconstruct(source, distant=distant, surface=False)
        expected = arrays(whole)
        for name, found in arrays(banded).items():
            np.testing.assert_array_equal(found, expected[name], err_msg=f"{name}, {band} rows")
        assert banded.warnings == whole.warnings


@pytest.mark.parametrize(
    ("channel", "law"),
    quick(
        [("rgb", False), pytest.param("joint", True, marks=pytest.mark.slow), ("joint", False)],
        every=3,
    ),
)
def test_maps_of_colours_do_not_depend_on_the_bands(
    monkeypatch: pytest.MonkeyPatch, channel: Literal["rgb", "joint"], law: bool
) -> None:
    """Red is saturated in some columns, and the first rows are black."""
    monkeypatch.setattr(Path, "exists", lambda self: True)  # the frames are arrays
    source = recording((0.8, 0.3, 0.1), noise=law, white=20)
    source = replace(source, frames=tuple(replace(f, load=black(f)) for f in source.frames))
    columns = source.size[1]
    monkeypatch.setattr(recorded_images, "_SAMPLE", 3 * 8 * columns)
    whole = reconstruct(source, method="cauchy", channel=channel, surface=False)
    assert not whole.normals.mask[:9].any()
    assert whole.normals.mask[9:].all()
    assert whole.uncertainty.valid[9:].all()
    monkeypatch.setattr(source_to_normals, "_IN_MEMORY", 0)
    monkeypatch.setattr(recorded_images, "_BAND", 7 * 3 * 4 * len(source.light_ids) * columns)
    banded = reconstruct(source, method="cauchy", channel=channel, surface=False)
    expected = arrays(whole)
    for name, found in arrays(banded).items():
        np.testing.assert_array_equal(found, expected[name], err_msg=name)
    assert banded.warnings == whole.warnings
    assert banded.uncertainty.neighbour_correlation == whole.uncertainty.neighbour_correlation


def black(frame: Frame) -> Callable[[], AnyArray]:
    """Return a loader of a frame whose first rows have no light."""

    def load() -> AnyArray:
        pixels = frame.load().copy()
        pixels[:9] = 0
        return pixels

    return load
