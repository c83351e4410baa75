"""Maps as datasets of xarray, which are cut, plotted and stored with their coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rig.arrays import Generic

if TYPE_CHECKING:
    import xarray

_DIMENSIONS = ("row", "column", "component")


def dataset_of(maps: Mapping[str, Generic], **facts: str | float) -> xarray.Dataset:
    """Return copies of maps of one size, by the rows and columns of the image.

    Raises
    ------
    ImportError
        If xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise ImportError("this needs xarray: pip install xarray") from error
    variables = {name: (_DIMENSIONS[: one.ndim], one.copy()) for name, one in maps.items()}
    whole = xarray.Dataset(variables, attrs=facts)
    places = {name: np.arange(length) for name, length in whole.sizes.items()}
    if "component" in places:
        places["component"] = np.array(["x", "y", "z"])
    return whole.assign_coords(places)
