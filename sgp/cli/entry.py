"""Start of the program: handle signals, and check that our packages are not hidden by others.

This module imports only modules that the interpreter has already loaded, so that `sgp --help` is
quick.
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

# All of them are in one folder, however they were installed.
PACKAGES = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")
_ADVICE = "install sgp in an environment of its own (pipx, uv tool)"
_USAGE = 2
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
_NUMBERS = tuple(int(getattr(signal, name)) for name in _NAMES if hasattr(signal, name))
# Added to a signal's number, this is the exit code of a program that the signal ended.
_SIGNALLED = 128
_ENDING: dict[object, int] = {_SIGNALLED + number: number for number in _NUMBERS}


def enter(run: Callable[[], None]) -> None:
    """Install signal handlers, then load and run the program unless a package of it is foreign."""
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
    """Return a message if one of our packages would be imported from another place, else None.

    The names of our packages are short, and other distributions use them too. Nothing is imported.
    """
    ours = Path(__file__).parents[2]
    for name in PACKAGES:
        places = _place(name)
        if places is None:
            return f"the package {name} of sgp is missing in {ours}: install sgp again"
        if not any(_same(place, ours / name) for place in places):
            return (
                f"the package {name} of sgp is hidden by another one, {places[0]}: rename or "
                f"remove the other one, or {_ADVICE}"
            )
    return None


def damaged_package(error: ImportError) -> str | None:
    """Return a message if an import failed because one of our packages was overwritten."""
    name = (error.name or "").partition(".")[0]
    if name not in PACKAGES:
        return None
    return (
        f"the package {name} in {Path(__file__).parents[2]} is not the one of sgp or is incomplete "
        f"({error}): another distribution may have replaced it; {_ADVICE}"
    )


def _place(name: str) -> list[Path] | None:
    """Return the folders of a package, or the file of a module; None if it does not exist."""
    try:
        spec = importlib.util.find_spec(name)
    except ValueError:  # a module without a spec: another program has put it into sys.modules
        return [Path(getattr(sys.modules[name], "__file__", None) or name)]
    if spec is None:
        return None
    folders = [Path(place) for place in spec.submodule_search_locations or ()]
    return folders or [Path(spec.origin or name)]


def _same(one: Path, two: Path) -> bool:
    return any(path(one) == path(two) for path in (os.path.abspath, os.path.realpath))


def _take_signals() -> None:
    for number in _NUMBERS:
        # Ignored signals stay ignored: nohup, and background jobs of a shell.
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _handle)


class _Work:
    begun = False


def begin_work() -> None:
    """State that the modules of the command are loaded, and that it begins."""
    _Work.begun = True


def _handle(number: int, frame: FrameType | None) -> None:
    end_program = _of_rig("end_program") if _Work.begun else None
    if end_program is None:
        # No work has begun that could be damaged, and imports swallow exceptions.
        _end(number)
    else:
        end_program(number, frame)


def _of_rig(name: str) -> Any:
    """Return a function of the package ``rig`` if that is loaded, else None.

    `getattr` would load it: an import in a handler that interrupts an import makes that one fail.
    """
    return vars(sys.modules["rig"]).get(name) if "rig" in sys.modules else None


def _unraisable(lost: Any) -> None:
    """Repeat a signal whose exception was lost in a finalizer or a callback from C."""
    resend_signal = _of_rig("resend_signal")
    error = lost.exc_value
    if resend_signal is not None and isinstance(error, KeyboardInterrupt):
        resend_signal(signal.SIGINT)
    elif resend_signal is not None and isinstance(error, SystemExit) and error.code in _ENDING:
        resend_signal(_ENDING[error.code])
    else:
        sys.__unraisablehook__(lost)


def _end(number: int) -> None:
    """End the process now, as `sgp.app` does later: print one line, exit with the signal's code."""
    code = _SIGNALLED + number
    text = f"stopped by {'Ctrl-C' if number == signal.SIGINT else signal.Signals(number).name}"
    # Written without the json module, because a signal handler must not import.
    _say(text, f'{{"ok": false, "error": "{text}", "exit_code": {code}}}')
    os._exit(code)


def _say(text: str, record: str = "") -> None:
    """Write a line to stderr and, with ``--json``, a record to stdout, both unbuffered."""
    with suppress(OSError):
        os.write(2, f"error: {text}\n".encode(errors="replace"))
    if record and "--json" in sys.argv:
        with suppress(OSError):
            os.write(1, f"{record}\n".encode())
