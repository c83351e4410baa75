"""The documented accuracy on real captures, measured with the commands of the documents."""

import json

import numpy as np
import pytest

from acquisition import angle_deg, read_image, read_lights, read_mask
from processing import read_normals
from tests.real_data import DATA, needs_data

pytestmark = needs_data


@pytest.mark.parametrize(
    ("name", "method", "low", "high"),
    [
        pytest.param("bearPNG", "ls", 8.34, 8.44, id="bear ls", marks=pytest.mark.slow),
        pytest.param("bearPNG", "cauchy", 0.0, 6.4, id="bear cauchy", marks=pytest.mark.slow),
        pytest.param("catPNG", "cauchy", 0.0, 7.2, id="cat cauchy", marks=pytest.mark.slow),
    ],
)
def test_diligent_against_ground_truth(sgp, tmp_path, name, method, low, high):
    metrics = sgp(
        "normals", DATA / "diligent" / name, "--method", method, "--out", tmp_path, "--json"
    ).figures()
    assert low <= metrics["mae_deg"] <= high
    assert metrics["coverage"] == 1.0


@pytest.mark.slow
def test_a_chrome_ball_gives_lights_in_front_of_the_object(uw_lights):
    lights = read_lights(uw_lights)
    assert len(lights) == 12
    assert not lights.near
    assert lights.unit_directions[:, 2].min() > 0.5
    record = json.loads(uw_lights.read_text(encoding="utf-8"))
    assert len(record["provenance"]["inputs"]) >= 12
    assert uw_lights.with_suffix(".lp").read_text(encoding="utf-8").startswith("12\n")


@pytest.mark.slow
def test_buddha_is_raised_right_is_red_and_up_is_green(sgp, uw_lights, tmp_path):
    sgp("run", DATA / "uw" / "buddha", "--lights", uw_lights, "--out", tmp_path).ok()
    assert (tmp_path / "overview.png").stat().st_size > 50_000
    mask = read_mask(tmp_path / "normals" / "mask.png")
    colours = read_image(tmp_path / "normals" / "normals.png").astype(float) / 65535
    rows, columns = np.nonzero(mask)
    # The normals of a raised object point right on its right side and up at its top.
    right = columns > np.quantile(columns, 0.9)
    left = columns < np.quantile(columns, 0.1)
    top, bottom = rows < np.quantile(rows, 0.05), rows > np.quantile(rows, 0.3)
    red, green = colours[rows, columns, 0], colours[rows, columns, 1]
    assert red[right].mean() > 0.6 > 0.4 > red[left].mean()
    assert green[top].mean() > green[bottom].mean()
    # In each row, the middle of the figure is higher than its two edges.
    height = read_image(tmp_path / "surface" / "height.exr")
    steps = []
    for row in range(rows.min() + 30, rows.max() - 30, 10):
        inside = np.flatnonzero(mask[row])
        edges = height[row, [inside[1], inside[-2]]].mean()
        steps.append(height[row, inside[len(inside) // 2]] - edges)
    assert np.median(steps) > 10
    assert np.mean(np.array(steps) > 0) > 0.9
    seconds = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["metrics"]
    assert set(seconds["seconds"]) >= {"normals", "detail", "surface"}


@pytest.mark.slow
def test_gray_ball_agrees_with_its_geometry(sgp, uw_lights, tmp_path):
    """The truth is the ball's outline, an ellipse since the pixels are not square."""
    sgp("normals", DATA / "uw" / "gray", "--lights", uw_lights, "--out", tmp_path).ok()
    found = read_normals(tmp_path).normal_map
    mask = read_mask(DATA / "uw" / "gray" / "gray.mask.tga")
    rows, columns = np.nonzero(mask)
    a, b = (np.ptp(columns) + 1) / 2, (np.ptp(rows) + 1) / 2
    x = (columns - (columns.min() + columns.max()) / 2) / a
    y = -(rows - (rows.min() + rows.max()) / 2) / b
    inside = x**2 + y**2 < 1
    z = np.sqrt(1 - x[inside] ** 2 - y[inside] ** 2)
    truth = np.stack([x[inside], y[inside], z], axis=1)
    error = angle_deg(found.normals[rows[inside], columns[inside]], truth)
    assert error.mean() <= 6.0
    assert error[z > 0.3].mean() <= 5.0


def test_a_raw_file_is_imported_with_its_colour_filter(sgp, tmp_path):
    out = tmp_path / "session"
    raw = DATA / "raw" / "RAW_KODAK_DC50.KDC"
    camera = sgp("capture", "import", raw, "--out", out, "--json").figures()["camera"]
    assert camera["cfa"] == "GRBG"
    (frame,) = (out / "frames").iterdir()
    pixels = read_image(frame)
    assert pixels.dtype == np.uint16
    assert pixels.shape == (512, 768)
    assert sgp("capture", "verify", out).code == 0
