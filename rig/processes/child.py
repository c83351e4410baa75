"""Commands that run a module of this project in a separate Python process."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_ROOT = str(Path(__file__).parents[2])
# The module search path is set first, so that the module is searched for nowhere else.
_RUN = (
    "import runpy, sys\n"
    "sys.path[:] = sys.argv[1].split('\\n')\n"
    "module = sys.argv[2]\n"
    "del sys.argv[1:3]\n"
    "runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def module_command(module: str, *arguments: object) -> list[str]:
    """Return the command that runs a module of this project in a separate process.

    The process imports from the same folders as this one, but not from the working directory, so
    that it does not run a `rig.py` or `numpy.py` there. `python -m` would search there first.

    Parameters
    ----------
    module
        Full name of the module.
    arguments
        Command line arguments, converted to text.

    Returns
    -------
    list[str]
        Arguments for `subprocess.Popen`.

    Examples
    --------
    >>> from rig.processes import module_command
    >>> module_command("simulator.board", "--leds", 4)[-2:]
    ['--leds', '4']
    """
    path = "\n".join(_search_path())
    return [sys.executable, "-P", "-c", _RUN, path, module, *map(str, arguments)]


def _search_path() -> list[str]:
    """Return ``sys.path`` without the working directory, unless this project is there."""
    try:
        here = os.getcwd()
    except FileNotFoundError:  # it was removed
        return [entry for entry in sys.path if entry]
    entries = [os.path.abspath(entry) for entry in sys.path]
    return [entry for entry in entries if entry != here or _same(entry, _ROOT)]


def _same(one: str, two: str) -> bool:
    return os.path.realpath(one) == os.path.realpath(two)
