"""Notes on an error if closing fails, too."""

from __future__ import annotations

import pytest

from rig import BoardError, BoardGoneError, CameraError, CameraGoneError, RigError
from rig._errors import close_after, note_unconfirmed

NOTES = {
    "something else": (
        CameraError("no frame"),
        CameraError("no end of acquisition"),
        ["on closing: no end of acquisition"],
    ),
    "gone, as before": (CameraGoneError("gone"), CameraGoneError("gone"), []),
    "gone by now": (RigError("no LED"), CameraGoneError("gone"), ["on closing: gone"]),
    "board gone, as before": (BoardGoneError("no answer"), BoardGoneError("closed"), []),
    "the other is gone": (CameraGoneError("c"), BoardGoneError("b"), ["on closing: b"]),
}
OFF = "LEDs not confirmed off"
UNCONFIRMED = {
    "the board is gone": (BoardGoneError("no answer"), BoardGoneError("closed"), [OFF]),
    "another failure": (CameraError("no frame"), BoardError("busy"), [f"{OFF}: busy"]),
}


@pytest.mark.parametrize(("error", "failure", "notes"), NOTES.values(), ids=NOTES)
def test_notes_of_a_failure_while_closing(
    error: RigError, failure: RigError, notes: list[str]
) -> None:
    def close() -> None:
        raise failure

    close_after(error, close)
    assert getattr(error, "__notes__", []) == notes


@pytest.mark.parametrize(("error", "failure", "notes"), UNCONFIRMED.values(), ids=UNCONFIRMED)
def test_leds_that_may_be_on_are_noted_once(
    error: RigError, failure: RigError, notes: list[str]
) -> None:
    note_unconfirmed(error, failure)
    note_unconfirmed(error, failure)
    assert error.__notes__ == notes
