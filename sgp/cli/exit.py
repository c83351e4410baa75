"""Exit codes: one table that maps errors to exit codes."""

from __future__ import annotations

import errno
from pathlib import Path

import acquisition
import calibration
import rig


class UsageError(Exception):
    """Error for an option, path or output folder that cannot be used (exit code 2)."""


class ClusterError(Exception):
    """Error of a cluster: its scheduler or a worker cannot do the work (exit code 3)."""


FAULT = 1
# Of a result that was written but should not be used.
UNUSABLE = 6

_CODES: tuple[tuple[type[Exception], int], ...] = (
    (UsageError, 2),
    (acquisition.MissingPathError, 2),
    (rig.RigNotFoundError, 2),
    (rig.RigError, 3),
    (ClusterError, 3),
    (acquisition.StorageError, 3),
    (acquisition.DataError, 4),
    (calibration.EstimateError, 5),
)


# Reasons that mean a wrong path; all others mean that the system or the disk refused.
_WRONG_PATHS = {
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.EEXIST,
    errno.ELOOP,
    errno.ENAMETOOLONG,
}


def exit_code(error: BaseException) -> int:
    """Return the exit code of an error; ``FAULT`` for an error in this program."""
    for kind, code in _CODES:
        if isinstance(error, kind):
            return code
    if isinstance(error, OSError):  # about a path that no package has checked
        return 2 if error.errno in _WRONG_PATHS else 3
    return FAULT


def error_text(error: BaseException) -> str:
    """Return one line that says what went wrong, where, and what to do about it."""
    if isinstance(error, OSError) and not isinstance(error, tuple(kind for kind, _ in _CODES)):
        path = Path(error.filename or "standard output")  # what is printed goes to no named file
        return str(acquisition.files.storage_error(path, "use it", error))
    if exit_code(error) == FAULT:
        return f"{type(error).__name__}: {error} (an error in this program: see --debug)"
    return str(error)
