"""Run a recording from its first missing shot to its end; it stays resumable after any error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from acquisition._errors import DataError, StorageError
from acquisition.engine.recording_loop import (
    ROOM,
    THREADS,
    Recording,
    RecordingHooks,
    Stored,
)
from acquisition.engine.rejection import References
from acquisition.engine.repeat_watch import RepeatWatch
from acquisition.engine.stop_request import StoppedError, StopRequest
from acquisition.engine.write_queue import WriteQueue
from acquisition.pixels.quality import measure_quality
from acquisition.plan.plan import CapturePlan
from acquisition.session.writer import SessionWriter
from rig import Rig, RigError

# Longest time without a finished write before the disk counts as stuck.
STALL_S: Final = 30.0
# Time that the writers get to finish when the recording must end immediately.
_PATIENCE_S: Final = 1.0


def carry_out(
    rig: Rig,
    writer: SessionWriter,
    plan: CapturePlan,
    hooks: RecordingHooks,
    events: Sequence[tuple[str, Mapping[str, Any]]],
    references: References,
    stall_s: float,
    stop: StopRequest,
) -> None:
    """Take the missing shots of a session and complete it; after an error, leave it resumable.

    The LEDs are off at the end in both cases.

    Parameters
    ----------
    rig
        Open rig.
    writer
        Open writer of the session.
    plan
        Plan of the session.
    hooks
        Callbacks that report progress.
    events
        Events to write first.
    references
        Figures of the frames that were recorded before.
    stall_s
        Longest time without a finished write before the disk counts as stuck.
    stop
        Request to end it early.

    Raises
    ------
    RigError, DataError, StorageError, NotAcceptedError, KeyboardInterrupt
        As `record` does.
    """
    # The first call compiles, which takes seconds; no LED may be on meanwhile.
    measure_quality(np.zeros((1, 1), np.uint16), white_level_dn=1)
    watch = RepeatWatch(writer.folder, stall_s)
    with stop.by_ctrl_c(hooks.on_stop):
        queue: WriteQueue[Stored | None] = WriteQueue(
            writer.folder,
            room=ROOM,
            threads=THREADS,
            stall_s=stall_s,
            when_idle=writer.proofs.check_next,
        )
        try:
            recording = Recording(rig, writer, plan, queue, hooks, references, watch)
            for name, details in events:
                recording.event(name, **details)
            recording.run(stop)
            recording.wait_for_checks(stop)
            recording.compare_repeats()
        except BaseException as error:
            # LEDs off first, then finish the writes, then write the event.
            confirmed = _turn_leds_off(rig, error)
            if _finish_writes(queue, error):
                _write_end(writer, error, leds_confirmed_off=confirmed)
            raise
        finally:
            watch.end(_PATIENCE_S)
        queue.end(_PATIENCE_S)
    writer.complete()


def _turn_leds_off(rig: Rig, error: BaseException) -> bool:
    """Turn the LEDs off; return whether the board confirmed it. A failure becomes a note."""
    try:
        rig.off()
    except RigError as failure:
        # The rig may have noted it already.
        if not any("not confirmed off" in note for note in getattr(error, "__notes__", ())):
            error.add_note(f"LEDs not confirmed off: {failure}")
        return False
    return True


def _finish_writes(queue: WriteQueue[Stored | None], error: BaseException) -> bool:
    """Write the frames that were taken if there is time; return whether no write is running."""
    if not isinstance(error, StorageError):
        can_wait = isinstance(error, Exception | StoppedError)
        with suppress(KeyboardInterrupt):  # the next Ctrl-C
            try:
                queue.drain(math.inf if can_wait else _PATIENCE_S)
            except StorageError as failure:
                error.add_note(str(failure))
    return queue.end(_PATIENCE_S)


def _write_end(writer: SessionWriter, error: BaseException, *, leds_confirmed_off: bool) -> None:
    event = "failed" if isinstance(error, Exception) else "interrupted"
    reason = str(error) or type(error).__name__
    if isinstance(error, SystemExit):
        reason = f"the program was ended, exit code {error.code}"
    with suppress(StorageError, DataError):
        writer.write_event(event, reason=reason, leds_confirmed_off=leds_confirmed_off)
