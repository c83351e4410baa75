"""How this project starts a Python process of its own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_ROOT = str(Path(__file__).parents[1])
# The module search path comes first, so that the module is looked for nowhere else.
_RUN = (
    "import runpy, sys\n"
    "sys.path[:] = sys.argv[1].split('\\n')\n"
    "module = sys.argv[2]\n"
    "del sys.argv[1:3]\n"
    "runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def module_command(module: str, *arguments: object) -> list[str]:
    """Return the command that runs a module of this project in a process of its own.

    The process imports from where this one does, but not from the working directory: a `rig.py` or
    `numpy.py` that lies there is not ours to run. `python -m` would look there first.

    Parameters
    ----------
    module
        Its full name.
    arguments
        Command line arguments, turned into text.

    Returns
    -------
    list[str]
        For `subprocess.Popen`.
    """
    path = "\n".join(_search_path())
    return [sys.executable, "-P", "-c", _RUN, path, module, *map(str, arguments)]


def _search_path() -> list[str]:
    """Return ``sys.path`` without the working directory, unless this project lies there."""
    try:
        here = os.getcwd()
    except FileNotFoundError:  # it was removed
        return [entry for entry in sys.path if entry]
    entries = [os.path.abspath(entry) for entry in sys.path]
    return [entry for entry in entries if entry != here or _same(entry, _ROOT)]


def _same(one: str, two: str) -> bool:
    return os.path.realpath(one) == os.path.realpath(two)
