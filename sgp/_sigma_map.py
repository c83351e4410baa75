"""Read the standard deviations of normals, and check that the file holds nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._record import records_of

_NAME = "normal_sigma_deg"
_LARGEST_DEG = 90.0


@dataclass(frozen=True, eq=False)
class SigmaMap:
    """Standard deviations of normals.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` float32.
    common_deg
        The part that all pixels have in common, from the record next to the file; 0 without one.
    notices
        Notices about gaps.
    """

    sigma_deg: npt.NDArray[np.float32]
    common_deg: float
    notices: list[rig.Notice]


def read_sigma(path: Path, normal_map: processing.NormalMap, max_pixels: int) -> SigmaMap:
    """Read standard deviations of normals in degrees."""
    common_deg = _common_deg(path)
    image = acquisition.read_image(path, max_pixels=max_pixels)
    rows, columns = normal_map.size
    if image.shape != (rows, columns) or not np.issubdtype(image.dtype, np.floating):
        raise acquisition.DataError(
            f"{path}: {image.dtype} values of shape {image.shape}: give a map of floats of "
            f"{columns} x {rows} pixels, the standard deviations of these normals in degrees"
        )
    inside = image[normal_map.mask]
    if not (inside > 0).any() or (inside < 0).any() or np.isinf(inside).any():
        raise acquisition.DataError(
            f"{path}: inside the mask, standard deviations are negative, infinite, or not known at "
            "any pixel: leave the file out, or replace it"
        )
    largest = float(np.nanmax(inside))
    if largest > _LARGEST_DEG:
        raise acquisition.DataError(
            f"{path}: values up to {largest:.4g} inside the mask are no standard deviations of "
            f"normals, which are 0 to {_LARGEST_DEG:g} degrees: give {_NAME}.exr"
        )
    unknown = int(np.count_nonzero(np.isnan(inside)))
    notices = [_gaps(path, unknown, len(inside))] if unknown else []
    return SigmaMap(image.astype(np.float32), common_deg, notices)


def _common_deg(path: Path) -> float:
    """Return the common part that a record next to the file states.

    Raises
    ------
    DataError
        If the record says that the file is another map.
    """
    common_deg = 0.0
    for record, read in records_of(path):
        outputs = read.outputs.items()
        names = [name for name, file in outputs if Path(file).name == path.name]
        if _NAME not in names:
            raise acquisition.DataError(
                f"{path}: {record.name} says that this is {names[0]}, not the standard deviations "
                f"of normals: give {_NAME}.exr"
            )
        stated = read.metrics.get("normal_sigma_common_deg")
        if isinstance(stated, (int, float)):
            common_deg = float(stated)
    return common_deg


def _gaps(path: Path, unknown: int, count: int) -> rig.Notice:
    text = (
        f"{unknown} of {rig.pluralize(count, 'normal')} have no standard deviation, and count as "
        "the least certain ones"
    )
    return rig.Notice("normal-sigma-gaps", text, str(path), "info")
