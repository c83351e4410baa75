"""Roughness of a rectangle in the 3D view, against `sgp roughness`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import read_image, write_exr
from rig import MAX_PIXELS
from sgp.report import make_report
from tests.sgp.chromium import MISSING, PROGRAM
from tests.sgp.report_folder import PIXEL_MM, SIZE, write_folder
from tests.sgp.test_cli_report import report_of
from tests.sgp.test_report_page import quiet
from tests.sgp.test_report_surface3d import VIEW, figures, opened, press, typed

pytestmark = [pytest.mark.slow, pytest.mark.skipif(PROGRAM is None, reason=MISSING)]

NAMES = ("Sa", "Sq", "Sz", "Ssk", "Sku")


@pytest.fixture
def folder(tmp_path) -> Path:
    """A ball with a rough patch that has a hole, on which the rectangle is not in the middle."""
    folder = write_folder(tmp_path / "ball")
    height = read_image(folder / "height.exr")
    rng = np.random.default_rng(3)
    height += 0.02 * rng.standard_normal(SIZE).astype(np.float32) ** 2
    height[40:44, 50:55] = np.nan
    write_exr(folder / "height.exr", height)
    # The record has the hashes of the heights before.
    record = json.loads((folder / "surface.json").read_text())
    del record["files"], record["record_sha256"]
    (folder / "surface.json").write_text(json.dumps(record))
    return folder


def places(result: dict[str, Any], region: tuple[int, ...]) -> list[tuple[float, float]]:
    """Return the lower left and the upper right corner of a region on the page."""
    (left, top), (x, y, width, height) = result["roughness"]["origin"], region
    middle = (result["columns"] - 1) / 2, (result["rows"] - 1) / 2
    return [
        (PIXEL_MM * (column - left - middle[0]), PIXEL_MM * (middle[1] - row + top))
        for column, row in ((x, y + height - 1), (x + width - 1, y))
    ]


@pytest.mark.parametrize("region", [(35, 30, 31, 26), (30, 36, 24, 14)])
def test_a_rectangle_has_the_parameters_that_sgp_roughness_measures(
    sgp, browser, folder, tmp_path, region
):
    words = [f"--region={','.join(map(str, region))}", "--form=plane", "--l-mm=0"]
    stated = sgp("roughness", folder, *words, "--json").figures()["regions"][0]
    page = tmp_path / "page.html"
    sgp("report", folder, "--out", page).ok()
    (result,) = report_of(make_report([folder], max_pixels=MAX_PIXELS).html)["results"][:1]
    opened(browser, page)
    press(browser, "Rectangle")
    typed(browser, *places(result, region))
    found = figures(browser, tmp_path)[0]["roughness"]
    assert found["sFilter"] == stated["s_mm"]
    assert found["region"] == ",".join(map(str, region))
    measured = {one["name"]: one["measured"] for one in stated["parameters"]}
    # Steps of the embedded heights are 0.1 um.
    for name in NAMES:
        assert found[name] == pytest.approx(measured[name], rel=1e-3), name
    shown = browser.value(f"{VIEW}.querySelector('.marks').textContent")
    assert f"{measured['Sa']:.3g} µm" in shown
    assert f"S-filter {stated['s_mm']:g} mm, no L-filter, noise included" in shown
    quiet(browser, page)


def test_a_rectangle_that_is_too_small_says_so(sgp, browser, folder, tmp_path):
    page = tmp_path / "page.html"
    sgp("report", folder, "--out", page).ok()
    (result,) = report_of(make_report([folder], max_pixels=MAX_PIXELS).html)["results"][:1]
    opened(browser, page)
    press(browser, "Rectangle")
    typed(browser, *places(result, (45, 30, 3, 20)))
    shown = browser.value(f"{VIEW}.querySelector('.marks').textContent")
    assert "smaller than the S-filter 1 mm" in shown


def test_heights_in_pixels_have_no_roughness(folder):
    content = json.loads((folder / "surface.json").read_text())
    content["metrics"] |= {"unit": "px", "pixel_size": 1.0}
    (folder / "surface.json").write_text(json.dumps(content))
    (result, *_) = report_of(make_report([folder], max_pixels=MAX_PIXELS).html)["results"]
    assert result["roughness"] is None
