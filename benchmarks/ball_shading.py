"""Light directions from the shading of a glossy gray ball, against those of a chrome ball.

Both balls are of the University of Washington ($SGP_DATA/uw), under the same 12 lights, seen from
afar. The gray ball is a paint under a coat: value = scale of the light * (c + bend * c (1 - c)),
where c is the cosine between normal and light. Scale and direction of each light and one bend for
all are fitted by Gauss-Newton with Tukey weights, which leave out the highlight. Points of less
than 78 degrees of incidence and of view count: beyond them, the attached shadow, the mask and
the coat matter. The columns are the angle to the chrome ball's direction with the outline of the
mask and with that found in the images, the scatter of the gray ball's values, and the mean weight
of its lit points.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from harness import command_line

from acquisition import Source, angle_deg, read_source
from calibration import calibrate_spheres, linear_stack
from rig.arrays import Bool, Float64

LEAST_COSINE = 0.2
TUKEY = 4.685
ROUNDS = 60


@dataclass(frozen=True, eq=False)
class BallLights:
    """Fitted lights of N images of a matte ball.

    Parameters
    ----------
    directions
        ``(N, 3)`` unit vectors.
    bend
        Deviation from Lambert's law that all lights share.
    scatter
        ``(N,)`` robust standard deviation of the values, relative to the scale of the light.
    share
        ``(N,)`` mean weight of the lit points.
    """

    directions: Float64
    bend: float
    scatter: Float64
    share: Float64


def ball_normals(mask: Bool) -> tuple[Float64, Bool]:
    """Return the normals ``(P, 3)`` of a ball that fills a mask, and the pixels they belong to."""
    y, x = np.nonzero(mask)
    # The area gives the radius and the moments the centre: both average over the drawn edge.
    radius = np.sqrt(len(x) / np.pi)
    across, up = (x - x.mean()) / radius, -(y - y.mean()) / radius
    square = 1 - across**2 - up**2
    use = square > LEAST_COSINE**2
    pixels = np.zeros_like(mask)
    pixels[y[use], x[use]] = True
    return np.column_stack([across, up, np.sqrt(np.maximum(square, 0))])[use], pixels


def fit_lights(values: Float64, normals: Float64) -> BallLights:
    """Fit directions and scales of N lights to the values ``(N, P)`` of P points.

    NaN is a value that was not measured.
    """
    seen = np.isfinite(values)
    values = np.where(seen, values, 0.0)
    count = len(values)
    lights = np.stack([_start(v, s, normals) for v, s in zip(values, seen, strict=True)])
    bend = 0.0
    scatter, share = np.zeros(count), np.zeros(count)
    for _ in range(ROUNDS):
        # The bend is eliminated: its pull adds up over the lights.
        square = np.zeros((count, 3, 3))
        cross, pull = np.zeros((count, 3)), np.zeros((count, 3))
        of_bend, pull_bend = 0.0, 0.0
        for k in range(count):
            scale = float(np.linalg.norm(lights[k]))
            cosine = normals @ lights[k] / scale
            lit = seen[k] & (cosine > LEAST_COSINE)
            n, c = normals[lit], cosine[lit]
            residual = (values[k][lit] - scale * (c + bend * c * (1 - c))) / scale
            scatter[k] = 1.4826 * np.median(np.abs(residual))
            weight = np.maximum(1 - (residual / (TUKEY * scatter[k])) ** 2, 0.0) ** 2
            share[k] = weight.mean()
            # scale * (c + bend c (1 - c)) with c = n . m / |m|, divided by the scale.
            unit = lights[k] / scale
            slope = (1 + bend * (1 - 2 * c))[:, None] * (n - c[:, None] * unit)
            slope += (c + bend * c * (1 - c))[:, None] * unit
            curve = c * (1 - c)
            square[k] = (slope * weight[:, None]).T @ slope
            cross[k] = (slope * weight[:, None]).T @ curve
            pull[k] = (slope * weight[:, None]).T @ residual
            of_bend += float(np.sum(weight * curve**2))
            pull_bend += float(np.sum(weight * curve * residual))
        left = np.linalg.solve(square, np.stack([cross, pull], axis=-1))
        step = pull_bend - float(np.sum(cross * left[..., 1]))
        step /= of_bend - float(np.sum(cross * left[..., 0]))
        scales = np.linalg.norm(lights, axis=1, keepdims=True)
        lights = lights + scales * (left[..., 1] - step * left[..., 0])
        bend += step
    unit = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    return BallLights(unit, bend, scatter, share)


def _start(values: Float64, seen: Bool, normals: Float64) -> Float64:
    """Return direction times scale by least squares over the brighter half of the points."""
    bright = seen & (values > np.median(values[seen]))
    found: Float64 = np.linalg.lstsq(normals[bright], values[bright], rcond=None)[0]
    return found


def ball_lights(source: Source) -> BallLights:
    """Return the lights fitted to the shading of the ball in the mask of a recording."""
    if source.mask is None:
        raise ValueError(f"{source.path} has no mask of the ball")
    normals, pixels = ball_normals(source.mask)
    values = linear_stack(source).values[:, pixels]
    return fit_lights(values.astype(np.float64), normals)


def main() -> None:
    parser = command_line(__doc__)
    parser.parse_args()
    data = os.environ.get("SGP_DATA")
    if not data:
        sys.exit("SGP_DATA is not set: it names the folder with uw/chrome and uw/gray")
    gray, chrome = (read_source(Path(data) / "uw" / name) for name in ("gray", "chrome"))
    fitted = ball_lights(gray)
    stack = linear_stack(chrome)
    masked = calibrate_spheres(stack, masks=[chrome.mask]).lights.unit_directions
    found = calibrate_spheres(stack).lights.unit_directions
    to_mask, to_found = (angle_deg(fitted.directions, d) for d in (masked, found))
    print("light   x      y      z      to chrome: mask   found   scatter   weight")
    for k, (x, y, z) in enumerate(fitted.directions):
        print(
            f"{k:4} {x:7.3f}{y:7.3f}{z:7.3f}     {to_mask[k]:8.2f} {to_found[k]:8.2f} deg"
            f" {100 * fitted.scatter[k]:7.1f} % {100 * fitted.share[k]:6.0f} %"
        )
    print(f"mean {to_mask.mean():30.2f} {to_found.mean():8.2f} deg   bend {fitted.bend:.3f}")


if __name__ == "__main__":
    main()
