"""Error of normals from merged brackets, against the Cramer-Rao bound.

A matte hemisphere under 36 distant lights is recorded by a 12-bit sensor in one or three exposures,
with dark frames. Pixels that no light shadows count. Normals are the least squares solution,
plain and weighted by `Stack.noise`. "floor" is the bound of all exposures together, "ratio" the
root mean square error over that of the bound.

    python benchmarks/noise_floor.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquisition import Frame, Lights, Source, angle_deg
from calibration import Stack, linear_stack
from rig.arrays import Bool, Float64
from simulator import bench_sensor
from simulator.camera import sensor_image
from simulator.rendering import Measurement, cramer_rao_deg

_SIZE = 161
_CASES = {
    "one exposure": (20_000.0,),
    "three exposures, 1 : 1/4 : 1/16": (20_000.0, 5_000.0, 1_250.0),
    "three exposures, 4 : 1 : 1/4": (80_000.0, 20_000.0, 5_000.0),
}


def hemisphere() -> tuple[Float64, Bool]:
    """Return normals ``(H, W, 3)`` of a hemisphere up to 50 degrees, and where it is."""
    y, x = np.mgrid[1 : -1 : _SIZE * 1j, -1 : 1 : _SIZE * 1j] * np.sin(np.radians(50))
    mask = np.hypot(x, y) < np.sin(np.radians(50))
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    return np.where(mask[..., None], np.stack([x, y, z], axis=-1), 0.0), mask


def lights() -> Lights:
    """Return 36 lights in three rings, at most 35 degrees from the axis: nothing is in shadow."""
    turn = np.radians(np.arange(36) * 10.0)
    tilt = np.radians(np.resize([15.0, 25.0, 35.0], 36))
    vectors = [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
    return Lights(directions=np.stack(vectors, axis=1))


def recorded(signal: Float64, exposures_us: tuple[float, ...], seed: int) -> Source:
    """Record electrons per 20 ms, ``(N, H, W)``, with one dark frame per exposure."""
    sensor = bench_sensor()
    frames = []
    for b, time_us in enumerate(exposures_us):
        for i, image in enumerate((*signal, np.zeros_like(signal[0]))):
            electrons = (image * time_us / 20_000).astype(np.float32)
            pixels = sensor_image(electrons, sensor, exposure_us=time_us, key=(seed, b, i))
            role = "light" if i < len(signal) else "dark"
            path = Path(__file__)
            frames.append(
                Frame(
                    path, f"L{i:02d}", pixels.shape, role, b, time_us, lambda pixels=pixels: pixels
                )
            )
    return Source(
        Path(__file__).parent,
        "images",
        tuple(frames),
        black_level=sensor.black_level_dn,
        white_level=sensor.white_level_dn,
        noise=sensor,
    )


def solved(stack: Stack, vectors: Float64, *, weighted: bool) -> Float64:
    """Return the normals by least squares over the samples that are not saturated."""
    values = stack.values.astype(float)
    use = np.isfinite(values)
    weight = use.astype(float)
    if weighted and stack.noise is not None:
        fitted = solved(stack, vectors, weighted=False)
        scale = np.nansum(values * np.einsum("hwc,nc->nhw", fitted, vectors), axis=0)
        scale /= np.sum(use * np.einsum("hwc,nc->nhw", fitted, vectors) ** 2, axis=0)
        for i, vector in enumerate(vectors):
            weight[i] = use[i] / stack.noise.variance(i, scale * (fitted @ vector))
    normal = np.einsum("nhw,na,nb->hwab", weight, vectors, vectors)
    moment = np.einsum("nhw,nhw,na->hwa", weight, np.where(use, values, 0), vectors)
    found = np.linalg.solve(normal, moment[..., None])[..., 0]
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))


def main() -> None:
    """Print one row for each set of exposures."""
    normals, mask = hemisphere()
    vectors = lights().directions
    albedo = np.full(mask.shape, 0.6)
    # White reaches the white level of the sensor at 20 ms.
    white_e = 4031 * bench_sensor().electrons_per_dn
    signal = white_e * albedo * np.clip(np.einsum("hwc,nc->nhw", normals, vectors), 0, None)
    print(f"{'':34s} floor deg   plain  weighted, ratio to the floor")
    for name, exposures_us in _CASES.items():
        measured = Measurement(bench_sensor(), white_e / 20_000, exposures_us)
        bound = cramer_rao_deg(normals, albedo, lights(), measured).astype(float)
        errors: dict[bool, list[Float64]] = {False: [], True: []}
        for seed in range(4):
            stack = linear_stack(recorded(signal, exposures_us, seed))
            for weighted, found in errors.items():
                angle = angle_deg(solved(stack, vectors, weighted=weighted), normals)
                found.append(angle[mask])
        floor = np.sqrt(np.mean(bound[mask] ** 2))
        plain, weighed = (np.sqrt(np.mean(np.square(errors[key]))) / floor for key in (False, True))
        print(f"{name:34s} {floor:9.4f} {plain:7.3f} {weighed:9.3f}")


if __name__ == "__main__":
    main()
