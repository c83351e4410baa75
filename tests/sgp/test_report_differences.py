"""What records state for measuring, on the page: deviations, the camera, jumps."""

from __future__ import annotations

import json

import numpy as np
import pytest

from acquisition import CameraModel
from processing import NormalMap, integrate
from rig import MAX_PIXELS
from sgp.pictures import Crop
from sgp.report import FolderMaps, embed, read_folder
from sgp.report.maps import camera_of, height_differences, jumps_plane
from sgp.results import write_record
from sgp.stages import SurfaceOptions
from sgp.stages.write_surface import write_surface
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


@pytest.mark.parametrize("most_pixels", [1e6, 500])
def test_the_camera_of_a_surface_is_that_of_its_points(tmp_path, most_pixels):
    """X = axis + (x - axis) (1 - z / distance) for each pixel, as the page computes it."""
    size = (40, 60)
    rows, columns = np.mgrid[: size[0], : size[1]]
    mask = (columns > 12) & (rows < 33)
    slopes = np.stack([0.3 * np.sin(columns / 9), 0.2 * np.cos(rows / 7), 0 * rows + 1], -1)
    normal_map = NormalMap.from_vectors(slopes, mask)
    K = [[150, 0, 22.0], [0, 150, 25.5], [0, 0, 1]]
    camera = CameraModel(K=K, width=60, height=40, working_distance_mm=300)
    surface = integrate(normal_map, camera=camera)
    result = write_surface(tmp_path, surface, normal_map, SurfaceOptions())
    write_record(tmp_path / "surface.json", "sgp surface", {}, result)
    folder = read_folder(tmp_path)
    maps = embed(FolderMaps(folder, MAX_PIXELS), most_pixels)
    found = camera_of(folder, maps)
    points = surface.points()
    step = maps.pixel_size / maps.crop.step
    x = (columns - (maps.crop.columns.start + maps.crop.columns.stop - 1) / 2) * step
    y = ((maps.crop.rows.start + maps.crop.rows.stop - 1) / 2 - rows) * step
    share = 1 - surface.height / found["distance"]
    for axis, place in enumerate((x, y)):
        seen = found["axis"][axis] + (place - found["axis"][axis]) * share
        shift = (seen - points[..., axis])[surface.mask]
        assert np.ptp(shift) < 1e-3
    assert np.ptp(surface.height[surface.mask]) > 5


def test_jumps_of_reduced_maps_are_between_the_pixels_around_them():
    values = np.zeros((40, 60), np.uint8)
    values[:, 31] = 85  # between columns 31 and 32
    values[17, 10:] += 170
    values[20, 5] = 255  # one pixel of many
    whole = Crop(slice(0, 40), slice(0, 60))
    for size in ((40, 60), (10, 15), (8, 12)):
        found = jumps_plane(values, whole, size).samples[..., 0]
        step = 40 // size[0]
        expected = np.zeros(size, np.uint8)
        expected[:, int((32 / step) - 0.5)] = 1
        expected[int(18 / step - 0.5), round(10 / step) :] += 2
        if step == 1:
            expected[20, 5] = 3
        np.testing.assert_array_equal(found, expected, err_msg=str(size))
