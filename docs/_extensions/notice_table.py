"""The table of notices: meanings from the packages' table, severities from their code."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "sgp/results/notices.toml"
ROOMS = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")
SEVERITIES = ("info", "warning", "error")
_NOTICED = re.compile(r"Notice\(|Cause\(|KINDS = |Arrangement\(")
# Codes of other notices or causes, which have their own place.
_COPIED = ("cause.name", "notice.code", "other.name", "hypothesis.name", "name", "_CURVE")
# Tables whose keys are names of causes.
_TABLES = ("KINDS", "IMAGE_KINDS")
Used = tuple[str, frozenset[str]]
Meanings = dict[str, dict[str, tuple[str, str]]]


def meanings() -> Meanings:
    """Return what each code means and what to do about it, by group."""
    groups = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return {
        title: {code: (meaning, remedy) for code, (meaning, remedy) in rows.items()}
        for title, rows in groups.items()
    }


def notice_table() -> str:
    """Return the table in Markdown."""
    page, severities = "", used_codes()
    for title, rows in meanings().items():
        page += f"## {title}\n\n:::{{container}} rows\n"
        page += "| code | severity | meaning | what to do |\n|---|---|---|---|\n"
        for code, texts in rows.items():
            named = ", ".join(one for one in SEVERITIES if one in severities[code])
            page += f"| `{code}` | {named} | {' | '.join(texts)} |\n"
        page += ":::\n\n"
    return page


@cache
def used_codes() -> dict[str, set[str]]:
    """Return the codes that the packages use, each with its severities."""
    used: dict[str, set[str]] = {}
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not _NOTICED.search(text):
                continue
            for code, severities in _used_in(ast.parse(text)):
                used.setdefault(code, set()).update(severities)
    return used


def _used_in(tree: ast.Module) -> Iterator[Used]:
    """Yield the codes of the notices of a module, and their severities.

    Codes are literals, or the values of its `_CODES`. The names of causes are codes, too: how
    severe a cause is depends on what it does.
    """
    table: list[str] = []
    indirect: frozenset[str] = frozenset()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if name not in ("Notice", "Cause", "Arrangement"):
                continue
            words = {word.arg: word.value for word in node.keywords}
            given = words.get("code", words.get("name"))
            if given is None and not node.args:  # `Notice(**stored)`: read back from a file
                continue
            code = given if given is not None else node.args[0]
            severities = frozenset(("info", "warning"))
            if name == "Notice":
                stated = words.get("severity", node.args[3] if len(node.args) > 3 else None)
                severities = _severities(stated, tree)
            if isinstance(code, ast.Constant):
                yield code.value, severities
            elif ast.unparse(code) not in _COPIED:
                if not ast.unparse(code).startswith("_CODES["):
                    raise ValueError(f"no code is known for {ast.unparse(node)}")
                indirect |= severities
        elif (
            isinstance(node, ast.AnnAssign)
            and isinstance(node.value, ast.Dict)
            and ast.unparse(node.target) == "_CODES"
        ):
            table = [ast.literal_eval(value) for value in node.value.values]
        elif (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Dict)
            and ast.unparse(node.targets[0]) in _TABLES
        ):
            for kind in filter(None, node.value.keys):
                yield ast.literal_eval(kind), frozenset(("info", "warning"))
    if indirect and not table:
        raise ValueError("there is no table _CODES")
    if indirect:
        yield from ((code, indirect) for code in table)


def _severities(stated: ast.expr | None, tree: ast.Module) -> frozenset[str]:
    """Return what an argument may be; what a name stands for is somewhere in its module."""
    if stated is None:
        return frozenset(("warning",))
    where = tree if isinstance(stated, ast.Name) else stated
    found = {node.value for node in ast.walk(where) if isinstance(node, ast.Constant)}
    return frozenset(found & {*SEVERITIES}) or frozenset(("info", "warning"))
