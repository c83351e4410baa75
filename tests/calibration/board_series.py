"""Views of a ChArUco board at random poses: rendered, or as corners with random errors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration import CharucoBoard
from calibration.camera import BoardView
from rig.arrays import Float32, Float64
from simulator import Lens
from simulator.rendering import board_view
from simulator.shapes import ChArUco

Pose = tuple[Float64, Float64]

BOARD = CharucoBoard(11, 8, 20.0)
PRINT = ChArUco(BOARD.columns, BOARD.rows, BOARD.square_mm)
SHEET_MM = (250.0, 190.0)
K = np.array([[1307.2, 0.0, 325.5], [0.0, 1307.9, 250.0], [0.0, 0.0, 1.0]])
CAMERA = CameraModel(K, 640, 512, 600.0, np.array([-0.12, 0.05, 0.0, 0.0, 0.0]))
FLAT: Pose = (np.eye(3), np.zeros(3))

_ELECTRONS, _READ_E = 8000.0, 8.0


def turned(axis: npt.ArrayLike, angle: float) -> Float64:
    """Rodrigues' rotation by an angle in radians about a unit axis."""
    x, y, z = np.asarray(axis, np.float64)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def poses(seed: int, count: int = 15, tilt_deg: tuple[float, float] = (15, 40)) -> list[Pose]:
    """Return poses tilted in all directions, with the board anywhere in the field."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        tilt = np.radians(rng.uniform(*tilt_deg))
        toward = 2 * np.pi * (k + rng.uniform()) / count
        lean = turned([np.cos(toward), np.sin(toward), 0], tilt)
        spin = turned([0, 0, 1], np.radians(rng.uniform(-180, 180)))
        centre = rng.uniform([-80, -60, -40], [80, 60, 60])
        found.append((lean @ spin, centre))
    return found


def shot(
    pose: Pose,
    key: int,
    lens: Lens | None = None,
    printed: ChArUco = PRINT,
    sheet_mm: tuple[float, float] = SHEET_MM,
) -> Float32:
    """Return an image with blur, shot noise and read noise, in electrons."""
    lens = lens or Lens(CAMERA, sharp=False)
    image = board_view(lens, printed, *pose, sheet_mm=sheet_mm)
    rng = np.random.default_rng(key)
    noisy = rng.poisson(image * _ELECTRONS) + rng.normal(0, _READ_E, image.shape)
    return noisy.astype(np.float32)


def shots(seed: int, count: int = 15) -> Iterator[Float32]:
    for k, pose in enumerate(poses(seed, count)):
        yield shot(pose, 1000 * seed + k)


def corners(
    pose: Pose,
    rng: np.random.Generator,
    name: str = "view",
    sigma_px: float = 0.03,
    camera: CameraModel = CAMERA,
) -> BoardView:
    """Return corners with normally distributed errors, projected by the simulator's lens."""
    turn, centre = pose
    flat = (BOARD.corners_mm - np.array(BOARD.size_mm) / 2) * (1, -1)
    places = Lens(camera).project(np.pad(flat, ((0, 0), (0, 1))) @ turn.T + centre)
    places = places + rng.normal(0, sigma_px, places.shape)
    seen = np.all((places > 5) & (places < np.array([camera.width, camera.height]) - 6), axis=1)
    return BoardView(name, BOARD, camera.size, np.flatnonzero(seen), places[seen])


def series(seed: int, count: int = 15, **options: object) -> list[BoardView]:
    rng = np.random.default_rng([seed, 7])
    return [corners(pose, rng, f"{k}.png", **options) for k, pose in enumerate(poses(seed, count))]
