"""A normal map: unit vectors and the mask of the pixels where they are known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing.maps.datasets import dataset_of
from rig import check_type, in_threads, pluralize
from rig.arrays import Bool, Float32, Floating, Generic, Int64
from rig.kernels import PART

if TYPE_CHECKING:
    import xarray

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Vectors in half-float EXR files deviate from unit length by up to 8e-4.
_UNIT_TOLERANCE = 1e-3
# The squares of shorter vectors lose their digits in float64, so the direction is lost, too.
_MIN_LENGTH = 1e-140
# Larger maps are shown smaller in notebooks.
_PICTURE_PX = 512


@dataclass(frozen=True, eq=False)
class NormalMap:
    """Surface normals of an image, in the house frame (X right, Y up, Z toward the camera).

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, unit vectors inside the mask and 0 outside.
    mask
        ``(H, W)`` bool, True where the normal is known.

    Raises
    ------
    DataError
        If the shapes differ, the mask is empty, a normal inside the mask is not finite or not of
        unit length (to 0.001), or a vector outside is not 0. The message names the first pixel.

    See Also
    --------
    NormalMap.from_vectors : Make a map from vectors of any length.
    """

    normals: Float32
    mask: Bool

    def __repr__(self) -> str:
        count = pluralize(int(np.count_nonzero(self.mask)), "normal")
        return f"NormalMap({self.normals.dtype}{list(self.normals.shape)}, {count})"

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> Generic:
        """Return the normals, so that ``np.asarray`` and plotting programs take a map."""
        return np.array(self.normals, dtype=dtype, copy=copy)

    def _repr_png_(self) -> bytes:
        """Return a picture for notebooks: right is red, up is green, alpha is the mask."""
        step = max(1, -(-max(self.size) // _PICTURE_PX))
        normals, mask = self.normals[::step, ::step], self.mask[::step, ::step]
        colours = np.rint((normals[..., ::-1] + 1) * 127.5).astype(np.uint8)
        alpha = np.where(mask, np.uint8(255), np.uint8(0))
        done, data = cv2.imencode(".png", np.dstack([colours, alpha]))
        if not done:
            raise AssertionError("a picture of 8 bits can be encoded")
        return data.tobytes()

    def __post_init__(self) -> None:
        normals = np.ascontiguousarray(self.normals, np.float32)
        mask = _checked_mask(normals, self.mask)
        unsound = np.zeros(len(mask), np.int64)
        in_threads(_unsound, len(mask), normals, mask, unsound)
        if unsound.any():
            row = int(np.argmax(unsound))
            column = int(unsound[row]) - 1
            where = "inside" if mask[row, column] else "outside"
            raise DataError(
                f"the vector {normals[row, column].tolist()} at row {row}, column {column} {where} "
                "the mask: a normal map holds unit vectors inside and 0 outside"
            )
        if not mask.any():
            raise DataError("a normal map with an empty mask holds no normal: check the mask")
        object.__setattr__(self, "normals", normals)
        object.__setattr__(self, "mask", mask)

    @classmethod
    def from_vectors(cls, vectors: npt.ArrayLike, mask: Bool | None = None) -> NormalMap:
        """Make a normal map from vectors of any length.

        Parameters
        ----------
        vectors
            ``(H, W, 3)`` numbers. A vector of length 0 or with a component that is not finite
            means that the normal is unknown, as does a masked one: the pixel is removed from the
            mask.
        mask
            ``(H, W)`` bool. Default: all pixels.

        Returns
        -------
        NormalMap
            Unit vectors, computed in float64.

        Raises
        ------
        DataError
            If the shapes differ or no vector is left.
        TypeError
            If the vectors are unsigned integers, as in an image of normals.
        """
        raw = np.asanyarray(vectors)
        if raw.dtype.kind == "u":
            raise TypeError(
                f"vectors must be numbers from -1 to 1, not {raw.dtype}, which encodes them: "
                "read_normals(path) decodes an image"
            )
        inside = _checked_mask(raw, mask)
        # The kernel is compiled for two types only.
        double = raw if raw.dtype == np.float32 else raw.astype(np.float64, copy=False)
        vectors = np.ascontiguousarray(np.ma.filled(double, np.nan))
        normals, known = np.zeros(raw.shape, np.float32), np.zeros(inside.shape, np.bool_)
        in_threads(directions, len(inside), vectors, inside, normals, known)
        return cls(normals, known)

    @classmethod
    def of_unit_vectors(cls, normals: Float32, mask: Bool) -> NormalMap:
        """Make a map from the result of a rotation or a filter, without checking it.

        Checking every vector would take a fifth of the time that their computation took.

        Parameters
        ----------
        normals, mask
            As described for the class, which the caller guarantees. The arrays are contiguous, and
            the caller does not use them afterwards.
        """
        made = object.__new__(cls)
        object.__setattr__(made, "normals", normals)
        object.__setattr__(made, "mask", mask)
        return made

    @classmethod
    def from_xarray(cls, dataset: xarray.Dataset) -> NormalMap:
        """Make a map from a dataset like that of `to_xarray`, also from a part of it.

        Raises
        ------
        DataError
            If it has no ``normals (row, column, component)`` or ``mask (row, column)``, or they do
            not fit together.
        """
        try:
            normals = dataset["normals"].sel(component=["x", "y", "z"])
            normals = normals.transpose("row", "column", "component")
            mask = dataset["mask"].transpose("row", "column")
        except (KeyError, ValueError) as error:
            raise DataError(
                f"the dataset is not a normal map ({' '.join(str(error).split())}): it needs "
                "normals (row, column, component) and mask (row, column)"
            ) from error
        return cls(normals.to_numpy(), mask.to_numpy())

    def to_xarray(self) -> xarray.Dataset:
        """Return copies of ``normals (row, column, component)`` and ``mask (row, column)``.

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        return dataset_of({"normals": self.normals, "mask": self.mask})

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        height, width = self.mask.shape
        return height, width


def _checked_mask(vectors: Generic, mask: Bool | None) -> Bool:
    if vectors.ndim != 3 or vectors.shape[2] != 3:
        raise DataError(f"normals must be of shape (H, W, 3), not {vectors.shape}")
    return check_mask("mask", mask, vectors.shape[:2])


@numba.njit(nogil=True, cache=True)
def directions(
    first: int, last: int, vectors: Floating, inside: Bool, normals: Float32,
    known: Bool,
) -> None:  # fmt: skip
    """Write unit vectors of rows, computed in float64, and where they are known; 0 elsewhere."""
    for r in range(first, last):
        for c in range(inside.shape[1]):
            if not inside[r, c]:
                continue
            x = np.float64(vectors[r, c, 0])
            y = np.float64(vectors[r, c, 1])
            z = np.float64(vectors[r, c, 2])
            length = math.sqrt(x * x + y * y + z * z)
            # False if a component is NaN.
            if length > _MIN_LENGTH and math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
                known[r, c] = True
                normals[r, c, 0] = x / length
                normals[r, c, 1] = y / length
                normals[r, c, 2] = z / length


@numba.njit(**PART)
def _misfits(row: Float32, inside: Bool) -> int:
    count = 0
    for c in range(inside.size):
        x, y, z = row[3 * c], row[3 * c + 1], row[3 * c + 2]
        off = x * x + y * y + z * z - (np.float32(1) if inside[c] else np.float32(0))
        bound = np.float32(2 * _UNIT_TOLERANCE) if inside[c] else np.float32(0)
        # NaN fails every comparison, so the test is for valid vectors, not for invalid ones.
        count += 0 if abs(off) <= bound else 1
    return count


@numba.njit(nogil=True, cache=True)
def _unsound(first: int, last: int, normals: Float32, mask: Bool, found: Int64) -> None:
    """Write, for each row, 1 + the column of the first vector that violates the mask."""
    for r in range(first, last):
        row = normals[r].reshape(-1)
        if _misfits(row, mask[r]):
            c = 0
            while not _misfits(row[3 * c : 3 * c + 3], mask[r, c : c + 1]):
                c += 1
            found[r] = c + 1


def check_normal_rows(name: str, value: object) -> None:
    """Refuse what has no normals and mask, such as a plain array, by `check_normal_map`."""
    if not (hasattr(value, "normals") and hasattr(value, "mask")):
        check_normal_map(name, value)


def check_mask(name: str, mask: npt.ArrayLike | None, size: tuple[int, ...]) -> Bool:
    """Return a mask as a contiguous array; without one, all pixels.

    Raises
    ------
    DataError
        If it is not bool or of another size; the message names the parameter.
    """
    array = np.ones(size, np.bool_) if mask is None else np.ascontiguousarray(mask)
    if array.dtype != np.bool_ or array.shape != size:
        raise DataError(
            f"{name} must be bool of shape {size}, not {array.dtype} of shape {array.shape}"
        )
    return array


def check_normal_map(name: str, value: object) -> None:
    """Refuse an argument that is not a `NormalMap`, such as a plain array.

    Raises
    ------
    TypeError
        The message names the parameter and how to make a map.
    """
    check_type(
        name, value, NormalMap, "NormalMap.from_vectors(array), or read_normals(path).normal_map"
    )
