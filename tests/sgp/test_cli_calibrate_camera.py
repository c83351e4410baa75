"""``sgp calibrate board`` and ``sgp calibrate camera``."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import read_camera, read_image, write_camera, write_png
from calibration import CharucoBoard, find_board, read_board
from sgp import read_record
from simulator import Lens
from simulator.shapes import ChArUco
from tests.calibration.board_series import BOARD, CAMERA, FLAT, poses, shot
from tests.cases import cases

SIZE = ("--squares", "11x8", "--square-mm", "20")


def save(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.clip(np.rint(image * 6), 0, 65535).astype(np.uint16))
    return path


@pytest.fixture(scope="module")
def views(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("views")
    for k, pose in enumerate(poses(51, 6, (20, 40))):
        save(folder / "shots" / f"V{k}.png", shot(pose, k))
    save(folder / "flat.png", shot(FLAT, 99))
    return folder


def test_a_camera_with_its_working_plane(sgp, views, tmp_path) -> None:
    out = tmp_path / "out"
    done = sgp(
        "calibrate", "camera", views / "shots", *SIZE, "--working-plane", views / "flat.png",
        "--lens", "16 mm", "--focus-mm", "600", "--out", out,
    ).ok()  # fmt: skip
    camera = read_camera(out / "camera.json")
    assert abs(camera.K[0, 0] / CAMERA.K[0, 0] - 1) < 2e-3
    assert abs(camera.working_distance_mm - 600) < 1.5
    assert (camera.lens, camera.focus_mm) == ("16 mm", 600.0)
    for name in ("camera.yml", "cameras.txt"):
        other = read_camera(out / name)
        np.testing.assert_allclose(other.K, camera.K, rtol=1e-14)
        np.testing.assert_array_equal(other.distortion, camera.distortion)
    record = read_record(out / "calibration.json")
    assert record.metrics["views"] == 6
    assert set(record.outputs) == {"camera", "opencv", "colmap", "picture"}
    assert len(record.inputs) == 7
    made_by = json.loads((out / "camera.json").read_text())["provenance"]
    assert made_by["metrics"]["std"].keys() >= {"fx", "fy", "cx", "cy"}
    assert "working distance" in done.out
    assert read_image(out / "camera.png").ndim == 3


@pytest.mark.slow
def test_a_wrong_square_size_contradicts_the_known_distance(sgp, views, tmp_path) -> None:
    done = sgp(
        "calibrate", "camera", views / "shots", "--squares", "11x8", "--square-mm", "22",
        "--working-plane", views / "flat.png", "--working-distance-mm", "600",
        "--out", tmp_path / "out",
    ).ok()  # fmt: skip
    assert re.search(r"is a square 20\.\d\d mm instead of 22 mm", done.err)


def test_images_that_cannot_be_used_are_named(sgp, views, tmp_path) -> None:
    folder = tmp_path / "mixed"
    for path in (views / "shots").iterdir():
        image = read_image(path)
        if path.name == "V3.png":
            image = np.ascontiguousarray(image[:, ::-1])
        write_png(tmp_path / path.name, image)
        folder.mkdir(exist_ok=True)
        (tmp_path / path.name).rename(folder / path.name)
    done = sgp("calibrate", "camera", folder, *SIZE, "--out", tmp_path / "out").ok()
    assert re.search(r"V3\.png: not used: the calibration board is mirrored", done.err)


@cases(
    ("words", "code", "match"),
    {
        "no board": (("{views}/shots",), 2, "give --board board.json, or"),
        "x": (("{views}/shots", "--squares", "11", *SIZE[2:]), 2, "for example 11x8"),
        "missing": (("{views}/shots", "--board", "none.json"), 2, "no such file"),
        "no source": (("{views}/none", *SIZE), 2, "no such file"),
        "height alone": (("{views}/shots", *SIZE, "--height-mm", "3"), 2, "give it too"),
        "one view": (("{views}/shots/V0.png", *SIZE), 5, "1 view of the calibration board"),
        "squares": (
            ("{views}/shots", "--squares", "12x8", "--square-mm", "20"),
            5,
            "another order",
        ),
        "few": (
            ("{views}/shots", "--squares", "5x4", "--square-mm", "20"),
            5,
            "marker .* is not on",
        ),
    },
)
def test_refused(sgp, views, tmp_path, words, code, match) -> None:
    given = [word.format(views=views) for word in words]
    done = sgp("calibrate", "camera", *given, "--out", tmp_path / "out")
    assert done.code == code, done.err
    errors = [line for line in done.err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert re.search(match, errors[0])
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_images_of_different_sizes(sgp, views, tmp_path) -> None:
    image = read_image(views / "flat.png")
    write_png(tmp_path / "part.png", np.ascontiguousarray(image[:480]))
    assert "part.png: 640 x 480 pixels, but" in sgp(
        "calibrate",
        "camera",
        views / "shots",
        tmp_path / "part.png",
        *SIZE,
        "--out",
        tmp_path / "o",
    ).error_line(4)


@pytest.mark.slow
def test_the_lens_of_a_recording(sgp, views, tmp_path) -> None:
    """A session whose camera has another lens than the camera that is given."""
    small = CAMERA.downscaled(16)
    for name, lens in (("old", "25 mm"), ("new", "16 mm")):
        write_camera(tmp_path / f"{name}.json", replace(small, lens=lens))
    image = np.zeros(small.size)
    image[8:24, 10:30] = 1000.0
    for k in range(4):
        save(tmp_path / "images" / f"L0{k}.png", image + 10 * k)
    lights = tmp_path / "lights.lp"
    lines = [
        f"L0{k}.png {x} {y} 0.8"
        for k, (x, y) in enumerate([(0.6, 0), (-0.6, 0), (0, 0.6), (0, -0.6)])
    ]
    lights.write_text("4\n" + "\n".join(lines) + "\n")
    session = tmp_path / "session"
    sgp(
        "capture", "import", tmp_path / "images", "--lights", lights, "--camera",
        tmp_path / "old.json", "--out", session,
    ).ok()  # fmt: skip
    done = sgp("normals", session, "--camera", tmp_path / "new.json", "--out", tmp_path / "n")
    assert "calibrated with another lens or focus: lens 16 mm, now 25 mm" in done.err


def content(pdf: bytes) -> str:
    """Return the drawing commands of a page, from the stream objects of a PDF."""
    for raw in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.S):
        try:
            text = zlib.decompress(raw).decode("latin-1")
        except zlib.error:
            continue
        if " re" in text or " l\n" in text:
            return text
    raise AssertionError("no drawing commands")


def rectangles(pdf: bytes) -> list[tuple[float, float, float, float, bool]]:
    """Return the filled polygons of a page with their bounds in points, and whether white."""
    found: list[tuple[float, float, float, float, bool]] = []
    points: list[tuple[float, float]] = []
    numbers: list[float] = []
    white = False
    for word in content(pdf).split():
        if re.fullmatch(r"-?[\d.]+", word):
            numbers.append(float(word))
            continue
        match word:
            case "rg" | "g":
                white = numbers[-1] > 0.5
            case "m" | "l":
                points.append((numbers[-2], numbers[-1]))
            case "re":
                x, y, width, height = numbers[-4:]
                points += [(x, y), (x + width, y + height)]
            case "f" | "f*":
                x, y = zip(*points, strict=True)
                found.append((min(x), min(y), max(x), max(y), white))
                points = []
            case "S" | "n" | "s":
                points = []
        numbers = []
    return found


def test_the_pdf_has_its_true_size(sgp, tmp_path) -> None:
    assert sgp("calibrate", "board", "--out", tmp_path / "b.pdf").code == 0
    pdf = (tmp_path / "b.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+)", pdf)
    assert box is not None
    np.testing.assert_allclose([float(v) / 72 * 25.4 for v in box.groups()], (297, 210), atol=0.01)
    density = 8  # pixels per mm
    page = np.full((210 * density, 297 * density), 255, np.uint8)
    for *edges, white in rectangles(pdf):
        left, low, right, high = np.array(edges) / 72 * 25.4
        part = np.rint(density * np.array([210 - high, 210 - low, left, right])).astype(int)
        page[part[0] : part[1], part[2] : part[3]] = 255 if white else 0
    board = read_board(tmp_path / "b.json")
    assert board == CharucoBoard(11, 8, 15.0)
    check_scale(page, board, density)


def check_scale(page: np.ndarray, board: CharucoBoard, density: float) -> None:
    """All corners are found, and at the distances of the board."""
    view = find_board(page, board)
    assert len(view.ids) == len(board.corners_mm)
    places = view.corners_px / density
    apart = places - places[0] - (board.corners_mm[view.ids] - board.corners_mm[view.ids[0]])
    assert np.abs(apart).max() < 1 / density


@pytest.mark.slow
def test_the_png_has_its_true_size(sgp, tmp_path) -> None:
    sgp(
        "calibrate", "board", "--squares", "5x4", "--square-mm", "12", "--out", tmp_path / "b.png"
    ).ok()
    data = (tmp_path / "b.png").read_bytes()
    at = data.index(b"pHYs") + 4
    per_m = int.from_bytes(data[at : at + 4], "big")
    assert per_m == pytest.approx(600 / 0.0254, rel=1e-4)
    page = read_image(tmp_path / "b.png")[..., 0]
    smaller = cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    check_scale(smaller, CharucoBoard(5, 4, 12.0), per_m / 1000 / 4)


@cases(
    ("words", "match"),
    {
        "suffix": (("--out", "b.txt"), "must end in .pdf or .png"),
        "too large": (("--out", "b.pdf", "--square-mm", "30"), "at most 20.* mm"),
        "squares": (("--out", "b.pdf", "--squares", "11"), "for example 11x8"),
        "dictionary": (("--out", "b.pdf", "--dictionary", "9x9"), "unknown"),
    },
)
def test_boards_that_are_refused(sgp, tmp_path, monkeypatch, words, match) -> None:
    monkeypatch.chdir(tmp_path)
    done = sgp("calibrate", "board", *words)
    assert done.code in (2, 4)
    assert re.search(match, done.err)
    assert not list(tmp_path.iterdir())


def test_files_are_not_overwritten(sgp, tmp_path) -> None:
    assert sgp("calibrate", "board", "--out", tmp_path / "b.pdf").code == 0
    before = (tmp_path / "b.pdf").read_bytes()
    assert sgp("calibrate", "board", "--out", tmp_path / "b.pdf").code == 2
    assert sgp("calibrate", "board", "--out", tmp_path / "b.pdf", "--force").code == 0
    assert (tmp_path / "b.pdf").read_bytes() == before


@pytest.mark.slow
def test_the_board_of_a_file_with_a_measured_size(sgp, views, tmp_path) -> None:
    page = tmp_path / "b.png"
    sgp("calibrate", "board", "--square-mm", "15", "--out", page)
    sgp(
        "calibrate", "camera", views / "shots", "--board", tmp_path / "b.json", "--square-mm", "20",
        "--working-plane", views / "flat.png", "--out", tmp_path / "out",
    ).ok()  # fmt: skip
    assert abs(read_camera(tmp_path / "out" / "camera.json").working_distance_mm - 600) < 1.5
    assert BOARD.square_mm == 20.0


@pytest.mark.slow
def test_recordings_of_the_simulated_board(sgp, tmp_path) -> None:
    """Sessions are views and the working plane, also those of a colour sensor."""
    sgp("simulate", "charuco", "--led-count", "4", "--out", tmp_path / "gray").ok()
    text = (tmp_path / "gray" / "derived" / "truth" / "scene.toml").read_text()
    scene = tmp_path / "gray" / "derived" / "truth" / "mosaic.toml"
    scene.write_text(text.replace("[lens]", '[lens]\ncfa = "RGGB"'))
    sgp("simulate", scene, "--out", tmp_path / "mosaic").ok()
    truth = read_camera(tmp_path / "gray" / "derived" / "truth" / "camera.json")
    lens, board = Lens(truth), ChArUco(10, 8, 26.0)
    for k, pose in enumerate(poses(52, 6, (20, 40))):
        save(tmp_path / "shots" / f"V{k}.png", shot(pose, k, lens, board, (300.0, 250.0)))
    for plane, other in (("gray", "mosaic"), ("mosaic", "gray")):
        words = ("--squares", "10x8", "--square-mm", "26", "--working-plane", tmp_path / plane)
        out = tmp_path / f"from {plane}"
        sources = (tmp_path / "shots", tmp_path / other)
        done = sgp("calibrate", "camera", *sources, *words, "--out", out).ok()
        camera = read_camera(out / "camera.json")
        assert abs(camera.K[0, 0] / truth.K[0, 0] - 1) < 5e-4
        assert abs(camera.working_distance_mm - 600) < 0.5
        assert read_record(out / "calibration.json").metrics["views"] == 7, done.err
