"""Errors of calibrated cameras over series of simulated views, relative to their deviations.

Each series has 15 views of a ChArUco board at random poses, with blur, shot noise and read noise.
The figures are the errors of focal length and principal point, and the root mean square of errors
over standard deviations, which should be 1.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from harness import command_line

from acquisition import CameraModel
from calibration import calibrate_camera, find_board
from calibration.camera import find_working_plane
from simulator import Lens
from tests.calibration.board_series import BOARD, CAMERA, FLAT, poses, shot

LENSES = {
    "k1 k2": CAMERA.distortion,
    "all five": np.array([-0.12, 0.05, 0.002, 0.001, -0.1]),
    "none": np.zeros(5),
}
NAMES = ("fx", "fy", "cx", "cy")


def errors(seed, views, distortion):
    """Return errors and standard deviations of NAMES and of the working distance."""
    camera: CameraModel = replace(CAMERA, distortion=distortion)
    lens = Lens(camera, sharp=False)
    images = [shot(pose, 1000 * seed + k, lens) for k, pose in enumerate(poses(seed, views))]
    found = [find_board(image, BOARD, f"{k}") for k, image in enumerate(images)]
    done = calibrate_camera(found)
    plane = find_working_plane(done, find_board(shot(FLAT, seed, lens), BOARD))
    got, true = done.camera.K, camera.K
    error = [got[at] - true[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2))]
    sigma = [done.sigma[name] for name in NAMES]
    distance_mm = plane.camera.working_distance_mm - camera.working_distance_mm
    return [*error, distance_mm], [*sigma, plane.sigma_mm], done.sigma_px


def main():
    parser = command_line(__doc__)
    parser.add_argument("--series", type=int, default=20)
    parser.add_argument("--views", type=int, default=15)
    parser.add_argument("--first-seed", type=int, default=900)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    print(f"{options.series} series of {options.views} views, {CAMERA.width} x {CAMERA.height} px")
    seeds = range(options.first_seed, options.first_seed + options.series)
    with ProcessPoolExecutor(options.workers) as pool:
        for lens, distortion in LENSES.items():
            jobs = [pool.submit(errors, seed, options.views, distortion) for seed in seeds]
            results = [job.result() for job in jobs]
            error, sigma = (np.array([one[k] for one in results]) for k in (0, 1))
            print(f"\nlens {lens}, corners {np.mean([one[2] for one in results]):.3f} px")
            print("                  rms error   largest   error / deviation")
            units = ["%", "%", "px", "px", "mm"]
            for k, name in enumerate((*NAMES, "distance")):
                scale = 100 / CAMERA.K[0, 0] if k < 2 else 1.0
                e, ratio = error[:, k] * scale, error[:, k] / sigma[:, k]
                print(
                    f"{name:10} {units[k]:3} {np.sqrt(np.mean(e**2)):11.4f} "
                    f"{np.abs(e).max():9.4f} {np.sqrt(np.mean(ratio**2)):10.2f}"
                )


if __name__ == "__main__":
    main()
