"""A private scratch file for image libraries that can write only to a file name.

The image libraries open the name themselves, follow any link there, and do not report why a write
failed. So they encode into this file, and the bytes are then written like all other files.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Larger files are on the disk.
_IN_MEMORY = 128 << 20


@contextmanager
def scratch_file(size: int, folder: Path) -> Iterator[Path]:
    """Yield the name of a new file that no other process can name, and remove it afterwards.

    On Linux the file is in memory, or in ``folder`` without a name if it may have more than 128 MB,
    so that a killed process leaves nothing behind. On other systems it is in a private temporary
    folder.
    """
    if sys.platform == "linux" and size > _IN_MEMORY:
        with tempfile.TemporaryFile(dir=folder) as file:
            yield Path(f"/proc/self/fd/{file.fileno()}")
    elif sys.platform == "linux":
        descriptor = os.memfd_create("image", os.MFD_CLOEXEC)
        try:
            yield Path(f"/proc/self/fd/{descriptor}")
        finally:
            os.close(descriptor)
    else:
        with tempfile.TemporaryDirectory(prefix="sgp-") as folder:
            yield Path(folder) / "image"
