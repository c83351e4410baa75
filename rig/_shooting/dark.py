"""LED-off on a path of its own: a signal puts the lights out before anything else happens.

``finally`` and ``with`` need the program to get there, and a program that is told to end may be
waiting for a camera or for a disk. So while a rig is open on the main thread, the signals that end
programs first write OFF straight to its port, and only then do what they did before. What no
program survives (SIGKILL, a call that never returns) is left to the board's own watchdog.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

from rig._ending import end_program

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
_ENDING = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))

_watched: dict[object, Callable[[], None]] = {}
# What a signal did before we came.
_before: dict[int, Any] = {}


def watch(darken: Callable[[], None]) -> Callable[[], None]:
    """Let signals that end the program call ``darken`` first.

    SIGINT goes on to whoever had it, so Ctrl-C is a KeyboardInterrupt as ever. SIGTERM and SIGHUP
    end the program through SystemExit, with code 128 + number, unless it had handlers for them.
    The lights go out at once; the exceptions wait until they can do no harm (`rig._ending`).
    Signals that are ignored stay so. On other threads than the main one no handler is installed.

    Parameters
    ----------
    darken
        Puts out the lights of one rig: fast, without waiting and without raising.

    Returns
    -------
    Callable
        Ends the watch; the last one puts the handlers back. Calling it twice does nothing.
    """
    key = object()
    _watched[key] = darken
    if _on_main_thread():
        for number in _ENDING:
            current = signal.getsignal(number)
            # None is a handler that is not Python's and could not be put back.
            if current not in (None, signal.SIG_IGN, _put_out_and_pass_on):
                _before[number] = current
                signal.signal(number, _put_out_and_pass_on)

    def release() -> None:
        _watched.pop(key, None)
        if _watched or not _on_main_thread():
            return
        for number, before in list(_before.items()):
            # Whoever has taken the signal since may still pass it on to us.
            if signal.getsignal(number) is _put_out_and_pass_on:
                signal.signal(number, before)
                del _before[number]

    return release


def _put_out_and_pass_on(number: int, frame: FrameType | None) -> None:
    for darken in tuple(_watched.values()):
        darken()
    before = _before.get(number, signal.SIG_DFL)
    if before is signal.default_int_handler:
        end_program(number, frame)
    elif callable(before):
        before(number, frame)
    elif before is signal.SIG_DFL and (number == signal.SIGINT or not _watched):
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    elif before is signal.SIG_DFL:
        end_program(number, frame)


def _on_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
