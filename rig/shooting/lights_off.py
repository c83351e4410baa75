"""Separate path for turning the LEDs off: a signal does this before anything else.

``finally`` and ``with`` take effect only when the program reaches them, and a program that should
end may be waiting for a camera or a disk. While a rig is open on the main thread, the signals that
end programs therefore first write OFF directly to its port, and only then do what they did before.
The board's own watchdog covers the remaining cases (SIGKILL, a call that never returns).
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

from rig.processes.ending import end_program

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
_ENDING = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))

_watched: dict[object, Callable[[], None]] = {}
# Handlers of the signals before `watch` replaced them.
_before: dict[int, Any] = {}


def watch(darken: Callable[[], None]) -> Callable[[], None]:
    """Let signals that end the program call ``darken`` first.

    SIGINT is passed to its previous handler, so Ctrl-C still raises KeyboardInterrupt. SIGTERM and
    SIGHUP end the program through SystemExit, with code 128 + number, unless the program had
    handlers for them. The LEDs are turned off immediately; the exceptions wait until they can do no
    harm (`rig.processes.ending`). Ignored signals remain ignored. Handlers are installed only on
    the main thread.

    Parameters
    ----------
    darken
        Turns off the LEDs of one rig: fast, without waiting and without raising.

    Returns
    -------
    Callable
        Function that ends the watch; the last one restores the handlers. Calling it twice does
        nothing.
    """
    key = object()
    _watched[key] = darken
    if _on_main_thread():
        for number in _ENDING:
            current = signal.getsignal(number)
            # None is a handler that is not Python's and could not be restored.
            if current not in (None, signal.SIG_IGN, _darken_and_pass_on):
                _before[number] = current
                signal.signal(number, _darken_and_pass_on)

    def release() -> None:
        _watched.pop(key, None)
        if _watched or not _on_main_thread():
            return
        for number, before in list(_before.items()):
            # A handler installed since then may still pass the signal on to this one.
            if signal.getsignal(number) is _darken_and_pass_on:
                signal.signal(number, before)
                del _before[number]

    return release


def _darken_and_pass_on(number: int, frame: FrameType | None) -> None:
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
