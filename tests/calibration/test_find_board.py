"""Corners of ChArUco boards in images, and messages about images without a board."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import DataError, MissingPathError
from calibration import CharucoBoard, EstimateError, find_board, read_board
from calibration.camera import write_board
from calibration.camera.board import DICTIONARIES
from tests.calibration.board_series import BOARD, CAMERA, FLAT, corners, poses, shot
from tests.cases import cases
from tests.quick_sample import quick


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return shot(poses(21)[1], 5)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    return corners(poses(21)[1], np.random.default_rng(0), sigma_px=0.0)


@pytest.mark.parametrize(
    "changed",
    quick(
        [
            pytest.param(lambda i: i, id="float"),
            pytest.param(lambda i: np.rint(i / i.max() * 255).astype(np.uint8), id="8-bit"),
            pytest.param(lambda i: np.clip(i * 6, 0, 65535).astype(np.uint16), id="16-bit"),
            pytest.param(lambda i: np.stack([i, 0.7 * i, 0.4 * i], axis=-1), id="colour"),
            pytest.param(lambda i: i * np.linspace(0.2, 1, i.shape[1]), id="uneven light"),
            pytest.param(lambda i: i - 500, id="negative"),
        ],
        every=3,
    ),
)
def test_kinds_of_images(image, truth, changed) -> None:
    view = find_board(changed(image), BOARD)
    ids, a, b = np.intersect1d(view.ids, truth.ids, return_indices=True)
    assert len(ids) == len(view.ids) >= 40
    apart = view.corners_px[a] - truth.corners_px[b]
    assert np.sqrt(np.mean(apart**2)) < 0.02
    assert np.abs(apart.mean(axis=0)).max() < 0.005


def test_a_partly_visible_board(image, truth) -> None:
    part = image[:300, :400]
    view = find_board(part, BOARD)
    assert 8 <= len(view.ids) < len(truth.ids)


def test_points_are_those_of_opencv() -> None:
    inner = np.asarray(BOARD.in_opencv().getChessboardCorners())[:, :2]
    np.testing.assert_allclose(BOARD.corners_mm, inner, atol=1e-4)


@pytest.mark.parametrize("dictionary", ["4x4_50", "5x5_100", "6x6_250", "7x7_1000"])
def test_what_is_printed_is_opencv_s_board(dictionary) -> None:
    board = CharucoBoard(5, 4, 16.0, 12.0, dictionary)
    modules = (int(dictionary[0]) + 2) * 12  # pixels of a marker, 12 for each of its modules
    square = modules * 4 // 3
    scale = square / 16.0
    drawn = np.full((4 * square, 5 * square), 255, np.uint8)
    for rectangles, value in zip(board.black_mm(), (0, 255), strict=True):
        for x, y, width, height in np.rint(rectangles * scale).astype(int):
            drawn[y : y + height, x : x + width] = value
    expected = board.in_opencv().generateImage((5 * square, 4 * square), marginSize=0)
    assert np.mean(drawn != expected) < 0.01


@cases(
    ("picture", "board", "match"),
    {
        "mirrored": (lambda i: i[:, ::-1], BOARD, "is mirrored"),
        "nothing": (lambda i: np.ones_like(i), BOARD, "shows 0 markers"),
        "dictionary": (lambda i: i, CharucoBoard(11, 8, 20, None, "5x5_100"), "4x4"),
        "smaller": (lambda i: i, CharucoBoard(5, 4, 20), "marker .* is not on"),
        "columns": (lambda i: i, CharucoBoard(12, 8, 20), "another order"),
        "too-little": (lambda i: i[150:260, 150:260], BOARD, "fewer than 8|shows . marker"),
    },
)
def test_no_board(image, picture, board, match) -> None:
    with pytest.raises(EstimateError, match=match) as caught:
        find_board(picture(image), board, "a.png")
    assert str(caught.value).startswith("a.png: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("array", "match"),
    [
        pytest.param(np.zeros((5, 400)), "too few", id="small"),
        pytest.param(np.full((64, 64), np.nan), "not finite", id="nan"),
        pytest.param(np.zeros((64, 64, 4)), "not an image", id="channels"),
        pytest.param(np.zeros(64), "not an image", id="vector"),
    ],
)
def test_no_image(array, match) -> None:
    with pytest.raises(DataError, match=match):
        find_board(array, BOARD)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        pytest.param({"columns": 2}, "must be 3 to 60", id="columns"),
        pytest.param({"square_mm": 0.0}, "smaller than a square", id="zero"),
        pytest.param({"square_mm": np.nan}, "smaller than a square", id="nan"),
        pytest.param({"marker_mm": 20.0}, "smaller than a square", id="marker"),
        pytest.param({"dictionary": "3x3_9"}, "unknown", id="dictionary"),
        pytest.param({"columns": 20, "dictionary": "4x4_50"}, "80 markers", id="too many"),
    ],
)
def test_impossible_boards(options, match) -> None:
    with pytest.raises(DataError, match=match):
        CharucoBoard(**options)


def test_dictionaries_exist() -> None:
    for name in DICTIONARIES:
        CharucoBoard(3, 3, 10, None, name).in_opencv()


def test_board_files(tmp_path) -> None:
    board = CharucoBoard(9, 6, 12.5, 9.0, "5x5_100")
    write_board(tmp_path / "board.json", board)
    assert read_board(tmp_path / "board.json") == board
    with pytest.raises(MissingPathError, match="no such file"):
        read_board(tmp_path / "none.json")
    with pytest.raises(DataError, match=r"\.json"):
        write_board(tmp_path / "board.txt", board)


GOOD = (
    '{"format": "sgp-board", "version": 1, "columns": 9, "rows": 6, "square_mm": 12.5, '
    '"marker_mm": 9.0, "dictionary": "5x5_100"}'
)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        pytest.param("", "not a board.json", id="empty"),
        pytest.param(GOOD[:50], "not a board.json", id="cut"),
        pytest.param(GOOD.replace('"version": 1', '"version": 2'), "version", id="version"),
        pytest.param(GOOD.replace("12.5", "NaN"), "square_mm|JSON", id="nan"),
        pytest.param(GOOD.replace("columns", "cols"), "cols", id="unknown key"),
        pytest.param(GOOD.replace("5x5_100", "9x9"), "unknown", id="dictionary"),
        pytest.param("[" * 5000, "nested|JSON", id="deep"),
    ],
)
def test_damaged_board_files(tmp_path, text, match) -> None:
    path = tmp_path / "board.json"
    path.write_text(text)
    with pytest.raises(DataError, match=match) as caught:
        read_board(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_the_flat_board_is_where_the_lens_projects_it() -> None:
    view = find_board(shot(FLAT, 2), BOARD)
    true = corners(FLAT, np.random.default_rng(0), sigma_px=0.0, camera=CAMERA)
    ids, a, b = np.intersect1d(view.ids, true.ids, return_indices=True)
    assert len(ids) == 70
    assert np.abs(view.corners_px[a] - true.corners_px[b]).max() < 0.2
