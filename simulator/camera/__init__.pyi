from .gentl_camera import GentlCamera as GentlCamera
from .gentl_camera import GentlDevice as GentlDevice
from .sensor import FixedPattern as FixedPattern
from .sensor import ImageFormation as ImageFormation
from .sensor import fixed_pattern as fixed_pattern
from .sensor import sensor_image as sensor_image
from .virtual_camera import VirtualCamera as VirtualCamera
