"""The bench: LED board, camera, and the two as one rig that knows which LED lit which frame."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from rig._bench import open_bench
from rig._board.board import Board
from rig._board.ports import FoundPort, find_board, find_boards
from rig._board.protocol import (
    MAX_COMMAND,
    NO_LED,
    PROTOCOL_VERSION,
    Command,
    ErrorCode,
    LineBuffer,
    LineError,
    Reply,
    crc16,
    decode_command,
    decode_reply,
    encode_command,
    encode_reply,
)
from rig._board.values import (
    BoardEcho,
    BoardIdentity,
    BoardStatus,
    FlashReport,
    Step,
    StepReport,
)
from rig._camera import Camera, CameraFrame, CameraInfo, Trigger
from rig._complaint import complaints
from rig._config import RigConfig, read_rig_config
from rig._errors import (
    BoardError,
    CameraError,
    FrameTimeoutError,
    RigConfigError,
    RigError,
    RigNotFoundError,
)
from rig._guard import (
    MAX_BINARY_BYTES,
    MAX_PIXELS,
    MAX_TEXT_BYTES,
    MAX_TOML_BYTES,
    UnreadableError,
    check_pixels,
    check_text,
    parse_json,
    parse_toml,
    read_bounded,
    read_head,
    refusing,
)
from rig._lights import Lights
from rig._mounting import Mounting
from rig._open import open_lights, open_rig, rig_names
from rig._rig import Rig
from rig._selftest.finding import Finding
from rig._shooting.shot import Shot
from rig._shooting.wires import Wires

if TYPE_CHECKING:
    from rig._genicam.camera import GenICamCamera, open_genicam
    from rig._genicam.system import FoundCamera, find_cameras
    from rig._selftest.selftest import SelfTest, selftest

__all__ = [
    "MAX_BINARY_BYTES",
    "MAX_COMMAND",
    "MAX_PIXELS",
    "MAX_TEXT_BYTES",
    "MAX_TOML_BYTES",
    "NO_LED",
    "PROTOCOL_VERSION",
    "Board",
    "BoardEcho",
    "BoardError",
    "BoardIdentity",
    "BoardStatus",
    "Camera",
    "CameraError",
    "CameraFrame",
    "CameraInfo",
    "Command",
    "ErrorCode",
    "Finding",
    "FlashReport",
    "FoundCamera",
    "FoundPort",
    "FrameTimeoutError",
    "GenICamCamera",
    "Lights",
    "LineBuffer",
    "LineError",
    "Mounting",
    "Reply",
    "Rig",
    "RigConfig",
    "RigConfigError",
    "RigError",
    "RigNotFoundError",
    "SelfTest",
    "Shot",
    "Step",
    "StepReport",
    "Trigger",
    "UnreadableError",
    "Wires",
    "check_pixels",
    "check_text",
    "complaints",
    "crc16",
    "decode_command",
    "decode_reply",
    "encode_command",
    "encode_reply",
    "find_board",
    "find_boards",
    "find_cameras",
    "open_bench",
    "open_genicam",
    "open_lights",
    "open_rig",
    "parse_json",
    "parse_toml",
    "read_bounded",
    "read_head",
    "read_rig_config",
    "refusing",
    "rig_names",
    "selftest",
]

# harvesters and scipy take a tenth of a second to import, and most who import rig need neither.
_LATE = {
    "FoundCamera": "rig._genicam.system",
    "GenICamCamera": "rig._genicam.camera",
    "find_cameras": "rig._genicam.system",
    "open_genicam": "rig._genicam.camera",
    "SelfTest": "rig._selftest.selftest",
    "selftest": "rig._selftest.selftest",
}


# Hidden from type checkers, for which any name would exist.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in _LATE:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_LATE[name]), name)
