"""The low-pass filter that turns a normal map into its shape component."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from acquisition import DataError
from processing.detail.choices import FILTER_KINDS, FilterKind
from processing.detail.separation_kernels import finish, gains, leave, separate_once, tiles
from processing.maps.normal_map import NormalMap
from rig import Progress, in_threads, no_progress
from rig.arrays import Bool, Float32

EdgeAware = Literal["guided", "bilateral"]

# Chosen on synthetic scenes with occlusions, folds and weak to strong relief (w of 3, 5 and 8), as
# a compromise between a small residue along edges and a small loss of relief elsewhere.
_GUIDED_REACH = 0.8  # of w
_GUIDED_EPSILON = 0.004
_BILATERAL_RANGE = 0.3
# Bytes per pixel that is separated: normals, shape, detail, and what the filter computes of them.
_OF_BAND, _OF_EDGE_AWARE_BAND = 50, 225


@dataclass(frozen=True)
class ShapeFilter:
    """A low-pass filter of unit vectors inside a mask (eq. ``eq_conv_cal`` of the paper).

    A Gaussian of order 1 is the paper's filter. A higher order filters the rest repeatedly
    ("twicing", Tukey 1977): the pass band is flatter, the half cut-off remains at the same
    frequency, and less of the shape leaks into the detail.

    Parameters
    ----------
    kind
        ``gaussian`` with sigma = w / 2, ``box``, or a filter that stops at occlusions: ``guided``
        or ``bilateral``, both guided by the shape component of a Gaussian of order 1.
    order
        Order of the Gaussian, 1 or more. The other filters ignore it: the frequency response of a
        box is negative at some frequencies, which repetition would amplify.
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
        if self.kind not in FILTER_KINDS:
            raise DataError(f"unknown shape filter {self.kind!r}: use {', '.join(FILTER_KINDS)}")
        for name, value in (("order", self.order), ("w", self.w)):
            if value != int(value) or value < 1:
                raise DataError(f"a shape filter's {name} must be a whole number above 0: {value}")

    @property
    def passes(self) -> int:
        """Number of blurs of the image; the guide of the edge-aware filters is blurred once."""
        return self.order if self.kind == "gaussian" else 1

    @property
    def sigma_px(self) -> float:
        """Sigma of one Gaussian pass.

        Each order passes more of the high frequencies. A wider Gaussian compensates for this and
        keeps the half cut-off, the frequency at which 1 - (1 - g)^order = 1/2.
        """
        return self.w / 2 * math.sqrt(math.log(1 - 0.5 ** (1 / self.passes)) / math.log(0.5))

    @property
    def _kernel(self) -> Float32:
        """Right half of the kernel, the centre first; the sum of the complete kernel is 1."""
        if self.kind == "box":
            return np.full(self.w + 1, 1 / (2 * self.w + 1), np.float32)
        # The paper truncates its Gaussian at 2 sigma; a wider Gaussian would then ring.
        radius = self.w if self.passes == 1 else math.ceil(3 * self.sigma_px)
        half = np.exp(-0.5 * (np.arange(radius + 1) / self.sigma_px) ** 2)
        return np.asarray(half / (2 * half.sum() - half[0]), np.float32)

    @property
    def margin(self) -> int:
        """Number of rows above and below on which the components of a row depend."""
        own = self.passes * (len(self._kernel) - 1)
        # OpenCV's windows: two boxes in a row, in two passes; 1.5 sigma in three passes.
        if self.kind == "guided":
            return own + 4 * round(_GUIDED_REACH * self.w)
        return own + 3 * _bilateral_reach(self.w) if self.kind == "bilateral" else own

    @property
    def halo(self) -> int:
        """Rows above and below that are read to separate some rows."""
        # A window that is cut at the border of the map must still fit.
        return max(self.margin, 2 * self.w)

    @property
    def pixel_bytes(self) -> int:
        """Bytes of memory per pixel that is separated."""
        return _OF_EDGE_AWARE_BAND if self.kind in ("guided", "bilateral") else _OF_BAND

    @property
    def paper(self) -> ShapeFilter:
        """The paper's filter with the same window: a Gaussian of order 1."""
        return ShapeFilter("gaussian", 1, self.w)

    def shape(self, normal_map: NormalMap) -> NormalMap:
        """Return the shape component of a normal map; see `split`."""
        return self.split(normal_map)[0]

    def split(
        self, normal_map: NormalMap, on_progress: Progress = no_progress
    ) -> tuple[NormalMap, NormalMap]:
        """Return the shape and the detail of a normal map.

        Only pixels inside the mask count. Outside the frame the image is mirrored about its
        outermost pixels. If the normals of a window cancel out, the normal itself is the shape.

        Parameters
        ----------
        normal_map
            Any normal map, at least 2w+1 pixels wide and high.
        on_progress
            Receives the stage ``detail``, one step per pass of the filter and one for the normals.

        Returns
        -------
        tuple[NormalMap, NormalMap]
            Maps with the same mask. A Gaussian of order 1 and a box require no additional memory,
            higher orders 8 bytes per pixel.

        Raises
        ------
        DataError
            If the window is larger than the map.
        """
        self.check_size(normal_map.size)
        height, _ = normal_map.size
        normals, mask = normal_map.normals.reshape(height, -1), normal_map.mask
        # Not zeros_like, which writes the zeros.
        shape, detail = np.zeros(normals.shape, np.float32), np.zeros(normals.shape, np.float32)
        steps = self.passes + 1
        on_progress("detail", 0, steps)
        if self.passes == 1:
            in_threads(separate_once, tiles(mask), normals, mask, self._kernel, shape, detail)
            on_progress("detail", 1, steps)
        else:
            shape, detail = self._repeat(normals, mask, shape, detail, on_progress)
        size = normal_map.normals.shape
        if self.kind == "guided" or self.kind == "bilateral":
            detail = _leave_within_edges(
                self.kind, normal_map.normals, mask, shape.reshape(size), self.w
            ).reshape(height, -1)
            in_threads(finish, height, normals, mask, shape, detail)
        on_progress("detail", steps, steps)
        return (
            NormalMap.of_unit_vectors(shape.reshape(size), mask),
            NormalMap.of_unit_vectors(detail.reshape(size), mask),
        )

    def check_size(self, size: tuple[int, int]) -> None:
        """Refuse the (height, width) of a normal map that is smaller than the window.

        Raises
        ------
        DataError
            The message names the largest `w` that fits, or the smallest map.
        """
        height, width = size
        if 2 * self.w + 1 > min(height, width):
            largest = (min(height, width) - 1) // 2
            remedy = "a map of at least 3 x 3 pixels is required"
            if largest:
                remedy = f"use w = {largest}{' or less' if largest > 1 else ''}, or a larger map"
            raise DataError(
                f"a shape filter with w={self.w} has a window of {2 * self.w + 1} pixels, larger "
                f"than the normal map of {width} x {height}: {remedy}"
            )

    def _repeat(
        self,
        normals: Float32,
        mask: Bool,
        shape: Float32,
        detail: Float32,
        on_progress: Progress,
    ) -> tuple[Float32, Float32]:
        kernel, gain = self._kernel, np.zeros(mask.shape, np.float32)
        in_threads(gains, tiles(mask), mask, mask.astype(np.float32), kernel, gain)
        # The two outputs hold the rest alternately, so no other buffer is required.
        rest, free = normals, (shape, detail)
        for done in range(self.passes):
            in_threads(leave, tiles(mask), mask, rest, gain, kernel, free[done % 2])
            rest = free[done % 2]
            on_progress("detail", done + 1, self.passes + 1)
        if rest is shape:
            shape, detail = detail, shape
        in_threads(finish, len(mask), normals, mask, shape, detail)
        return shape, detail


def _leave_within_edges(
    kind: EdgeAware, normals: Float32, mask: Bool, guide: Float32, w: int
) -> Float32:
    """Return the rest of the normals after smoothing that does not cross the edges of the guide.

    At an occlusion, a Gaussian mixes the normals of the two surfaces, which leaves a bright seam in
    the detail. These filters are guided by the Gaussian's shape, which contains no detail but still
    separates the two sides of an edge. Outside the mask, the guide and the normals are 0, which
    differs from a unit vector as much as the other side of an edge does.

    A first pass computes a better guide for the second: it restores edges that the Gaussian has
    rounded.

    Parameters
    ----------
    kind
        ``guided``: the normals are fitted as a linear function of the guide in windows of 0.8 w to
        either side (He et al., 2010). ``bilateral``: a Gaussian of sigma w that gives less weight
        to pixels whose guide differs by more than 0.3 (joint bilateral filter, Petschnigg et al.,
        2004). Its rest is filtered once more, because the wide range leaves shape in the rest.
    normals, guide
        ``(H, W, 3)`` unit vectors, 0 outside the mask: the map and its Gaussian shape.
    mask
        ``(H, W)``.
    w
        Half width of the Gaussian's window in pixels.

    Returns
    -------
    Float
        ``(H, W, 3)`` normals minus their smooth part, 0 outside the mask.
    """
    smooth = _smooth(kind, normals, mask, guide, w)
    length = np.linalg.norm(smooth, axis=2, keepdims=True)
    guide = smooth / np.maximum(length, np.float32(1e-6))
    rest = normals - _smooth(kind, normals, mask, guide, w)
    return rest - _smooth(kind, rest, mask, guide, w) if kind == "bilateral" else rest


def _smooth(kind: EdgeAware, vectors: Float32, mask: Bool, guide: Float32, w: int) -> Float32:
    import cv2  # late: other filters do not wait for it

    smooth = (
        cv2.ximgproc.guidedFilter(guide, vectors, round(_GUIDED_REACH * w), _GUIDED_EPSILON)
        if kind == "guided"
        else _bilateral(guide, vectors, w)
    )
    # Smoothing blurs across the border of the mask; the next pass must not use the values outside.
    return np.where(mask[..., None], np.asarray(smooth, np.float32), np.float32(0))


def _bilateral(guide: Float32, vectors: Float32, w: int) -> Float32:
    """Smooth vectors with weights that do not depend on the part of a map that is given."""
    import cv2

    reach = _bilateral_reach(w)
    guide, vectors = (
        np.asarray(
            cv2.copyMakeBorder(part, reach, reach + 1, reach, reach, cv2.BORDER_REFLECT_101),
            np.float32,
        )
        for part in (guide, vectors)
    )
    # OpenCV tabulates its weights over the range of the guide. A row that no pixel reaches makes it
    # that of all unit vectors.
    guide[-1], guide[-1, 0] = -1, 1
    smooth = cv2.ximgproc.jointBilateralFilter(guide, vectors, -1, _BILATERAL_RANGE, w)
    return np.asarray(smooth, np.float32)[reach : -reach - 1, reach:-reach]


def _bilateral_reach(w: int) -> int:
    return round(1.5 * w)
