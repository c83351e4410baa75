"""A drawn recording: a matte hemisphere between two mirror spheres under distant lights."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SIZE = (200, 300)
OBJECT, BALLS, RADIUS = (150.0, 100.0), [(50.0, 60.0), (255.0, 140.0)], 30.0
OBJECT_RADIUS = 55.0
CIRCLES = [(x, y, RADIUS) for x, y in BALLS]


def directions(count=8):
    azimuth = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([0.6 * np.cos(azimuth), 0.6 * np.sin(azimuth), np.full(count, 0.8)], axis=1)


def normals_of(centre, radius):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    across, up = (x - centre[0]) / radius, (centre[1] - y) / radius
    square = across**2 + up**2
    return np.dstack([across, up, np.sqrt(np.clip(1 - square, 0, None))]), square < 1


def write_recording(folder: Path) -> None:
    """Write one 16-bit PNG for each light."""
    normals, inside = normals_of(OBJECT, OBJECT_RADIUS)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    for i, light in enumerate(directions()):
        image = np.where(inside, 0.5 * np.clip(normals @ light, 0, None), 0.004)
        half = light + np.array([0.0, 0, 1])
        half /= np.linalg.norm(half)
        for centre in BALLS:
            ball = np.clip(RADIUS - np.hypot(x - centre[0], y - centre[1]) + 0.5, 0, 1)
            place = centre[0] + RADIUS * half[0], centre[1] - RADIUS * half[1]
            spot = 0.8 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 1.2**2))
            image = image * (1 - ball) + (0.1 + spot) * ball
        cv2.imwrite(str(folder / f"L{i:02d}.png"), np.rint(65535 * image).astype(np.uint16))


def printed(folder: Path) -> np.ndarray:
    """Return the images of a recording, with paint on object and ground, ``(N, H, W)`` uint16."""
    write_recording(folder)
    made = np.array(
        [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(folder.glob("L*.png"))]
    ).astype(np.float64)
    rng = np.random.default_rng(3)
    paint = 1 + 0.6 * cv2.GaussianBlur(rng.normal(size=SIZE), (0, 0), 1.5)
    painted = (made + 4000) * np.clip(paint, 0.2, 2)
    on_ball = np.any([normals_of(ball, RADIUS + 1)[1] for ball in BALLS], axis=0)
    return np.where(on_ball, made, painted).clip(0, 65535).astype(np.uint16)
