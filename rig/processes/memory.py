"""How much memory there is, and how much a computation may use."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

_UNITS = {"K": 10, "M": 20, "G": 30, "T": 40}
_SIZE = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,6})?)\s*([KMGT])(i?B)?", re.IGNORECASE)
_MEMINFO = Path("/proc/meminfo")
_GROUP = Path("/sys/fs/cgroup")
# Of version 2 and 1: limit, memory in use, statistics, and the line of unused contents of files.
_LIMITS = (
    ("memory.max", "memory.current", "memory.stat", "inactive_file"),
    (
        "memory/memory.limit_in_bytes",
        "memory/memory.usage_in_bytes",
        "memory/memory.stat",
        "total_inactive_file",
    ),
)


def memory_of_computer() -> tuple[int | None, int | None]:
    """Return the total and the available memory in bytes; None for what the system does not show.

    Limits of a container (cgroup version 1 or 2) count as the memory of the computer. Contents of
    files that the system only keeps for the next reading count as available.

    Examples
    --------
    >>> from rig.processes import memory_of_computer
    >>> total, available = memory_of_computer()
    """
    if not hasattr(os, "sysconf"):
        return None, None
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    available = None
    with suppress(OSError):
        match = re.search(r"^MemAvailable:\s+(\d+) kB", _MEMINFO.read_text(), re.MULTILINE)
        available = None if match is None else int(match[1]) * 1024
    for names in _LIMITS:
        try:
            limit, used = (int((_GROUP / name).read_text()) for name in names[:2])
            cached = _cached(_GROUP / names[2], names[3])
        except (OSError, ValueError):  # no such file, or "max": no limit
            continue
        if limit < total:
            left = min(max(limit - used + cached, 0), limit)
            return limit, left if available is None else min(available, left)
    return total, available


def _cached(statistics: Path, name: str) -> int:
    """Return the bytes of a container that hold contents of files and are free when needed."""
    try:
        match = re.search(rf"^{name} (\d+)$", statistics.read_text(), re.MULTILINE)
    except OSError:
        return 0
    return 0 if match is None else int(match[1])


def memory_size(text: str) -> int:
    """Return the bytes that a text such as ``3G`` or ``500 MB`` means.

    K, M, G and T, alone or followed by iB, are powers of 1024; followed by B, powers of 1000.

    Raises
    ------
    ValueError
        If it is not a number with one of these units; a number alone would be ambiguous.

    Examples
    --------
    >>> from rig.processes import memory_size
    >>> memory_size("1.5G"), memory_size("500MB")
    (1610612736, 500000000)
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise ValueError("is not a size of memory: give a number and a unit, such as 3G or 500M")
    number, unit, suffix = match.groups()
    bits = _UNITS[unit.upper()]
    factor = 10.0 ** (3 * bits // 10) if (suffix or "").upper() == "B" else 2.0**bits
    return round(float(number) * factor)


def memory_budget(asked: int | None = None) -> int:
    """Return the bytes that a computation may use: those asked for, or half of what is available.

    Without information from the system, it is 2 GiB.

    Examples
    --------
    >>> from rig.processes import memory_budget
    >>> memory_budget(3_000_000_000)
    3000000000
    """
    if asked is not None:
        return asked
    total, available = memory_of_computer()
    known = available if available is not None else total
    return 2**31 if known is None else known // 2
