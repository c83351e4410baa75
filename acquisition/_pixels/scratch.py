"""A file for libraries that write only to a name, where nobody else can put anything in its place.

The image libraries open a name themselves, through any link that stands there, and do not say why a
disk refused. So they encode into memory, and the bytes are written as all other files are.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def scratch_file() -> Iterator[Path]:
    """Give the name of a new file that no other process can name; it is gone afterwards.

    In memory on Linux, so that a process that is killed leaves nothing; elsewhere in a private
    folder among the temporary files.
    """
    if sys.platform == "linux":
        descriptor = os.memfd_create("image", os.MFD_CLOEXEC)
        try:
            yield Path(f"/proc/self/fd/{descriptor}")
        finally:
            os.close(descriptor)
    else:
        with tempfile.TemporaryDirectory(prefix="sgp-") as folder:
            yield Path(folder) / "image"
