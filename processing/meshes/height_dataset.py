"""A surface as a dataset of xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from processing.maps.datasets import dataset_of
from processing.surface.height_map import HeightMap

if TYPE_CHECKING:
    import xarray


def height_dataset(height_map: HeightMap) -> xarray.Dataset:
    """Return copies of the maps of a surface by ``(row, column)``, with the places of its points.

    Parameters
    ----------
    height_map
        The surface.

    Returns
    -------
    xarray.Dataset
        The variables ``height``, ``mask``, ``parts`` and, of a perspective surface, ``depth``; the
        coordinates ``x`` and ``y`` of the points in the house frame, NaN outside the mask; and the
        attributes ``unit`` and ``pixel_size``.

    Raises
    ------
    ImportError
        If xarray is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, integrate
    >>> from processing.meshes import height_dataset
    >>> plane = NormalMap.from_vectors(np.ones((4, 5, 3)))
    >>> height_dataset(integrate(plane, pixel_mm=0.5)).attrs  # doctest: +SKIP
    {'unit': 'mm', 'pixel_size': 0.5}
    """
    maps = {name: values[:] for name, values in height_map.maps.items()}
    x, y, _ = np.moveaxis(height_map.points(), -1, 0)
    whole = dataset_of(
        {**maps, "mask": height_map.mask, "x": x, "y": y},
        unit=height_map.unit,
        pixel_size=height_map.pixel_size,
    )
    return whole.set_coords(["x", "y"])
