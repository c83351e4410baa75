"""Figures of commands: each has a type, a unit and a meaning, as docs/result-format.md prints."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NotRequired, get_args, get_origin, get_type_hints

from typing_extensions import get_original_bases, is_typeddict

from sgp.results import COMMANDS
from sgp.results import metrics as _metrics
from sgp.results import stage_metrics as _stage_metrics

DOCUMENT = Path(__file__).parents[2] / "docs" / "result-format.md"
NAMES = {int: "integer", float: "number", str: "text", bool: "boolean"}
# The first figures of a command are its own; the others are those of its stages.
TITLES = {kinds[0]: command for command, kinds in COMMANDS.items()}


def title(kind: type) -> str:
    """Return the command that has these figures, else the words in the name of the type."""
    words = re.findall("[A-Z][a-z]+", kind.__name__.removesuffix("Metrics"))
    return TITLES.get(kind, " ".join(words).lower())


def type_text(hint: Any) -> str:
    origin, args = get_origin(hint), get_args(hint)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in args)
    if origin is UnionType:
        (one,) = (arg for arg in args if arg is not NoneType)
        return f"{type_text(one)} or null"
    if origin is tuple:
        (one,) = dict.fromkeys(args)
        return f"{len(args)} {type_text(one)}s"
    if origin in (list, dict):
        several = type_text(args[-1]) + "s" * (args[-1] in NAMES)
        return f"{'list' if origin is list else 'object'} of {several}"
    if is_typeddict(hint):
        return f"[{title(hint)}](#{title(hint).replace(' ', '-')})"
    return NAMES[hint]


def described(kind: Any) -> dict[str, tuple[str, str]]:
    """Return unit and meaning of the figures of a type, from docstrings, by name."""
    found: dict[str, tuple[str, str]] = {}
    for base in filter(is_typeddict, get_original_bases(kind)):
        found |= described(base)
    _, _, rows = (inspect.getdoc(kind) or "").partition("Parameters\n----------\n")
    for row in re.split(r"\n(?! )", rows) if rows else ():
        head, *meaning = row.splitlines()
        name, _, unit = head.partition(" : ")
        found[name] = unit, " ".join(map(str.strip, meaning))
    return found


def table(kind: Any) -> list[str]:
    """Return the rows that the document should have for a type."""
    found, texts = [], described(kind)
    assert texts.keys() == kind.__annotations__.keys()
    for name, hint in get_type_hints(kind, include_extras=True).items():
        optional = name in kind.__optional_keys__
        if get_origin(hint) is NotRequired:
            optional, (hint,) = True, get_args(hint)
        unit, meaning = texts[name]
        assert meaning, name
        text = type_text(hint) + (", optional" if optional else "")
        found.append(f"| `{name}` | {text} | {unit} | {meaning} |".replace("|  |", "| |"))
    return found


def declared() -> dict[str, list[str]]:
    """Return the table of every type, by title; types that only others extend have none."""
    modules = (_metrics, _stage_metrics)
    kinds = [kind for one in modules for kind in vars(one).values() if is_typeddict(kind)]
    bases = {base for kind in kinds for base in get_original_bases(kind)}
    return {title(kind): table(kind) for kind in kinds if kind not in bases}


def documented() -> dict[str, list[str]]:
    _, *sections = DOCUMENT.read_text(encoding="utf-8").split("\n### ")
    found = {}
    for section in sections:
        name, *lines = section.splitlines()
        rows = [line for line in lines if line.startswith("| `")]
        found[name.replace("`", "").lower()] = rows
    return found


def test_the_document_lists_the_figures_of_each_command() -> None:
    found, expected = documented(), declared()
    assert set(COMMANDS) <= set(found)
    for name, rows in expected.items():
        assert found.get(name) == rows, "\n".join([name, *rows])
    assert set(found) == set(expected)


def test_a_figure_names_a_unit_that_its_name_names() -> None:
    """A name such as ``height_range_mm`` and its unit agree."""
    units = {"deg": "deg", "mm": "mm", "px": "px", "us": "µs", "dn": "DN", "percent": "%"}
    for rows in declared().values():
        for row in rows:
            name, _, unit, _ = (cell.strip() for cell in row.strip("|").split("|"))
            last = name.strip("`").removesuffix("_paper").rpartition("_")[2]
            if last in units and "_per_" not in name:
                assert unit == units[last], row
