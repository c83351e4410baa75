"""Whether a ball is shaded, as a painted one is, or mirrors."""

from __future__ import annotations

import numpy as np

from calibration._radiance.raw_stack import Images
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.highlights import Highlights
from calibration._spheres.reflection import orthographic_directions
from calibration._spheres.robust import Array

# The middle of a ball, without its highlights, in multiples of the radius.
_MIDDLE = 0.7
_APART = 0.3
_STEPS = 15
_SHADED = 0.6


def is_painted(values: Images, outline: Ellipse, highlights: Highlights) -> bool:
    """Return whether the middle of a ball is shaded like a matte surface.

    The middle of a mirror shows the camera and the ceiling, whose brightness does not follow the
    cosine of the angle between the ball's normal and the light. That of a painted ball does, with
    or without gloss: the correlation over lights and places exceeds 0.6.

    Parameters
    ----------
    values
        ``(N, H, W)`` linear images, NaN where saturated.
    outline
        The outline of the ball.
    highlights
        Its highlights.
    """
    grid = np.linspace(-_MIDDLE, _MIDDLE, _STEPS)
    x, y = (v.ravel() for v in np.meshgrid(grid, grid))
    inside = np.hypot(x, y) < _MIDDLE
    unit = np.column_stack([x, y])[inside]
    pixels = np.rint(unit @ outline.matrix + outline.centre_px).astype(int)
    height, width = values.shape[1:]
    seen = np.all((pixels >= 0) & (pixels < (width, height)), axis=1)
    unit, pixels = unit[seen], pixels[seen]
    lit = np.flatnonzero(highlights.found)
    if len(lit) < 3 or len(unit) < 20:
        return False
    normals = np.column_stack([unit[:, 0], -unit[:, 1], np.sqrt(1 - np.sum(unit**2, axis=1))])
    directions = orthographic_directions(outline, highlights.pixels[lit])
    shading: Array = np.clip(normals @ directions.T, 0, None).T
    brightness = values[lit][:, pixels[:, 1], pixels[:, 0]].astype(np.float64)
    spots = outline.unit(highlights.pixels[lit])
    apart = np.linalg.norm(spots[:, None] - unit, axis=2) > _APART
    use = apart & np.isfinite(brightness)
    if np.count_nonzero(use) < 50 or np.ptp(brightness[use]) <= 0:
        return False
    correlation = float(np.corrcoef(brightness[use], shading[use])[0, 1])
    return correlation > _SHADED
