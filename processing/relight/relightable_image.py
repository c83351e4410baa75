"""An image as functions of the direction of its light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from rig.arrays import Float32, Float64

LightBasis = Literal["ptm", "hsh4", "hsh9"]

TERMS: dict[LightBasis, int] = {"ptm": 6, "hsh4": 4, "hsh9": 9}


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
    coefficients: Float32
    colour: Float32 | None = None

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

    def relit(self, direction: npt.ArrayLike) -> Float32:
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
        >>> from processing.relight import RelightableImage
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


def light_basis(directions: npt.ArrayLike, basis: LightBasis) -> Float64:
    """Return the values of the basis functions for some directions.

    Parameters
    ----------
    directions
        ``(..., 3)`` vectors toward the lights, of any length: X right, Y up, Z toward the camera.
        One from behind (z < 0) is replaced by the direction on the horizon below it.
    basis
        ``ptm``: 1, u, v, u², uv, v² of the unit vector (u, v, w) (Malzbender, Gelb and Wolters,
        *Polynomial Texture Maps*, SIGGRAPH 2001). ``hsh4``, ``hsh9``: the first 4 or 9
        hemispherical harmonics, in the order and with the signs of RelightLab and OpenLIME
        (Gautron et al., *A Novel Hemispherical Basis for Accurate and Efficient Rendering*, EGSR
        2004): orthonormal over the hemisphere.

    Returns
    -------
    NDArray
        ``(..., K)`` float64, K = 6, 4 or 9.

    Raises
    ------
    DataError
        If a vector is not finite or has no length, or there is no such basis.

    Examples
    --------
    >>> from processing.relight import light_basis
    >>> light_basis([[0, 0, 2], [3, 4, 0]], "ptm").round(2)
    array([[1.  , 0.  , 0.  , 0.  , 0.  , 0.  ],
           [1.  , 0.6 , 0.8 , 0.36, 0.48, 0.64]])
    """
    if basis not in get_args(LightBasis):
        raise DataError(f"a basis is one of {', '.join(get_args(LightBasis))}, not {basis!r}")
    vectors = np.array(directions, np.float64)
    if vectors.shape[-1:] != (3,):
        raise DataError(f"directions have 3 coordinates: the shape is {vectors.shape}")
    vectors[..., 2] = np.maximum(vectors[..., 2], 0.0)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (np.isfinite(length) & (length > 0)).all():
        raise DataError("a direction of a light is not finite, or has no length above the horizon")
    u, v, w = np.moveaxis(vectors / length, -1, 0)
    one = np.ones_like(u)
    if basis == "ptm":
        return np.stack([one, u, v, u * u, u * v, v * v], axis=-1)
    # cos(phi) and sin(phi) times sin(theta) are u and v, so that nothing is undefined at the pole:
    # sqrt(cos - cos²) = sin(theta) * sqrt(cos / (1 + cos)).
    side = np.sqrt(w / (1 + w))
    turned = w / (1 + w)
    shifted = 2 * w - 1
    columns = [
        one / np.sqrt(2 * np.pi),
        np.sqrt(6 / np.pi) * side * u,
        np.sqrt(3 / (2 * np.pi)) * shifted,
        np.sqrt(6 / np.pi) * side * v,
        -np.sqrt(30 / np.pi) * turned * (u * u - v * v),
        np.sqrt(30 / np.pi) * shifted * side * u,
        np.sqrt(5 / (2 * np.pi)) * (1 - 6 * w + 6 * w * w),
        np.sqrt(30 / np.pi) * shifted * side * v,
        -np.sqrt(30 / np.pi) * turned * 2 * u * v,
    ]
    return np.stack(columns[: TERMS[basis]], axis=-1)
