"""Recordings of real objects, from the folder that SGP_DATA names."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from acquisition import Lights, read_source
from benchmarks.imperfections.recordings import BRIGHTEST, Recording
from calibration import calibrate_spheres, raw_stack
from rig.arrays import Bool, Float32

_COUNT = 36
# Images of the bear that are up to a quarter too bright for their stated intensities.
_FAULTY = 20


def data_folder() -> Path:
    """Return the folder of real data, or end the program."""
    if "SGP_DATA" not in os.environ:
        raise SystemExit("SGP_DATA is not set: it names the folder of the data")
    return Path(os.environ["SGP_DATA"])


def diligent(name: str, first: int = 0, count: int = _COUNT) -> Recording:
    """Return an object of DiLiGenT under lights that are spread over those it has."""
    source = read_source(data_folder() / "diligent" / name)
    if source.lights is None or source.mask is None or source.normals_truth is None:
        raise SystemExit(f"{source.path} has no lights, no mask, or no true normals")
    chosen = np.linspace(first, len(source.frames) - 1, count).round().astype(int)
    images = np.stack([source.frames[i].read() for i in chosen]).astype(np.float32)
    images *= np.float32(BRIGHTEST / np.percentile(images[:, source.mask], 99.9))
    lights = source.lights.take([int(i) for i in chosen])
    return Recording(name, images, lights, None, source.mask, source.normals_truth, None)


def washington(name: str) -> Recording:
    """Return an object of the University of Washington, under lights from the mirror ball.

    Only the shape of the gray ball is known.
    """
    chrome = read_source(data_folder() / "uw" / "chrome")
    if chrome.mask is None:
        raise SystemExit(f"{chrome.path} has no mask")
    lights = calibrate_spheres(raw_stack(chrome), masks=[chrome.mask]).lights
    source = read_source(data_folder() / "uw" / name)
    if source.mask is None:
        raise SystemExit(f"{source.path} has no mask")
    images = np.stack([frame.read() for frame in source.frames]).astype(np.float32)
    images /= np.float32(255)
    lights = Lights(directions=lights.unit_directions)
    normals = _ball_normals(source.mask) if name == "gray" else None
    return Recording(name, images, lights, None, source.mask, normals, None)


def _ball_normals(mask: Bool) -> Float32:
    rows, columns = np.nonzero(mask)
    middle = [(i.min() + i.max()) / 2 for i in (rows, columns)]
    radius = [(i.max() - i.min() + 1) / 2 for i in (rows, columns)]
    y, x = np.indices(mask.shape)
    y, x = -(y - middle[0]) / radius[0], (x - middle[1]) / radius[1]
    ball = np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, None))], axis=2)
    ball /= np.maximum(np.linalg.norm(ball, axis=2, keepdims=True), 1e-9)
    return (ball * mask[..., None]).astype(np.float32)


REAL: dict[str, Callable[[], Recording]] = {
    "catPNG": partial(diligent, "catPNG"),
    "bearPNG": partial(diligent, "bearPNG", _FAULTY),
    "bearPNG-all": partial(diligent, "bearPNG"),
    "buddha": partial(washington, "buddha"),
    "cat": partial(washington, "cat"),
    "gray": partial(washington, "gray"),
}
