from .calibrate import IntensityCalibration as IntensityCalibration
from .calibrate import calibrate_intensities as calibrate_intensities
from .fit import Vignetting as Vignetting
from .surface import MatteSurface as MatteSurface
