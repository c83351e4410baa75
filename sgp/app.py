"""The commands ``sgp`` and ``capture``: one parser, one place where errors become exit codes."""

from __future__ import annotations

import ast
import functools
import io
import os
import signal
import sys
from importlib.resources import files
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from sgp import __version__
from sgp._help import HelpPage, flowing, page, usage_complaint
from sgp._printable import printable, printable_lines
from sgp._stderr import STDERR

# Idle threads of numba's OpenMP pool would spin, which costs several times the work itself.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# The exit code of a program that a signal has ended is so much more than the signal's number.
_SIGNALLED = 128
# Command modules are named, not imported: `sgp --help` must not wait for OpenCV.
_TOP = ("demo", "run", "normals", "surface", "project", "compare", "simulate")
# Of each group its help page, and its commands by module.
_GROUPS: dict[str, tuple[str, dict[str, tuple[str, ...]]]] = {
    "capture": (
        page(
            "Record sessions, check them and bring in others.",
            "capture plan plan.toml --rig bench.toml",
            "capture run recordings/owl --rig bench.toml --plan plan.toml",
            "capture verify recordings/owl",
        ),
        {
            "capture": ("run", "resume", "verify", "info"),
            "capture_plan": ("plan", "check"),
            "capture_files": ("compact", "export", "import_"),
        },
    ),
    "rig": (
        page(
            "Talk to a rig: board and camera.",
            "sgp rig list",
            "sgp rig check --rig bench.toml",
        ),
        {"rig_list": ("list_",), "rig": ("check", "light", "off", "snap", "selftest")},
    ),
    "calibrate": (
        page(
            "Estimate where the lights are and how strong.",
            "sgp calibrate spheres chrome/ --out lights.json",
        ),
        {"calibrate": ("spheres", "intensities")},
    ),
    "detail": (
        page(
            "Split normal maps into shape and detail, combine, transfer and measure them.",
            "sgp detail separate out/normals --out parts",
            "sgp detail transfer leather.png out/normals --out leathery",
        ),
        {
            "detail": ("separate", "combine"),
            "detail_transfer": ("transfer",),
            "detail_properties": ("properties",),
        },
    ),
    "bench": (
        page(
            "Make the paper's tables anew, beside its own figures.",
            "sgp bench paper --out tables --quick",
        ),
        {"bench": ("paper",)},
    ),
}


def _app(name: str, text: str) -> App:
    return App(
        name=name,
        help=text,
        version=__version__,
        help_format="plaintext",
        help_formatter=HelpPage(),
        default_parameter=Parameter(negative=()),
        suppress_keyboard_interrupt=False,
    )


def _add(app: App, module: str, functions: tuple[str, ...]) -> None:
    """Name commands with the help of their docstrings, read without running the module."""
    source = files("sgp.commands").joinpath(f"{module}.py").read_text(encoding="utf-8")
    nodes = ast.parse(source).body
    found = {node.name: node for node in nodes if isinstance(node, ast.FunctionDef)}
    for function in functions:
        app.command(
            f"sgp.commands.{module}:{function}",
            name=function.rstrip("_"),
            help=_text(found[function]),
            help_formatter=HelpPage(_optional(found[function].args)),
        )


def _text(command: ast.FunctionDef) -> str:
    return flowing((ast.get_docstring(command) or "").partition("Parameters\n---")[0])


def _optional(arguments: ast.arguments) -> str:
    """Return the positional arguments that may be left out, as a usage line has them."""
    given = len(arguments.args) - len(arguments.defaults)
    names = [f"[{one.arg.upper()}]" for one in arguments.args[given:]]
    if arguments.vararg is not None:
        names.append(f"[{arguments.vararg.arg.upper()}...]")
    return " ".join(names)


def _group(name: str) -> App:
    text, modules = _GROUPS[name]
    app = _app(name, text)
    for module, functions in modules.items():
        _add(app, module, functions)
    return app


def build() -> App:
    """Return the whole command tree of ``sgp``."""
    app = _app(
        "sgp",
        page(
            "Photometric stereo from a rig or from photographs, and the surface detail in its "
            "normals.",
            "sgp demo --out demo",
            "sgp run photographs/ --lights lights.json --out result",
        ),
    )
    for name in _TOP:
        _add(app, name, (name,))
    for name in _GROUPS:
        app.command(_group(name))
    return app


def run(app: App, tokens: list[str]) -> int:
    """Run one command line and return its exit code."""

    @app.meta.default
    def launch(
        *tokens: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
        json: bool = False,
        debug: bool = False,
    ) -> tuple[Any, bool]:
        """Run a command.

        Parameters
        ----------
        json
            Print one JSON object on stdout: outputs, metrics, warnings.
        debug
            Show the stack trace of an error.
        """
        result = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        return result, json

    for stream in (sys.stdout, sys.stderr):  # what they cannot encode is escaped
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    app.meta.suppress_keyboard_interrupt = False
    fail = functools.partial(_fail, as_json="--json" in tokens, debug="--debug" in tokens)
    try:
        outcome = app.meta(
            tokens, exit_on_error=False, print_error=False, result_action="return_value"
        )
        code = _show(*outcome) if isinstance(outcome, tuple) else 0
        if sys.stdout is not None:  # it was closed before the start
            sys.stdout.flush()
        return code
    except CycloptsError as error:
        return fail(error, 2, usage_complaint(error, app.name[0]))
    except KeyboardInterrupt as error:
        return fail(error, 130, "stopped by Ctrl-C")
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):
            return 0  # a help page whose reader has gone: the console sends the rest nowhere
        # What the rig makes of SIGTERM and SIGHUP once its lights are out.
        if not isinstance(error.code, int) or error.code <= _SIGNALLED:
            raise
        name = signal.Signals(error.code - _SIGNALLED).name
        return fail(error, error.code, f"stopped by {name}")
    except BrokenPipeError:
        # The reader of our output has gone; what it wanted it has.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # noqa: BLE001 - the front door turns every error into one line
        from sgp._exit import error_text, exit_code

        return fail(error, exit_code(error), error_text(error))


def _show(result: Any, as_json: bool) -> int:
    from sgp._console import note
    from sgp._result import Result

    if not isinstance(result, Result):
        return 0
    if as_json:
        print(result.to_json())
    else:
        # Whoever reads the last line has what they came for: what they are to know comes first.
        for warning in result.warnings:
            note(f"note: {warning}")
        for line in result.summary:
            print(printable(line))
    return 0 if result.ok else result.failing_code


def _fail(error: BaseException, code: int, text: str, *, as_json: bool, debug: bool) -> int:
    # Notes were added to the error on its way, such as LEDs that are not confirmed off.
    said = "; ".join([text, *getattr(error, "__notes__", ())])
    line = printable(" ".join(said.split()))
    if debug:
        import traceback

        print(printable_lines(traceback.format_exc()), file=STDERR, end="")
    if as_json:
        from sgp._result import dumps

        print(dumps({"ok": False, "error": line, "exit_code": code}))
    print(f"error: {line}", file=STDERR)
    return code


def main() -> None:
    """Entry point of ``sgp``."""
    raise SystemExit(run(build(), sys.argv[1:]))


def capture() -> None:
    """Entry point of ``capture``, the same as ``sgp capture``."""
    raise SystemExit(run(_group("capture"), sys.argv[1:]))
