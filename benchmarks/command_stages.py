"""Where a command spends its CPU time and its memory: one row for each slow function of ours.

A row is a function that took at least 0.2 CPU seconds, or during which the resident memory
was within a tenth of its peak, indented below its caller. "user" and "sys" are CPU seconds of all
threads with the functions it called, "self" those without the rows below it, and "GB" the peak of
the resident memory while it ran. Run it twice: the first run may compile kernels.

    python benchmarks/command_stages.py run photographs/ --out result --force
"""

from __future__ import annotations

import re
import resource
import runpy
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

_ROOMS = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")
_ROOT = Path(__file__).resolve().parents[1]
_LEAST_S = 0.2
# The peak is read and reset at the first event after this time: it takes about 20 microseconds.
_INTERVAL_S = 0.002
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_PEAK = re.compile(rb"VmHWM:\s+(\d+)")


@dataclass
class Node:
    """A function, or the part of it that one caller started."""

    name: str
    calls: int = 0
    user: float = 0.0
    system: float = 0.0
    peak: float = 0.0
    below: dict[str, Node] = field(default_factory=dict)


class Tree:
    """Costs of our functions on the main thread, by their callers."""

    def __init__(self) -> None:
        self.root = Node("everything")
        self.open: list[tuple[FrameType | None, Node, float, float]] = []
        self.last = 0.0

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """Receive an event of `sys.setprofile`."""
        if event == "call":
            name = _name(frame)
            if name:
                self._settle(last=False)
                above = self.open[-1][1] if self.open else self.root
                node = above.below.setdefault(name, Node(name))
                node.calls += 1
                self.open.append((frame, node, *_spent()))
        elif event == "return" and self.open and self.open[-1][0] is frame:
            self._settle(last=False)
            _, node, user, system = self.open.pop()
            now = _spent()
            node.user += now[0] - user
            node.system += now[1] - system

    def _settle(self, *, last: bool) -> None:
        """Count the peak since the last time for all functions that are running."""
        now = time.perf_counter()
        if now - self.last < _INTERVAL_S and not last:
            return
        found = _PEAK.search(_STATUS.read_bytes())
        peak = int(found[1]) * 1024 / 1e9 if found else float("nan")
        for node in (self.root, *(entry[1] for entry in self.open)):
            node.peak = max(node.peak, peak)
        _CLEAR.write_bytes(b"5")
        self.last = time.perf_counter()

    def close(self) -> None:
        sys.setprofile(None)
        self._settle(last=True)
        self.root.user, self.root.system = _spent()


def _spent() -> tuple[float, float]:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime, used.ru_stime


def _name(frame: FrameType) -> str:
    """Return module and function of a frame of ours, else nothing."""
    module = frame.f_globals.get("__name__", "")
    if module.partition(".")[0] not in _ROOMS:
        return ""
    name = frame.f_code.co_qualname.replace(".<locals>", "")
    return f"{module.rpartition('.')[2]}.{name}"


def rows(node: Node, least_s: float, high: float, depth: int = 0) -> Iterator[str]:
    """Yield the lines of the table."""
    shown = [
        child
        for child in node.below.values()
        if child.user + child.system >= least_s or child.peak >= high
    ]
    own = node.user + node.system - sum(child.user + child.system for child in shown)
    yield (
        f"{node.user:8.2f}{node.system:8.2f}{own:8.2f}{node.peak:7.2f}{node.calls:7}"
        f"  {'  ' * depth}{node.name}"
    )
    for child in shown:
        yield from rows(child, least_s, high, depth + 1)


def main() -> None:
    words = sys.argv[1:]
    if not words or words[0] in ("-h", "--help"):
        print(__doc__)
        return
    sys.path.insert(0, str(_ROOT))
    tree = Tree()
    sys.argv[1:] = words
    sys.setprofile(tree)
    try:
        runpy.run_module("sgp", run_name="__main__", alter_sys=True)
    except SystemExit as end:
        if end.code:
            raise
    finally:
        tree.close()
        print(f"{'user s':>8}{'sys s':>8}{'self s':>8}{'GB':>7}{'calls':>7}", flush=True)
        for line in rows(tree.root, _LEAST_S, 0.9 * tree.root.peak):
            print(line)


if __name__ == "__main__":
    main()
