"""A temporary file for a sheet that is too large for memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import acquisition

# A larger sheet is in a file while it is synthesised.
_MOST_IN_MEMORY = 400_000_000  # bytes


@contextmanager
def sheet_file(out: Path, size: tuple[int, int]) -> Iterator[acquisition.BandFile | None]:
    """Yield a file for the normals of a sheet, and delete it afterwards; None for small sheets.

    What was mapped into memory remains readable, and its space is free when the process ends.

    Parameters
    ----------
    out
        Folder of the result, which is created. The file is in a hidden folder inside; one that a
        killed process left is replaced.
    size
        (height, width) of the sheet.

    Raises
    ------
    DataError
        If the disk has too little space.
    StorageError
        If the disk refuses the file.
    """
    shape = (*size, 3)
    if 4 * int(np.prod(shape)) <= _MOST_IN_MEMORY:
        yield None
        return
    store = acquisition.BandStore(
        out / "detail", {"command": "synthesize"}, {"sheet": (shape, np.float32)}, replace=True
    )
    with store:
        try:
            yield store["sheet"]
        finally:
            store.remove()
