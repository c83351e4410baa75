"""Cameras from views of a ChArUco board, against the simulator's lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from acquisition import CameraModel, DataError
from calibration import CharucoBoard, EstimateError, calibrate_camera, find_board
from calibration.camera import BoardView, find_working_plane
from simulator import Lens
from tests.calibration.board_series import (
    BOARD,
    CAMERA,
    FLAT,
    corners,
    poses,
    series,
    shot,
    shots,
    turned,
)
from tests.calibration.conftest import codes
from tests.cases import cases

FOUR = ((0, 0), (1, 1), (0, 2), (1, 2))


def pulls(seeds: range, camera: CameraModel = CAMERA) -> np.ndarray:
    """Return errors over standard deviations of fx, fy, cx, cy, working distance."""
    rows = []
    for seed in seeds:
        done = calibrate_camera(series(seed, camera=camera))
        flat = corners(FLAT, np.random.default_rng([seed, 9]), camera=camera)
        plane = find_working_plane(done, flat)
        errors = [done.camera.K[at] - camera.K[at] for at in FOUR]
        row = [
            e / done.sigma[name] for e, name in zip(errors, ("fx", "fy", "cx", "cy"), strict=True)
        ]
        distance = plane.camera.working_distance_mm - camera.working_distance_mm
        rows.append([*row, distance / plane.sigma_mm])
    return np.array(rows)


@pytest.mark.parametrize(
    ("distortion", "free"),
    [
        pytest.param((0, 0, 0, 0, 0), set(), id="none"),
        pytest.param((-0.12, 0.05, 0, 0, 0), {"k1", "k2"}, id="radial"),
        pytest.param((-0.12, 0.05, 0.002, 0.001, 0), {"k1", "k2", "p1", "p2"}, id="tangential"),
        pytest.param((-0.12, 0.5, 0.002, 0.001, -20), {"k1", "k2", "p1", "p2", "k3"}, id="all"),
    ],
)
def test_without_errors_the_camera_is_exact(distortion, free) -> None:
    camera = replace(CAMERA, distortion=np.array(distortion, float))
    done = calibrate_camera(series(1, sigma_px=0.0, camera=camera))
    np.testing.assert_allclose(done.camera.K, camera.K, atol=2e-2)
    if not free:
        assert np.abs(done.camera.distortion).max() < 1e-2
    else:
        assert set(done.sigma) - {"fx", "fy", "cx", "cy"} >= free
        assert abs(done.camera.distortion[0] - distortion[0]) < 1e-3


@pytest.mark.slow
def test_deviations_are_right() -> None:
    ratio = np.sqrt(np.mean(pulls(range(300, 320)) ** 2, axis=0))
    assert np.all((ratio > 0.7) & (ratio < 1.3)), ratio


@pytest.mark.slow
@pytest.mark.parametrize(
    "distortion",
    [
        pytest.param((0, 0, 0, 0, 0), id="none"),
        pytest.param((-0.12, 0.05, 0.002, 0.001, -0.1), id="all"),
    ],
)
def test_deviations_of_other_lenses_are_right(distortion) -> None:
    camera = replace(CAMERA, distortion=np.array(distortion, float))
    ratio = np.sqrt(np.mean(pulls(range(400, 420), camera) ** 2, axis=0))
    assert np.all((ratio > 0.7) & (ratio < 1.3)), ratio


@pytest.mark.slow
def test_fifteen_rendered_views() -> None:
    done = calibrate_camera([find_board(image, BOARD, f"{k}") for k, image in enumerate(shots(31))])
    K = done.camera.K
    assert abs(K[0, 0] / CAMERA.K[0, 0] - 1) < 5e-4
    assert abs(K[1, 1] / CAMERA.K[1, 1] - 1) < 5e-4
    assert np.abs(K[:2, 2] - CAMERA.K[:2, 2]).max() < 0.3
    assert done.sigma_px < 0.02
    plane = find_working_plane(done, find_board(shot(FLAT, 3), BOARD))
    assert abs(plane.camera.working_distance_mm - 600) < 0.5
    assert abs(plane.mm_per_px - 600 / CAMERA.focal_px) < 1e-3


def test_board_at_a_height_and_tilted() -> None:
    done = calibrate_camera(series(2))
    rng = np.random.default_rng(0)
    raised = corners((np.eye(3), np.array([0, 0, 5.0])), rng)
    plane = find_working_plane(done, raised, height_mm=5.0)
    assert abs(plane.camera.working_distance_mm - 600) < 5 * plane.sigma_mm + 0.05
    assert not plane.warnings
    leaning = corners((turned([1, 0, 0], np.radians(3)), np.zeros(3)), rng)
    plane = find_working_plane(done, leaning)
    assert abs(plane.tilt_deg - 3) < 0.1
    assert [notice.code for notice in plane.warnings] == ["working-plane-tilted"]


def test_another_focus_on_the_working_plane() -> None:
    done = calibrate_camera(series(2))
    other = replace(CAMERA, distortion=np.array([0.1, 0, 0, 0, 0]))
    view = corners(FLAT, np.random.default_rng(0), camera=other)
    found = [notice.code for notice in find_working_plane(done, view).warnings]
    assert "working-plane-contradicts" in found


def test_a_view_that_contradicts_is_left_out() -> None:
    views = series(3)
    rng = np.random.default_rng(1)
    views[4] = replace(
        views[4], corners_px=views[4].corners_px + rng.normal(0, 2, (len(views[4].ids), 2))
    )
    done = calibrate_camera(views)
    assert [one.used for one in done.views] == [k != 4 for k in range(15)]
    assert [n.where for n in done.warnings if n.code == "view-left-out"] == ["4.png"]
    assert abs(done.camera.K[0, 0] - CAMERA.K[0, 0]) < 5 * done.sigma["fx"]


def test_outliers_among_corners_are_left_out() -> None:
    views = series(3)
    views[4].corners_px[3] += (1.0, -1.0)
    done = calibrate_camera(views)
    assert not done.views[4].kept[3]
    assert sum((~one.kept).sum() for one in done.views) == 1
    assert "corners-left-out" in codes(done)


def test_views_of_one_place_are_one_view() -> None:
    rng = np.random.default_rng(5)
    views = series(4, 6)
    again = [corners(poses(4, 6)[0], rng, f"again{k}.png") for k in range(3)]
    done = calibrate_camera([*views, *again])
    assert len(done.views) == 6
    assert codes(done).count("views-alike") == 1
    # The mean of four has half the errors of one.
    truth = corners(poses(4, 6)[0], rng, sigma_px=0.0).corners_px
    rms = np.sqrt(np.mean((done.views[0].view.corners_px - truth) ** 2))
    assert 0.008 < rms < 0.025


def test_corners_of_the_image_that_no_view_covers() -> None:
    views = []
    for view in series(6):
        keep = np.any(view.corners_px > (250, 200), axis=1)
        views.append(replace(view, ids=view.ids[keep], corners_px=view.corners_px[keep]))
    done = calibrate_camera(views)
    assert "upper left" in done.bare_corners
    assert "field-not-covered" in codes(done)
    assert 0.2 < done.coverage < 1


def test_a_stretched_print() -> None:
    stretched = replace(CAMERA, K=CAMERA.K * [[1], [1.005], [1]])
    assert "pixels-not-square" in codes(calibrate_camera(series(7, camera=stretched)))
    assert "pixels-not-square" not in codes(calibrate_camera(series(7)))


def parallel(angle_deg: float) -> list[BoardView]:
    rng = np.random.default_rng(8)
    lean = turned([1, 0, 0], np.radians(angle_deg))
    return [
        corners(
            (lean @ turned([0, 0, 1], k), np.array([8.0 * k - 30, 5.0 * k, 6.0 * k])), rng, f"{k}"
        )
        for k in range(8)
    ]


@cases(
    ("views", "error", "match"),
    {
        "parallel": (lambda: parallel(0), EstimateError, "do not determine the focal"),
        "seen-once": (lambda: [series(1)[0]] * 4, EstimateError, "^1 view of"),
        "two": (lambda: series(1)[:2], EstimateError, "^2 views of"),
        "size": (
            lambda: [*series(1)[:3], replace(series(1)[3], size=(400, 300))],
            DataError,
            "3.png: 300 x 400 pixels, but 0.png has 640 x 512",
        ),
        "board": (
            lambda: [*series(1)[:3], replace(series(1)[3], board=CharucoBoard(12, 9, 20.0))],
            DataError,
            "3.png: shows another calibration board",
        ),
    },
)
def test_refused(views, error, match) -> None:
    with pytest.raises(error, match=match) as caught:
        calibrate_camera(views())
    assert "\n" not in str(caught.value)


def zoomed(factor: float) -> list[BoardView]:
    """Return views of which every second one has another focal length."""
    rng = np.random.default_rng(3)
    other = replace(CAMERA, K=CAMERA.K * [[factor], [factor], [1]])
    return [
        corners(pose, rng, f"{k}.png", camera=other if k % 2 else CAMERA)
        for k, pose in enumerate(poses(9))
    ]


@pytest.mark.parametrize(
    ("factor", "doubtful"), [pytest.param(1.0, False, id="same"), pytest.param(1.02, True, id="2%")]
)
def test_a_zoom_that_changed_leaves_a_pattern(factor, doubtful) -> None:
    assert ("camera-model-doubtful" in codes(calibrate_camera(zoomed(factor)))) is doubtful


def test_views_that_no_camera_explains() -> None:
    with pytest.raises(EstimateError, match="no camera explains"):
        calibrate_camera(zoomed(2.0))


@pytest.mark.slow
def test_a_lens_of_the_simulator_that_is_sharp_gives_the_same_corners() -> None:
    """Blur moves no corner: sharp and blurred views agree to .03 px."""
    pose = poses(12)[0]
    soft = find_board(shot(pose, 1), BOARD)
    sharp = find_board(shot(pose, 1, Lens(CAMERA)), BOARD)
    ids, a, b = np.intersect1d(soft.ids, sharp.ids, return_indices=True)
    assert len(ids) > 30
    assert np.sqrt(np.mean((soft.corners_px[a] - sharp.corners_px[b]) ** 2)) < 0.03
