"""Stated against actual errors of what the model of the images does not contain.

Each scene is reconstructed as a user does it. For normals and heights, the columns are the root
mean square error, that which is stated, the ratio of both in ten parts by the stated one (lowest
and highest), and the rank correlation of actual and stated. Heights are those of the part with
the most pixels, without their mean. With `--strengths`, it is the strengths that
`--semi-calibrated` estimates: actual and stated deviation of their logarithms, and the root mean
square of their quotients. The true strengths are those of the scene.

    python -m benchmarks.model_errors leather head --seed 11
    python -m benchmarks.model_errors --strengths
    SGP_DATA=../shared/data python -m benchmarks.model_errors catPNG bearPNG
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import label
from scipy.stats import spearmanr

from acquisition import angle_deg
from benchmarks.imperfections.real import REAL
from benchmarks.imperfections.recordings import Recording
from benchmarks.imperfections.remedies import Remedy
from benchmarks.imperfections.scenes import SCENES, random_scene, scene
from processing import Reconstruction, integrate
from rig.arrays import Float64

_PARTS = 10


def recording(name: str, seed: int) -> Recording:
    """Return a scene of the table, a real object, or a random scene by its number."""
    if name.isdigit():
        return random_scene(int(name))
    return REAL[name]() if name in REAL else scene(name, seed)


def compared(actual: Float64, stated: Float64) -> str:
    """Return the columns of one map, of pixels ``(P,)``."""
    parts = [
        np.sqrt(np.mean(actual[part] ** 2) / np.mean(stated[part] ** 2))
        for part in np.array_split(np.argsort(stated), _PARTS)
    ]
    rank = spearmanr(np.abs(actual), stated).statistic
    rms = np.sqrt(np.mean(actual**2)), np.sqrt(np.mean(stated**2))
    return f"{rms[0]:7.2f} {rms[1]:7.2f}   {min(parts):5.2f} {max(parts):5.2f}   {rank:5.2f}"


def normals(made: Reconstruction, given: Recording) -> str:
    """Return the columns of the normals."""
    if given.normals is None:
        return "no true normals"
    sigma = made.uncertainty.sigma_deg
    seen = made.valid & given.mask & np.isfinite(sigma)
    angles = angle_deg(made.normals.normals, given.normals)
    return compared(angles[seen], sigma[seen].astype(np.float64))


def heights(made: Reconstruction, given: Recording) -> str:
    """Return the columns of the heights."""
    if given.height_mm is None:
        return ""
    bars = made.uncertainty
    depth = None if made.near_height is None else made.near_height.depth
    surface = integrate(
        made.normals,
        camera=given.camera,
        depth_mm=depth,
        sigma_deg=bars.sigma_deg,
        common_sigma_deg=bars.common_sigma_deg,
        weighted=False,
        height_errors=True,
    )
    if surface.uncertainty is None or surface.unit != "mm":
        return ""
    parts, _ = label(surface.mask)
    largest = parts == 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
    sigma = surface.uncertainty.sigma
    seen = largest & given.mask & np.isfinite(given.height_mm) & np.isfinite(sigma)
    off = (surface.height - given.height_mm)[seen]
    return compared(off - off.mean(), sigma[seen].astype(np.float64))


def strengths(given: Recording) -> str:
    """Return actual and stated deviations of the strengths, percent."""
    with TemporaryDirectory() as folder:
        made = given.reconstructed(
            Path(folder) / "images", Remedy(keywords={"semi_calibrated": True})
        )
    if made.strengths is None:
        return "no strengths"
    off = np.log(made.strengths.factors)
    sigma = made.strengths.sigmas
    rms = np.sqrt(np.mean(off**2)), np.sqrt(np.mean(sigma**2))
    quotient = np.sqrt(np.mean((off / sigma) ** 2))
    return f"{100 * rms[0]:6.2f} {100 * rms[1]:6.2f}   {rms[0] / rms[1]:5.2f} {quotient:5.2f}"


def main() -> None:
    """Print one line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=[*SCENES], help="names, or random numbers")
    parser.add_argument("--seed", type=int, default=11, help="seed of the scenes")
    parser.add_argument("--strengths", action="store_true", help="strengths instead of normals")
    options = parser.parse_args()
    for name in options.scenes:
        given = recording(name, options.seed)
        if options.strengths:
            print(f"{name:10} {len(given.lights):3} lights  {strengths(given)}", flush=True)
            continue
        with TemporaryDirectory() as folder:
            made = given.reconstructed(Path(folder) / "images")
        blur = "" if made.blur is None else f"blur {made.blur.sigma_px:.2f} px"
        print(f"{name:10} normals {normals(made, given)}   {blur}", flush=True)
        print(f"{'':10} heights {heights(made, given)}", flush=True)


if __name__ == "__main__":
    main()
