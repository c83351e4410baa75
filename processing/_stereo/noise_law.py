"""The noise of the samples of a block of pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from calibration import StackNoise
from processing._stereo.least_squares import least_squares
from processing._stereo.pixel_algebra import Float
from rig import pluralize

Double = npt.NDArray[np.float64]


class NoiseLaw:
    """The law of the noise of a stack, in the form that an `Estimator` uses.

    Parameters
    ----------
    noise
        Law of the N images.
    shape
        ``(N, H, W)`` of the stack.

    Raises
    ------
    DataError
        If the law belongs to another number of images.
    """

    def __init__(self, noise: StackNoise, shape: tuple[int, int, int]) -> None:
        images, _, self._width = shape
        if len(noise.slope) != images:
            raise DataError(
                f"a law of the noise of {pluralize(len(noise.slope), 'image')} does not fit "
                f"{pluralize(images, 'image')}"
            )
        self._noise = noise
        self._linear: Double | None = None
        if noise.linear:
            tile = np.zeros((2, 2))
            floor, unit = (
                np.stack([noise.variance(i, tile + v) for i in range(images)]) for v in (0.0, 1.0)
            )
            self._linear = np.stack([floor, unit - floor]).astype(np.float32)
        self._alike = self._linear is not None and bool(
            np.all(self._linear == self._linear[..., :1, :1])
        )

    def of(self, pixels: npt.NDArray[np.intp], values: Float, vectors: Float) -> Float:
        """Return the law of some samples, ``(1, 2, N)`` or ``(P, 2, N)``, see `Estimator`.

        The law of merged exposures or colours is not linear: its variance at the signal that least
        squares predict is used.

        Parameters
        ----------
        pixels
            ``(P,)`` increasing indices into the flat image.
        values, vectors
            The samples, see `LightModel.samples`.
        """
        if self._alike and self._linear is not None:
            return np.ascontiguousarray(self._linear[None, :, :, 0, 0])
        rows, columns = np.divmod(pixels, self._width)
        if self._linear is not None:
            return np.ascontiguousarray(
                np.moveaxis(self._linear[:, :, rows % 2, columns % 2], 2, 0)
            )
        scaled, _ = least_squares(values, vectors)
        law = np.zeros((len(pixels), 2, values.shape[1]), np.float32)
        first, last = int(rows[0]), int(rows[-1])
        band = np.zeros((last - first + 1, self._width))
        for i in range(values.shape[1]):
            of_image = vectors[:, :, i].astype(np.float64)
            band[rows - first, columns] = np.einsum(
                "pc,pc->p", scaled, np.broadcast_to(of_image, scaled.shape)
            )
            law[:, 0, i] = self._noise.variance(i, band, first)[rows - first, columns]
        return law
