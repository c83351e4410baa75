"""The certificate of a measurement of roughness, as a page and on paper."""

from __future__ import annotations

import base64
import re
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, DataError, Flat, Lights, write_camera, write_exr
from acquisition.source import read_identity
from acquisition.value_files import flat_files, write_flat, write_sensor
from acquisition.values import Calibrated, LightErrors, Measured, MeasuredSensor, Setup
from rig import MAX_PIXELS
from sgp.report import make_report, read_folder
from sgp.report.instrument import instrument_rows
from sgp.report.recording import Recording
from sgp.results import Result, sha256, write_record
from tests.acquisition.small_session import write
from tests.sgp.chromium import MISSING, PROGRAM
from tests.sgp.report_folder import PIXEL_MM, SIZE, write_folder
from tests.sgp.test_report_page import quiet

PLACE = (40, 30, 30, 24)


def parameter(name, unit, value, sigma, doubts=()):
    budget = {} if sigma is None else {"noise": 0.6 * sigma, "filter": 0.8 * sigma}
    return {
        "name": name, "unit": unit, "value": value, "sigma": sigma, "measured": value,
        "budget": budget, "doubts": list(doubts),
    }  # fmt: skip


@pytest.fixture
def measured(tmp_path) -> Path:
    """A result of an area, high in its upper half, and a profile of a simulated recording."""
    session = write(tmp_path / "session")
    surface = write_folder(tmp_path / "ball", inputs=[session / "session.toml"])
    out = tmp_path / "roughness"
    out.mkdir()
    x, y, width, height = PLACE
    heights = np.full(SIZE, np.nan, np.float32)
    heights[y : y + height, x : x + width] = -0.004
    heights[y : y + height // 2, x : x + width] = 0.004
    outputs = {"heights_0": out / "heights_0.exr", "heights_1": out / "heights_1.csv"}
    write_exr(outputs["heights_0"], heights)
    lines = [f"{PIXEL_MM * n},{0.001 * n}" for n in range(20)]
    outputs["heights_1"].write_text("\n".join(["position_mm,height_mm", *lines]))
    scales = {"form": "plane", "s_mm": 0.8, "l_mm": 2.5}
    area = [parameter("Sq", "um", 3.9968, 0.0456), parameter("Ssk", "", None, None)]
    line = [parameter("Rq", "um", 5.72, 0.31, ["61% of it is noise"])]
    metrics = {
        "pixel_mm": PIXEL_MM, "lens_blur_px": 0.76, "lateral_resolution_mm": 0.92,
        "regions": [
            {"name": "seal", "kind": "area", "place": "40,30,30,24", "pixels": 720}
            | scales | {"parameters": area},
            {"name": "across", "kind": "profile", "place": "30,40,50,40,3", "pixels": 20}
            | scales | {"parameters": line},
        ],
        "limits": [
            {"parameter": "Sq", "region": "seal", "least": None, "most": 3.5, "answer": "exceeded"}
        ],
    }  # fmt: skip
    inputs = [surface / "surface.json", surface / "height.exr"]
    result = Result(outputs, metrics, inputs=inputs)
    write_record(out / "roughness.json", "sgp roughness", {"result": surface}, result)
    return out


def html_of(folder: Path) -> str:
    return make_report([folder], max_pixels=MAX_PIXELS).html


def cells(html: str) -> list[list[str]]:
    """Return the texts of the rows of all tables in the certificate."""
    part = html[html.index('<section class="certificate">') :]
    part = part[: part.index("</section>")]
    rows = re.findall(r"<tr>(.*?)</tr>", part)
    return [
        [re.sub(r"<[^>]*>", "", one) for one in re.findall(r"<t[hd].*?>(.*?)</t[hd]>", row)]
        for row in rows
    ]


def test_the_certificate_states_the_measurement_and_where_it_came_from(measured):
    html = html_of(measured)
    rows = cells(html)
    assert ["Sq", "root mean square height", "3.997", "0.091", "µm"] in rows
    assert ["Sq", "µm", "0.027", "0.036", "0.046"] in rows
    assert ["seal", "Sq", "", "3.5", "3.997", "0.091", "µm", "exceeded"] in rows
    doubted = next(row for row in rows if row[0] == "Rq" and len(row) == 5 and "." in row[2])
    assert doubted[1].endswith("not assured: 61% of it is noise")
    assert "Not defined here: Ssk." in html
    conditions = "x, y, width, height 40, 30, 30, 24 px: form plane, S-filter 0.8 mm, L-filter 2.5"
    assert conditions in html
    for path in (measured / "heights_0.exr", measured.parent / "ball" / "height.exr"):
        assert any(row[0].endswith(path.name) and row[1] == sha256(path) for row in rows)
    identity = read_identity(measured.parent / "session" / "session.toml")
    assert f"<dd>{identity.object}</dd>" in html
    assert ("SIMULATED" in html) is identity.simulated
    assert "NOT VALID" not in html


def test_up_is_up_in_the_picture_of_an_area(measured):
    pictures = re.findall(r'href="data:image/jpeg;base64,([^"]*)"', html_of(measured))
    assert len(pictures) == 2  # the places, and the area
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(pictures[1]), np.uint8), cv2.IMREAD_COLOR)
    height, width, _ = shown.shape
    upper, lower = (shown[int(share * height), width // 2].astype(int) for share in (0.35, 0.65))
    assert upper[2] > upper[0] + 80  # red
    assert lower[0] > lower[2] + 80  # blue


@pytest.mark.parametrize("changed", ["heights_0.exr", "roughness.json"])
def test_a_certificate_of_changed_files_is_not_valid(measured, changed):
    path = measured / changed
    if changed == "roughness.json":
        path.write_text(path.read_text().replace("3.9968", "2.9968"))
    else:
        write_exr(path, np.ones(SIZE, np.float32))
    html = html_of(measured)
    assert "NOT VALID" in html
    assert "output-damaged" in html


def test_without_the_surface_the_certificate_has_no_picture_of_places(measured):
    for path in (measured.parent / "ball").iterdir():
        path.unlink()
    html = html_of(measured)
    assert html.count('class="places"') == 1
    assert ["Sq", "root mean square height", "3.997", "0.091", "µm"] in cells(html)
    assert "input-missing" in html


def test_damaged_heights_of_a_line_are_named(measured):
    (measured / "heights_1.csv").write_text("position_mm\n1\n")
    assert "heights_1.csv: is missing or damaged" in html_of(measured)


@pytest.mark.skipif(PROGRAM is None, reason=MISSING)
def test_a_printed_certificate_has_two_pages_of_a4_at_most(sgp, browser, measured, tmp_path):
    page = tmp_path / "page.html"
    sgp("report", measured, "--out", page).ok()
    browser.open(page)
    printed = base64.b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert 1 <= len(re.findall(rb"/Type /Page\b", printed)) <= 2
    (box,) = set(re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed))
    assert [float(side) for side in box] == pytest.approx([595, 842], abs=1.5)
    browser.call("Emulation.setEmulatedMedia", media="print")
    shown = "[...document.querySelectorAll('main > section')].filter((one) => one.offsetHeight > 0)"
    names = browser.value(f"{shown}.map((one) => one.className)")
    assert names == ["certificate", "notices"]
    browser.call("Emulation.setEmulatedMedia", media="")
    for width in (1200, 390):
        browser.resize(width, 800)
        assert browser.value("document.documentElement.scrollWidth") <= width
    quiet(browser, page)


def drift_folder(path: Path, files, *, moved=False, beyond=()) -> Path:
    path.mkdir()
    metrics = {
        "lights": 2, "beyond": len(beyond), "moved": moved, "false_alarm": 0.01,
        "common_limit_deg": None,
        "calibrations": [
            {"name": f"{n}.json", "time_utc": f"2026-0{n}-01T12:00:00+00:00",
             "common_deg": None, "common_ratio": None} for n in (1, 2, 3)
        ],
        "drifts": [
            {"id": name, "direction_deg": 0.1, "direction_ratio": 0.5, "strength_percent": None,
             "strength_ratio": None, "beyond": name in beyond} for name in ("L00", "L01")
        ],
    }  # fmt: skip
    write_record(path / "check.json", "sgp calibrate check", {}, Result({}, metrics, inputs=files))
    return path


@pytest.mark.parametrize(
    ("moved", "beyond", "text"),
    [
        (False, (), "all lights within control limits"),
        (False, ("L01",), "beyond control limits: L01"),
        (True, (), "all lights turned together, beyond the control limit"),
    ],
)
def test_a_certificate_states_the_drift_of_the_lights(measured, moved, beyond, text):
    # The folder's records list this file as an input.
    lights = measured.parent / "session" / "session.toml"
    drift = drift_folder(measured.parent / "drift", [lights], moved=moved, beyond=beyond)
    html = make_report([measured], max_pixels=MAX_PIXELS, check=drift).html
    rows = cells(html)
    assert ["Drift of the lights", f"3 calibrations, 2026-01-01 to 2026-03-01, {text}"] in rows


def test_a_drift_of_other_lights_is_refused(sgp, measured, tmp_path):
    other = tmp_path / "other.json"
    other.write_text("{}")
    drift = drift_folder(tmp_path / "drift", [other])
    page = tmp_path / "page.html"
    for result, check, text in (
        (measured, drift, "does not contain the lights of"),
        (measured, measured / "roughness.json", "is the record of sgp roughness: give the folder"),
        (measured.parent / "ball", drift, "is for certificates, and no result of sgp roughness"),
    ):
        assert text in sgp("report", result, "--check", check, "--out", page).error_line(4)
    assert not page.exists()


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("drift/check.json", "check.json: was changed"),
        ("session/session.toml", "session.toml"),
    ],
)
def test_a_drift_that_has_changed_is_refused(measured, file, text):
    lights = measured.parent / "session" / "session.toml"
    drift = drift_folder(measured.parent / "drift", [lights], beyond=("L01",))
    path = measured.parent / file
    path.write_text(path.read_text().replace('"beyond": true', '"beyond": false') + "\n")
    with pytest.raises(DataError, match=text):
        make_report([measured], max_pixels=MAX_PIXELS, check=drift)


def test_the_instrument_is_that_of_the_files_that_the_record_names(tmp_path):
    time = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)
    setup = Setup("dome", "Maker", "M2", "77")
    camera = CameraModel([[900, 0, 54.5], [0, 900, 44.5], [0, 0, 1]], SIZE[1], SIZE[0], 500.0)
    ones = np.ones(SIZE, np.float32)
    write_camera(tmp_path / "camera.json", camera)
    write_flat(
        tmp_path / "flat", Flat(ones, ones, pixel_std=0.002, calibrated=Calibrated(time, setup))
    )
    figure = Measured(2.5, 0.02)
    sensor = MeasuredSensor(12, 0.0, figure, figure, *[Measured(0.01, 0.001)] * 4, time_utc=time)
    write_sensor(tmp_path / "sensor.json", sensor)
    spread = np.broadcast_to(np.diag([0.04, 0.09, 0.25]), (4, 3, 3))
    places = [[100.0, 0, 300], [0, 100, 300], [-100, 0, 300], [0, -100, 300]]
    errors = LightErrors(spread, np.full(4, 0.01))
    lights = Lights(
        positions_mm=np.array(places), errors=errors, calibrated=Calibrated(time, setup)
    )
    named = {name: tmp_path / f"{name}.json" for name in ("camera", "sensor")}
    named["flat"] = tmp_path / "flat"
    files = [named["camera"], named["sensor"], *flat_files(named["flat"])]
    folder = write_folder(tmp_path / "ball", inputs=files, **named)
    notices = []
    rows = dict(instrument_rows(read_folder(folder), Recording(lights=lights), notices))
    assert notices == []
    assert rows["Lights"] == (
        "4 near lights, calibrated 2026-03-01 12:00 UTC, standard deviation of positions 0.5 mm "
        "(median), of intensities 1 %"
    )
    assert rows["Camera calibration"].startswith("focal length 900.0 px, working distance 500 mm")
    assert rows["Sensor"].startswith("calibrated 2026-03-01 12:00 UTC, 2.5 electrons/DN (standard")
    assert "standard deviation of pixels 0.2 %" in rows["Flat field"]
    (tmp_path / "sensor.json").write_text("{}")
    rows = dict(instrument_rows(read_folder(folder), Recording(), notices))
    assert [one.code for one in notices] == ["input-changed"]
    assert rows["Sensor"] == "not known"
