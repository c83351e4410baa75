"""The bench: LED board, camera, and the two as one rig that knows which LED lit which frame."""

from rig._board import Board, BoardEcho, BoardIdentity, BoardStatus
from rig._camera import Camera, CameraFrame, CameraInfo
from rig._complaint import first_complaint
from rig._config import RigConfig, read_rig_config
from rig._errors import BoardError, CameraError, RigConfigError, RigError, RigNotFoundError
from rig._open import open_rig, rig_names
from rig._protocol import (
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
from rig._rig import Rig, Shot

__all__ = [
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
    "LineBuffer",
    "LineError",
    "Reply",
    "Rig",
    "RigConfig",
    "RigConfigError",
    "RigError",
    "RigNotFoundError",
    "Shot",
    "crc16",
    "decode_command",
    "decode_reply",
    "encode_command",
    "encode_reply",
    "first_complaint",
    "open_rig",
    "read_rig_config",
    "rig_names",
]
