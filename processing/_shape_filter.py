"""The low-pass filter that turns a normal map into its shape component."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap

Float = npt.NDArray[np.float32]
FilterKind = Literal["gaussian", "box"]


@dataclass(frozen=True)
class ShapeFilter:
    """A mask-normalised low-pass filter of unit vectors (eq. ``eq_conv_cal`` of the paper).

    A Gaussian of order 1 is the paper's. A higher order filters what the filter left over again
    ("twicing", Tukey 1977): the pass band is flatter, the half cut-off stays at the same
    frequency, and less of the shape leaks into the detail.

    Parameters
    ----------
    kind
        ``gaussian`` with sigma = w / 2, or ``box``.
    order
        Of the Gaussian, 1 or more. A box is applied once whatever the order: its frequency
        response is negative in places, where repetition would amplify.
    w
        Half width in pixels of the paper's (2w+1) x (2w+1) window, 1 or more.

    Raises
    ------
    DataError
        If the kind is unknown, or `order` or `w` is below 1.
    """

    kind: FilterKind = "gaussian"
    order: int = 8
    w: int = 5

    def __post_init__(self) -> None:
        if self.kind not in ("gaussian", "box"):
            raise DataError(f"there is no shape filter {self.kind!r}: use gaussian or box")
        for name, value in (("order", self.order), ("w", self.w)):
            if value != int(value) or value < 1:
                raise DataError(f"a shape filter's {name} must be a whole number above 0: {value}")

    @property
    def passes(self) -> int:
        """How often the image is blurred."""
        return self.order if self.kind == "gaussian" else 1

    @property
    def sigma_px(self) -> float:
        """Sigma of one Gaussian pass.

        Each order passes more of the high frequencies, so that a wider Gaussian keeps the half
        cut-off: half of the amplitude is left at the frequency where 1 - (1 - g)^order = 1/2.
        """
        return self.w / 2 * math.sqrt(math.log(1 - 0.5 ** (1 / self.passes)) / math.log(0.5))

    @property
    def _kernel(self) -> Float:
        if self.kind == "box":
            return np.full(2 * self.w + 1, 1 / (2 * self.w + 1), np.float32)
        # The paper cuts its Gaussian at 2 sigma; a wider one would ring if it were cut as short.
        radius = self.w if self.passes == 1 else math.ceil(3 * self.sigma_px)
        offsets = np.arange(-radius, radius + 1)
        kernel = np.exp(-0.5 * (offsets / self.sigma_px) ** 2)
        return np.asarray(kernel / kernel.sum(), np.float32)

    def shape(self, normal_map: NormalMap) -> NormalMap:
        """Return the shape component of a normal map.

        Only pixels inside the mask count; beyond the frame the image is mirrored about its
        outermost pixels. Where normals cancel out the normal itself is the shape.

        Parameters
        ----------
        normal_map
            Any normal map, at least 2w+1 pixels wide and high.

        Returns
        -------
        NormalMap
            With the same mask.

        Raises
        ------
        DataError
            If the window is larger than the map.
        """
        height, width = normal_map.size
        if 2 * self.w + 1 > min(height, width):
            raise DataError(
                f"a shape filter with w={self.w} has a window of {2 * self.w + 1} pixels, larger "
                f"than the normal map of {width} x {height}: use a smaller w"
            )
        kernel = self._kernel
        window = _window(normal_map.mask, len(kernel) // 2)
        normals = normal_map.normals[window]
        inside = normal_map.mask[window]
        weight = _blur(inside.astype(np.float32), kernel)
        gain = np.where(inside, 1 / np.where(inside, weight, 1), 0).astype(np.float32)[..., None]
        rest = normals.copy()
        for _ in range(self.passes):
            # The gain is 0 outside: what a pass smeared over the border is cut off again.
            rest -= _blur(rest, kernel) * gain
        smooth = (normals - rest).astype(np.float64)
        length = np.sqrt(np.einsum("ijk,ijk->ij", smooth, smooth))[..., None]
        unit = np.where(length > 1e-6, smooth / np.where(length > 1e-6, length, 1), normals)
        out = np.zeros_like(normal_map.normals)
        out[window] = unit
        return NormalMap(out, normal_map.mask)


def _blur(image: Float, kernel: Float) -> Float:
    blurred = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred, np.float32)


def _window(mask: npt.NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """Return the mask's bounding box and a margin the blur cannot look past, as far as it goes."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + margin + 1),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + margin + 1),
    )
