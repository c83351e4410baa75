"""Exit codes: one table from what went wrong to what the shell is told."""

from __future__ import annotations

import errno
from pathlib import Path

from acquisition import DataError, MissingPathError, StorageError, refusal
from calibration import EstimateError
from rig import RigError, RigNotFoundError


class UsageError(Exception):
    """An option, path or output folder that cannot be used as asked (exit code 2)."""


FAULT = 1

_CODES: tuple[tuple[type[Exception], int], ...] = (
    (UsageError, 2),
    (MissingPathError, 2),
    (RigNotFoundError, 2),
    (RigError, 3),
    (StorageError, 3),
    (DataError, 4),
    (EstimateError, 5),
)


# A path that cannot be meant; with any other reason the system or its disk refuses.
_WRONG_PATHS = {
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.EEXIST,
    errno.ELOOP,
    errno.ENAMETOOLONG,
}


def exit_code(error: BaseException) -> int:
    """Return the exit code of an error; ``FAULT`` for one that is ours to repair."""
    for kind, code in _CODES:
        if isinstance(error, kind):
            return code
    if isinstance(error, OSError):  # for a path that no room has checked
        return 2 if error.errno in _WRONG_PATHS else 3
    return FAULT


def error_text(error: BaseException) -> str:
    """Return what went wrong, where, and what to do about it, in one line."""
    if isinstance(error, OSError) and not isinstance(error, tuple(kind for kind, _ in _CODES)):
        return str(refusal(Path(error.filename or "."), "use it", error))
    if exit_code(error) == FAULT:
        return f"{type(error).__name__}: {error} (a fault of this program: see --debug)"
    return str(error)
