"""Threads, and the locks and conditions between them."""

from __future__ import annotations

import threading

Thread = threading.Thread
Lock = threading.Lock
Condition = threading.Condition


def is_main() -> bool:
    """Return whether this is the thread that handles the signals of the program."""
    return threading.current_thread() is threading.main_thread()
