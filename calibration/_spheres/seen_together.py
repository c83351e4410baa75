"""The spheres of all recordings of a calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from calibration._spheres.robust import Array
from calibration._spheres.sphere_calibration import Sphere
from calibration._spheres.sphere_image import SphereImage


@dataclass(frozen=True, eq=False)
class SeenTogether:
    """Names of N lights; K spheres, the number of the recording of each, whether it was found.

    ``places_mm (N, 3)`` are the places of the lights that are known independently, and ``names``
    has a name for each recording, empty if there is only one.
    """

    lights: tuple[str, ...]
    places_mm: Array
    images: list[SphereImage]
    of_recording: list[int]
    names: tuple[str, ...]
    found: list[bool]

    def without(self, k: int) -> SeenTogether:
        kept = [i for i in range(len(self.images)) if i != k]
        return replace(
            self,
            images=[self.images[i] for i in kept],
            of_recording=[self.of_recording[i] for i in kept],
            found=[self.found[i] for i in kept],
        )

    def numbered(self, spheres: tuple[Sphere, ...]) -> tuple[Sphere, ...]:
        pairs = zip(spheres, self.of_recording, strict=True)
        return tuple(replace(sphere, recording=k) for sphere, k in pairs)


def rms_deg(angle_deg: Array, use: npt.NDArray[np.bool_]) -> Array:
    """Return the root mean square ``(N,)`` of the used angles among ``(N, K)``."""
    square = np.where(use, angle_deg, 0.0) ** 2
    rms: Array = np.sqrt(square.sum(axis=1) / np.maximum(use.sum(axis=1), 1))
    return rms
