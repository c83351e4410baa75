"""Pages that are written before each build: the commands, and the public names of the packages."""

from __future__ import annotations

import importlib
import inspect
import io
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from cyclopts import App
from cyclopts.help import HelpPanel

from sgp.app import build
from sgp.cli.help import HelpPage, entry_text

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PACKAGES = ("rig", "acquisition", "calibration", "processing", "simulator")
GROUPS = {
    "sgp": (),
    "capture": ("capture",),
    "sgp rig": ("rig",),
    "sgp calibrate": ("calibrate",),
    "sgp detail": ("detail",),
}
_OF_EVERY_COMMAND = {"--json", "--debug", "--help", "--version"}


class PageFormat(HelpPage):
    """Prints the help page of a command as reStructuredText."""

    def render_usage(self, console: Any, options: object, usage: Any) -> None:
        """Print the usage line."""
        text = io.StringIO()
        with redirect_stdout(text):
            super().render_usage(console, options, usage)
        line = " ".join(text.getvalue().split()).removeprefix("Usage: ")
        print(f".. code-block:: text\n\n   {line}\n")

    def render_description(self, console: Any, options: object, description: Any) -> None:
        """Print the text; lines that are indented are examples."""
        inside = False
        for line in str(description.primary_renderable).splitlines():
            if line.startswith(" ") and not inside:
                print("\n.. code-block:: console\n")
            inside = line.startswith(" ") or (inside and not line)
            print(line if inside else f"{escaped(line)}\n")
        print()

    def __call__(self, console: Any, options: object, panel: HelpPanel) -> None:
        """Print the parameters, the arguments first."""
        if panel.title == "Commands":
            return
        for entry in sorted(panel.entries, key=lambda entry: not entry.positional_label):
            if not _OF_EVERY_COMMAND & {*entry.positive_names}:
                label = entry.positional_label or ", ".join(entry.display_labels_with_metavar)
                print(f"``{label}``\n   {escaped(entry_text(entry))}\n")


def escaped(text: str) -> str:
    """Return a text with its signs escaped that have a meaning in reStructuredText."""
    return re.sub(r"([*|\\]|(?<=\w)_(?!\w))", r"\\\1", text)


def heading(text: str, sign: str = "=") -> str:
    return f"{text}\n{sign * len(text)}\n\n"


def toctree(names: list[str]) -> str:
    return ".. toctree::\n   :maxdepth: 1\n\n" + "".join(f"   {name}\n" for name in names)


def help_page(app: App, words: tuple[str, ...]) -> str:
    """Return the help page of a command."""
    command = app
    for word in words:
        command = command[word]
    if isinstance(command.help_formatter, HelpPage):
        command.help_formatter = PageFormat(command.help_formatter.optional)
    page = io.StringIO()
    with redirect_stdout(page):
        app.help_print(words)
    return page.getvalue()


def command_pages() -> Iterator[tuple[str, str]]:
    """Yield the pages of all commands: an index, and a page for each group."""
    app = build()
    files = [title.replace(" ", "-") for title in GROUPS]
    yield "index", heading("Commands") + EVERY_COMMAND + toctree(files)
    for file, (title, words) in zip(files, GROUPS.items(), strict=True):
        group = app[words[0]] if words else app
        page = heading(f"``{title}``") + help_page(app, words)
        for name in group:
            if not name.startswith("-") and (words or name not in GROUPS_OF_SGP):
                page += heading(f"``{title} {name}``", "-") + help_page(app, (*words, name))
        yield file, page


GROUPS_OF_SGP = {word for words in GROUPS.values() for word in words}
EVERY_COMMAND = """
Written from the help pages of the program. Every command also has ``--json``, which prints one
JSON object to stdout, ``--debug``, which prints the stack trace of an error, and ``--help``.

"""


def namespaces(package: ModuleType) -> dict[str, ModuleType]:
    """Return the namespaces of a package by their full names."""
    values = {f"{package.__name__}.{name}": getattr(package, name) for name in package.__all__}
    return {name: value for name, value in values.items() if inspect.ismodule(value)}


def documented(value: object) -> bool:
    """Return whether a name is documented by its docstring; constants and choices have none."""
    return inspect.isclass(value) or inspect.isfunction(value)


def module_page(full_name: str, module: ModuleType, names: list[str]) -> str:
    """Return the page of a namespace."""
    page = heading(f"``{full_name}``") + f".. automodule:: {full_name}\n   :no-members:\n\n"
    for name in names:
        value = getattr(module, name)
        kind = "class" if inspect.isclass(value) else "function"
        if documented(value):
            page += f".. auto{kind}:: {full_name}.{name}\n\n"
        else:
            page += f".. py:data:: {name}\n   :value: {shown(value)}\n\n"
    return page


def shown(value: object) -> str:
    """Return a constant, or a choice of texts, in one short line."""
    text = re.sub(r"(typing|numpy|simulator\.scene\.\w+)\.", "", repr(value))
    return text if len(text) <= 100 else f"{text[:100]} ..."


def package_pages() -> Iterator[tuple[str, str]]:
    """Yield the pages of the public names: an index, and a page for each package and namespace."""
    yield "index", heading("Python") + toctree([*PACKAGES])
    for package in map(importlib.import_module, PACKAGES):
        inside = namespaces(package)
        homes = {
            id(getattr(module, name)): f"{full_name}.{name}"
            for full_name, module in inside.items()
            for name in module.__all__
        }
        names = [name for name in package.__all__ if not inspect.ismodule(getattr(package, name))]
        own = [name for name in names if id(getattr(package, name)) not in homes]
        page = module_page(package.__name__, package, own)
        page += ".. list-table:: Most used names, with their places\n   :widths: auto\n\n"
        for name in names:
            if name not in own:
                value = getattr(package, name)
                text = (
                    (inspect.getdoc(value) or "").partition("\n\n")[0] if documented(value) else ""
                )
                page += f"   * - :py:obj:`{name} <{homes[id(value)]}>`\n"
                page += f"     - {' '.join(text.split())}\n"
        yield package.__name__, f"{page}\n{toctree([*inside])}"
        for full_name, module in inside.items():
            yield full_name, module_page(full_name, module, sorted(module.__all__))


def write_pages(app: Sphinx) -> None:
    """Write all pages; a page that is the same stays as it is, so that it is not read again."""
    generated = Path(app.srcdir, "generated")
    examples = {path.stem for path in Path(app.srcdir, "gallery").glob("*.py")}
    for path in (generated / "gallery").glob("*.rst"):
        if path.stem not in {"index", *examples}:  # of an earlier version
            path.unlink()
    for folder, pages in (("commands", command_pages()), ("api", package_pages())):
        (generated / folder).mkdir(parents=True, exist_ok=True)
        left = {*(generated / folder).iterdir()}
        for name, text in pages:
            path = generated / folder / f"{name}.rst"
            left.discard(path)
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")
        for path in left:
            path.unlink()


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the pages with Sphinx."""
    app.connect("builder-inited", write_pages, priority=100)
    return {"parallel_read_safe": True}
