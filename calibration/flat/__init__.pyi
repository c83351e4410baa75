from .calibrate import FlatCalibration as FlatCalibration
from .calibrate import calibrate_flat as calibrate_flat
