"""Surfaces with jumps in depth: simulated scenes, smooth, by default, and with jumps in any case.

The scenes are those of ``occlusion_scenes.py``, sharp and blurred by the lens, with several noises
on each component of the normals and several sharpnesses k. Errors are means over the scenes of the
mean absolute error in pixels after removal of the median; "ratio" is the geometric mean of the
default error over the smooth one, and "worst" the largest ratio. "share" is the share of pairs of
neighbours between which the true surface jumps, "jumping" the share of scenes in which the default
has jumps, "spanning" counts triangles by default whose corners differ by more than 6 px in true
height. Parameters were chosen on the seeds 0 to 4 and 100 to 119.

    python benchmarks/discontinuity_scenes.py --out docs/measured/surface-scenes.csv
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from harness import Table, command_line
from occlusion_scenes import KINDS, scene

import processing
from processing.surface.jumps import SHARPNESS
from rig.arrays import Float64

STEP_PX = 6.0


def error_px(surface: processing.HeightMap, height: Float64) -> float:
    off = (surface.height - height)[surface.mask]
    return float(np.abs(off - np.median(off)).mean())


def spanning(surface: processing.HeightMap, height: Float64) -> int:
    """Return the number of triangles whose corners differ by more than STEP_PX in true height."""
    corners = height[surface.mask][processing.height_mesh(surface).faces]
    return int(np.count_nonzero(np.ptp(corners, axis=1) > STEP_PX))


def share_of_jumps(height: Float64) -> float:
    """Return the share of pairs of neighbours that differ by more than STEP_PX."""
    steps = np.concatenate([np.diff(height, axis=axis).ravel() for axis in (0, 1)])
    return float(np.mean(np.abs(steps) > STEP_PX))


def row_of(
    kind: str, noise_deg: float, k: float, blurs: list[float], seeds: range, size: int
) -> dict[str, str]:
    """Return the row of scenes of a kind."""
    errors, spanned, jumping, shares = [], 0, 0, []
    for blur_px in blurs:
        for seed in seeds:
            made = scene(kind, seed, size, blur_px)
            normals = made.noisy(noise_deg, seed)
            surfaces = [
                processing.integrate(normals, discontinuity=wanted, k=k)
                for wanted in (False, None, True)
            ]
            errors.append([error_px(surface, made.height) for surface in surfaces])
            spanned += spanning(surfaces[1], made.height)
            jumping += surfaces[1].jumps is not None
            shares.append(share_of_jumps(made.height))
    table = np.array(errors)
    ratios = table[:, 1] / table[:, 0]
    smooth, default, jumps = table.mean(axis=0)
    return {
        "scenes": kind,
        "noise_deg": f"{noise_deg:g}",
        "k": f"{k:g}",
        "share": f"{np.mean(shares):.4f}",
        "smooth": f"{smooth:.3f}",
        "default": f"{default:.3f}",
        "jumps": f"{jumps:.3f}",
        "ratio": f"{np.exp(np.log(ratios).mean()):.3f}",
        "worst": f"{ratios.max():.3f}",
        "jumping": f"{jumping / len(table):.2f}",
        "spanning": str(spanned),
    }


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first-seed", type=int, default=300, help="first seed of the scenes")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--size", type=int, default=112, help="side of the scenes, pixels")
    parser.add_argument("--noise-deg", type=float, nargs="*", default=[0, 1, 3, 6], help="noise")
    parser.add_argument("--k", type=float, nargs="*", default=[1, 2, 8, 16], help="other k")
    parser.add_argument("--blur-px", type=float, nargs="*", default=[0.0, 0.6], help="blurs")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS), help="classes")
    parser.add_argument("--out", type=Path, help="table (.csv)")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    settings = [(noise, SHARPNESS) for noise in options.noise_deg]
    settings += [(1.0, k) for k in options.k]
    table = Table(options.out)
    for kind in options.kinds:
        for noise_deg, k in settings:
            table.add(row_of(kind, noise_deg, k, options.blur_px, seeds, options.size))


if __name__ == "__main__":
    main()
