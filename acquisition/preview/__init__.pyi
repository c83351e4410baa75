from .live_frame import Composite as Composite
from .live_frame import LiveFrame as LiveFrame
from .live_frame import Region as Region
from .live_picture import Marks as Marks
from .live_picture import picture_of as picture_of
