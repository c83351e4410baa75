"""Mean height of a surface under near lights whose strengths are not known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from acquisition import Lights
from processing._reconstruction.mean_height_search import coarse_images
from processing._reconstruction.recorded_images import Images
from processing._reconstruction.strength_fit import fit_strengths
from processing._reconstruction.views import View

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_PIXELS = 250
_TRIED = 13
# Of heights, relative to the range: a millimetre changes strengths by .2 %.
_ACCURACY = 1e-3


class HeightWithStrengths:
    """Finds the mean height at which a surface and any strengths explain the images best.

    Strengths that are fitted at a wrong height explain the mean fall-off of each light, so that the
    images seem to be those of a surface at this height. Only its change over the object shows the
    height: strengths, normals and height have to be fitted together.

    Parameters
    ----------
    values
        N images of linear radiance.
    lights
        N lights with positions.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see the surface.
    limits
        Lowest and highest mean height, mm.
    """

    def __init__(
        self, values: Images, lights: Lights, mask: Mask, view: View, limits: tuple[float, float]
    ) -> None:
        coarse = coarse_images(values, mask, view)
        places = np.flatnonzero(coarse.mask)
        places = places[:: max(1, -(-len(places) // _PIXELS))]
        self._values = coarse.values.reshape(len(lights), -1)[:, places].T.astype(np.float64)
        self._origins, self._rays = (
            of.reshape(-1, 3)[places] for of in (coarse.origins, coarse.rays)
        )
        rows, columns = np.divmod(places, coarse.mask.shape[1])
        self._pixels = tuple(coarse.factor * at + coarse.factor // 2 for at in (rows, columns))
        self._lights, self._view, self._limits = lights, view, limits
        self._spacing = (limits[1] - limits[0]) / (_TRIED - 1)
        self._scale = 0.0

    def best(self, depth: Float, found: float | None) -> float | None:
        """Return the best mean height of a surface of known shape; None if it is at a limit.

        Parameters
        ----------
        depth
            ``(H, W)`` depths of the surface.
        found
            The height that was found before, near which the new one is; None for the first time.
        """
        shape = depth[self._pixels].astype(np.float64)
        if found is None:
            tried = np.linspace(*self._limits, _TRIED)
            best = int(np.argmin([self._cost(shape, height) for height in tried]))
            if best in (0, _TRIED - 1):
                return None
            bounds = tried[best - 1], tried[best + 1]
        else:
            bounds = found - self._spacing, found + self._spacing
        # Imported here, as in `MeanHeightSearch`: it takes .4 s.
        from scipy.optimize import minimize_scalar

        accuracy = _ACCURACY * (self._limits[1] - self._limits[0])
        return float(
            minimize_scalar(
                lambda height: self._cost(shape, height),
                bounds=bounds,
                method="bounded",
                options={"xatol": accuracy},
            ).x
        )

    def _cost(self, shape: Double, height: float) -> float:
        depth = self._view.moved(shape, float(shape.mean()), self._view.distance_mm - height)
        points = self._origins + depth[:, None] * self._rays
        fit = fit_strengths(self._values, self._lights.vectors_at(points).transpose(1, 0, 2))
        if fit is None:
            return float("inf")
        if not self._scale:
            self._scale = max(float(np.median(fit.spread)), 1e-6)
        measured = fit.samples > 0
        cost = np.log1p(np.where(measured, fit.residuals / self._scale, 0.0) ** 2)
        return float(np.mean(cost.sum(axis=1) / measured.sum(axis=1)))
