from .interface import Camera as Camera
from .interface import CameraFrame as CameraFrame
from .interface import CameraInfo as CameraInfo
from .interface import Trigger as Trigger
