"""What surrounds a program: signals, and what it does at its end."""

from __future__ import annotations

import atexit
import os
import secrets
import signal

draw_below = secrets.randbelow
handle = signal.signal
handler_of = signal.getsignal
at_exit = atexit.register
not_at_exit = atexit.unregister


def send_to_itself(number: int) -> None:
    """Send a signal to this program."""
    os.kill(os.getpid(), number)
