"""Separate path for turning the LEDs off: a signal does this before anything else.

``finally`` and ``with`` take effect only when the program reaches them, and a program that should
end may be waiting for a camera or a disk. While a rig is open on the main thread, the signals that
end programs therefore first write OFF directly to its port, and only then do what they did before.
The board's own watchdog covers the remaining cases (SIGKILL, a call that never returns).
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

from rig.host import program, threads
from rig.processes.ending import end_program

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
_ENDING = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))

watched: dict[object, Callable[[], None]] = {}
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
    watched[key] = darken
    if threads.is_main():
        for number in _ENDING:
            current = program.handler_of(number)
            # None is a handler that is not Python's and could not be restored.
            if current not in (None, signal.SIG_IGN, _darken_and_pass_on):
                _before[number] = current
                program.handle(number, _darken_and_pass_on)

    def release() -> None:
        watched.pop(key, None)
        if watched or not threads.is_main():
            return
        for number, before in list(_before.items()):
            # A handler installed since then may still pass the signal on to this one.
            if program.handler_of(number) is _darken_and_pass_on:
                program.handle(number, before)
                del _before[number]

    return release


def _darken_and_pass_on(number: int, frame: FrameType | None) -> None:
    for darken in tuple(watched.values()):
        darken()
    before = _before.get(number, signal.SIG_DFL)
    if before is signal.default_int_handler:
        end_program(number, frame)
    elif callable(before):
        before(number, frame)
    elif before is signal.SIG_DFL and (number == signal.SIGINT or not watched):
        program.handle(number, signal.SIG_DFL)
        program.send_to_itself(number)
    elif before is signal.SIG_DFL:
        end_program(number, frame)
