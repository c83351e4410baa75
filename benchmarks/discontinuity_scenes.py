"""Surfaces with jumps in depth: simulated scenes, integrated without and with jumps.

The scenes are those of ``occlusion_scenes.py``, sharp and blurred by the lens, without noise and
with 3 degrees on each component of the normals. "error" is the mean over the scenes of the mean
absolute error in pixels after removal of the median; "ratio" is the geometric mean of the error
with jumps over that without, and "worst" the largest ratio. "spanning" counts triangles whose
corners differ by more than 6 px in true height, without and with jumps. "unsettled" counts surfaces
with the notice ``jumps-not-settled``. Parameters were chosen on the seeds 0 to 4.

    python benchmarks/discontinuity_scenes.py --first-seed 20 --seeds 3
"""

from __future__ import annotations

import numpy as np
from harness import command_line
from occlusion_scenes import KINDS, scene

import processing
from rig.arrays import Float64

STEP_PX = 6.0


def error_px(surface: processing.HeightMap, height: Float64) -> float:
    off = (surface.height - height)[surface.mask]
    return float(np.abs(off - np.median(off)).mean())


def spanning(surface: processing.HeightMap, height: Float64) -> int:
    """Return the number of triangles whose corners differ by more than STEP_PX in true height."""
    corners = height[surface.mask][processing.height_mesh(surface).faces]
    return int(np.count_nonzero(np.ptp(corners, axis=1) > STEP_PX))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--first-seed", type=int, default=20, help="first seed of the scenes")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--size", type=int, default=112, help="side of the scenes, pixels")
    parser.add_argument("--noise-deg", type=float, nargs="*", default=[0.0, 3.0], help="noise")
    parser.add_argument("--blur-px", type=float, nargs="*", default=[0.0, 0.6], help="blurs")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS), help="classes")
    options = parser.parse_args()
    print(
        f"{'scenes':8} {'noise':>5} {'error, plain':>12} {'jumps':>7} {'ratio':>6} {'worst':>6} "
        f"{'spanning':>15} {'unsettled':>9}"
    )
    for kind in options.kinds:
        for noise_deg in options.noise_deg:
            errors, triangles, moving = [], np.zeros(2, int), 0
            for blur_px in options.blur_px:
                for seed in range(options.first_seed, options.first_seed + options.seeds):
                    made = scene(kind, seed, options.size, blur_px)
                    normals = made.noisy(noise_deg, seed)
                    both = [
                        processing.integrate(normals, discontinuity=wanted)
                        for wanted in (False, True)
                    ]
                    errors.append([error_px(surface, made.height) for surface in both])
                    triangles += [spanning(surface, made.height) for surface in both]
                    moving += both[1].jumps is not None and not both[1].jumps.settled
            table = np.array(errors)
            ratios = table[:, 1] / table[:, 0]
            plain, jumps = table.mean(axis=0)
            print(
                f"{kind:8} {noise_deg:5.1f} {plain:12.3f} {jumps:7.3f} "
                f"{np.exp(np.log(ratios).mean()):6.2f} {ratios.max():6.2f} "
                f"{triangles[0]:7d} {triangles[1]:7d} {moving:5d}/{len(errors)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
