"""Exit codes: one table from what went wrong to what the shell is told."""

from __future__ import annotations

from acquisition import DataError, MissingPathError, StorageError
from calibration import EstimateError
from rig import RigError, RigNotFoundError


class UsageError(Exception):
    """An option, path or output folder that cannot be used as asked (exit code 2)."""


FAULT = 1

_CODES: tuple[tuple[type[Exception], int], ...] = (
    (UsageError, 2),
    (MissingPathError, 2),
    (RigNotFoundError, 2),
    # What the rooms let through is an output place that cannot be used.
    (OSError, 2),
    (RigError, 3),
    (StorageError, 3),
    (DataError, 4),
    (EstimateError, 5),
)


def exit_code(error: BaseException) -> int:
    """Return the exit code of an error; ``FAULT`` for one that is ours to mend."""
    return next((code for kind, code in _CODES if isinstance(error, kind)), FAULT)
