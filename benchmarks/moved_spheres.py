"""Errors of light positions with two spheres, and with the same spheres moved.

The simulator renders two recordings of 8 LEDs and two chrome spheres of 20 and 14 mm, which lie in
opposite corners of the field, the second time in the other two. The images are without noise, and
not saturated, as merged brackets are. The spheres are searched for, and their radii are given. The
errors are means over the lights; docs/light-setup.md has them.
"""

from dataclasses import replace

import numpy as np
from harness import command_line

from calibration import calibrate_moved_spheres, calibrate_spheres
from simulator import render, scene_named

RADII_MM = (20.0, 14.0)
PLACES = (((-92, 58), (84, -66)), ((-88, -62), (86, 64)))


def recording(places, width, leds):
    """Return the linear images, the camera, and the true positions of the lights."""
    scene = scene_named("spheres", width=width, height=round(width * 4 / 5), leds=leds)
    spheres = [
        replace(scene.spheres[0], centre_mm=(float(x), float(y), radius), radius_mm=radius)
        for (x, y), radius in zip(places, RADII_MM, strict=True)
    ]
    rendering = render(replace(scene, spheres=tuple(spheres)))
    white = np.percentile(rendering.planes, 99)
    images = (rendering.planes / white).astype(np.float32)
    return images, rendering.truth.camera, rendering.truth.lights.positions_mm


def main():
    parser = command_line(__doc__)
    parser.add_argument("--width", type=int, default=640, help="width of the images in pixels")
    parser.add_argument("--leds", type=int, default=8)
    options = parser.parse_args()
    recordings = [recording(places, options.width, options.leds) for places in PLACES]
    images = [one[0] for one in recordings]
    _, camera, truth_mm = recordings[0]
    results = {
        name: calibrate_spheres(one, camera=camera, radius_mm=RADII_MM)
        for name, one in zip(("first", "moved"), images, strict=True)
    }
    results["both"] = calibrate_moved_spheres(images, camera=camera, radius_mm=RADII_MM)
    for name, result in results.items():
        error_mm = np.linalg.norm(result.lights.positions_mm - truth_mm, axis=1).mean()
        print(f"{name:6} {len(result.spheres)} spheres  {error_mm:.2f} mm")


if __name__ == "__main__":
    main()
