"""Deviations of differences in height, from the record to the page."""

from __future__ import annotations

import json

import pytest

from sgp._report.differences import height_differences
from sgp._report.folder import read_folder
from tests.sgp.report_folder import PIXEL_MM, write_folder


def test_recorded_deviations_have_distances_in_the_unit(tmp_path):
    folder = write_folder(tmp_path / "ball")
    assert height_differences(read_folder(folder)) is None
    path = folder / "surface.json"
    record = json.loads(path.read_text())
    sigma = [0.01, 0.02, 0.04]
    for distances, found in (
        ([1, 2, 5], [PIXEL_MM, 2 * PIXEL_MM, 5 * PIXEL_MM]),
        ([1, 2], None),
        ([], None),
    ):
        record["metrics"] |= {"difference_distances_px": distances, "difference_sigma": sigma}
        path.write_text(json.dumps(record))
        differences = height_differences(read_folder(folder))
        if found is None:
            assert differences is None
        else:
            assert differences == {"distances": pytest.approx(found), "sigma": sigma}
