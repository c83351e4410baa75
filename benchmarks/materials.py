"""Mean angular error of every method on simulated materials, degrees.

A ball under distant lights on a dome, with the noise of a 12-bit sensor, clipped at white. "known"
uses the law of this noise. In the translucent rows light enters behind the terminator:
``max((n . l + w) / (1 + w), 0)``. In the shadowed rows half of the lights do not reach a point:
those on one side, which differs from point to point, or any half. The second table compares the
errors on a Lambertian cap without shadows and clipping with the Cramer-Rao bound.

    python benchmarks/materials.py --seed 1
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from harness import command_line

from acquisition import Lights, angle_deg
from calibration import StackNoise
from processing import photometric_stereo
from processing.stereo import METHODS
from rig.arrays import Bool, Float64
from simulator.scene import Ggx, OrenNayar
from simulator.scene.reflectance import reflectance

# Variance per value and without light, where white is 1: 10 000 electrons at white, 5 read noise.
_SLOPE, _FLOOR = 1e-4, 2.5e-7
_EYE = np.array([0.0, 0.0, 1.0])


def dome(count: int, lowest: float = 0.35) -> Float64:
    """Return directions ``(N, 3)`` spread over a dome by the golden angle."""
    z = np.linspace(0.98, lowest, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def ball(size: int) -> tuple[Float64, Bool]:
    """Return the normals ``(H, W, 3)`` of a ball, and where it is."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    return np.stack([x, y, z], axis=-1), np.hypot(x, y) < 0.97


def materials(
    directions: Float64, normals: Float64, rng: np.random.Generator
) -> Iterator[tuple[str, Float64]]:
    """Yield the name of each case and its images ``(N, H, W)`` without noise."""
    cosine = np.einsum("nc,hwc->nhw", directions, normals)
    lit = np.clip(cosine, 0, None)
    to_light = directions[:, None, None]
    yield "Lambertian", 0.6 * lit
    yield "rough paint, 30 deg", lit * reflectance(OrenNayar(30), 0.6, normals, to_light, _EYE)
    for roughness in (0.5, 0.25, 0.1):
        gloss = reflectance(Ggx(roughness, 0.6), 0.0, normals, to_light, _EYE)
        yield f"metal, GGX {roughness}", lit * gloss
    for roughness in (0.3, 0.15):
        gloss = reflectance(Ggx(roughness, 0.04), 0.05, normals, to_light, _EYE)
        yield f"dark glossy, GGX {roughness}", lit * gloss
    yield "glossy, GGX 0.3", lit * reflectance(Ggx(0.3, 0.04), 0.5, normals, to_light, _EYE)
    for wrap in (0.3, 0.6):
        yield f"translucent, wrap {wrap}", 0.6 * np.clip((cosine + wrap) / (1 + wrap), 0, None)
    turn = rng.uniform(0, 2 * np.pi, normals.shape[:2])
    side = np.einsum("nc,chw->nhw", directions[:, :2], np.stack([np.cos(turn), np.sin(turn)]))
    yield "one side shadowed", np.where(side > np.median(side, axis=0), 0.6 * lit, 0)
    kept = rng.uniform(size=lit.shape).argsort(axis=0) < len(directions) // 2
    yield "any half shadowed", np.where(kept, 0.6 * lit, 0)


def recorded(images: Float64, rng: np.random.Generator) -> Float64:
    """Return images with noise; the brightest hundredth is white, and saturated samples NaN."""
    images = images / np.quantile(images, 0.99)
    noisy = images + rng.normal(size=images.shape) * np.sqrt(_FLOOR + _SLOPE * images)
    return np.where(noisy < 1, noisy, np.nan)


def errors(
    values: Float64, directions: Float64, normals: Float64, mask: Bool, known: bool
) -> list[Float64]:
    """Return the angular errors of every method, degrees; pixels without a normal count as 90."""
    noise = StackNoise.of_one_exposure(_SLOPE, _FLOOR, len(values)) if known else None
    found = []
    for method in METHODS:
        result = photometric_stereo(values, Lights(directions), mask, method=method, noise=noise)
        angles = angle_deg(result.normal_map.normals, normals)
        found.append(np.where(result.normal_map.mask, angles, 90.0)[mask])
    return found


def bound_deg(normals: Float64, directions: Float64, albedo: float) -> float:
    """Return the Cramer-Rao bound of the root mean square error of unshadowed points, degrees."""
    signal = albedo * np.einsum("nc,pc->np", directions, normals)
    information = np.einsum("np,ni,nj->pij", 1 / (_FLOOR + _SLOPE * signal), directions, directions)
    inverse = np.linalg.inv(information)
    tangent = np.trace(inverse, axis1=1, axis2=2) - np.einsum(
        "pi,pij,pj->p", normals, inverse, normals
    )
    return float(np.degrees(np.sqrt(tangent.mean()) / albedo))


def main() -> None:
    """Print one row for each material, and the efficiency under plain noise."""
    parser = command_line(__doc__)
    parser.add_argument("--lights", type=int, default=36, help="number of lights")
    parser.add_argument("--seed", type=int, default=1, help="seed of noise and shadows")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    directions = dome(options.lights)
    normals, mask = ball(71)
    names = "".join(f"{name:>9}" for name in METHODS)
    print(f"{f'{options.lights} lights, mean error, deg':28}{names}  | known:{names[6:]}")
    for name, images in materials(directions, normals, rng):
        values = recorded(images, rng)
        rows = [errors(values, directions, normals, mask, known) for known in (False, True)]
        unknown, known = ("".join(f"{np.mean(e):9.2f}" for e in row) for row in rows)
        print(f"{name:28}{unknown}  |{known}")
    print(f"\n{'rms error / Cramer-Rao bound':28}{names}  | known:{names[6:]}")
    mask &= normals[..., 2] > 0.87
    for count in (96, 36, 12, 6):
        directions = dome(count, lowest=0.6)
        for albedo in (0.8, 0.1):
            images = albedo * np.einsum("nc,hwc->nhw", directions, normals)
            shaded = _FLOOR + _SLOPE * np.clip(images, 0, None)
            values = images + rng.normal(size=images.shape) * np.sqrt(shaded)
            bound = bound_deg(normals[mask], directions, albedo)
            rows = [errors(values, directions, normals, mask, known) for known in (False, True)]
            unknown, known = (
                "".join(f"{np.sqrt(np.mean(e**2)) / bound:9.3f}" for e in row) for row in rows
            )
            print(f"{f'{count} lights, albedo {albedo}':28}{unknown}  |{known}")


if __name__ == "__main__":
    main()
