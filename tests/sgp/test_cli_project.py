"""``sgp project``: a mesh or points are projected to a normal map, or refused with one line."""

import json

import numpy as np
import pytest
import trimesh

from acquisition import CameraModel, angle_deg, read_image, write_camera
from processing import read_normals

BALL = trimesh.creation.icosphere(subdivisions=4, radius=10.0)


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "in" / "ball.ply"
    path.parent.mkdir()
    BALL.export(path)
    return path


@pytest.fixture
def camera(tmp_path):
    path = tmp_path / "camera.json"
    K = np.array([[800.0, 0, 59.5], [0, 800, 49.5], [0, 0, 1]])
    write_camera(path, CameraModel(K, 120, 100, 300.0))
    return path


def test_a_mesh_becomes_a_folder_of_normals(sgp, ball, tmp_path):
    out = tmp_path / "out"
    report = sgp("project", ball, "--size", "120x100", "--out", out, "--json").report()
    assert sorted(report["outputs"]) == ["height", "mask", "normals", "normals_png"]
    metrics = report["metrics"]
    assert (metrics["width"], metrics["height"], metrics["faces"]) == (120, 100, len(BALL.faces))
    assert metrics["mm_per_px"] == pytest.approx(20 / 96)
    normal_map = read_normals(out).normal_map
    y, x = np.mgrid[49.5:-50.5:-1, -59.5:60.5] * metrics["mm_per_px"]
    truth = np.stack([x, y, np.sqrt(np.maximum(100 - x**2 - y**2, 0))], axis=2)
    inner = x**2 + y**2 < 90
    assert angle_deg(normal_map.normals[inner], truth[inner]).max() < 0.5
    height = read_image(out / "height.exr")
    np.testing.assert_allclose(height[inner], truth[inner][:, 2], atol=0.05)
    assert np.isnan(height[0, 0])
    record = json.loads((out / "project.json").read_text(encoding="utf-8"))
    assert record["command"] == "sgp project"
    assert str(ball) in record["inputs"]


@pytest.mark.parametrize(
    ("options", "normal"),
    [
        pytest.param((), (0, 1, 1), id="front"),
        pytest.param(("--view", "top"), (0, -1, 1), id="top"),
        pytest.param(("--rotate-deg", "45,0,0"), (0, 0, 1), id="turned to the viewer"),
        pytest.param(("--look", "-1,0,-1"), (-0.5, np.sqrt(0.5), 0.5), id="look"),
    ],
)
def test_up_is_up_and_the_view_is_the_one_named(sgp, tmp_path, options, normal):
    path = tmp_path / "roof.obj"
    # The roof rises toward the back: its normal is (0, 1, 1).
    path.write_text("v 0 0 0\nv 4 0 0\nv 4 2 -2\nv 0 2 -2\nf 1 2 3\nf 1 3 4\n", encoding="ascii")
    assert sgp("project", path, "--out", tmp_path / "o", "--size", "40x30", *options).code == 0
    seen = read_normals(tmp_path / "o").normal_map
    assert angle_deg(seen.normals[seen.mask], normal).max() < 0.01


def test_a_camera_gives_depth_in_millimetres(sgp, ball, camera, tmp_path):
    out = tmp_path / "out"
    sgp("project", ball, "--camera", camera, "--distance-mm", "400", "--out", out).ok()
    depth, height = read_image(out / "depth.exr"), read_image(out / "height.exr")
    assert np.nanmin(depth) == pytest.approx(390, abs=0.1)
    np.testing.assert_allclose(depth + height, np.where(np.isnan(depth), np.nan, 400), rtol=1e-5)


@pytest.mark.parametrize(
    ("suffix", "options", "span_mm"),
    [
        pytest.param("ply", (), 20.0, id="mm"),
        pytest.param("ply", ("--unit", "in"), 508.0, id="inches"),
        pytest.param("glb", (), 20_000.0, id="glb in metres"),
        pytest.param("glb", ("--unit", "cm"), 200.0, id="glb with unit cm"),
    ],
)
def test_units(sgp, tmp_path, suffix, options, span_mm):
    path = tmp_path / f"ball.{suffix}"
    BALL.export(path)
    answer = sgp("project", path, "--out", tmp_path / "o", "--size", "104x104", *options, "--json")
    assert json.loads(answer.out)["metrics"]["mm_per_px"] == pytest.approx(span_mm / 100, rel=1e-5)


def test_points_become_normals_too(sgp, tmp_path):
    path = tmp_path / "ball.xyz"
    points = np.random.default_rng(0).normal(size=(5000, 3))
    points *= 10 / np.linalg.norm(points, axis=1, keepdims=True)
    np.savetxt(path, np.concatenate([points, points[:7]]))
    answer = sgp("project", path, "--out", tmp_path / "o", "--pixel-mm", "0.2").ok()
    assert "points left out because they are duplicates: 7" in answer.err
    seen = read_normals(tmp_path / "o").normal_map
    middle = tuple(side // 2 for side in seen.size)
    assert angle_deg(seen.normals[middle], [0, 0, 1]) < 2


def _spoil(path, text):
    path.write_text(text, encoding="ascii")
    return path


@pytest.mark.parametrize(
    ("name", "text", "code", "words"),
    [
        pytest.param("a.obj", "v 0 0 0\nv 1 0 0\n", 4, "no faces", id="no faces"),
        pytest.param("a.obj", "v 0 0 0\nv nan 0 0\nv 1 1 1\nf 1 2 3\n", 4, "vertex 1", id="NaN"),
        pytest.param("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2 2\n", 5, "no area", id="degenerate"),
        pytest.param("a.xyz", "0 0 0\n1 0 0\n", 5, "points (2)", id="two points"),
        pytest.param("a.xyz", "0 0 0\n0 0 0\n0 0 0\n1 1 1\n", 5, "points (2)", id="duplicates"),
        pytest.param("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", 4, "truncated", id="truncated"),
        pytest.param("a.stl", "solid", 4, "a.stl", id="not a mesh"),
        pytest.param("a.doc", "words", 4, "give one of", id="another file"),
    ],
)
def test_bad_files_get_one_line(sgp, tmp_path, name, text, code, words):
    path = _spoil(tmp_path / name, text)
    answer = sgp("project", path, "--out", tmp_path / "o", "--pixel-mm", "0.1")
    assert words in answer.error_line(code)
    assert not (tmp_path / "o").exists()


def test_a_single_point_has_no_surface_at_any_size(sgp, tmp_path):
    path = _spoil(tmp_path / "a.xyz", "1 2 3\n" * 3)
    answer = sgp("project", path, "--out", tmp_path / "o", "--size", "64x64")
    assert (answer.code, "different points (1)" in answer.err) == (5, True), answer.err


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        pytest.param(("--size", "100"), 2, "640x512", id="half a size"),
        pytest.param(("--size", "100000x100000"), 2, "100 million", id="huge size"),
        pytest.param(("--pixel-mm", "0.00001"), 4, "too large", id="tiny pixels"),
        pytest.param(("--pixel-mm", "0"), 2, "", id="no pixel size"),
        pytest.param(("--look", "0,0,0"), 2, "no view along", id="look nowhere"),
        pytest.param(("--look", "1,2"), 2, "3 numbers", id="look of two"),
        pytest.param(("--look", "0,0,1", "--view", "top"), 2, "give only one", id="two views"),
        pytest.param(("--neighbours", "2"), 2, "", id="two neighbours"),
        pytest.param(("--distance-mm", "5"), 2, "--camera too", id="no camera"),
        pytest.param(("--camera", "nowhere.json"), 2, "nowhere.json", id="missing camera"),
        pytest.param(("--size", "1x2", "--pixel-mm", "90"), 5, "no pixel centre", id="unseen"),
    ],
)
def test_impossible_options_get_one_line(sgp, ball, tmp_path, options, code, words):
    assert words in sgp("project", ball, "--out", tmp_path / "o", *options).error_line(code)


def test_scale_and_distance_of_a_camera_are_given_once(sgp, ball, camera, tmp_path):
    words = ("project", ball, "--out", tmp_path / "o", "--camera")
    assert "--pixel-mm" in sgp(*words, camera, "--pixel-mm", "1").error_line(2)
    (tmp_path / "K.txt").write_text("800 0 60\n0 800 50\n0 0 1\n", encoding="ascii")
    answer = sgp(*words, tmp_path / "K.txt", "--size", "120x100")
    assert (answer.code, "give --distance-mm" in answer.err) == (2, True)
    sgp(*words, tmp_path / "K.txt", "--size", "120x100", "--distance-mm", "300").ok()
