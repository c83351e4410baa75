"""A flat printed sheet at any pose in front of the camera, such as a calibration board."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from rig.arrays import Float32, Float64
from simulator.rendering.blur import blur
from simulator.scene.lens import Lens
from simulator.shapes.patterns import Pattern

_FINE = 8
_STRIP = 1 << 15  # pixels with edges that are sampled at a time


def board_view(
    lens: Lens,
    pattern: Pattern,
    rotation: npt.ArrayLike,
    centre_mm: npt.ArrayLike,
    *,
    sheet_mm: tuple[float, float],
    background: float = 0.02,
) -> Float32:
    """Render a flat sheet with a pattern under even light, without noise.

    Parameters
    ----------
    lens
        Perspective lens, which blurs what is out of focus unless it is sharp.
    pattern
        Grey pattern on the sheet, with details of at least three pixels.
    rotation
        ``(3, 3)`` rotation from the axes of the sheet, x right, y up and z out of it, to the house
        frame; the identity is a sheet on the working plane.
    centre_mm
        Centre of the sheet in the house frame, below the camera.
    sheet_mm
        Width and height of the sheet.
    background
        Signal beyond the sheet.

    Returns
    -------
    FloatImage
        ``(H, W)`` float32, the albedo as the camera sees it.

    Raises
    ------
    DataError
        If the rotation is not one, the lens is orthographic, or the camera sees the back of the
        sheet.

    Examples
    --------
    >>> import numpy as np
    >>> from simulator import Lens, bench_camera
    >>> from simulator.rendering import board_view
    >>> from simulator.shapes import ChArUco
    >>> lens, board = Lens(bench_camera()), ChArUco(7, 5, 30)
    >>> image = board_view(lens, board, np.eye(3), (0, 0, 0), sheet_mm=(230, 170))
    >>> image.shape, round(float(image.max()), 2)
    ((512, 640), 0.85)
    """
    turn, centre = np.asarray(rotation, np.float64), np.asarray(centre_mm, np.float64)
    if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-9):
        raise DataError("the rotation of a sheet must be an orthonormal 3 x 3 matrix")
    if lens.camera is None:
        raise DataError("a sheet needs a perspective lens: give one with a camera")
    rows, columns = lens.size
    x, y = np.meshgrid(np.arange(-1.0, columns + 1), np.arange(-1.0, rows + 1))
    origins, rays = lens.origins_and_rays(x, y)
    facing = rays @ turn[:, 2]
    depth = ((centre - origins) @ turn[:, 2]) / facing
    if not np.all((facing < 0) & (depth > 0)):
        raise DataError("the camera sees the back of the sheet, or its edge: turn it less")
    places = (origins + depth[..., None] * rays - centre) @ turn[:, :2]
    image = _integrated(pattern, places, np.asarray(sheet_mm) / 2, background)
    inner = (slice(1, -1), slice(1, -1))
    if not lens.sharp:
        circles = lens.circle_px(depth[inner]).astype(np.float32)
        blur(image[None], depth[inner], circles, lens.blur_px)
    return image


def _integrated(pattern: Pattern, places: Float64, half_mm: Float64, background: float) -> Float32:
    """Integrate over pixels; ``places`` has one more pixel on each side of the image."""

    def values(at: Float64) -> Float64:
        on_sheet = np.all(np.abs(at) <= half_mm, axis=-1)
        return np.where(on_sheet, pattern.evaluate(at[..., 0], at[..., 1]), background)

    coarse = values(places)
    image = coarse[1:-1, 1:-1].astype(np.float32)
    rows, columns = image.shape
    parts = [coarse[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    mixed = np.ptp(np.stack(parts), axis=0) > 0
    # Within a pixel, the sheet is a linear function of the position.
    along = (places[1:-1, 2:] - places[1:-1, :-2])[mixed] / 2
    down = (places[2:, 1:-1] - places[:-2, 1:-1])[mixed] / 2
    middle = places[1:-1, 1:-1][mixed]
    fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    dx, dy = (part.ravel()[:, None] for part in np.meshgrid(fine, fine))
    mean = np.zeros(len(middle), np.float32)
    for first in range(0, len(middle), _STRIP):
        part = slice(first, first + _STRIP)
        at = middle[part, None] + along[part, None] * dx + down[part, None] * dy
        mean[part] = values(at).mean(axis=1)
    image[mixed] = mean
    return image
