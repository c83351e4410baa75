"""`sgp report` of a comparison with `--register`: before and after, and what has changed."""

from __future__ import annotations

import re

import numpy as np
import pytest

from processing import read_normals
from rig import MAX_PIXELS
from sgp.report import FolderMaps, embed, make_report, read_folder
from sgp.report.maps import embed_beside
from tests.sgp.chromium import MISSING, PROGRAM
from tests.sgp.report_folder import shaded
from tests.sgp.test_cli_changes import compare, recorded  # noqa: F401
from tests.sgp.test_cli_report import report_of
from tests.sgp.test_report_page import FRAME, at_map, opened, pixels, quiet

LIGHT = (180, 35)
# Where the loss was planted.
ROW, COLUMN = 80, 150


def cells(html):
    """Return the texts of the tables of changes."""
    tables = re.findall(r'<table class="changes">(.*?)</table>', html)
    return [re.findall(r"<td>(.*?)</td>", table) for table in tables]


def test_the_page_has_the_planted_change_and_the_smallest_that_would_be_found(sgp, recorded):  # noqa: F811
    compare(sgp, recorded, "lost", "--significance", "--pixel-mm", "0.05").ok()
    html = make_report([recorded / "out"], max_pixels=MAX_PIXELS).html
    after, before = report_of(html)["results"]
    assert (after["name"], before["name"]) == ("After: lost", "Before: before")
    assert (after["pixelSize"], after["unit"]) == (0.05, "mm")
    assert {"change_height", "normals_deg", "change_significance", "significant"} <= {
        plane["name"] for plane in after["planes"]
    }
    (height,) = (plane for plane in after["planes"] if plane["name"] == "change_height")
    # The scale is that of the changes, though these are less than 0.5 % of the map.
    assert height["unit"] == "mm"
    assert height["shown"] == [pytest.approx(-0.015, rel=0.4), pytest.approx(0.015, rel=0.4)]
    changes, levels = cells(html)
    column, row = map(int, changes[1].split(", "))
    assert (column, row) == pytest.approx((COLUMN, ROW), abs=2)
    depth, deviation = map(float, changes[6].split(" ± "))
    assert abs(depth + 0.3 * 0.05) < deviation < 0.006
    assert len(levels) == 4 * 3
    assert "1 significant change," in html


def test_without_a_change_the_page_states_what_would_be_found(sgp, recorded):  # noqa: F811
    compare(sgp, recorded, "same", "--significance").ok()
    html = make_report([recorded / "out"], max_pixels=MAX_PIXELS).html
    (levels,) = cells(html)
    assert len(levels) == 4 * 3
    assert "0 significant changes," in html
    (recorded / "out" / "changes.csv").write_text("number\n1\n")
    damaged = make_report([recorded / "out"], max_pixels=MAX_PIXELS).html
    assert "changes.csv is missing or damaged" in damaged


def test_without_significance_the_page_says_so(sgp, recorded):  # noqa: F811
    compare(sgp, recorded, "bare").ok()
    html = make_report([recorded / "out"], max_pixels=MAX_PIXELS).html
    assert "Significance was not computed" in html
    assert cells(html) == []


@pytest.mark.skipif(PROGRAM is None, reason=MISSING)
def test_the_divider_shows_before_and_after_registered(sgp, browser, recorded):  # noqa: F811
    compare(sgp, recorded, "lost", "--significance", "--pixel-mm", "0.05").ok()
    page = recorded / "page.html"
    sgp("report", recorded / "out", "--out", page).ok()
    maps = embed(FolderMaps(read_folder(recorded / "out"), MAX_PIXELS), 1e6)
    before = read_normals(recorded / "before").normal_map
    beside = embed_beside(before.normals, before.mask, maps, 1e6)
    opened(browser, page)
    browser.value(f"location.hash = 'zoom=1&light={LIGHT[0]},{LIGHT[1]}'")
    browser.until("document.querySelector('.status').textContent.includes('180°')")
    assert browser.value("document.querySelector('.divider').getClientRects().length") == 1
    names = browser.value("[...document.querySelectorAll('.stage .name')].map((e) => e.innerText)")
    assert [name.split()[:2] for name in names] == [["Before:", "before"], ["After:", "lost"]]
    browser.value(FRAME)
    outlined = at_map(pixels(browser), maps.size)[..., :3].astype(int)
    browser.value(
        "[...document.querySelectorAll('label')]"
        ".find((one) => one.textContent.includes('outline significant')).click()"
    )
    browser.value(FRAME)
    found = at_map(pixels(browser), maps.size)[..., :3].astype(int)
    first, second = (shaded(one.planes, "matte", LIGHT) for one in (beside, maps))
    known = maps.planes["normals"].samples[..., 0] > 0
    middle = maps.size[1] // 2
    for part, expected in (
        (np.s_[:, : middle - 2], first),
        (np.s_[:, middle + 2 :], second),
    ):
        assert np.abs(found - expected)[part][known[part]].max() <= 2
    # Normals of the same place: three pixels apart before the registration.
    still = np.s_[120:180, 20:240]
    assert np.abs(first[still] - second[still]).mean() < 3
    # The wall away from the light from the left is darker: sunk, not raised.
    row, column = ROW - maps.crop.rows.start, COLUMN - maps.crop.columns.start
    step = (second - first)[row - 2 : row + 3, :, 0].mean(axis=0)
    assert step[column - 4 : column].mean() < -2
    assert step[column + 1 : column + 5].mean() > 2
    # The outline goes around the loss.
    line = np.argwhere(np.abs(outlined - found).max(axis=2) > 20)
    assert len(line) > 20
    assert np.abs(line.mean(axis=0) - (row, column)).max() < 3
    assert np.hypot(*(line - (row, column)).T).min() > 3
    quiet(browser, page)
