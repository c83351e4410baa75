from .camera import GenICamCamera as GenICamCamera
from .camera import open_genicam as open_genicam
from .setup import CameraOptions as CameraOptions
from .system import FoundCamera as FoundCamera
from .system import find_cameras as find_cameras
