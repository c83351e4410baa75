"""Pre-flight of the disk: free space for the recording, and durable writes."""

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
# Required space relative to the estimate: retakes and other programs need some, too.
MARGIN = 1.25
_PROBE_BYTES = 4_000_000


def check_disk(folder: Path, estimate_bytes: int) -> Check:
    """Check the disk of a planned session.

    A probe file is written into the nearest existing folder, flushed, read back and removed.

    Parameters
    ----------
    folder
        Folder of the session; it need not exist.
    estimate_bytes
        Estimated size of the recording; 1.25 times as much must be free.
    """
    place = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    try:
        rate_mb_s = _probe(place)
        with disk(place, "read the free space"):
            free_bytes = shutil.disk_usage(place).free
    except StorageError as error:
        return Check(NAME, "failed", str(error))
    needed_bytes = int(estimate_bytes * MARGIN)
    values: dict[str, float | int | str | None] = {
        "free_bytes": free_bytes,
        "needed_bytes": needed_bytes,
        "write_mb_per_s": round(rate_mb_s, 1),
    }
    finding = (
        f"{place}: {free_bytes / 1e6:.0f} MB free, {needed_bytes / 1e6:.0f} MB required "
        f"({MARGIN:g} x the estimate)"
    )
    if free_bytes < needed_bytes:
        text = f"{finding}: free space, choose another disk, or plan fewer shots"
        return Check(NAME, "failed", text, values)
    return Check(NAME, "ok", f"{finding}; writes durably at {rate_mb_s:.0f} MB/s", values)


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
            f"{place}: a file read back differs from the data written: do not use this disk"
        )
    return len(data) / 1e6 / max(seconds, 1e-6)
