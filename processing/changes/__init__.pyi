from .changes import Change as Change
from .changes import Changes as Changes
from .changes import find_changes as find_changes
from .detection import DetectionLevel as DetectionLevel
