"""What happens before anything is loaded: signals, and whether our packages are ours.

Nothing here imports more than the interpreter has loaded already: `sgp --help` is to be quick.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

# All in one folder, whichever way they were installed.
PACKAGES = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")
_ADVICE = "install sgp in an environment of its own (pipx, uv tool)"
_USAGE = 2
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
_NUMBERS = tuple(int(getattr(signal, name)) for name in _NAMES if hasattr(signal, name))
# The exit code of a program that a signal has ended is so much more than the signal's number.
_SIGNALLED = 128
_ENDING: dict[object, int] = {_SIGNALLED + number: number for number in _NUMBERS}


def enter(run: Callable[[], None]) -> None:
    """Load and run the program, with signals taken, unless a package of ours is not ours."""
    _take_signals()
    sys.unraisablehook, hook = _unraisable, sys.unraisablehook
    try:
        complaint = foreign_package()
        if complaint is None:
            run()
    except KeyboardInterrupt:
        _say("stopped by Ctrl-C")
        raise SystemExit(_SIGNALLED + signal.SIGINT) from None
    except ImportError as error:
        complaint = damaged_package(error)
        if complaint is None:
            raise
    finally:
        sys.unraisablehook = hook
    if complaint is not None:
        import json

        _say(complaint, json.dumps({"ok": False, "error": complaint, "exit_code": _USAGE}))
        raise SystemExit(_USAGE)


def foreign_package() -> str | None:
    """Return what is wrong where a package of ours would be imported from another place.

    Their names are short, and others use them too. Nothing is imported.
    """
    ours = Path(__file__).parents[1]
    for name in PACKAGES:
        found = _place(name)
        if found is None:
            return f"the package {name} of sgp is missing in {ours}: install sgp again"
        if not any(_same(place, ours / name) for place in found):
            return (
                f"the package {name} of sgp is hidden by another one, {found[0]}: rename or remove "
                f"that one, or {_ADVICE}"
            )
    return None


def damaged_package(error: ImportError) -> str | None:
    """Return what is wrong where an import failed in a package of ours, which others wrote over."""
    name = (error.name or "").partition(".")[0]
    if name not in PACKAGES:
        return None
    return (
        f"the package {name} in {Path(__file__).parents[1]} is not that of sgp, or not all of it "
        f"({error}): another distribution may have replaced it; {_ADVICE}"
    )


def _place(name: str) -> list[Path] | None:
    """Return where a package lies, or where the file of a module does."""
    try:
        spec = importlib.util.find_spec(name)
    except ValueError:  # a module without a spec, which somebody has put there
        return [Path(getattr(sys.modules[name], "__file__", None) or name)]
    if spec is None:
        return None
    folders = [Path(place) for place in spec.submodule_search_locations or ()]
    return folders or [Path(spec.origin or name)]


def _same(one: Path, two: Path) -> bool:
    return any(path(one) == path(two) for path in (os.path.abspath, os.path.realpath))


def _take_signals() -> None:
    for number in _NUMBERS:
        # What is ignored stays so: nohup, and what a shell runs in the background.
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _handle)


def _handle(number: int, frame: FrameType | None) -> None:
    end_program = getattr(sys.modules.get("rig"), "end_program", None)
    if end_program is None:
        # Nothing has been begun that could be damaged, and imports swallow exceptions.
        _end(number)
    else:
        end_program(number, frame)


def _unraisable(lost: Any) -> None:
    """Let a signal come again whose exception was lost in a finalizer or a callback from C."""
    end_later = getattr(sys.modules.get("rig"), "end_later", None)
    error = lost.exc_value
    if end_later is not None and isinstance(error, KeyboardInterrupt):
        end_later(signal.SIGINT)
    elif end_later is not None and isinstance(error, SystemExit) and error.code in _ENDING:
        end_later(_ENDING[error.code])
    else:
        sys.__unraisablehook__(lost)


def _end(number: int) -> None:
    """End the process now, as `sgp.app` does it later: one line and the code of the signal."""
    code = _SIGNALLED + number
    text = f"stopped by {'Ctrl-C' if number == signal.SIGINT else signal.Signals(number).name}"
    # By hand: in a signal handler nothing is imported.
    _say(text, f'{{"ok": false, "error": "{text}", "exit_code": {code}}}')
    os._exit(code)


def _say(text: str, record: str = "") -> None:
    """Write a line to stderr and, with ``--json``, a record to stdout, past Python's buffers."""
    with suppress(OSError):
        os.write(2, f"error: {text}\n".encode(errors="replace"))
    if record and "--json" in sys.argv:
        with suppress(OSError):
            os.write(1, f"{record}\n".encode())
