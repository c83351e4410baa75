"""A recording from its first missing shot to its end, dark and resumable whatever happens."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from acquisition._engine.hooks import Hooks
from acquisition._engine.recording import ROOM, THREADS, Recording, StoppedError, Stored
from acquisition._engine.references import References
from acquisition._engine.stop_request import StopRequest
from acquisition._engine.write_queue import WriteQueue
from acquisition._errors import DataError, StorageError
from acquisition._pixels.quality import measure_quality
from acquisition._plan.plan import CapturePlan
from acquisition._session.writer import SessionWriter
from rig import Rig, RigError

# How long the disk may take no frame at all.
STALL_S: Final = 30.0
# How long writers may still take when the work has to end now.
_PATIENCE_S: Final = 1.0


def carry_out(
    rig: Rig,
    writer: SessionWriter,
    plan: CapturePlan,
    hooks: Hooks,
    events: Sequence[tuple[str, Mapping[str, Any]]],
    references: References,
    stall_s: float,
) -> None:
    """Take what a session is missing and complete it, or leave it dark and resumable.

    Parameters
    ----------
    rig
        Open rig.
    writer
        The session.
    plan
        Its plan.
    hooks
        Who is told.
    events
        Written first.
    references
        What was recorded before tells.
    stall_s
        How long the disk may take no frame at all.

    Raises
    ------
    RigError, DataError, StorageError, KeyboardInterrupt
        As `record` does.
    """
    # Its first call compiles: seconds, in which no light may burn.
    measure_quality(np.zeros((1, 1), np.uint16), white_level_dn=1)
    with StopRequest(hooks.on_stop) as stop:
        queue: WriteQueue[Stored | None] = WriteQueue(
            writer.folder,
            room=ROOM,
            threads=THREADS,
            stall_s=stall_s,
            when_idle=writer.check_next,
        )
        try:
            recording = Recording(rig, writer, plan, queue, hooks, references)
            for name, details in events:
                recording.event(name, **details)
            recording.run(stop)
            recording.wait_for_checks(stop)
        except BaseException as error:
            # Dark first, then the disk, then words.
            confirmed = _go_dark(rig, error)
            if _settle(queue, error):
                _note_end(writer, error, leds_confirmed_off=confirmed)
            raise
        queue.end(_PATIENCE_S)
    writer.complete()


def _go_dark(rig: Rig, error: BaseException) -> bool:
    """Turn the LEDs off and tell whether the board confirmed it; hides no error."""
    try:
        rig.off()
    except RigError as failure:
        note = f"LEDs not confirmed off: {failure}"
        if note not in getattr(error, "__notes__", ()):  # the rig may have tried in vain already
            error.add_note(note)
        return False
    return True


def _settle(queue: WriteQueue[Stored | None], error: BaseException) -> bool:
    """Let the disk have what was taken, unless the work has to end now; tell whether it rests."""
    if not isinstance(error, StorageError):
        can_wait = isinstance(error, Exception | StoppedError)
        with suppress(KeyboardInterrupt):  # the next Ctrl-C
            try:
                queue.drain(math.inf if can_wait else _PATIENCE_S)
            except StorageError as failure:
                error.add_note(str(failure))
    return queue.end(_PATIENCE_S)


def _note_end(writer: SessionWriter, error: BaseException, *, leds_confirmed_off: bool) -> None:
    event = "failed" if isinstance(error, Exception) else "interrupted"
    reason = str(error) or type(error).__name__
    if isinstance(error, SystemExit):
        reason = f"the program was told to end, exit code {error.code}"
    with suppress(StorageError, DataError):
        writer.write_event(event, reason=reason, leds_confirmed_off=leds_confirmed_off)
