from .camera import GenICamCamera as GenICamCamera
from .camera import open_genicam as open_genicam
from .isolated import IsolatedCamera as IsolatedCamera
from .isolated import open_isolated as open_isolated
from .setup import CameraOptions as CameraOptions
from .system import FoundCamera as FoundCamera
from .system import find_cameras as find_cameras
