from .calibrate import SensorCalibration as SensorCalibration
from .calibrate import calibrate_sensor as calibrate_sensor
