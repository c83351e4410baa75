"""Options that `sgp run` shares with its stages; the scale of meshes; the direction of green."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import CameraModel, angle_deg, read_image, write_camera
from processing import read_normals
from tests.quick_sample import quick
from tests.sgp.conftest import SIZE

STAGES = ["--filter", "box", "--w", "3", "--order", "2", "--pixel-mm", "0.5", "--glb", "--obj"]


def record(path: Path) -> dict:
    return json.loads(path.read_text(encoding="utf-8"))


def close(first: Path, second: Path) -> None:
    # Reading a map normalises its vectors again.
    np.testing.assert_allclose(read_image(first), read_image(second), atol=1e-5)


def test_run_passes_options_to_its_stages(sgp, recording, tmp_path) -> None:
    lights = ["--lights", tmp_path / "lights.json"]
    answer = sgp("run", recording, *lights, *STAGES, "--green-out", "down", "--out", tmp_path / "a")
    assert answer.code == 0, answer.err
    assert "scale" not in answer.err
    one = tmp_path / "a" / "normals"
    alone = sgp("detail", "separate", one, *STAGES[:6], "--out", tmp_path / "d")
    surface = sgp("surface", one, *STAGES[6:], "--out", tmp_path / "s")
    assert (alone.code, surface.code) == (0, 0), alone.err + surface.err
    for name in ("shape.exr", "detail.exr"):
        close(tmp_path / "a" / "detail" / name, tmp_path / "d" / name)
    height = tmp_path / "a" / "surface" / "height.exr"
    close(height, tmp_path / "s" / "height.exr")
    assert {path.suffix for path in height.parent.glob("surface.*")} >= {".ply", ".glb", ".obj"}
    for path in (tmp_path / "a" / "summary.json", height.parent / "surface.json"):
        chosen = record(path)["parameters"]
        assert (chosen["w"], chosen["filter"], chosen["order"]) == (3, "box", 2)
        assert (chosen["pixel_mm"], chosen["green_out"]) == (0.5, "down")
    # The PNGs are in the convention of DirectX, the EXR holds the vectors.
    exr = read_normals(one / "normals.exr").normal_map
    for folder, name in ((one, "normals"), (tmp_path / "a" / "detail", "shape")):
        down = read_normals(folder / f"{name}.png", green="down").normal_map
        whole = read_normals(folder / f"{name}.exr").normal_map
        assert angle_deg(down.normals, whole.normals).max() < 0.01
        outside = cv2.imread(str(folder / f"{name}.png"), -1)[~exr.mask]
        assert (outside == [65535, 32768, 32768, 0]).all()


@pytest.mark.parametrize("command", quick(["normals", "separate", "combine", "transfer"], every=2))
def test_every_command_that_writes_maps_has_green_out(sgp, recording, tmp_path, command) -> None:
    made = tmp_path / "made"
    sgp("normals", recording, "--lights", tmp_path / "lights.json", "--out", made)
    sgp("detail", "separate", made, "--out", tmp_path / "parts")
    words, name = {
        "normals": (["normals", recording, "--lights", tmp_path / "lights.json"], "normals"),
        "separate": (["detail", "separate", made], "detail"),
        "combine": (
            ["detail", "combine", *(tmp_path / "parts" / f"{n}.exr" for n in ("shape", "detail"))],
            "normals",
        ),
        "transfer": (["detail", "transfer", made, made], "normals"),
    }[command]
    out = tmp_path / "out"
    answer = sgp(*words, "--green-out", "down", "--out", out)
    assert answer.code == 0, answer.err
    down = read_normals(out / f"{name}.png", green="down").normal_map
    whole = read_normals(out / f"{name}.exr").normal_map
    assert angle_deg(down.normals, whole.normals).max() < 0.01


@pytest.mark.slow
def test_a_surface_without_scale_says_so_and_its_files_name_the_unit(
    sgp, recording, tmp_path
) -> None:
    lights = ["--lights", tmp_path / "lights.json"]
    formats = ["--glb", "--obj", "--stl"]
    for name, scale, unit in (("px", [], "px"), ("mm", ["--pixel-mm", "0.1"], "mm")):
        out = tmp_path / name
        answer = sgp("run", recording, *lights, *scale, *formats, "--out", out)
        assert answer.code == 0, answer.err
        assert ("heights and meshes are in pixels" in answer.err) == (unit == "px")
        notices = record(out / "surface" / "surface.json")["notices"]
        assert ("surface-without-scale" in [n["code"] for n in notices]) == (unit == "px")
        folder = out / "surface"
        assert f"\ncomment unit {unit}\n".encode() in (folder / "surface.ply").read_bytes()[:200]
        assert (folder / "surface.obj").read_text().startswith(f"# unit {unit}\n")
        assert f"unit {unit}".encode() in (folder / "surface.stl").read_bytes()[:80]
        extras = b'{"unit":"px / 1000"}' if unit == "px" else b'{"unit":"m"}'
        assert extras in (folder / "surface.glb").read_bytes()[:2000]


def test_a_pixel_size_and_a_camera_with_a_distance_are_refused_before_the_normals(
    sgp, recording, tmp_path
) -> None:
    height, width = SIZE
    K = np.array([[100.0, 0, 24], [0, 100, 20], [0, 0, 1]])
    camera = CameraModel(K, width, height, working_distance_mm=500.0)
    write_camera(tmp_path / "camera.json", camera)
    given = ["--lights", tmp_path / "lights.json", "--camera", tmp_path / "camera.json"]
    answer = sgp("run", recording, *given, "--pixel-mm", "0.1", "--out", tmp_path / "out")
    line = answer.error_line(4)
    assert "0.1 mm" in line
    assert "only one" in line
    assert not (tmp_path / "out").exists()
