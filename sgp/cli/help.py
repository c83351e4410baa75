"""Help pages, and one-line messages about wrong command lines."""

from __future__ import annotations

import difflib
import re
import shutil
import textwrap
from collections.abc import Iterator
from typing import Any

from cyclopts import CoercionError, CycloptsError, MissingArgumentError, UnknownCommandError
from cyclopts.help import HelpEntry, HelpPanel

from sgp.cli.help_groups import grouped

# Defaults that a help page does not show, since they only mean that nothing was given.
_NOTHING = ("()", '""', "False")
# Texts start in this column, or on a line of their own below a long name.
_TEXT_COLUMN = 22
_WIDEST = 100
_OF_EVERY_COMMAND = {"--json", "--debug", "--help", "--version"}


class PlainConsole:
    """The part of ``rich.console.Console`` that help pages need, without its slow import."""

    options = None

    @property
    def width(self) -> int:
        """Number of columns to fill."""
        return min(shutil.get_terminal_size().columns, _WIDEST)

    def print(self, text: Any = "") -> None:
        """Print a text to stdout."""
        print(getattr(text, "primary_renderable", text))


class HelpPage:
    """A formatter of help pages: plain text, wrapped to the width of the terminal.

    Parameters
    ----------
    optional
        Optional arguments, as the usage line shows them.
    """

    def __init__(self, optional: str = "") -> None:
        self.optional = optional

    def render_usage(self, console: Any, options: object, usage: Any) -> None:
        """Print the usage line."""
        named = re.sub(r"\[ARGS(\.\.\.)?\]", self.optional, str(usage)).strip()
        console.print(_wrapped(f"Usage: {named}", console.width, indent=7))
        console.print()

    def render_description(self, console: Any, options: object, description: Any) -> None:
        """Print the text above the panels; lines that are indented stay as they are."""
        for line in str(description.primary_renderable).splitlines():
            console.print(line if line.startswith(" ") else _wrapped(line, console.width))
        console.print()

    def __call__(self, console: Any, options: object, panel: HelpPanel) -> None:
        """Print one panel: a title, then names on the left and texts on the right."""
        if not panel.entries:
            return
        for title, entries in grouped(str(panel.title), sorted(panel.entries, key=_rank)):
            console.print(f"{title}:")
            for entry in entries:
                for line in _entry_lines(entry, console.width):
                    console.print(line)
            console.print()


def _rank(entry: HelpEntry) -> int:
    """Return a sort key: arguments, options, options of every command."""
    if entry.positional_label:
        return 0
    return 2 if set(entry.positive_names) & _OF_EVERY_COMMAND else 1


def _entry_lines(entry: HelpEntry, width: int) -> Iterator[str]:
    names = "  " + (entry.positional_label or ", ".join(entry.display_labels_with_metavar))
    text = _wrapped(entry_text(entry), width, first=_TEXT_COLUMN, indent=_TEXT_COLUMN)
    if len(names) + 2 <= _TEXT_COLUMN:
        yield names + text[len(names) :]
    else:
        yield names
        yield text


def entry_text(entry: HelpEntry) -> str:
    """Return what a help page says of a parameter: meaning, choices, default."""
    text = getattr(entry.description, "primary_renderable", entry.description)
    parts = [" ".join(str(text or "").split())]
    if entry.choices:
        parts.append(f"[choices: {', '.join(entry.choices)}]")
    if entry.default is not None and entry.default not in _NOTHING:
        parts.append(f"[default: {entry.default}]")
    if entry.required:
        parts.append("[required]")
    return " ".join(part for part in parts if part)


def _wrapped(text: str, width: int, *, first: int = 0, indent: int = 0) -> str:
    return textwrap.fill(
        text,
        max(width, indent + 20),
        initial_indent=" " * first,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def flowing(text: str) -> str:
    """Join the lines of each paragraph, so that the terminal can wrap it; keep examples as is."""
    return re.sub(r"(?<=\S)\n(?=\S)", " ", text)


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
    argument, given = error.argument, getattr(error, "keyword", None)
    if isinstance(error, MissingArgumentError) and argument is not None:
        if given is None and not argument.tokens:
            positional = argument.field_info.is_positional
            name = argument.name.lstrip("-").upper() if positional else argument.name
            return f"{name} is missing"
        if given is not None and argument.token_count()[0] == 1:
            return f"{given} requires a value: write one that begins with a minus as {given}=VALUE"
    if isinstance(error, CoercionError) and argument is not None and error.token is not None:
        # The parser's message names an option but not an argument.
        named = error.token.keyword is not None
        return str(error) if named else f"{argument.name.lstrip('-').upper()}: {error}"
    return str(error)
