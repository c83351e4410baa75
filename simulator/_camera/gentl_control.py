"""The control file of a virtual GenICam camera: `simulator/gentl/control.h` in Python.

Change both together. The library checks magic, version and size before it uses the rest.
"""

from __future__ import annotations

import ctypes
import mmap
from pathlib import Path
from typing import Any

FAULTS = 256
MAX_LEDS = 1024
MAX_PATH = 1024
FAULT_KINDS = {
    "lost": 1,
    "late": 2,
    "incomplete": 3,
    "doubled": 4,
    "missed": 5,
    "unplug": 6,
    "underrun": 7,
}
AUTOMATICS = {"exposure": 1, "gain": 2, "white": 4, "gamma": 8}
CONTENT_PLANES, CONTENT_FRAMES = 1, 2
_VERSION = 1


class _Fault(ctypes.Structure):
    _fields_ = [
        ("at", ctypes.c_int64),
        ("late_ns", ctypes.c_int64),
        ("kind", ctypes.c_uint32),
        ("armed", ctypes.c_uint32),
    ]


def _fields(kind: Any, names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


class _Layout(ctypes.Structure):
    _fields_ = [
        ("magic", ctypes.c_char * 8),
        *_fields(ctypes.c_uint32, "version size width height leds content bit_depth noisy rolling"),
        *_fields(ctypes.c_uint32, "block_base autos stuck patterned most_buffers"),
        ("seed", ctypes.c_uint64),
        ("cfa", ctypes.c_char * 8),
        ("serial", ctypes.c_char * 64),
        ("hidden", ctypes.c_char * 256),
        ("bench_path", ctypes.c_char * MAX_PATH),
        *_fields(ctypes.c_double, "readout_us frame_period_us shake_px"),
        *_fields(ctypes.c_double, "electrons_per_dn read_noise_e black_level_dn"),
        *_fields(ctypes.c_double, "quantum_efficiency full_well_e dark_current_e_per_s"),
        *_fields(ctypes.c_double, "warm_up warm_up_s flicker pwm_hz pwm_duty"),
        ("dead", ctypes.c_uint8 * MAX_LEDS),
        ("temperature_c", ctypes.c_double),
        *_fields(ctypes.c_uint32, "plugged unplugs"),
        *_fields(ctypes.c_uint64, "exposures delivered dropped missed"),
        ("faults", _Fault * FAULTS),
    ]


SIZE = ctypes.sizeof(_Layout)


class ControlFile:
    """The mapped file: its fields are attributes of ``fields`` and shared with the library."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(SIZE))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), SIZE)
        self.fields: Any = _Layout.from_buffer(self._map)
        self.fields.magic = b"SGPCAMRA"
        self.fields.version = _VERSION
        self.fields.size = SIZE

    def close(self) -> None:
        """Close the file and set ``fields`` to None."""
        self.fields = None
        self._map.close()
