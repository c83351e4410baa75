"""Recordings that do not give lights: each is reported in one clear line with its exit code."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    Lights,
    angle_deg,
    read_lights,
    write_camera,
    write_lights,
    write_png,
)

SIZE = (200, 260)
LEDS = 6
CENTRE, RADIUS = (130.0, 100.0), 45.0


def directions():
    around = 2 * np.pi * np.arange(LEDS) / LEDS
    return np.stack([0.6 * np.cos(around), 0.6 * np.sin(around), np.full(LEDS, 0.8)], axis=1)


def ball(k):
    """Return coverage and normals of the ball, and the place of its highlight."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    across, up = (x - CENTRE[0]) / RADIUS, (CENTRE[1] - y) / RADIUS
    normals = np.dstack([across, up, np.sqrt(np.clip(1 - across**2 - up**2, 0, None))])
    half = directions()[k] + np.array([0.0, 0, 1])
    half /= np.linalg.norm(half)
    away = np.hypot(x - CENTRE[0] - RADIUS * half[0], y - CENTRE[1] + RADIUS * half[1])
    cover = np.clip(RADIUS - np.hypot(x - CENTRE[0], y - CENTRE[1]) + 0.5, 0, 1)
    return cover, normals, away


def nothing(k):
    return np.full(SIZE, 0.3)


def diffuse(k):
    cover, normals, _ = ball(k)
    return 0.3 * (1 - cover) + cover * 0.6 * np.clip(normals @ directions()[k], 0, None)


def mirror(k, peak=0.8):
    cover, _, away = ball(k)
    return 0.3 * (1 - cover) + cover * (0.05 + peak * np.exp(-(away**2) / (2 * 2.0**2)))


def unlit(k):
    return np.full(SIZE, -1.0)


def white(k):
    return np.full(SIZE, 1.2)


def saturated(k):
    return mirror(k, peak=60.0)


def overexposed(k):
    """The ball and its surroundings are white, whatever the light."""
    cover, _, _ = ball(k)
    return 0.3 + 2 * cover


def recording(folder, draw, count=LEDS, size=SIZE):
    folder.mkdir()
    for k in range(count):
        noise = np.random.default_rng(k).normal(0, 0.002, SIZE)
        dn = np.clip(np.rint(65535 * (draw(k) + noise)), 0, 65535).astype(np.uint16)
        write_png(folder / f"L{k:02d}.png", dn[: size[0], : size[1]])
    return folder


def camera_file(path, focal_px=900.0):
    K = [[focal_px, 0, 129.5], [0, focal_px, 99.5], [0, 0, 1]]
    write_camera(path, CameraModel(K, SIZE[1], SIZE[0], 600.0))
    return path


@pytest.mark.parametrize(
    ("draw", "says"),
    [
        pytest.param(nothing, "no mirror sphere found", id="no sphere"),
        pytest.param(diffuse, "no mirror sphere found", id="a diffuse ball"),
        pytest.param(overexposed, "no mirror sphere found", id="an overexposed ball"),
        pytest.param(unlit, "all 6 images are black or saturated", id="black images"),
        pytest.param(white, "every sample of all 6 images is saturated", id="white images"),
    ],
)
def test_what_is_no_mirror_sphere_is_refused(sgp, tmp_path, draw, says):
    source = recording(tmp_path / "s", draw)
    assert says in sgp("calibrate", "spheres", source, "--out", tmp_path / "l.json").error_line(5)
    assert not (tmp_path / "l.json").exists()


@pytest.mark.parametrize(
    ("draw", "says"),
    [(diffuse, "no highlight under light"), (overexposed, "no highlight under light")],
)
def test_a_marked_ball_without_highlights_is_refused(sgp, tmp_path, draw, says):
    source = recording(tmp_path / "s", draw)
    mark = ("--sphere", "130,100,45")
    answer = sgp("calibrate", "spheres", source, *mark, "--out", tmp_path / "l.json")
    assert says in answer.error_line(5)


def test_saturated_highlights_are_reported_and_located(sgp, tmp_path):
    source = recording(tmp_path / "s", saturated)
    answer = sgp("calibrate", "spheres", source, "--out", tmp_path / "l.json").ok()
    (line,) = [one for one in answer.err.splitlines() if one.startswith("warning: ")]
    assert "100 % of the highlights are saturated" in line
    assert "add a short exposure" in line
    found = read_lights(tmp_path / "l.json").unit_directions
    assert angle_deg(found, directions()).max() < 0.5


def test_one_sphere_where_positions_are_wanted_says_so(sgp, tmp_path):
    source = recording(tmp_path / "s", mirror)
    words = ("calibrate", "spheres", source, "--camera", camera_file(tmp_path / "c.json"))
    radius = ("--sphere", "130,100,45", "--radius-mm", 28.5)
    answer = sgp(*words, *radius, "--out", tmp_path / "l.json").ok()
    assert "one sphere gives only directions, as they are at the sphere" in answer.err
    assert not read_lights(tmp_path / "l.json").near


def test_lights_for_another_number_of_leds_are_refused(sgp, tmp_path):
    source = recording(tmp_path / "s", mirror)
    write_lights(tmp_path / "four.json", Lights(directions=directions()[:4]))
    words = ("normals", source, "--lights", tmp_path / "four.json", "--out", tmp_path / "n")
    line = sgp(*words).error_line(4)
    assert "4" in line
    assert "6" in line
    fewer = recording(tmp_path / "t", mirror, count=5)
    answer = sgp("calibrate", "spheres", source, fewer, "--out", tmp_path / "l.json")
    assert f"{fewer} has no light L05, which {source} shows" in answer.error_line(4)


def test_recordings_under_different_cameras_are_refused(sgp, tmp_path):
    sources = []
    for name, focal_px in (("a", 900.0), ("b", 910.0)):
        plain = recording(tmp_path / f"plain {name}", mirror)
        camera = camera_file(tmp_path / f"{name}.json", focal_px)
        words = ("capture", "import", plain, "--camera", camera, "--out", tmp_path / name)
        assert sgp(*words).code == 0
        sources.append(tmp_path / name)
    answer = sgp("calibrate", "spheres", *sources, "--out", tmp_path / "l.json")
    line = answer.error_line(4)
    assert f"{sources[1]} differs from {sources[0]}" in line
    assert "focal length 900 px at 260 x 200, now 910 px at 260 x 200" in line


def test_recordings_of_different_sizes_are_refused(sgp, tmp_path):
    sources = [
        recording(tmp_path / "s", mirror),
        recording(tmp_path / "t", mirror, size=(200, 250)),
    ]
    answer = sgp("calibrate", "spheres", *sources, "--out", tmp_path / "l.json")
    assert "has images of 250 x 200 pixels" in answer.error_line(4)
