"""The tables of figures and keys of records, from their types and docstrings."""

from __future__ import annotations

import inspect
import re
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NotRequired, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, JsonValue
from typing_extensions import get_original_bases, is_typeddict

import processing
from sgp.results import COMMANDS, ResultRecord
from sgp.results import metrics as _metrics
from sgp.results import record as _record
from sgp.results import stage_metrics as _stage_metrics

NAMES = {int: "integer", float: "number", str: "text", bool: "boolean"}
# The first figures of a command are its own; the others are those of its stages.
TITLES = {kinds[0]: command for command, kinds in COMMANDS.items()}
HEADER = ":::{container} rows\n| figure | type | unit | meaning |\n|---|---|---|---|\n"


def title(kind: type) -> str:
    """Return the command that has these figures, else the words in the name of the type."""
    words = re.findall("[A-Z][a-z]+", kind.__name__.removesuffix("Metrics"))
    return TITLES.get(kind, " ".join(words).lower())


def type_text(hint: Any) -> str:
    """Return the words for a type of figures."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in args)
    if origin in (UnionType, Union):
        (one,) = (arg for arg in args if arg is not NoneType)
        return f"{type_text(one)} or null"
    if hint is JsonValue:
        return "value"
    if origin is Annotated:
        return type_text(args[0])
    if origin is tuple and args[-1] is Ellipsis:
        return f"list of {several(args[0])}"
    if origin is tuple:
        (one,) = dict.fromkeys(args)
        return f"{len(args)} {several(one)}"
    if origin in (list, dict):
        return f"{'list' if origin is list else 'object'} of {several(args[-1])}"
    if is_typeddict(hint):
        return f"[{title(hint)}](#{title(hint).replace(' ', '-')})"
    return NAMES.get(hint, "object")


def several(hint: Any) -> str:
    """Return the words for several values of a type."""
    text = type_text(hint)
    return text + "s" * (text in ("object", "value", *NAMES.values()))


def described(kind: Any) -> dict[str, tuple[str, str]]:
    """Return unit and meaning of the figures of a type, from docstrings, by name."""
    found: dict[str, tuple[str, str]] = {}
    for base in filter(is_typeddict, get_original_bases(kind)):
        found |= described(base)
    _, _, text = (inspect.getdoc(kind) or "").partition("Parameters\n----------\n")
    rows = re.split(r"\n(?=\S)", text.partition("\n\n")[0]) if text else []
    for row in rows:
        head, *meaning = row.splitlines()
        names, _, unit = head.partition(" : ")
        for name in names.split(", "):
            found[name] = unit, " ".join(map(str.strip, meaning))
    return found


def table(kind: Any) -> list[str]:
    """Return the rows of the table of a type."""
    found, texts = [], described(kind)
    for name, hint in get_type_hints(kind, include_extras=True).items():
        optional = name in kind.__optional_keys__
        if get_origin(hint) is NotRequired:
            optional, (hint,) = True, get_args(hint)
        unit, meaning = texts[name]
        text = type_text(hint) + (", optional" if optional else "")
        found.append(f"| `{name}` | {text} | {unit} | {meaning} |".replace("|  |", "| |"))
    return found


def declared() -> dict[str, list[str]]:
    """Return the table of every type, by title; types that only others extend have none."""
    modules = (_metrics, _stage_metrics)
    kinds = [kind for one in modules for kind in vars(one).values() if is_typeddict(kind)]
    bases = {base for kind in kinds for base in get_original_bases(kind)}
    tables = {title(kind): table(kind) for kind in kinds if kind not in bases}
    order = [*COMMANDS, *sorted(tables.keys() - COMMANDS.keys())]
    return {name: tables[name] for name in order}


def figure_tables() -> str:
    """Return the figures of all commands in Markdown."""
    page = ""
    for name, rows in declared().items():
        heading = f"`{name}`" if name in COMMANDS else name.capitalize()
        page += f"### {heading}\n\n{HEADER}" + "\n".join(rows) + "\n:::\n\n"
    return page


def keys(model: type[BaseModel], documented: Any) -> str:
    """Return the keys of a model in Markdown; another class may have the meanings."""
    page, texts = (
        ":::{container} rows\n| key | type | meaning |\n|---|---|---|\n",
        described(documented),
    )
    for name, field in model.model_fields.items():
        always = field.is_required() or get_origin(field.annotation) is Literal
        optional = "" if always else ", optional"
        meaning = re.sub("``?", "`", texts[name][1])
        meaning = re.sub(r"\bNaN\b|\bNone\b", "null", meaning)
        page += f"| `{name}` | {type_text(field.annotation)}{optional} | {meaning} |\n"
    return page + ":::\n\n"


def record_keys() -> str:
    """Return the keys of a record in Markdown."""
    return keys(ResultRecord, ResultRecord)


def verdict_keys() -> str:
    """Return the keys of a cause, and of what was tested, in Markdown."""
    return (
        "### Causes\n\n"
        + keys(_record.CauseTable, processing.checks.Cause)
        + "### Tested\n\n"
        + keys(_record.TestedTable, processing.checks.Verdict)
    )
