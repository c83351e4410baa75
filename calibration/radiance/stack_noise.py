"""Law of the variance of the samples of a stack."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from calibration.radiance.demosaicing import LUMA
from rig import short_repr
from rig.arrays import Float32, Float64, UInt8


@dataclass(frozen=True, eq=False)
class StackNoise:
    """Temporal variance of the samples of N images, from up to B brackets each.

    The variance of one bracket is linear in the radiance: shot noise grows with it, read noise,
    quantisation and the noise of subtracted dark frames do not (EMVA 1288, equation 10). Merged
    brackets have the reciprocal of the sum of their reciprocal variances. Fixed patterns of the
    sensor are not included.

    Parameters
    ----------
    slope, floor
        ``(N, B)`` variance of a bracket per radiance and without light, before the division by the
        intensity of the light. The floor is infinite for a bracket that an image does not have.
    limit
        ``(N, B)`` radiance above which a bracket is too close to white to count; infinite for the
        shortest. It decides where ``used`` is not known.
    intensities
        ``(N, 3)`` intensities by which the images were divided.
    site_factor
        ``(2, 2, 3)`` factor of each colour at the sites of a mosaic, from the first pixel of the
        images on; ``(1, 1, 3)`` if all pixels are alike.
    colour
        Whether the sensor sees colours; images of one channel are then their luma.
    used
        ``(N, H, W)`` or ``(N, H, W, 3)`` uint8, the shape of the frames: bit b is set where bracket
        b counts; None for a single bracket, demosaiced images or averaged blocks.
    pattern
        Colours of the first 2 x 2 pixels if each pixel was divided by the intensity in the colour
        of its filter; None for other images.
    response
        ``(H, W)`` or ``(H, W, 3)`` flat field by which the images were divided; None without one.
    origin
        ``sensor`` if the recording states the sensor, ``repeats`` if repeats were compared.

    Examples
    --------
    >>> import numpy as np
    >>> from calibration import StackNoise
    >>> noise = StackNoise.of_one_exposure(slope=1e-4, floor=1e-6, images=3)
    >>> noise.variance(0, np.full((1, 2), 0.5, np.float32)).round(7)
    array([[5.1e-05, 5.1e-05]])
    """

    slope: Float64
    floor: Float64
    limit: Float64
    intensities: Float64
    site_factor: Float64
    colour: bool
    origin: str
    used: UInt8 | None = None
    pattern: str | None = None
    response: Float32 | None = None

    __repr__ = short_repr

    @classmethod
    def of_one_exposure(cls, slope: float, floor: float, images: int) -> StackNoise:
        """Return the law of images of one exposure under lights of intensity 1, without colour."""
        column = np.ones((images, 1))
        return cls(
            slope * column,
            floor * column,
            np.inf * column,
            np.ones((images, 3)),
            np.ones((1, 1, 3)),
            False,
            "sensor",
        )

    @property
    def linear(self) -> bool:
        """Whether the variance is linear in the values, with the same law at every second pixel."""
        return self.slope.shape[1] == 1 and self.used is None and self.response is None

    def variance(self, image: int, values: npt.ArrayLike, first_row: int = 0) -> Float64:
        """Return the variance of the samples of an image.

        Parameters
        ----------
        image
            Index of the image in the stack.
        values
            ``(H, W)`` or ``(H, W, 3)`` values of the stack, complete rows. Better estimates of the
            same radiance, for example of a model, give better variances.
        first_row
            Row of the first of them in the image.

        Returns
        -------
        NDArray
            float64 of the same shape, in the squared unit of the values; NaN where they are NaN.
        """
        values = np.asarray(values, np.float64)
        used = None
        if self.used is not None:
            used = self.used[image, first_row : first_row + len(values)]
        flat = self._flat(first_row, len(values))
        if not self.colour:
            strength = self._strength(image, values.shape, first_row) * flat
            variance = self._of_radiance(image, values * strength, used)
            if self.site_factor.shape[:2] == (1, 1):
                return np.asarray(variance * self.site_factor[0, 0, 0] / strength**2)
            return np.asarray(variance * self._sites(values.shape, first_row)[..., 0] / strength**2)
        # Gray values are the luma of a neutral surface: all channels have the gray value.
        gray = values.ndim == 2
        strength = self.intensities[image] * (flat[..., None] if flat.ndim == 2 else flat)
        colours = values[..., None] * strength if gray else values * strength
        variance = self._of_radiance(image, colours, used) / strength**2
        variance *= self._sites(variance.shape, first_row)
        return np.asarray(variance @ LUMA.astype(np.float64) ** 2 if gray else variance)

    def _flat(self, first_row: int, rows: int) -> Float64:
        """Return the flat field at some rows, 1 without one."""
        if self.response is None:
            return np.ones(())
        return np.asarray(self.response[first_row : first_row + rows], np.float64)

    def _strength(self, image: int, shape: tuple[int, ...], first_row: int) -> Float64:
        """Return the intensity by which an image of one channel was divided at each pixel."""
        if self.pattern is None:
            return np.asarray(self.intensities[image].mean())
        colours = ["RGB".index(name) for name in self.pattern]
        of_site: Float64 = self.intensities[image][colours].reshape(2, 2)
        rows, columns = (np.arange(shape[0]) + first_row) % 2, np.arange(shape[1]) % 2
        return np.asarray(of_site[rows][:, columns])

    def _of_radiance(self, image: int, radiance: Float64, used: UInt8 | None) -> Float64:
        """Return the variance of merged brackets at a radiance."""
        lit = np.maximum(radiance, 0)
        precision = np.zeros(lit.shape)
        brackets = zip(self.slope[image], self.floor[image], self.limit[image], strict=True)
        for b, (slope, floor, limit) in enumerate(brackets):
            if np.isfinite(floor):
                counts = lit < limit if used is None else used & np.uint8(1 << b) > 0
                precision += counts / (slope * lit + floor)
        precision[np.isnan(radiance)] = np.nan
        with np.errstate(divide="ignore"):
            return np.asarray(1 / precision, np.float64)

    def _sites(self, shape: tuple[int, ...], first_row: int) -> Float64:
        """Return the factor of each colour at each pixel of ``(H, W, 3)`` rows."""
        height, width = shape[:2]
        rows = (np.arange(height) + first_row) % len(self.site_factor)
        columns = np.arange(width) % self.site_factor.shape[1]
        return self.site_factor[rows][:, columns]

    def take(self, indices: list[int]) -> Self:
        """Return the law of the images with these indices, in this order."""
        return replace(
            self,
            slope=self.slope[indices],
            floor=self.floor[indices],
            limit=self.limit[indices],
            intensities=self.intensities[indices],
            used=None if self.used is None else self.used[indices],
        )

    def of_colour(self, channel: int) -> StackNoise:
        """Return the law of one channel (0 red, 1 green, 2 blue) of images in colour."""
        used, response = self.used, self.response
        return replace(
            self,
            intensities=np.repeat(self.intensities[:, [channel]], 3, axis=1),
            site_factor=np.repeat(self.site_factor[..., [channel]], 3, axis=2),
            colour=False,
            used=None if used is None else used[..., channel],
            response=response if response is None or response.ndim == 2 else response[..., channel],
        )

    def rows(self, first: int, last: int) -> Self:
        """Return the law of the rows from ``first`` to before ``last``, of which the first is 0."""
        return replace(
            self,
            site_factor=np.roll(self.site_factor, -first, axis=0),
            used=None if self.used is None else self.used[:, first:last],
            response=None if self.response is None else self.response[first:last],
            pattern=self.pattern and pattern_from_row(self.pattern, first),
        )


def pattern_from_row(pattern: str, row: int) -> str:
    """Return the colours of the first 2 x 2 pixels of a mosaic from a row on."""
    return pattern if row % 2 == 0 else pattern[2:] + pattern[:2]
