"""A folder among the temporary files for kernels, which no other user can write."""

from __future__ import annotations

import os
import stat
from pathlib import Path


def private_folder() -> Path | None:
    """Return a folder among the temporary files that no other user can write, or None.

    A kernel that is read back is code: a folder that another user has made, or can write or
    replace, is not used.
    """
    if not hasattr(os, "geteuid"):  # Windows keeps temporary files with those of the user
        return None
    for place in (os.environ.get("TMPDIR"), "/tmp", "/var/tmp"):
        if (
            place
            and os.path.isabs(place)
            and _is_private(path := Path(place) / f"sgp-{os.geteuid()}")
        ):
            return path
    return None


def _is_private(folder: Path) -> bool:
    try:
        above = folder.parent.stat()
        if above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX:
            return False
        folder.mkdir(0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    return ours and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
