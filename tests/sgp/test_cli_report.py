"""``sgp report``: complete, unfinished and unreadable folders, the size of the page, its errors."""

import json
import re
import shutil

import numpy as np
import pytest

from acquisition import write_exr
from rig import MAX_PIXELS
from sgp.report import FolderMaps, embed, large_maps, make_report, read_folder
from sgp.report import maps as maps_module
from sgp.report import report as report_module
from sgp.report.scripts import asset
from tests.sgp.report_folder import SIZE, write_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("results") / "ball", source="nowhere")


def report_of(html: str) -> dict:
    """Return the data for the scripts of a page."""
    found = re.search(r'id="report">(.*?)</script>', html, re.DOTALL)
    return json.loads(found[1])


def test_a_page_names_its_maps_and_what_is_missing(sgp, folder, tmp_path):
    page = tmp_path / "page.html"
    printed = sgp("report", folder, "--out", page, "--json").report()
    assert printed["metrics"] == {"results": 1, "bytes": page.stat().st_size, "reduction": [1.0]}
    assert [one["code"] for one in printed["notices"]] == ["recording-unreadable"]
    html = page.read_text(encoding="utf-8")
    (result,) = report_of(html)["results"]
    names = [plane["name"] for plane in result["planes"]]
    assert names == ["normals", "shape", "albedo", "height", "normal_sigma_deg", "height_sigma"]
    assert (result["unit"], result["pixelSize"]) == ("mm", 0.2)
    assert result["full"] == {"rows": SIZE[0], "columns": SIZE[1]}
    assert "https://" not in html
    # Names of drawings and of HTML are no addresses.
    assert set(re.findall(r"http://[\w./]*", html)) <= {
        f"http://www.w3.org/{name}" for name in ("2000/svg", "1999/xhtml")
    }


def test_maps_are_reduced_until_the_page_is_small_enough(folder):
    large = make_report([folder], max_pixels=MAX_PIXELS)
    assert large.reduction == [1.0]
    # Scripts, style and colour maps are about 70 kB of it.
    limit = len(large.html) - 20_000
    small = make_report([folder], max_pixels=MAX_PIXELS, most_bytes=limit)
    assert small.reduction[0] > 1
    assert len(small.html.encode()) <= limit
    (result,) = report_of(small.html)["results"]
    assert result["pixelSize"] == pytest.approx(0.2 * small.reduction[0])
    assert "reduced from" in small.html


def test_the_terminal_states_the_reduction(sgp, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(report_module, "_PIXELS", 2000)
    answer = sgp("report", folder, "--out", tmp_path / "page.html")
    (line,) = [line for line in answer.out.splitlines() if "reduced" in line]
    sizes = r"from 90 x 90 to 4\d x 4\d pixels"
    assert re.fullmatch(rf"the page shows ball reduced {sizes}; --full adds all pixels", line)
    answer = sgp("report", folder, "--out", tmp_path / "full.html", "--full")
    assert "reduced" not in answer.out


def test_each_file_is_read_once_and_three_js_is_for_heights(folder, tmp_path, monkeypatch):
    read = []
    original = maps_module.acquisition.read_image
    monkeypatch.setattr(
        maps_module.acquisition,
        "read_image",
        lambda path, **options: (read.append(path.name), original(path, **options))[1],
    )
    flat = shutil.copytree(folder, tmp_path / "flat")
    (flat / "height.exr").unlink()
    pages = [
        make_report([one], max_pixels=MAX_PIXELS, most_bytes=700_000) for one in (folder, flat)
    ]
    assert pages[0].reduction[0] > 1
    assert sorted(set(read[:4])) == sorted(read[:4])
    three = [asset("vendor/three.js") in page.html for page in pages]
    assert three == [True, False]
    assert len(pages[1].html) < 400_000


def test_large_maps_that_are_read_in_bands_give_the_same_page(folder, tmp_path, monkeypatch):
    part = shutil.copytree(folder, tmp_path / "ball")
    (part / "invented.png").write_bytes((part / "mask.png").read_bytes())

    def planes(pixels):
        found = embed(FolderMaps(read_folder(part), MAX_PIXELS), pixels, full=True)
        assert found.notices == []
        tiles = [(one.key, one.encoded) for one in found.tiles]
        return {name: plane.samples for name, plane in found.planes.items()}, tiles

    for pixels in (2000, 1e6):
        expected = planes(pixels)
        with monkeypatch.context() as patch:
            patch.setattr(large_maps, "LARGE", 0)
            found = planes(pixels)
        np.testing.assert_equal(found, expected)
    monkeypatch.setattr(large_maps, "LARGE", 0)
    height = part / "height.exr"
    height.write_bytes(height.read_bytes()[:20_000])
    made = make_report([part], max_pixels=MAX_PIXELS)
    assert [(one.code, "height.exr" in one.text) for one in made.notices if "map" in one.code] == [
        ("map-unreadable", True)
    ]


def test_two_folders_are_on_one_page(sgp, folder, tmp_path):
    page = tmp_path / "page.html"
    assert sgp("report", folder, folder, "--out", page).code == 0
    first, second = report_of(page.read_text(encoding="utf-8"))["results"]
    assert first["planes"][0]["id"] != second["planes"][0]["id"]


def test_an_unfinished_folder_is_shown_as_far_as_it_is_there(sgp, folder, tmp_path):
    part, page = tmp_path / "part", tmp_path / "page.html"
    shutil.copytree(folder, part / "normals")
    (part / "normals" / "surface.json").unlink()
    height = part / "normals" / "height.exr"
    height.write_bytes(height.read_bytes()[:2000])
    write_exr(part / "normals" / "curl_deg.exr", np.zeros((3, 4), np.float32))
    answer = sgp("report", part, "--out", page, "--json")
    notices = {one["text"]: one["code"] for one in json.loads(answer.out)["notices"]}
    expected = {
        "detail: is missing": "result-unfinished",
        "surface: is missing": "result-unfinished",
        "normals: has no record: the command that writes it has not finished": "result-unfinished",
        "curl_deg: has another size than the other maps, and is left out": "map-unreadable",
    }
    assert expected.items() <= notices.items()
    assert sum("height.exr" in text for text in notices) == 1
    html = page.read_text(encoding="utf-8")
    assert all(text in html for text in expected)


def test_missing_maps_and_records_are_named(sgp, folder, tmp_path):
    expected = {"height.exr": "maps are missing: height.exr", "surface.json": "has no record"}
    for gone, text in expected.items():
        part, page = tmp_path / gone, tmp_path / f"{gone}.html"
        shutil.copytree(folder, part)
        (part / gone).unlink()
        answer = sgp("report", part, "--out", page)
        lines = [line for line in answer.err.splitlines() if text in line]
        assert (answer.code, len(lines)) == (0, 1), answer.err
        assert text in page.read_text(encoding="utf-8")


def test_a_record_of_another_version_is_named(sgp, folder, tmp_path):
    other, page = tmp_path / "other", tmp_path / "page.html"
    shutil.copytree(folder, other)
    record = other / "surface.json"
    record.write_text(record.read_text().replace('"version": 1', '"version": 7', 1))
    answer = sgp("report", other, "--out", page)
    (line,) = answer.err.splitlines()
    assert "surface.json: has version 7" in line
    assert "has version 7" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("make", "code", "text"),
    [
        (lambda path: None, 2, "no such file or folder"),
        (lambda path: path.mkdir(), 4, "no record and no map of a result"),
        (lambda path: path.write_text("{}"), 4, "is a file: give the folder"),
    ],
)
def test_what_is_no_result_is_refused(sgp, tmp_path, make, code, text):
    place = tmp_path / "place"
    make(place)
    assert text in sgp("report", place, "--out", tmp_path / "page.html").error_line(code)
    assert not (tmp_path / "page.html").exists()


def test_an_existing_page_is_kept_unless_forced(sgp, folder, tmp_path):
    page = tmp_path / "page.html"
    page.write_text("mine")
    assert "already exists" in sgp("report", folder, "--out", page).error_line(2)
    assert page.read_text() == "mine"
    assert sgp("report", folder, "--out", page, "--force").code == 0
    assert ".html" in sgp("report", folder, "--out", tmp_path / "page.png").error_line(2)
