from .frames import import_frames as import_frames
from .frames import read_import as read_import
from .watch import WatchResult as WatchResult
from .watch import watch_folder as watch_folder
from .watch_shots import Watch as Watch
from .watch_shots import lights_in_order as lights_in_order
