"""What a report shows of the inputs of a result: only files that have not changed."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rig import MAX_PIXELS
from sgp.report import large_maps, make_report
from sgp.report.folder import ResultFolder
from sgp.report.recording import Image, Recording
from sgp.report.sections import Part, sections
from sgp.report.source_maps import companions
from tests.sgp.report_folder import write_folder, write_recording
from tests.sgp.test_cli_report import report_of


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording and a result of it."""
    path = tmp_path_factory.mktemp("recorded")
    source = write_recording(path / "frames")
    write_folder(path / "result", inputs=sorted(source.iterdir()), source=str(source))
    return path


def changed(path, *names):
    for name in names:
        file = path / name
        file.write_bytes(file.read_bytes() + b" ")


CASES = {
    "nothing changed": ((), 8, []),
    "a frame": (("frames/L3.png",), 7, ["L3.png has changed since the result was computed: "]),
    "two frames": (("frames/L3.png", "frames/L5.png"), 6, ["L3.png and 1 other file have changed"]),
    "the lights": (("frames/lights.lp",), 0, ["lights.lp has changed", "recording is not shown"]),
}


@pytest.mark.parametrize(("files", "images", "texts"), CASES.values(), ids=CASES)
def test_images_are_shown_only_if_their_hashes_are_those_of_the_record(
    recorded, files, images, texts
):
    try:
        changed(recorded, *files)
        made = make_report([recorded / "result"], max_pixels=MAX_PIXELS)
    finally:
        for file in files:
            path = recorded / file
            path.write_bytes(path.read_bytes()[:-1])
    (result,) = report_of(made.html)["results"]
    assert len(result["images"]) == images
    assert made.html.count("data:image/jpeg;base64,") == images + 8  # those under eight lights
    line = " ".join(notice.text for notice in made.notices if notice.code == "input-changed")
    assert all(text in line for text in texts)
    assert bool(line) == bool(texts)
    assert all(text in made.html for text in texts)


def test_images_that_no_record_names_are_not_shown(recorded, tmp_path):
    write_folder(tmp_path / "result", source=str(recorded / "frames"))
    made = make_report([tmp_path / "result"], max_pixels=MAX_PIXELS)
    assert [notice.code for notice in made.notices] == ["recording-unreadable"]
    assert "name no file of the recording" in made.html
    assert report_of(made.html)["results"][0]["images"] == []


@pytest.mark.parametrize("fault", [None, "changed", "missing"])
def test_a_filled_map_is_shown_next_to_the_one_before(tmp_path, fault):
    before = write_folder(tmp_path / "before")
    after = write_folder(
        tmp_path / "after",
        command="sgp detail fill",
        invented=True,
        inputs=[before / "normals.exr", before / "mask.png"],
        normals=str(before),
    )
    if fault == "changed":
        changed(before, "mask.png")
    elif fault == "missing":
        shutil.rmtree(before)
    made = make_report([after], max_pixels=MAX_PIXELS)
    first, *others = report_of(made.html)["results"]
    assert first["marked"]
    assert "invented" in [plane["name"] for plane in first["planes"]]
    if fault is None:
        (other,) = others
        assert other["name"] == "Before: before"
        assert (other["rows"], other["columns"]) == (first["rows"], first["columns"])
        assert made.notices == []
    else:
        assert others == []
        (notice,) = made.notices
        assert "“Before” is not shown" in str(notice) or "“Before” is not shown" in notice.text


SHAPE, DETAIL = "normals.exr", "shape.exr"
COMPANIONS = {
    "detail separate": {"Before": ("normals", SHAPE)},
    "detail combine": {
        "Shape component": ("shape", SHAPE),
        "Detail component": ("detail", DETAIL),
    },
    "detail properties": {"The map": ("normals", SHAPE), "Target": ("targets", [DETAIL])},
    "detail transfer": {"Target": ("target", SHAPE), "Source of the detail": ("source", DETAIL)},
    "curvature": {"Normals": ("normals", SHAPE)},
    "surface": {"Normals": ("normals", SHAPE)},
    "compare": {"First map": ("a", SHAPE), "Second map": ("b", DETAIL)},
}


@pytest.mark.parametrize("command", COMPANIONS)
def test_maps_that_a_result_was_computed_from_are_next_to_it(recorded, command):
    parameters, expected = {}, []
    for title, (key, files) in COMPANIONS[command].items():
        paths = [str(recorded / "result" / one) for one in ([files] if key != "targets" else files)]
        parameters[key] = paths if key == "targets" else paths[0]
        expected += [f"{title}: {Path(one).name}" for one in paths]
    outputs = {"shape": f"result/{DETAIL}"} if command == "detail separate" else {}
    expected += ["Shape component"] * len(outputs)
    record = SimpleNamespace(
        command=f"sgp {command}", parameters=parameters, inputs={}, outputs=outputs
    )
    notices = []
    folder = ResultFolder(recorded, {"record.json": record})
    assert [name for name, *_ in companions(folder, MAX_PIXELS, notices)] == expected
    assert notices == []
    # The picture of a result with normals of its own shows them.
    folder = ResultFolder(recorded / "result", {"record.json": record})
    shown = [name for name, *_ in companions(folder, MAX_PIXELS, notices)]
    assert ("Normals: normals.exr" in shown) is False


def test_large_maps_next_to_a_result_are_read_in_bands(tmp_path, monkeypatch):
    before = write_folder(tmp_path / "before")
    record = SimpleNamespace(
        command="sgp compare", parameters={"a": str(before), "b": str(before / "shape.exr")}
    )
    record.inputs = record.outputs = {}
    folder = ResultFolder(tmp_path, {"record.json": record})
    whole = list(companions(folder, MAX_PIXELS, []))
    monkeypatch.setattr(large_maps, "LARGE", 0)
    for (name, normals, mask), (other, rows, inside) in zip(
        whole, companions(folder, MAX_PIXELS, []), strict=True
    ):
        assert (name, isinstance(rows, np.ndarray)) == (other, False)
        np.testing.assert_array_equal(inside, mask)
        np.testing.assert_allclose(rows[: len(mask)][mask], normals[mask], atol=1e-6)


def test_maps_of_numbers_without_a_mask_are_cut_out(tmp_path):
    folder = write_folder(tmp_path / "ball")
    for name in ("normals", "shape", "albedo", "mask"):
        for file in folder.glob(f"{name}.*"):
            file.unlink()
    (result,) = report_of(make_report([folder], max_pixels=MAX_PIXELS).html)["results"]
    assert (result["rows"], result["columns"]) == (90, 90)


def test_inputs_with_relative_paths_are_found_from_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = write_recording(Path("frames"))
    write_folder(Path("out") / "result", inputs=sorted(source.iterdir()), source="frames")
    for place in ("out/result", "/"):
        monkeypatch.chdir(tmp_path / place)
        made = make_report([tmp_path / "out" / "result"], max_pixels=MAX_PIXELS)
        assert made.notices == []
        assert len(report_of(made.html)["results"][0]["images"]) == 8


def test_a_recording_without_a_result_is_shown(sgp, recorded, tmp_path):
    page = tmp_path / "page.html"
    answer = sgp("report", recorded / "frames", "--out", page, "--json")
    notices = [one["text"] for one in json.loads(answer.out)["notices"]]
    assert "there are no normals, no detail and no surface yet: sgp run computes them" in notices
    html = page.read_text(encoding="utf-8")
    assert html.count("data:image/jpeg;base64,") == 8
    assert "Directions of 8 lights" in html
    assert "is a recording without a result" in html


def test_the_contact_sheet_names_exposures_and_rejected_images(tmp_path):
    def image(name, **others):
        given = {"light_id": name, "role": "light", "exposure_us": 20_000.0, "status": "kept"}
        return Image(name=f"{name}.tif", known=True, source="AAAA", **given | others)

    images = [
        image("L00"),
        image("L01", exposure_us=500.0, status="rejected"),
        image("D", role="dark", exposure_us=None),
    ]
    recording = Recording(images=images, total=4)
    part = Part(7, "result", None, ResultFolder(tmp_path, {}), recording)
    html = "".join(sections(part, ""))
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", html)
    assert captions == ["L00, 20 ms", "L01, 500 µs, REJECTED", "D dark"]
    assert re.findall(r'<figure class="(.*?)">', html) == ["kept", "rejected", "kept"]
    assert "3 of 4 images, 1 of them rejected. " in html
    assert re.findall(r'alt="(.*?)" id="(.*?)"', html)[1] == ("Image L01.tif", "image-7-1")
