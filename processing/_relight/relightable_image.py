"""An image as functions of the direction of its light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._relight.light_basis import TERMS, LightBasis, light_basis

Float = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RelightableImage:
    """Coefficients of `light_basis` at each pixel, for one function or for one per colour.

    Parameters
    ----------
    basis
        Name of the basis, with K functions.
    coefficients
        ``(H, W, K)`` float32 if all colours share one function, ``(H, W, K, 3)`` with one function
        for each of red, green and blue.
    colour
        ``(H, W, 3)`` float32 RGB that a shared function is multiplied by; None otherwise.

    Raises
    ------
    DataError
        If the shapes do not fit.
    """

    basis: LightBasis
    coefficients: Float
    colour: Float | None = None

    def __post_init__(self) -> None:
        terms = TERMS.get(self.basis)
        shared = self.colour is not None
        kind = (terms,) if shared else (terms, 3)
        shape = self.coefficients.shape
        if shape[2:] != kind or (self.colour is not None and self.colour.shape != (*shape[:2], 3)):
            found = "no colour" if self.colour is None else f"a colour of {self.colour.shape}"
            raise DataError(
                f"coefficients of shape {shape} with {found} are no image of the basis "
                f"{self.basis!r}"
            )

    def __repr__(self) -> str:
        height, width = self.size
        colours = "RGB" if self.colour is None else "LRGB"
        return f"RelightableImage({self.basis}, {colours}, {width} x {height} px)"

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.coefficients.shape[0], self.coefficients.shape[1]

    def relit(self, direction: npt.ArrayLike) -> Float:
        """Return the image under a distant light.

        Parameters
        ----------
        direction
            Vector toward the light, of any length: X right, Y up, Z toward the camera.

        Returns
        -------
        NDArray
            ``(H, W, 3)`` float32 RGB in the unit of the fitted images, of which 0 is black and 1
            white. Values may be outside 0 to 1.

        Raises
        ------
        DataError
            If the direction is not a vector with a length.

        Examples
        --------
        >>> import numpy as np
        >>> from processing import RelightableImage
        >>> brighter_upward = np.float32([[[0.5, 0, 0.5, 0, 0, 0]]])
        >>> image = RelightableImage("ptm", brighter_upward, np.ones((1, 1, 3), np.float32))
        >>> image.relit([0, 1, 0]).tolist(), image.relit([0, -1, 0]).tolist()
        ([[[1.0, 1.0, 1.0]]], [[[0.0, 0.0, 0.0]]])
        """
        vector = np.asarray(direction, np.float64)
        if vector.shape != (3,):
            raise DataError(f"a direction has 3 coordinates: the shape is {vector.shape}")
        weights = light_basis(vector, self.basis).astype(np.float32)
        if self.colour is None:
            return np.asarray(np.einsum("hwkc,k->hwc", self.coefficients, weights))
        return np.asarray((self.coefficients @ weights)[..., None] * self.colour)
