from .camera_settings import camera_notices as camera_notices
from .engine import check_resume as check_resume
from .engine import record as record
from .engine import rehearse as rehearse
from .engine import resume as resume
from .recording_loop import RecordingHooks as RecordingHooks
from .stop_request import StopRequest as StopRequest
