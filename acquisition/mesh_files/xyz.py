"""XYZ files: points as lines of numbers, with or without normals."""

from __future__ import annotations

import re

import numpy as np

from acquisition.mesh_files.mesh_file import MeshFile, numbers_of
from rig import Notice, UnreadableError, pluralize
from rig.arrays import Float64

# Vectors in a file deviate from unit length only by rounding; colours are not unit vectors.
_UNIT_TOLERANCE = 0.02


def read_xyz(data: bytes) -> MeshFile:
    """Read a table of points; columns other than coordinates and normals are left out.

    Lines that begin with # or // are comments. Numbers may be separated by spaces, commas or
    semicolons. Commas between digits are decimal commas if other separators are there too.

    Raises
    ------
    UnreadableError
        If the lines do not have the same number of columns, at least three, or commas may be
        decimal or separate the columns.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    lines = [
        line for line in data.splitlines() if line.strip() and not line.startswith((b"#", b"//"))
    ]
    if not lines:
        raise UnreadableError("the point cloud has no points")
    lines, notices = _separated(lines)
    columns = len(lines[0].split())
    if columns < 3:
        raise UnreadableError(f"lines of {columns} numbers, expected x y z or x y z nx ny nz")
    wrong = next((line for line in lines if len(line.split()) != columns), None)
    if wrong is not None:
        shown = wrong[:40].decode("ascii", "backslashreplace")
        raise UnreadableError(
            f"not a table of x y z lines: {shown!r} does not have {columns} numbers"
        )
    try:
        table = numbers_of(b"\n".join(lines)).reshape(-1, columns)
    except UnreadableError as error:
        raise UnreadableError(f"not a table of x y z lines: {error}") from error
    begin = _begin_of_normals(table)
    left = columns - (3 if begin is None else 6)
    if left:
        text = f"{pluralize(left, 'column that is', 'columns that are')} not coordinates or normals"
        notices.append(Notice("columns-left-out", f"{text}, for example colours: left out"))
    normals = None if begin is None else table[:, begin : begin + 3]
    return MeshFile(table[:, :3], None, normals, tuple(notices))


def _separated(lines: list[bytes]) -> tuple[list[bytes], list[Notice]]:
    """Separate the numbers by spaces, and write decimal points."""
    text = b"\n".join(lines)
    comma, notices = b" ", []
    if b"," in text and b"." not in text:
        between_digits = text.count(b",") == len(re.findall(rb"\d,(?=\d)", text))
        other = all(re.search(rb"[;\s]", line.strip()) for line in lines)
        if other and between_digits:
            comma = b"."
            notices.append(Notice("decimal-commas", "the commas are read as decimal commas"))
        # An integer does not begin with 0, the digits after a decimal comma do.
        elif re.search(rb"\d,0\d", text):
            raise UnreadableError(
                "commas that may be decimal or separate the columns: save it with decimal points"
            )
    return text.replace(b",", comma).replace(b";", b" ").split(b"\n"), notices


def _begin_of_normals(table: Float64) -> int | None:
    """Return the first of the three columns that are unit vectors, or None.

    Colours, intensities and other values may come before or after them.
    """
    # After x y z, after a colour, after an intensity or an opacity.
    for begin in (begin for begin in (3, 6, 4, 7) if begin + 3 <= table.shape[1]):
        length = np.linalg.norm(np.clip(table[:, begin : begin + 3], -2, 2), axis=1)
        if (np.abs(length[np.isfinite(table[:, :3]).all(axis=1)] - 1) < _UNIT_TOLERANCE).all():
            return begin
    # Three columns more are normals or colours; which, is judged with those of other formats.
    return 3 if table.shape[1] == 6 else None
