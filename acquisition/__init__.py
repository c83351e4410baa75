"""Recordings: plans, sessions, image files, and the values of lights, camera and sensor."""

from acquisition._camera_files import read_camera, write_camera
from acquisition._camera_model import CameraModel
from acquisition._engine import record
from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._images import read_image, write_exr, write_png, write_tiff
from acquisition._import import import_frames
from acquisition._journal import EventLine, FrameLine
from acquisition._lights import Lights, led_id, light_id
from acquisition._lights_files import read_lights, write_lights
from acquisition._manifest import Manifest
from acquisition._mask_files import read_mask, read_mask_shares
from acquisition._noise_model import NoiseModel
from acquisition._plan import CapturePlan, PlannedShot, read_plan
from acquisition._raw import RawFrame, read_raw
from acquisition._session import Session
from acquisition._session_frame import SessionFrame
from acquisition._session_writer import SessionWriter
from acquisition._software import SOFTWARE, software_version
from acquisition._source import Frame, Source
from acquisition._source_reader import read_source
from acquisition._verify import Verification, verify_session

__all__ = [
    "SOFTWARE",
    "CameraModel",
    "CapturePlan",
    "DataError",
    "EventLine",
    "Frame",
    "FrameLine",
    "Lights",
    "Manifest",
    "MissingPathError",
    "NoiseModel",
    "PlannedShot",
    "RawFrame",
    "Session",
    "SessionFrame",
    "SessionWriter",
    "Source",
    "StorageError",
    "Verification",
    "import_frames",
    "led_id",
    "light_id",
    "read_camera",
    "read_image",
    "read_lights",
    "read_mask",
    "read_mask_shares",
    "read_plan",
    "read_raw",
    "read_source",
    "record",
    "software_version",
    "verify_session",
    "write_camera",
    "write_exr",
    "write_lights",
    "write_png",
    "write_tiff",
]
