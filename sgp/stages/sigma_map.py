"""Read the standard deviations of normals, and check that the file holds nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import AnyArray, Bool, Float32
from sgp.results import records_of

_NAME = "normal_sigma_deg"
# Earlier versions wrote values above that of a uniform direction; they count as this.
_LARGEST_DEG = 180.0
# Values that are read at once.
_READ = 4_000_000


@dataclass(frozen=True, eq=False)
class SigmaMap:
    """Standard deviations of normals.

    Parameters
    ----------
    sigma_deg
        ``(H, W)`` float32, perhaps in a file.
    common_deg
        The part that all pixels have in common, from the record next to the file; 0 without one.
    notices
        Notices about gaps.
    """

    sigma_deg: acquisition.MapRows
    common_deg: float
    notices: list[rig.Notice]


def read_sigma(
    path: Path, mask: Bool, max_pixels: int, store: acquisition.files.BandStore | None = None
) -> SigmaMap:
    """Read standard deviations of normals in degrees, into a file next to maps if there are any."""
    common_deg = _common_deg(path)
    if store is None:
        whole = acquisition.read_image(path, max_pixels=max_pixels)
        notices = _checked(path, whole, mask)
        return SigmaMap(_limited(whole), common_deg, notices)
    with acquisition.pixels.ImageRows(path, max_pixels=max_pixels) as image:
        notices = _checked(path, image, mask)
        file = store.folder / "sigma.raw"
        sigma = acquisition.files.BandFile(file, image.shape, np.dtype(np.float32))
        store.close_with(sigma)
        height, width = mask.shape
        for rows in acquisition.files.rows_in_bands(height, width, _READ):
            sigma[rows] = _limited(image[rows])
    return SigmaMap(sigma, common_deg, notices)


def _limited(sigma_deg: AnyArray) -> Float32:
    return np.minimum(sigma_deg.astype(np.float32), np.float32(processing.noise.UNIFORM_DEG))


def _checked(path: Path, image: acquisition.MapRows, mask: Bool) -> list[rig.Notice]:
    """Return notices about gaps; refuse a map that is not one of standard deviations."""
    height, width = mask.shape
    if image.shape != (height, width) or not np.issubdtype(image.dtype, np.floating):
        raise acquisition.DataError(
            f"{path}: {image.dtype} values of shape {image.shape}: give a map of floats of "
            f"{width} x {height} pixels, the standard deviations of these normals in degrees"
        )
    unknown, known, count, largest = 0, False, 0, 0.0
    for rows in acquisition.files.rows_in_bands(height, width, _READ):
        inside = image[rows][mask[rows]]
        if (inside < 0).any() or np.isinf(inside).any():
            raise _no_deviations(path)
        known |= bool((inside > 0).any())
        unknown += int(np.count_nonzero(np.isnan(inside)))
        count += len(inside)
        largest = max(largest, float(np.nanmax(inside, initial=0)))
    if not known:
        raise _no_deviations(path)
    if largest > _LARGEST_DEG:
        raise acquisition.DataError(
            f"{path}: values up to {largest:.4g} inside the mask are no standard deviations of "
            f"normals, which are 0 to {_LARGEST_DEG:g} degrees: give {_NAME}.exr"
        )
    return [_gaps(path, unknown, count)] if unknown else []


def _no_deviations(path: Path) -> acquisition.DataError:
    return acquisition.DataError(
        f"{path}: inside the mask, standard deviations are negative, infinite, or not known at "
        "any pixel: leave the file out, or replace it"
    )


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
