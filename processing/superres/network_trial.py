"""A first run of a network in a process of its own: OpenCV can crash on a damaged graph.

A network that comes with the program is known by its hash and needs no trial.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2

from acquisition import DataError
from processing.superres.model import SuperResolutionModel, comes_with_program
from rig.processes import module_command

# The network of the paper's size, with 90 MB, takes 5 s and 1 GB.
_LIMIT_S: Final = 60
_LIMIT_BYTES: Final = 2 << 30
_LIMIT_PER_BYTE: Final = 16
_REFUSED: Final = 1


def try_network(model: SuperResolutionModel) -> None:
    """Load and run a network of another origin in a separate process, with limits.

    Raises
    ------
    DataError
        If the process crashes, takes too long or too much memory, or refuses the network.
    """
    if comes_with_program(model):
        return
    where = f"{model.path}: not a usable network for super-resolution"
    try:
        ended = subprocess.run(
            module_command(__name__),
            # The parent's description is not needed.
            input=pickle.dumps(replace(model, training={}, deviations=None)),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # OpenCV's own messages
            timeout=_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise DataError(f"{where}: a first run took longer than {_LIMIT_S} s") from error
    if ended.returncode == 0:
        return
    reason = ended.stdout.decode(errors="replace")
    if ended.returncode != _REFUSED or not reason:
        reason = f"{where}: OpenCV crashed with it: export the network again"
    raise DataError(reason)


def _limit_resources(data: bytes) -> None:
    """Limit memory beyond what the process has now, and its time; only where the system can."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (2 * _LIMIT_S, 2 * _LIMIT_S))
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        most = pages * resource.getpagesize() + _LIMIT_BYTES + _LIMIT_PER_BYTE * len(data)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _main() -> int:
    from processing.superres.network import Network

    model = pickle.load(sys.stdin.buffer)
    cv2.setNumThreads(1)  # the stacks of many threads would count as its memory
    _limit_resources(model.data)
    try:
        Network(model, tried=True)
    except DataError as error:
        sys.stdout.buffer.write(str(error).encode(errors="replace"))
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main())
