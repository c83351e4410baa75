"""The estimators of photometric stereo and their protocol."""

from __future__ import annotations

from typing import Protocol

from processing._stereo.best import best
from processing._stereo.cauchy import cauchy
from processing._stereo.least_squares import least_squares
from processing._stereo.method import Method
from processing._stereo.pixel_algebra import Double, Float
from processing._stereo.trimmed import trimmed


class Estimator(Protocol):
    """Function that estimates the scaled normal of each pixel of a block independently.

    To add an estimator, write a function of this form in a separate file and list it in
    `ESTIMATORS` and in `Method`. An estimator does not depend on images, on masks, or on whether
    the lights are near.
    """

    def __call__(
        self, values: Float, vectors: Float, law: Float | None = None, view: Float | None = None, /
    ) -> tuple[Double, Double]:
        """Return the scaled normals and the residuals of P pixels under N lights.

        Parameters
        ----------
        values
            ``(P, N)`` float32 linear radiance, divided by the lights' intensities; not finite
            if a sample was not measured.
        vectors
            ``(1, 3, N)`` float32 light vectors (x, y, z) that all pixels share, or ``(P, 3, N)``.
        law
            ``(1, 2, N)`` or ``(P, 2, N)`` float32: variance of a sample without light, and its
            increase per value; None if the noise is not known.
        view
            ``(1, 3)`` or ``(P, 3)`` float32 unit vectors toward the camera, for models of
            reflectance; None for the direction z.

        Returns
        -------
        scaled
            ``(P, 3)`` float64, normal times albedo; 0 if the samples do not determine it.
        rms
            ``(P,)`` float64, root mean square of ``value - vector . scaled`` over the finite
            samples; 0 if there is no solution.
        """
        ...


ESTIMATORS: dict[Method, Estimator] = {
    "ls": least_squares,
    "trimmed": trimmed,
    "cauchy": cauchy,
    "best": best,
}
