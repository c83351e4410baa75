"""The normals that remain visible behind a blurring lens."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simulator._render.blur import blur
from simulator._render.truth import Truth

Values = npt.NDArray[np.float32]


def resolved_normals(truth: Truth) -> Values:
    r"""Return the normals of the ground truth, blurred as the lens blurs the images.

    A matte surface of albedo a and normal n sends ``a n . l`` under a light l. The lens averages
    this light over its point-spread function. Where l is nearly constant and no shadow begins, this
    is the light of the averaged ``a n``. Photometric stereo of images without noise gives the
    direction of this mean; its angle to the normal at the pixel's centre is the error by resolution
    alone.

    Parameters
    ----------
    truth
        Ground truth of a rendered scene; its lens has the defocus and the Gaussian.

    Returns
    -------
    Values
        ``(H, W, 3)`` float32 unit vectors inside the mask, 0 outside. Only light of the object is
        averaged. The normals themselves for a sharp lens.

    Raises
    ------
    DataError
        If a circle of confusion is larger than 64 pixels.

    Examples
    --------
    >>> from simulator import render, resolved_normals, scene_named
    >>> truth = render(scene_named("coin", width=64, height=52, leds=4)).truth
    >>> resolved = resolved_normals(truth)
    >>> cosine = (resolved * truth.normals).sum(axis=2)[truth.mask]
    >>> bool(0.9 < cosine.mean() < 1)
    True
    """
    mask = truth.mask
    if truth.lens.sharp or not mask.any():
        return truth.normals.copy()
    albedo = truth.albedo if truth.albedo.ndim == 2 else truth.albedo.mean(axis=2)
    planes = np.ascontiguousarray(np.moveaxis(truth.normals * albedo[..., None], 2, 0))
    depth = truth.lens.camera_z_mm - truth.height_mm
    depth[~mask] = depth[mask].max()
    circle = truth.lens.circle_px(depth).astype(np.float32)
    blur(planes, depth, circle, truth.lens.blur_px)
    resolved = np.moveaxis(planes, 0, 2)
    length = np.linalg.norm(resolved, axis=2)
    seen = mask & (length > 0)
    result = truth.normals.copy()
    result[seen] = resolved[seen] / length[seen, None]
    return result
