"""The commands ``sgp`` and ``capture``: one parser, one place that maps errors to exit codes."""

from __future__ import annotations

import ast
import contextlib
import functools
import inspect
import io
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from cyclopts import App, CycloptsError, Group, Parameter, UnknownCommandError

from sgp import __version__
from sgp.cli.help import HelpPage, PlainConsole, flowing, usage_complaint
from sgp.cli.terminal import STDERR, coloured, fitted, printable, printable_lines

if TYPE_CHECKING:
    from rich.console import Console

# Idle threads of numba's OpenMP pool would spin and use several times the CPU time of the work.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# The matrices are small: more threads of OpenBLAS would only wait for each other, and use CPU time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_CONSOLE = cast("Console", PlainConsole())
_PARAMETERS = Group("Parameters")

# Options that choose what a command prints to stdout; the first of those given counts.
_FORMS = ("json", "events")
# Added to a signal's number, this is the exit code of a program that the signal ended.
_SIGNALLED = 128
_COMMANDS = Path(__file__).with_name("commands")
# Command modules are named, not imported: `sgp --help` must not wait for OpenCV.
_TOP = (
    "demo",
    "run",
    "batch",
    "normals",
    "inspect",
    "surface",
    "curvature",
    "roughness",
    "project",
    "compare",
    "merge",
    "export",
    "relight",
    "simulate",
    "report",
    "verify",
    "doctor",
)
_COMPLETION = "completion"
# For each group: its commands by module. The one of its name has its help page.
_GROUPS: dict[str, dict[str, tuple[str, ...]]] = {
    "capture": {
        "capture": ("run", "resume"),
        "capture_info": ("verify", "info"),
        "capture_plan": ("plan", "check"),
        "capture_preview": ("preview",),
        "capture_files": ("compact", "export", "import_"),
    },
    "rig": {"rig": ("list_", "check", "light", "off", "snap", "selftest")},
    "calibrate": {
        "calibrate": ("spheres",),
        "calibrate_intensities": ("intensities",),
        "calibrate_flat": ("flat",),
        "calibrate_check": ("check",),
        "calibrate_sensor": ("sensor",),
        "calibrate_board": ("board",),
        "calibrate_camera": ("camera",),
    },
    "detail": {
        "detail": ("separate", "combine"),
        "detail_transfer": ("transfer",),
        "detail_properties": ("properties",),
        "detail_synthesize": ("synthesize",),
        "detail_fill": ("fill",),
        "detail_superres": ("superres",),
        "detail_train": ("train",),
    },
}


def _app(name: str, module: str) -> App:
    """Return an application whose help page is the docstring of a module of the commands."""
    _, text, *_ = (_COMMANDS / f"{module}.py").read_text(encoding="utf-8").split('"""', 2)
    return App(
        name=name,
        help=flowing(inspect.cleandoc(text)),
        version=__version__,
        help_format="plaintext",
        help_formatter=HelpPage(),
        group_arguments=_PARAMETERS,
        group_parameters=_PARAMETERS,
        console=_CONSOLE,
        error_console=_CONSOLE,
        default_parameter=Parameter(negative=()),
        suppress_keyboard_interrupt=False,
    )


def _add(app: App, module: str, functions: tuple[str, ...]) -> None:
    """Register commands, with help texts from their docstrings, without importing the module."""
    for function in functions:
        text, optional = _texts(module)[function]
        app.command(
            f"sgp.commands.{module}:{function}",
            name=function.rstrip("_"),
            help=text,
            help_formatter=HelpPage(optional),
        )


@functools.cache
def _texts(module: str) -> dict[str, tuple[str, str]]:
    """Return the help text and the optional positional arguments of each function."""
    nodes = ast.parse((_COMMANDS / f"{module}.py").read_text(encoding="utf-8")).body
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    return {node.name: (_text(node), _optional(node.args)) for node in functions}


def _add_completion(app: App) -> None:
    text = flowing((inspect.getdoc(completion) or "").partition("Parameters\n")[0])
    app.command(completion, name=_COMPLETION, help=text, help_formatter=HelpPage())


def _text(command: ast.FunctionDef) -> str:
    return flowing((ast.get_docstring(command) or "").partition("Parameters\n---")[0])


def _optional(arguments: ast.arguments) -> str:
    """Return the optional positional arguments in the notation of a usage line."""
    required = len(arguments.args) - len(arguments.defaults)
    names = [f"[{one.arg.upper()}]" for one in arguments.args[required:]]
    if arguments.vararg is not None:
        names.append(f"[{arguments.vararg.arg.upper()}...]")
    return " ".join(names)


def _group(name: str, command: str | None = None) -> App:
    """Return a group with its commands, or with those of the module that has the named one."""
    app, modules = _app(name, name), _GROUPS[name]
    having = [module for module, functions in modules.items() if command in _names(functions)]
    for module in having or modules:
        _add(app, module, modules[module])
    return app


def _names(functions: tuple[str, ...]) -> list[str]:
    return [function.rstrip("_") for function in functions]


def build(tokens: Sequence[str] | None = None) -> App:
    """Return the command tree of ``sgp``.

    With the words of a command line, the tree has only what this command line needs: to read the
    help texts of all commands takes as long as to start Python.
    """
    app = _app("sgp", "__init__")
    first, second, *_ = [*_words(tokens or ()), None, None]
    if first in _TOP:
        _add(app, first, (first,))
    elif first == _COMPLETION:
        _add_completion(app)
    elif first in _GROUPS:
        app.command(_group(first, second))
    else:
        for name in _TOP:
            _add(app, name, (name,))
        _add_completion(app)
        for name in _GROUPS:
            app.command(_group(name) if tokens is None else _app(name, name))
    return app


def _words(tokens: Sequence[str]) -> list[str]:
    return [token for token in tokens if not token.startswith("-")]


def completion(
    shell: Literal["bash", "zsh", "fish"], *, program: Literal["sgp", "capture"] = "sgp"
) -> None:
    """Print a script that completes commands and options when Tab is pressed.

    Redirect it into a file that the shell reads. For bash, with the package bash-completion, this
    is ~/.local/share/bash-completion/completions/sgp; for zsh a file _sgp in a folder of $fpath;
    for fish ~/.config/fish/completions/sgp.fish. Then start a new shell.

    For example:

        sgp completion bash
        sgp completion zsh --program capture

    Parameters
    ----------
    shell
        Shell that reads the script.
    program
        Program to complete: sgp, or capture, which needs a file of its own (capture, _capture,
        capture.fish).
    """
    app = build() if program == "sgp" else _group("capture")
    _take_common_options(app)
    print(app.generate_completion(prog_name=program, shell=shell), end="")


def _take_common_options(app: App) -> None:
    """Add the options of every command to an application, which then runs command lines."""

    @app.meta.default
    def launch(
        *tokens: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
        json: bool = False,
        debug: bool = False,
    ) -> Any:
        """Run a command.

        Parameters
        ----------
        json
            Print one JSON object with outputs, metrics and warnings to stdout.
        debug
            Print the stack trace of an error.
        """
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
        if getattr(command, "__module__", "").startswith("sgp.commands."):
            from sgp.cli.console import forget_reports
            from sgp.cli.entry import begin_work
            from sgp.cli.exit import UsageError
            from sgp.cli.options import require_inputs
            from sgp.results import own_files_named

            begin_work()
            forget_reports()
            if json and bound.arguments.get("events"):
                raise UsageError("--events prints lines and --json one object: give one of them")
            require_inputs(command, bound.arguments)
            with own_files_named():
                return command(*bound.args, **bound.kwargs)
        return command(*bound.args, **bound.kwargs)


def run(app: App, tokens: list[str]) -> int:
    """Run one command line and return its exit code."""
    _take_common_options(app)
    for stream in (sys.stdout, sys.stderr):  # escape characters that they cannot encode
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    app.meta.suppress_keyboard_interrupt = False
    form = next((form for form in _FORMS if f"--{form}" in tokens), "text")
    fail = functools.partial(_fail, form=form, debug="--debug" in tokens)
    try:
        _refuse_unknown_command(app, _words(tokens))
        outcome = app.meta(
            tokens, exit_on_error=False, print_error=False, result_action="return_value"
        )
        code = _show(outcome, form)
        if sys.stdout is not None:  # None if it was closed before the start
            sys.stdout.flush()
        return code
    except CycloptsError as error:
        return fail(error, 2, usage_complaint(error, app.name[0]))
    except KeyboardInterrupt as error:
        return fail(error, 130, "stopped by Ctrl-C")
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):
            return 0  # the reader of a help page has exited; the console discards the rest
        # The rig raises this on SIGTERM and SIGHUP after its LEDs are off.
        if not isinstance(error.code, int) or error.code <= _SIGNALLED:
            raise
        name = signal.Signals(error.code - _SIGNALLED).name
        return fail(error, error.code, f"stopped by {name}")
    except BrokenPipeError:
        # The reader of our output, for example `head`, has exited: this is not an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:  # noqa: BLE001 - every error becomes one line here
        from sgp.cli.exit import error_text, exit_code

        return fail(error, exit_code(error), error_text(error))


def _refuse_unknown_command(app: App, words: list[str]) -> None:
    # The parser itself would answer `nosuch --help` with the help page of the group.
    chain, apps, unused = app.parse_commands(words, include_parent_meta=False)
    if unused and apps[-1].default_command is None:
        raise UnknownCommandError(app=apps[-1], command_chain=chain, unused_tokens=unused)


def _show(result: Any, form: str) -> int:
    from sgp.cli.console import report
    from sgp.results import Result

    if not isinstance(result, Result):
        return 0
    code = 0 if result.ok else result.failing_code
    if form == "json":
        print(result.to_json())
        return code
    # Warnings are printed first, so that the last line on the terminal is the result.
    for warning in result.warnings:
        report(warning)
    if form == "events":
        from sgp.sessions import write_finished

        write_finished(result, code)
        return code
    for line in (*result.summary, *result.conclusion):
        print(coloured(fitted(printable(line), sys.stdout), sys.stdout))
    return code


def _fail(error: BaseException, code: int, text: str, *, form: str, debug: bool) -> int:
    # Callers add notes to an error, for example LEDs that are not confirmed off.
    finding = getattr(error, "finding", None)
    accept = [] if finding is None else [f"--accept {finding.code} continues anyway"]
    message = "; ".join([text, *accept, *getattr(error, "__notes__", ())])
    line = printable(" ".join(message.split()))
    if debug:
        import traceback

        print(printable_lines(traceback.format_exc()), file=STDERR, end="")
    findings = getattr(error, "findings", None)
    listed = {} if findings is None else {"findings": findings}
    if form == "json":
        from sgp.results import dumps

        with contextlib.suppress(OSError):  # standard output may be what failed
            print(dumps({"ok": False, "error": line, "exit_code": code, **listed}), flush=True)
    elif form == "events":
        from sgp.sessions import write_event

        write_event("failed", error=line, exit_code=code, **listed)
    # One write: a signal must not separate the line from its end.
    STDERR.write(coloured(fitted(f"error: {line}", STDERR), STDERR) + "\n")
    return code


def main() -> None:
    """Entry point of ``sgp``."""
    tokens = words_of_help(sys.argv[1:])
    raise SystemExit(_run_in_process(build(tokens), tokens))


def capture() -> None:
    """Entry point of ``capture``, the same as ``sgp capture``."""
    tokens = words_of_help(sys.argv[1:])
    command, *_ = [*_words(tokens), None]
    raise SystemExit(_run_in_process(_group("capture", command), tokens))


def words_of_help(tokens: list[str]) -> list[str]:
    """Return a command line in which ``help run`` is ``run --help``."""
    return [*tokens[1:], "--help"] if tokens[:1] == ["help"] else tokens


def _run_in_process(app: App, tokens: list[str]) -> int:
    """Run the command line of this process, which reports kernels that are compiled."""
    # An overwritten package is then reported as such.
    from rig.kernels import watch_kernels
    from sgp.cli.console import Compiling

    watch_kernels(Compiling())
    return run(app, tokens)
