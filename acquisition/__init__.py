"""Recordings: plans, sessions, image files, and the values of lights, camera and sensor."""

from acquisition._camera_files import read_camera, write_camera
from acquisition._camera_model import CameraModel
from acquisition._check import Check
from acquisition._compact import Compaction, compact_session
from acquisition._engine import check_resume, record, resume
from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._export import Export, prepare_export
from acquisition._images import read_image, write_exr, write_png, write_tiff
from acquisition._import import import_frames, read_import
from acquisition._journal import EventLine, FrameLine
from acquisition._light_level import MeteringGoal
from acquisition._lights import Lights, led_id, light_id
from acquisition._lights_files import read_lights, write_lights
from acquisition._manifest import Manifest
from acquisition._mask_files import read_mask, read_mask_shares
from acquisition._metered import Metered, MeteredLight
from acquisition._metering import meter
from acquisition._noise_model import NoiseModel
from acquisition._plan import CapturePlan, PlannedShot, read_plan
from acquisition._plan_estimate import PlanEstimate, estimate_plan
from acquisition._preflight import Preflight, preflight, preflight_resume
from acquisition._raw import RawFrame, read_raw
from acquisition._rehearsal import rehearse
from acquisition._session import Session
from acquisition._session_frame import SessionFrame
from acquisition._session_writer import SessionWriter
from acquisition._software import SOFTWARE, software_version
from acquisition._source import Frame, Source
from acquisition._source_reader import read_source
from acquisition._verify import Verification, verify_session
from acquisition._watch import Watch, WatchResult, lights_in_order, watch_folder

__all__ = [
    "SOFTWARE",
    "CameraModel",
    "CapturePlan",
    "Check",
    "Compaction",
    "DataError",
    "EventLine",
    "Export",
    "Frame",
    "FrameLine",
    "Lights",
    "Manifest",
    "Metered",
    "MeteredLight",
    "MeteringGoal",
    "MissingPathError",
    "NoiseModel",
    "PlanEstimate",
    "PlannedShot",
    "Preflight",
    "RawFrame",
    "Session",
    "SessionFrame",
    "SessionWriter",
    "Source",
    "StorageError",
    "Verification",
    "Watch",
    "WatchResult",
    "check_resume",
    "compact_session",
    "estimate_plan",
    "import_frames",
    "led_id",
    "light_id",
    "lights_in_order",
    "meter",
    "preflight",
    "preflight_resume",
    "prepare_export",
    "read_camera",
    "read_image",
    "read_import",
    "read_lights",
    "read_mask",
    "read_mask_shares",
    "read_plan",
    "read_raw",
    "read_source",
    "record",
    "rehearse",
    "resume",
    "software_version",
    "verify_session",
    "watch_folder",
    "write_camera",
    "write_exr",
    "write_lights",
    "write_png",
    "write_tiff",
]
