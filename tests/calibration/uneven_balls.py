"""Drawn images of a mirror ball in front of a horizon, whose outline is uneven or partly dark."""

import functools

import cv2
import numpy as np

HEIGHT, WIDTH, FINE = 240, 280, 3


def uneven_ball(seed, lights=8):
    """Return ``(N, H, W)`` images, (x, y, radius) of the ball in pixels, and ``(N, 3)`` directions.

    The ball mirrors what is behind it near its limb, up to an uneven border, and a dark room
    farther inside; a window, a post and texture are drawn at random, and the lower part of the
    background may be black.
    """
    values, circle, directions = _drawn(seed, lights)
    return values.copy(), circle, directions.copy()


@functools.lru_cache(maxsize=8)  # many tests draw the same few balls
def _drawn(seed, lights):
    rng = np.random.default_rng(seed)
    radius = rng.uniform(35, 80)
    x, y = WIDTH / 2 + rng.uniform(-25, 25), HEIGHT / 2 + rng.uniform(-25, 25)
    rows, columns = (np.mgrid[: HEIGHT * FINE, : WIDTH * FINE] + 0.5) / FINE - 0.5

    def texture(scale, contrast):
        shape = (int(HEIGHT / scale) + 2, int(WIDTH / scale) + 2)
        return np.exp(contrast * _large(rng.normal(size=shape), HEIGHT * FINE))

    bright = rng.uniform(0.1, 0.5) * texture(60, 0.25)
    bright *= texture(rng.uniform(4, 15), rng.uniform(0, 0.35))
    dark = bright * rng.choice([0.02, 0.1, 0.5])
    level = y + rng.uniform(-0.2, 0.9) * radius + rng.uniform(-0.3, 0.3) * (columns - x)
    level = level + _large(rng.normal(size=(1, 12)), 1) * rng.uniform(0, 6)
    behind = np.where(rows > level, dark, bright)
    u, v = (columns - x) / radius, (rows - y) / radius
    depth = np.hypot(u, v)
    angle = np.arctan2(v, u)
    farther = radius * (1 + 3 * np.sqrt(np.clip(1 - depth, 0, 1))) / np.maximum(depth, 1e-6)
    at = (np.stack([x + u * farther, y + v * farther]) + 0.5) * FINE
    at = np.clip(at, 0, np.array([WIDTH, HEIGHT])[:, None, None] * FINE - 1).astype(int)
    mirrored = rng.uniform(0.4, 0.8) * behind[at[1], at[0]]
    border = rng.uniform(0.7, 0.8) + rng.choice([0.03, 0.06]) * sum(
        rng.normal() * np.cos(k * angle + rng.uniform(0, 6)) for k in range(1, 5)
    )
    ball = np.where(depth > border, mirrored, rng.uniform(0.005, 0.08))
    if rng.random() < 0.6:
        aside = np.abs(np.angle(np.exp(1j * (angle - rng.uniform(0, 2 * np.pi)))))
        low = rng.uniform(0.75, 0.92)
        window = (depth > low) & (depth < low + rng.uniform(0.03, 0.07))
        ball = np.where(window & (aside < rng.uniform(0.2, 0.6)), rng.uniform(0.3, 1), ball)
    if rng.random() < 0.5:
        aside = np.abs(columns - x - rng.uniform(-0.2, 0.2) * radius)
        post = (aside < rng.uniform(0.1, 0.4) * radius) & (rows > y)
        behind = np.where(post, rng.uniform(0.01, 0.15), behind)
    scene = np.where(depth < 1, ball, behind).astype(np.float32)
    blurred = cv2.GaussianBlur(scene, (0, 0), rng.uniform(0.4, 1.2) * FINE)
    base = cv2.resize(blurred, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    images, directions = [], []
    for _ in range(lights):
        tilt, turn = rng.uniform(0.1, 0.9), rng.uniform(0, 2 * np.pi)
        direction = np.array(
            [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
        )
        normal = direction + np.array([0, 0, 1])
        normal /= np.linalg.norm(normal)
        off = np.hypot(columns - x - radius * normal[0], rows - y + radius * normal[1])
        fading = 1 + rng.uniform(-0.3, 0.3) * (columns - x) / WIDTH
        image = base * rng.uniform(0.6, 1.4) * fading + 8 * np.exp(-0.5 * (off / 1.5) ** 2)
        image += rng.normal(size=image.shape) * 0.003 * np.sqrt(image + 0.05)
        images.append(np.where(image > 1, np.nan, image))
        directions.append(direction)
    return np.array(images, np.float32), (x, y, radius), np.array(directions)


def _large(values, height):
    return cv2.resize(
        values.astype(np.float32), (WIDTH * FINE, height), interpolation=cv2.INTER_CUBIC
    )


def wrong_circle(seed, circle):
    """Return a circle that is off by 1 to 12 px in position and radius together."""
    rng = np.random.default_rng((seed, 1))
    change = rng.normal(size=3)
    return tuple(circle + rng.uniform(1, 12) * change / np.linalg.norm(change))
