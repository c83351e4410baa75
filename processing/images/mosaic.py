"""Images and albedo of a Bayer mosaic whose sites were solved one by one."""

from __future__ import annotations

import cv2
import numpy as np

from calibration.radiance import demosaic, luma
from rig.arrays import Bool, Float32


def blocks_of_sites(mosaic: Float32) -> Float32:
    """Return an image in which every pixel is the mean of 2 x 2 sites, so one of each block.

    Parameters
    ----------
    mosaic
        ``(H, W)``; saturated samples, NaN, count as white.
    """
    return np.asarray(cv2.boxFilter(np.nan_to_num(mosaic, nan=1.0), -1, (2, 2)), np.float32)


def gray_picture(mosaic: Float32, pattern: str) -> Float32:
    """Return the gray values of a mosaic, for people."""
    return luma(demosaic(mosaic, pattern))


def albedo_of_sites(albedo: Float32, mask: Bool, pattern: str) -> Float32:
    """Return the albedo in three colours from that of each site in the colour of its filter.

    Green is interpolated along the direction in which it and the colour of the site vary less
    (Hamilton and Adams, US patent 5,629,734). Red and blue are upsampled with green as the guide:
    what is interpolated is their difference to green, which varies less than they do. Each site
    keeps its own colour as measured.

    Parameters
    ----------
    albedo
        ``(H, W)`` albedo of each site.
    mask
        ``(H, W)`` where it is known.
    pattern
        Colours of the first 2 x 2 sites, row by row.

    Returns
    -------
    Float
        ``(H, W, 3)`` RGB, at least 0; 0 outside the mask. A pixel without a measured site of a
        colour around it has the albedo of its own site there.
    """
    known = np.where(mask, albedo, np.float32(np.nan))
    green = _green(known, pattern)
    green = np.where(np.isfinite(green), green, albedo)
    differences = demosaic(known - green, pattern)
    colours = np.stack(
        [green + np.nan_to_num(differences[..., channel]) for channel in range(3)], axis=-1
    )
    colours[..., 1] = green
    for site, name in enumerate(pattern):
        rows, columns = slice(site // 2, None, 2), slice(site % 2, None, 2)
        colours[rows, columns, "RGB".index(name)] = albedo[rows, columns]
    colours[~mask] = 0
    return np.maximum(colours, 0)


def _green(known: Float32, pattern: str) -> Float32:
    """Return the green of all sites; NaN where no site around one is known."""
    green = demosaic(known, pattern)[..., 1]
    far = np.pad(known, 2, constant_values=np.nan)
    height, width = known.shape

    def moved(rows: int, columns: int) -> Float32:
        return far[2 + rows : 2 + rows + height, 2 + columns : 2 + columns + width]

    ways = []
    for rows, columns in ((0, 1), (1, 0)):
        before, after = moved(-rows, -columns), moved(rows, columns)
        bend = 2 * known - moved(-2 * rows, -2 * columns) - moved(2 * rows, 2 * columns)
        ways.append((np.abs(before - after) + np.abs(bend), (before + after) / 2 + bend / 4))
    (steep_x, along_x), (steep_y, along_y) = ways
    better = np.where(steep_x < steep_y, along_x, along_y)
    better = np.where(steep_x == steep_y, (along_x + along_y) / 2, better)
    sites = np.zeros(known.shape, bool)
    for site, name in enumerate(pattern):
        sites[site // 2 :: 2, site % 2 :: 2] = name != "G"
    return np.where(sites & np.isfinite(better), better, green)
