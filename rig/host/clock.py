"""Time: the monotonic clock, sleep, and the time of day."""

from __future__ import annotations

import time
from datetime import UTC, datetime

monotonic = time.monotonic
monotonic_ns = time.monotonic_ns
sleep = time.sleep


def utc_now() -> datetime:
    """Return the time of day. It is for people: it may jump, and decides nothing."""
    return datetime.now(UTC)
