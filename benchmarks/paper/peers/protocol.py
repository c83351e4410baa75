"""What all peers have in common: a system is fitted to data that stay, and run on others.

Each peer is a module here with a value ``PEER``; `peer` finds it by the name of the module.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Generic, NamedTuple, TypeVar

from benchmarks.harness import alone, peak_begins, resident_bytes
from sgp.cli.exit import UsageError

Given = TypeVar("Given")
Asked = TypeVar("Asked")
Made = TypeVar("Made")

NAMES = ("dspl", "lapl", "efros_leung", "xie2014", "dgts", "pu_net", "rdn")


@dataclass(frozen=True)
class Peer(Generic[Given, Asked, Made]):
    """A system that the paper compares with.

    Parameters
    ----------
    name
        Its name in tables.
    source
        Its publication.
    fit
        Takes what stays (a target, an exemplar, weights) and returns the function that is run.
    """

    name: str
    source: str
    fit: Callable[[Given], Callable[[Asked], Made]]


class Costs(NamedTuple):
    """CPU seconds of all threads of fitting and running, and the peak of memory above both inputs.

    The memory is NaN if the system does not report it.
    """

    fit_cpu_s: float
    run_cpu_s: float
    peak_mb: float


def peer(name: str) -> Peer[Any, Any, Any]:
    """Return a peer by the name of its module.

    Raises
    ------
    UsageError
        The message has the known names.
    """
    if name not in NAMES:
        raise UsageError(f"no peer {name!r}: use one of {', '.join(NAMES)}")
    found: Peer[Any, Any, Any] = import_module(f"benchmarks.paper.peers.{name}").PEER
    return found


def costs(system: Peer[Given, Asked, Made], given: Given, asked: Asked) -> Costs:
    """Measure a system in a process of its own, with compiled kernels."""
    return alone(_costs, system, given, asked)


def _costs(system: Peer[Given, Asked, Made], given: Given, asked: Asked) -> Costs:
    system.fit(given)(asked)  # compiles
    before, begun = peak_begins(), time.process_time()
    run = system.fit(given)
    fitted = time.process_time()
    run(asked)
    ended = time.process_time()
    peak = resident_bytes("VmHWM") - before
    return Costs(fitted - begun, ended - fitted, peak / 1e6)
