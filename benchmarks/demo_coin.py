"""What the lens costs the normals of the demo's coin, and the bowl of its surface.

The rows are mean angles to the normals at the pixel centres, of images without noise under the true
lights at the true points: of sharp images, and of images that the lens blurs. "lens alone" is the
angle of the mean of albedo times normal over the point-spread function, which is what the lens
leaves of the normals whatever estimates them. With the folder of a finished `sgp demo`, its normals
and its height are compared as well: the bowl is the mean error of the height within a quarter of
the radius of the coin, minus that of its outer tenth.

    sgp demo --out demo && python benchmarks/demo_coin.py --demo demo
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import command_line

from acquisition import read_image
from processing import NormalMap, angular_error, photometric_stereo, read_normals
from processing.stereo import METHODS
from rig.arrays import Float32
from simulator import Rendering, Truth, render, resolved_normals, scene_named


def mean_deg(found: NormalMap, truth: Truth) -> float:
    """Return the mean angle to the true normals."""
    return angular_error(found, truth.normals, truth.mask).mae_deg


def print_methods(label: str, of: Rendering) -> None:
    """Print the errors of all methods on images without noise."""
    truth = of.truth
    strengths = np.asarray(truth.lights.intensities).mean(axis=1)
    values = np.asarray(of.planes / strengths[:, None, None], np.float32)
    values /= np.float32(values[:, truth.mask].max())
    points = np.where(truth.mask[..., None], truth.points_mm, 0.0)
    errors = {
        method: mean_deg(
            photometric_stereo(
                values, truth.lights, truth.mask, method=method, points_mm=points
            ).normal_map,
            truth,
        )
        for method in METHODS
    }
    cells = "  ".join(f"{method} {error:.3f}" for method, error in errors.items())
    print(f"{label:24}{cells}", flush=True)


def bowl_mm(height: Float32, truth: Truth) -> float:
    """Return the mean error of a height at the centre of the object minus that at its rim, mm."""
    rows, columns = np.nonzero(truth.mask)
    away = np.hypot(rows - rows.mean(), columns - columns.mean())
    away /= away.max()
    error = (height - truth.height_mm)[truth.mask]
    return float(np.nanmean(error[away < 0.25]) - np.nanmean(error[away > 0.9]))


def main() -> None:
    """Print the rows."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=0, help="seed of the coin, as of `sgp demo`")
    parser.add_argument("--demo", type=Path, help="folder of `sgp demo` with this seed")
    options = parser.parse_args()
    scene = scene_named("coin", seed=options.seed)
    sharp = render(replace(scene, ambient=0.0, lens=replace(scene.lens, sharp=True)))
    print_methods("sharp", sharp)
    del sharp
    blurred = render(replace(scene, ambient=0.0))
    print_methods("blurred", blurred)
    truth = blurred.truth
    lens = NormalMap.from_vectors(resolved_normals(truth), truth.mask)
    print(f"{'lens alone':24}{mean_deg(lens, truth):.3f}")
    if options.demo is not None:
        found = read_normals(options.demo / "normals").normal_map
        height = read_image(options.demo / "surface" / "height.exr")
        print(f"{'sgp demo':24}{mean_deg(found, truth):.3f}")
        print(f"{'bowl of its surface':24}{bowl_mm(height, truth):+.4f} mm")


if __name__ == "__main__":
    main()
