"""Every public error is also the builtin that a caller would expect."""

from __future__ import annotations

import importlib
import pickle

import pytest

from rig import SgpError

KINDS: dict[tuple[str, str], type[Exception]] = {
    ("rig", "RigError"): RuntimeError,
    ("rig", "RigConfigError"): ValueError,
    ("rig", "UnreadableError"): ValueError,
    ("acquisition", "DataError"): ValueError,
    ("acquisition", "MissingPathError"): FileNotFoundError,
    ("acquisition", "StorageError"): OSError,
    ("calibration", "EstimateError"): ValueError,
}


@pytest.mark.parametrize(("room", "name"), KINDS, ids=lambda value: value)
def test_an_error_is_a_builtin_with_its_message(room: str, name: str) -> None:
    error = getattr(importlib.import_module(room), name)("where: what; what to do")
    assert isinstance(error, KINDS[room, name])
    assert isinstance(error, SgpError)
    assert str(error) == "where: what; what to do"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
