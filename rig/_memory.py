"""How much memory there is, and how much a computation may use."""

from __future__ import annotations

import os
import re
from pathlib import Path

_UNITS = {"K": 10, "M": 20, "G": 30, "T": 40}
_SIZE = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,6})?)\s*([KMGT])(i?B)?", re.IGNORECASE)
_MEMINFO = Path("/proc/meminfo")
_GROUP = Path("/sys/fs/cgroup")


def memory_of_computer() -> tuple[int | None, int | None]:
    """Return the total and the available memory in bytes; None for what the system does not show.

    Limits of a container (cgroup version 2) count as the memory of the computer.

    Examples
    --------
    >>> from rig import memory_of_computer
    >>> total, available = memory_of_computer()
    """
    if not hasattr(os, "sysconf"):
        return None, None
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    available = None
    try:
        match = re.search(r"^MemAvailable:\s+(\d+) kB", _MEMINFO.read_text(), re.MULTILINE)
        available = None if match is None else int(match[1]) * 1024
        limit = int((_GROUP / "memory.max").read_text())
        used = int((_GROUP / "memory.current").read_text())
    except (OSError, ValueError):  # no such file, or "max": no limit
        return total, available
    left = max(limit - used, 0)
    return min(total, limit), left if available is None else min(available, left)


def memory_size(text: str) -> int:
    """Return the bytes that a text such as ``3G`` or ``500 MB`` means.

    K, M, G and T, alone or followed by iB, are powers of 1024; followed by B, powers of 1000.

    Raises
    ------
    ValueError
        If it is not a number with one of these units; a number alone would be ambiguous.

    Examples
    --------
    >>> from rig import memory_size
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
    >>> from rig import memory_budget
    >>> memory_budget(3_000_000_000)
    3000000000
    """
    if asked is not None:
        return asked
    total, available = memory_of_computer()
    known = available if available is not None else total
    return 2**31 if known is None else known // 2
