"""Help pages, and one-line messages about wrong command lines."""

from __future__ import annotations

import difflib
import re
from typing import TYPE_CHECKING, Any

from cyclopts import CoercionError, CycloptsError, MissingArgumentError, UnknownCommandError
from cyclopts.help import DefaultFormatter, HelpPanel, InlineText

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions

# Defaults that a help page does not show, since they only mean that nothing was given.
_NOTHING = ("()", '""', "False")


class HelpPage(DefaultFormatter):
    """A help page that is wrapped to the width of the terminal.

    Parameters
    ----------
    optional
        Optional arguments, as the usage line shows them.
    """

    def __init__(self, optional: str = "") -> None:
        super().__init__()
        self._optional = optional

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print one panel."""
        entries = [
            entry.copy(
                description=InlineText.from_format(_one_line(entry.description), "plaintext"),
                default=None if entry.default in _NOTHING else entry.default,
            )
            for entry in panel.entries
        ]
        super().__call__(console, options, panel.copy(entries=entries))

    def render_usage(self, console: Console, options: ConsoleOptions, usage: Any) -> None:
        """Print the usage line."""
        named = re.sub(r"\[ARGS(\.\.\.)?\]", self._optional, str(usage))
        super().render_usage(console, options, named)


def flowing(text: str) -> str:
    """Join the lines of each paragraph, so that the terminal can wrap it; keep examples as is."""
    return re.sub(r"(?<=\S)\n(?=\S)", " ", text)


def page(text: str, *examples: str) -> str:
    """Return the text of a help page with examples, in the form of a command's docstring."""
    return "\n".join([text, "", "For example:", "", *(f"    {line}" for line in examples)])


def usage_complaint(error: CycloptsError, program: str) -> str:
    """Return one line that says what is wrong with a command line and names the help page.

    The parser's own message would import every command to list some of them, and would call an
    argument an option.
    """
    words = " ".join([program, *(error.command_chain or ())])
    return f"{_complaint(error, words)} (see `{words} --help`)"


def _complaint(error: CycloptsError, words: str) -> str:
    if isinstance(error, UnknownCommandError) and error.app and error.unused_tokens:
        unknown = error.unused_tokens[0]
        if unknown.startswith("-"):
            return f"{words} has no option {unknown}"
        names = [name for name in error.app if not name.startswith("-")]
        meant = difflib.get_close_matches(unknown, names, n=1)
        guess = f", did you mean {meant[0]}?" if meant else f": there are {', '.join(names)}"
        return f"{words} has no command {unknown}{guess}"
    argument = error.argument
    if (
        isinstance(error, MissingArgumentError)
        and argument is not None
        and not argument.tokens
        and error.keyword is None
    ):
        positional = argument.field_info.is_positional
        return f"{argument.name.lstrip('-').upper() if positional else argument.name} is missing"
    if isinstance(error, CoercionError) and argument is not None and error.token is not None:
        # The parser's message names an option but not an argument.
        named = error.token.keyword is not None
        return str(error) if named else f"{argument.name.lstrip('-').upper()}: {error}"
    return str(error)


def _one_line(description: Any) -> str:
    return " ".join(str(description.primary_renderable).split())
