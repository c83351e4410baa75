"""Pre-flight of the disk: room for the recording, and writes that are durable."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

from acquisition._errors import StorageError
from acquisition._part_files import temporary
from acquisition._preflight.check import Check
from acquisition._storage import disk, read_back, sync_folder, write_whole

NAME = "disk"
# Room asked for, relative to the estimate: retakes, and what else writes to the disk.
MARGIN = 1.25
_PROBE_BYTES = 4_000_000


def check_disk(folder: Path, estimate_bytes: int) -> Check:
    """Check the disk on which a session is to lie.

    A probe file is written into the nearest folder that exists, flushed, read back and removed.

    Parameters
    ----------
    folder
        Of the session; it need not exist.
    estimate_bytes
        What the recording takes; 1.25 times as much must be free.
    """
    place = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    try:
        rate_mb_s = _probe(place)
        with disk(place, "ask for free space"):
            free_bytes = shutil.disk_usage(place).free
    except StorageError as error:
        return Check(NAME, "failed", str(error))
    needed_bytes = int(estimate_bytes * MARGIN)
    values: dict[str, float | int | str | None] = {
        "free_bytes": free_bytes,
        "needed_bytes": needed_bytes,
        "write_mb_per_s": round(rate_mb_s, 1),
    }
    said = (
        f"{place}: {free_bytes / 1e6:.0f} MB free, {needed_bytes / 1e6:.0f} MB wanted "
        f"({MARGIN:g} x the estimate)"
    )
    if free_bytes < needed_bytes:
        text = f"{said}: free space, choose another disk, or plan fewer shots"
        return Check(NAME, "failed", text, values)
    return Check(NAME, "ok", f"{said}; writes durably at {rate_mb_s:.0f} MB/s", values)


def _probe(place: Path) -> float:
    """Write, flush, read back and remove a file; return megabytes per second."""
    data = os.urandom(_PROBE_BYTES)
    with disk(place, "write a file here"), temporary(place / "sgp-probe") as part:
        began_s = time.monotonic()
        write_whole(part.descriptor, data)
        os.fsync(part.descriptor)
        sync_folder(place)
        seconds = time.monotonic() - began_s
        same = read_back(part.path) == data
    if not same:
        raise StorageError(
            f"{place}: a file read back differs from what was written: do not use this disk"
        )
    return len(data) / 1e6 / max(seconds, 1e-6)
