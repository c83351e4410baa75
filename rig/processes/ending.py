"""Ends the program on a signal by an exception, raised when it does no harm.

Python runs signal handlers between any two steps of the program. An exception that a handler
raises inside a compiler or an import can do damage that `finally` does not repair: if it is raised
just after LLVM has linked one module into another, llvmlite still owns memory that LLVM has freed,
and the process dies of a segmentation fault when that memory is released. If it is raised in a
finalizer, it is reported and ignored. The exception therefore waits until the main thread has left
this code.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from types import FrameType
from typing import Literal

# Added to the number of the signal in the exit code of a program that a signal has ended.
SIGNALLED = 128

# pydantic compiles models, and turns exceptions into errors about the model.
_COMPILERS = ("numba", "llvmlite", "pydantic")
# Imports, which would fail half-way, and garbage collector callbacks, which swallow exceptions.
_BRIEF = (
    *("importlib", "_frozen_importlib", "_frozen_importlib_external"),
    *("weakref", "_weakrefset"),
)
_FINALIZER = "__del__"
# An import may run an entire program, so the wait is limited; a compiler always ends.
_BRIEF_PATIENCE_S = 10.0
_AGAIN_EVERY_S = 0.1
# So many intervals after a signal that no handler has seen, another one is sent.
_LOST_AFTER = 20


class _Waiting:
    """A signal whose exception is delayed, and the thread that sends the signal again.

    Only one signal of the thread is on its way at a time, and none after `end`: a late one would
    look like a second signal from outside, or would end the program in its cleanup.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.sent_again = False
        # When the main thread entered the import or finalizer in which it is now.
        self.brief_since_s: float | None = None
        self._over = False
        # The handler may interrupt itself while it holds the lock.
        self._lock = threading.RLock()
        # A daemon thread: the end of the program does not wait for it.
        threading.Thread(target=self._send_again, daemon=True).start()

    def waits(self, harm: Literal["lasting", "brief"]) -> bool:
        """Return whether the exception still has to wait in code that it could harm."""
        if harm == "lasting":
            # What follows the compiler has its own time: it may import at once.
            self.brief_since_s = None
            return True
        now_s = time.monotonic()
        if self.brief_since_s is None:
            self.brief_since_s = now_s
        return now_s - self.brief_since_s < _BRIEF_PATIENCE_S

    def end(self) -> None:
        """Stop sending."""
        with self._lock:
            self._over = True

    def _send_again(self) -> None:
        late = 0
        while True:
            time.sleep(_AGAIN_EVERY_S)
            late = late + 1 if self.sent_again else 0
            if late % _LOST_AFTER:
                continue
            with self._lock:
                if self._over:
                    return
                self.sent_again = True
                self._send()

    def _send(self) -> None:
        if hasattr(signal, "pthread_kill"):
            ident = threading.main_thread().ident
            if ident is not None:
                signal.pthread_kill(ident, self.number)
        else:  # Windows
            signal.raise_signal(self.number)


_waiting: _Waiting | None = None


def end_program(number: int, frame: FrameType | None) -> None:
    """Handle a signal that ends the program; a handler for `signal.signal`.

    Raises KeyboardInterrupt for SIGINT and SystemExit with 128 + number for other signals, either
    immediately or as soon as the main thread has left a compiler (numba), an import or a finalizer.
    A second signal during this wait ends the process by the signal's default action.

    Parameters
    ----------
    number, frame
        As Python passes them to a handler.
    """
    global _waiting
    waiting = _waiting
    if waiting is not None and waiting.number == number:
        if not waiting.sent_again:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        waiting.sent_again = False
    if harm := _harm(frame):
        waiting = _waiting = waiting or _Waiting(number)
        if waiting.waits(harm):
            return
    if waiting is not None:
        waiting.end()
        _waiting = None
        number = waiting.number
    raise exception_of(number)


def resend_signal(number: int) -> None:
    """Send a signal to the main thread in a moment; for use when its exception was lost."""
    global _waiting
    _waiting = _waiting or _Waiting(number)


def exception_of(number: int) -> BaseException:
    """Return the exception by which a signal ends the program."""
    if number == signal.SIGINT:
        return KeyboardInterrupt()
    return SystemExit(SIGNALLED + number)


def _harm(frame: FrameType | None) -> Literal["lasting", "brief"] | None:
    """Return whether an exception raised in this frame could do harm or be lost, and for long."""
    harm: Literal["brief"] | None = None
    while frame is not None:
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if package in _COMPILERS:
            return "lasting"
        if package in _BRIEF or frame.f_code.co_name == _FINALIZER:
            harm = "brief"
        frame = frame.f_back
    return harm
