"""Recordings: plans, sessions, image files, and the values of lights, camera and sensor."""

from acquisition._engine.engine import check_resume, record, resume
from acquisition._engine.rehearsal import rehearse
from acquisition._errors import DataError, MissingPathError, SessionInUseError, StorageError
from acquisition._export.export import Export, prepare_export
from acquisition._import.frames import import_frames, read_import
from acquisition._import.watch import WatchResult, watch_folder
from acquisition._import.watch_shots import Watch, lights_in_order
from acquisition._metering.light_level import MeteringGoal
from acquisition._metering.metered import Metered, MeteredLight
from acquisition._metering.metering import meter
from acquisition._pixels.images import (
    read_image,
    read_image_with_alpha,
    write_exr,
    write_png,
    write_tiff,
)
from acquisition._pixels.mask_files import read_mask, read_mask_shares
from acquisition._pixels.normals_mat import write_normals_mat
from acquisition._pixels.raw import RawFrame, read_raw
from acquisition._plan.estimate import PlanEstimate, estimate_plan
from acquisition._plan.plan import CapturePlan, read_plan
from acquisition._plan.planned_shot import PlannedShot
from acquisition._preflight.check import Check
from acquisition._preflight.preflight import Preflight, preflight, preflight_resume
from acquisition._session.compact import Compaction, compact_session
from acquisition._session.journal import EventLine, FrameLine
from acquisition._session.manifest import Manifest
from acquisition._session.session import Session
from acquisition._session.session_frame import SessionFrame
from acquisition._session.verify import Verification, verify_session
from acquisition._session.writer import SessionWriter
from acquisition._software import SOFTWARE, software_version
from acquisition._source.reader import read_source
from acquisition._source.source import Frame, Source
from acquisition._staging import staged
from acquisition._storage import is_rest, make_folder, refusal, remove_rests, write_durably
from acquisition._value_files.camera import read_camera, write_camera
from acquisition._value_files.lights import read_lights, write_lights
from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights, led_id, light_id
from acquisition._values.noise_model import NoiseModel

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
    "SessionInUseError",
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
    "is_rest",
    "led_id",
    "light_id",
    "lights_in_order",
    "make_folder",
    "meter",
    "preflight",
    "preflight_resume",
    "prepare_export",
    "read_camera",
    "read_image",
    "read_image_with_alpha",
    "read_import",
    "read_lights",
    "read_mask",
    "read_mask_shares",
    "read_plan",
    "read_raw",
    "read_source",
    "record",
    "refusal",
    "rehearse",
    "remove_rests",
    "resume",
    "software_version",
    "staged",
    "verify_session",
    "watch_folder",
    "write_camera",
    "write_durably",
    "write_exr",
    "write_lights",
    "write_normals_mat",
    "write_png",
    "write_tiff",
]
