"""How many chrome spheres, where and how large: errors of the lights, for docs/light-setup.md.

Each row draws outlines and highlights of 36 lights at 450 mm, with the errors that
light_uncertainty.py states, and compares the positions that follow from them with the true ones.
The camera has a focal length of 5000 px and a field of 290 x 245 mm at 600 mm, unless the row names
another. The last tables have no observation errors: they show what a wrong radius, distance or
focal length costs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from harness import command_line
from light_uncertainty import COMMON_PX, HIGHLIGHT_PX, camera, dome, outline_points

from acquisition import CameraModel, angle_deg
from calibration import EstimateError
from calibration.spheres.outline.outline_noise import viewing_cone
from calibration.spheres.solve.joint_refinement import Observation, predicted_highlights
from calibration.spheres.solve.light_positions import locate_lights
from calibration.spheres.solve.sphere_positions import place
from rig.arrays import Float64

CORNERS = [(-105, -82), (105, 82), (-105, 82), (105, -82)]
PLACES: dict[str, list[tuple[float, float]]] = {
    "2, opposite corners": CORNERS[:2],
    "3, corners": CORNERS[:3],
    "4, corners": CORNERS,
    "6, rim": [*CORNERS, (0, -82), (0, 82)],
    "2, 50 mm apart": [(-25, 0), (25, 0)],
    "4, in a row": [(-105, 0), (-35, 0), (35, 0), (105, 0)],
    "4, 50 mm apart": [(-25, -25), (25, 25), (-25, 25), (25, -25)],
}
RADII_MM = (6.0, 10.0, 15.0, 20.0, 30.0)


def lights_of(
    model: CameraModel,
    places: list[tuple[float, float]],
    radius_mm: float,
    *,
    rng: np.random.Generator | None = None,
    assumed: CameraModel | None = None,
    assumed_radius_mm: float | None = None,
) -> Float64:
    """Return the positions ``(36, 3)`` found with spheres that rest at these places.

    Without ``rng`` the observations are exact. ``assumed`` is what the operator states.
    """
    centres = np.array([(x, y, radius_mm) for x, y in places], np.float64)
    radii = np.full(len(centres), radius_mm)
    truth = dome()
    exact = Exact() if rng is None else rng
    common_px = float(exact.normal(0, COMMON_PX))
    assumed = assumed or model
    cones = [
        viewing_cone(
            assumed.rays(outline_points(model, centre, radius_mm, exact, common_px)),
            1 / assumed.focal_px,
        )
        for centre in centres
    ]
    highlights = predicted_highlights(model, centres, radii, truth)
    sigma_px = np.full(highlights.shape[:2], float(np.sqrt(np.prod(HIGHLIGHT_PX))))
    if rng is not None:
        sigma_px = np.exp(rng.uniform(*np.log(HIGHLIGHT_PX), sigma_px.shape))
        highlights = highlights + rng.normal(0, 1, highlights.shape) * sigma_px[..., None]
    given = np.full(len(centres), assumed_radius_mm or radius_mm)
    ids = tuple(f"L{i:02d}" for i in range(len(truth)))
    seen = Observation(assumed, place(cones, given, assumed), highlights, sigma_px)
    located = locate_lights(seen, ids)
    found: Float64 = located.refined.positions_mm
    return found


class Exact(np.random.Generator):
    """A generator without errors."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def normal(self, loc=0.0, scale=1.0, size=None):  # type: ignore[no-untyped-def,override]
        return np.zeros(() if size is None else size) + loc


def error(found: Float64) -> tuple[float, float]:
    """Return the mean error in mm, and that of the direction from the origin in degrees."""
    truth = dome()
    shift = np.linalg.norm(found - truth, axis=1).mean()
    return float(shift), float(angle_deg(found, truth).mean())


def tilt_deg(found: Float64) -> float:
    """Return the mean error in degrees of the normals of a flat object that fills the field.

    The true lights shine on a matte surface with equal irradiances at the origin; the normals are
    computed by least squares with the lights found.
    """
    x, y = np.meshgrid(np.linspace(-140, 140, 15), np.linspace(-118, 118, 13))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 1, 3)

    def light_vectors(lights: Float64) -> Float64:
        toward = lights - points
        squared = (lights**2).sum(axis=1) / (toward**2).sum(axis=2)
        return toward / np.linalg.norm(toward, axis=2, keepdims=True) * squared[..., None]

    brightness = light_vectors(dome())[..., 2:]
    normals = (np.linalg.pinv(light_vectors(found)) @ brightness)[..., 0]
    return float(angle_deg(normals, np.array([0.0, 0.0, 1.0])).mean())


def noisy(model: CameraModel, name: str, radius_mm: float, seeds: range) -> str:
    """Return mean errors; how many draws were refused; or that such spheres would touch."""
    places = np.array(PLACES[name], np.float64)
    gaps = np.linalg.norm(places[:, None] - places, axis=-1) + 1e9 * np.eye(len(places))
    if gaps.min() <= 2 * radius_mm:
        return "touch"
    figures = []
    for seed in seeds:
        try:
            rng = np.random.default_rng(seed)
            figures.append(error(lights_of(model, PLACES[name], radius_mm, rng=rng)))
        except EstimateError:
            continue
    if len(figures) < len(seeds):
        return f"refused {len(seeds) - len(figures)}/{len(seeds)}"
    mm, deg = np.mean(figures, axis=0)
    return f"{mm:5.2f} {deg:5.3f}"


def smaller(model: CameraModel, factor: float) -> CameraModel:
    """Return the camera with fewer pixels for the same field."""
    K = model.K.copy()
    K[:2] *= factor
    width, height = round(model.width * factor), round(model.height * factor)
    return CameraModel(K, width, height, model.working_distance_mm)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="draws of each row")
    parser.add_argument("--first", type=int, default=7000)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    model = camera()

    print("Error of the lights, mm and deg, by number and place (rows) and radius (columns)")
    print(" " * 20 + "".join(f"{f'R{radius:g} mm':>14}" for radius in RADII_MM))
    for name in PLACES:
        cells = [noisy(model, name, radius, seeds) for radius in RADII_MM]
        print(f"{name:20}" + "".join(f"{cell:>14}" for cell in cells))

    print("\nThe same for 4 in the corners, with fewer pixels for the same field")
    for factor in (1.0, 0.5, 0.25):
        less = smaller(model, factor)
        cells = [noisy(less, "4, corners", radius, seeds) for radius in RADII_MM]
        label = f"{less.width} x {less.height} px"
        print(f"{label:20}" + "".join(f"{cell:>14}" for cell in cells))

    print("\nCost of a wrong input for 4 x R20 in the corners, without other errors: mm and deg of")
    print("the lights, and mean error in degrees of the normals of a flat object in the field")
    print(" " * 20 + "".join(f"{f'{percent:g} %':>20}" for percent in (0.1, 0.5, 1, 2, 5)))
    distance = float(model.working_distance_mm or 0)
    for label in ("radius", "working distance", "focal length"):
        cells = []
        for percent in (0.1, 0.5, 1, 2, 5):
            factor = 1 + percent / 100
            assumed, radius = model, 20.0
            if label == "radius":
                radius *= factor
            elif label == "working distance":
                assumed = replace(model, working_distance_mm=distance * factor)
            else:
                K = model.K.copy()
                K[0, 0] *= factor
                K[1, 1] *= factor
                assumed = replace(model, K=K)
            found = lights_of(
                model, PLACES["4, corners"], 20.0, assumed=assumed, assumed_radius_mm=radius
            )
            mm, deg = error(found)
            cells.append(f"{mm:5.2f} {deg:5.3f} {tilt_deg(found):5.3f}")
        print(f"{label:20}" + "".join(f"{cell:>20}" for cell in cells))


if __name__ == "__main__":
    main()
