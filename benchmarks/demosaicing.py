"""Normals of a colour mosaic: site by site, and from gray images of several demosaicings.

Waves with a gray or a coloured print, under 12 distant lights, are recorded by a 12-bit sensor with
an RGGB mosaic, with its noise and without. Printed is the mean error of the normals in degrees,
over all pixels and within 2 px of edges of the print. The last rows are edge-aware or
gradient-corrected methods of libraries, applied to the linear image of each light.

    python benchmarks/demosaicing.py
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

from acquisition import Lights, angle_deg
from calibration.radiance import demosaic, luma
from processing import photometric_stereo
from rig.arrays import Bool, Float32, Float64
from simulator import bench_sensor
from simulator.camera import sensor_image

_SIZE = (240, 320)
_SEEDS = (11, 12)
_PATTERN = "RGGB"
_COLOURS = ((0.8, 0.2, 0.15), (0.15, 0.7, 0.2), (0.2, 0.25, 0.8), (0.7, 0.7, 0.65))
_GRAYS = ((0.2,) * 3, (0.7,) * 3, (0.4,) * 3, (0.8,) * 3)
_SPAN_DN = 4000.0


def lights() -> Lights:
    """Return 12 lights in two rings."""
    turn, tilt = np.radians(np.arange(12) * 30.0), np.radians(np.resize([20.0, 40.0], 12))
    vectors = [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
    return Lights(directions=np.stack(vectors, axis=1))


def waves() -> Float64:
    """Return true normals."""
    y, x = np.indices(_SIZE, dtype=float)
    normals = np.dstack([0.4 * np.sin(x / 7), 0.4 * np.cos(y / 9), np.ones(_SIZE)])
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def print_of(colours: tuple[tuple[float, ...], ...]) -> tuple[Float64, Bool]:
    """Return the albedo of patches ``(H, W, 3)``, and where an edge is within 2 px."""
    y, x = np.indices(_SIZE)
    patch = (x // 24 + y // 18) % 4
    edge = np.zeros(_SIZE, np.uint8)
    edge[:, 1:] |= patch[:, 1:] != patch[:, :-1]
    edge[1:] |= patch[1:] != patch[:-1]
    near = cv2.dilate(edge, np.ones((5, 5), np.uint8))
    return np.array(colours)[patch], np.asarray(near, np.uint8).astype(np.bool_)


def mosaics(albedo: Float64, seed: int | None) -> Float32:
    """Return linear mosaics ``(N, H, W)``, with the noise of a sensor if there is a seed."""
    sensor = bench_sensor()
    y, x = np.indices(_SIZE)
    channel = np.array(["RGB".index(name) for name in _PATTERN])[2 * (y % 2) + x % 2]
    own = np.take_along_axis(albedo, channel[..., None], axis=2)[..., 0]
    images = []
    for i, vector in enumerate(lights().unit_directions):
        signal = 0.9 * own * np.clip(waves() @ vector, 0, None)
        if seed is not None:
            electrons = (signal * _SPAN_DN * sensor.electrons_per_dn).astype(np.float32)
            raw = sensor_image(electrons, sensor, key=(seed, i)).astype(np.float64)
            signal = (raw - sensor.black_level_dn) / _SPAN_DN
        images.append(signal.astype(np.float32))
    return np.stack(images)


def opencv_edge_aware(mosaic: Float32) -> Float32:
    """Demosaic by OpenCV's edge-aware method, in 16 bits."""
    scale = np.float32(60_000 / mosaic.max())
    samples = np.clip(np.rint(mosaic * scale), 0, 65_535).astype(np.uint16)
    colours = cv2.demosaicing(samples, cv2.COLOR_BayerBG2RGB_EA)
    return np.asarray(colours / scale, np.float32)


def malvar(mosaic: Float32) -> Float32:
    """Demosaic by the method of Malvar, He and Cutler, of OpenImageIO."""
    buffer = oiio.ImageBuf(np.ascontiguousarray(mosaic[..., None]))
    result = oiio.ImageBufAlgo.demosaic(buffer, pattern="bayer", algorithm="MHC", layout=_PATTERN)
    return np.asarray(result.get_pixels(oiio.FLOAT), np.float32)


_METHODS: dict[str, Callable[[Float32], Float32] | None] = {
    "every site": None,
    "gray, bilinear": lambda mosaic: demosaic(mosaic, _PATTERN),
    "gray, OpenCV edge-aware": opencv_edge_aware,
    "gray, Malvar, He and Cutler": malvar,
}


def errors(values: Float32, edge: Bool) -> tuple[float, float]:
    """Return the mean errors of all pixels and of those near edges, degrees."""
    mask = np.zeros(_SIZE, np.bool_)
    mask[4:-4, 4:-4] = True
    found = photometric_stereo(values, lights(), mask, method="ls").normal_map.normals
    error = angle_deg(found, waves())
    return float(error[mask].mean()), float(error[mask & edge].mean())


def main() -> None:
    """Print the table."""
    print(f"{'print':10}{'noise':7}{'method':30}{'all':>8}{'edges':>8}")
    for name, colours in (("gray", _GRAYS), ("coloured", _COLOURS)):
        albedo, edge = print_of(colours)
        for seeds in ((None,), _SEEDS):
            for method, convert in _METHODS.items():
                rows = []
                for seed in seeds:
                    values = mosaics(albedo, seed)
                    if convert is not None:
                        values = np.stack([luma(convert(image)) for image in values])
                    rows.append(errors(values, edge))
                every, near = np.mean(rows, axis=0)
                noise = "no" if seeds[0] is None else "yes"
                print(f"{name:10}{noise:7}{method:30}{every:8.3f}{near:8.3f}", flush=True)


if __name__ == "__main__":
    main()
