"""What the images of a recording show of each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from processing._stereo.photometric_stereo import PhotometricStereoResult
from processing._uncertainty.normal_uncertainty import NormalUncertainty
from rig import Notice


@dataclass(frozen=True, eq=False)
class SolvedImages:
    """Normals of the valid pixels, their error bars, and the light above a matte surface."""

    stereo: PhotometricStereoResult
    uncertainty: NormalUncertainty
    specular: npt.NDArray[np.float32]
    warnings: tuple[Notice, ...]
