"""The demo: the complete chain on the simulated rig, with errors against the ground truth."""

import json

import numpy as np
import pytest

from acquisition import read_image
from sgp import read_record
from sgp.app import build, run

# The demo renders, calibrates and surfaces a complete recording.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    assert run(build(), ["demo", "--out", str(out), "--seed", "7"]) == 0
    return out


def test_errors_are_within_the_documented_limits(demo):
    metrics = json.loads((demo / "summary.json").read_text(encoding="utf-8"))["metrics"]
    assert metrics["light_error_deg"] <= 0.06
    assert metrics["light_error_mm"] <= 0.8
    assert metrics["normals_mae_deg"] < 0.5
    assert metrics["normals_resolved_mae_deg"] < 0.3
    assert metrics["normals_coverage"] == 1.0
    assert metrics["height_relative_error"] <= 0.0025


def test_every_record_can_be_read(demo):
    assert read_record(demo / "summary.json").command == "sgp demo"
    for name in ("normals", "detail", "surface"):
        assert read_record(demo / name / f"{name}.json").command == "sgp run"


def test_the_pictures_and_maps_are_there(demo):
    assert read_image(demo / "overview.png").std() > 10
    height = read_image(demo / "surface" / "height.exr")
    assert 8 < np.nanmax(height) - np.nanmin(height) < 12
    for name in ("normals/normals.png", "detail/detail.exr", "surface/surface.ply", "lights.json"):
        assert (demo / name).stat().st_size > 1000


def test_its_recording_can_be_processed_again_from_its_files(sgp, demo, tmp_path):
    sgp(
        "run", demo / "recording", "--lights", demo / "lights.json", "--out", tmp_path, "--json"
    ).ok()
    again = read_image(tmp_path / "normals" / "normals.exr")
    np.testing.assert_allclose(again, read_image(demo / "normals" / "normals.exr"), atol=1e-6)


def test_parts_combine_to_the_normals_they_came_from(sgp, demo, tmp_path):
    parts, back = tmp_path / "parts", tmp_path / "back"
    assert sgp("detail", "separate", demo / "normals", "--out", parts).code == 0
    shape, detail = parts / "shape.exr", parts / "detail.exr"
    assert sgp("detail", "combine", shape, detail, "--out", back).code == 0
    out = tmp_path / "compared"
    compared = sgp("compare", back, demo / "normals", "--out", out, "--json")
    assert read_record(out / "compare.json").command == "sgp compare"
    metrics = json.loads(compared.out)["metrics"]
    assert metrics["mae_deg"] < 1e-3
    assert metrics["coverage"] == 1.0


def test_a_second_demo_replaces_the_first_and_nothing_else(sgp, demo):
    (demo / "notes.txt").write_text("keep me", encoding="utf-8")
    before = (demo / "lights.json").read_bytes()
    edited = demo / "detail" / "edited.png"
    edited.write_bytes(b"an afternoon of retouching")
    assert "detail" in sgp("demo", "--out", demo, "--seed", "8").error_line(2)
    assert edited.read_bytes() == b"an afternoon of retouching"
    edited.rename(demo / "edited.png")
    assert sgp("demo", "--out", demo, "--seed", "8").code == 0
    assert (demo / "notes.txt").read_text(encoding="utf-8") == "keep me"
    assert (demo / "edited.png").exists()
    assert (demo / "lights.json").read_bytes() != before
