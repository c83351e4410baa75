"""Notes on an error if closing fails, too."""

from __future__ import annotations

import pytest

from rig import CameraError, CameraGoneError, RigError
from rig._errors import close_after

NOTES = {
    "something else": (
        CameraError("no frame"),
        CameraError("no end of acquisition"),
        ["on closing: no end of acquisition"],
    ),
    "gone, as before": (CameraGoneError("gone"), CameraGoneError("gone"), []),
    "gone by now": (RigError("no LED"), CameraGoneError("gone"), ["on closing: gone"]),
}


@pytest.mark.parametrize(("error", "failure", "notes"), NOTES.values(), ids=NOTES)
def test_notes_of_a_failure_while_closing(
    error: RigError, failure: RigError, notes: list[str]
) -> None:
    def close() -> None:
        raise failure

    close_after(error, close)
    assert getattr(error, "__notes__", []) == notes
