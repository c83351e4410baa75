"""The estimators of photometric stereo, and what one has to be."""

from __future__ import annotations

from typing import Protocol

from processing._stereo.cauchy import cauchy
from processing._stereo.least_squares import least_squares
from processing._stereo.method import Method
from processing._stereo.pixel_algebra import Double, Float


class Estimator(Protocol):
    """Estimates the scaled normal of each pixel of a block, each pixel on its own.

    A new one is a function of this form in a file of its own, listed in `ESTIMATORS` and in
    `Method`. It never sees images, masks, or whether lights are near.
    """

    def __call__(self, values: Float, vectors: Float, /) -> tuple[Double, Double]:
        """Return the scaled normals and the residuals of P pixels under N lights.

        Parameters
        ----------
        values
            ``(P, N)`` float32 linear radiance, divided by the lights' intensities; not finite
            where a sample was not measured.
        vectors
            ``(1, 3, N)`` float32 light vectors (x, y, z) that all pixels share, or ``(P, 3, N)``.

        Returns
        -------
        scaled
            ``(P, 3)`` float64, normal times albedo; 0 where the samples do not determine it.
        rms
            ``(P,)`` float64, root mean square of ``value - vector . scaled`` over the finite
            samples; 0 where there is no solution.
        """
        ...


ESTIMATORS: dict[Method, Estimator] = {"ls": least_squares, "cauchy": cauchy}
