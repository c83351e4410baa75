"""Checks a GenTL producer file before it is loaded, since loading a wrong file can crash."""

from __future__ import annotations

import struct
from pathlib import Path

from genicam import gentl

from rig._errors import CameraError
from rig._genicam.errors import in_words
from rig._guard import MAX_BINARY_BYTES, UnreadableError, read_bounded

# Every producer exports this function, so the file contains its name.
_ENTRY_POINT = b"GCInitLib\0"
_ELF_MAGIC = b"\x7fELF"
_PT_LOAD = 1


def check_cti(path: Path) -> None:
    """Check that a file is a GenTL producer and can be loaded; this process must not be using it.

    Raises
    ------
    CameraError
        If there is no such file, it cannot be read, is cut short, or is not a GenTL producer.
    """
    try:
        content = read_bounded(path, MAX_BINARY_BYTES)
    except FileNotFoundError as error:
        raise CameraError(
            f"{path}: no such GenTL producer; give the path of the .cti file that came with the "
            "camera's driver"
        ) from error
    except UnreadableError as error:
        raise CameraError(f"{path}: cannot be read as a GenTL producer ({error})") from error
    if content[:4] == _ELF_MAGIC and _elf_is_cut_short(content):
        raise CameraError(f"{path}: this GenTL producer is cut short; install the driver again")
    if _ENTRY_POINT not in content:
        raise CameraError(f"{path}: not a GenTL producer; give the driver's .cti file")
    producer = gentl.GenTLProducer.create_producer()
    try:
        producer.open(str(path))
        producer.close()
    except gentl.GenericException as error:
        raise CameraError(
            f"{path}: this GenTL producer cannot be loaded ({in_words(error)}); install the driver "
            "again"
        ) from error


def _elf_is_cut_short(content: bytes) -> bool:
    """Return whether segments extend beyond the end: mapping them would kill the process."""
    wide, order = content[4:5] == b"\x02", ">" if content[5:6] == b"\x02" else "<"
    header, entry = ("16s2HI3QI3H", "2I4Q") if wide else ("16s2HI3II3H", "6I")
    try:
        fields = struct.unpack_from(order + header, content)
        table_at, entry_size, entries = fields[5], fields[9], fields[10]
        for index in range(entries):
            segment = struct.unpack_from(order + entry, content, table_at + index * entry_size)
            kind, at, size = segment[0], segment[2 if wide else 1], segment[5 if wide else 4]
            if kind == _PT_LOAD and at + size > len(content):
                return True
    except struct.error:
        return True
    return False
