"""docs/notices.md lists the codes that the packages use, and no others."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import get_args

from acquisition.preflights import check
from acquisition.selftests import finding
from rig import Notice

ROOT = Path(__file__).parents[2]
ROOMS = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")
_NOTICED = re.compile(r"Notice\(|Cause\(|KINDS = |Arrangement\(")
# Codes of other notices or causes, which have their own place.
_COPIED = ("cause.name", "notice.code", "other.name", "hypothesis.name", "name", "_CURVE")
# Tables whose keys are names of causes.
_TABLES = ("KINDS", "IMAGE_KINDS")
_SEVERITIES = ("info", "warning", "error")
_ROW = re.compile(r"^\| `([^`]+)` \| ([a-z, ]+) \| (.+) \| (.+) \|$", re.MULTILINE)
Used = tuple[str, frozenset[str]]


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
                assert ast.unparse(code).startswith("_CODES["), ast.unparse(node)
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
    if indirect:
        assert table
        yield from ((code, indirect) for code in table)


def _severities(stated: ast.expr | None, tree: ast.Module) -> frozenset[str]:
    """Return what an argument may be; what a name stands for is somewhere in its module."""
    if stated is None:
        return frozenset(("warning",))
    where = tree if isinstance(stated, ast.Name) else stated
    found = {node.value for node in ast.walk(where) if isinstance(node, ast.Constant)}
    return frozenset(found & {*_SEVERITIES}) or frozenset(("info", "warning"))


@cache
def _used() -> dict[str, set[str]]:
    """Return the severities of each code."""
    used: dict[str, set[str]] = {}
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not _NOTICED.search(text):
                continue
            for code, severities in _used_in(ast.parse(text)):
                used.setdefault(code, set()).update(severities)
    return used


def _documented() -> list[tuple[str, str]]:
    text = (ROOT / "docs/notices.md").read_text(encoding="utf-8")
    return [(row[0], row[1]) for row in _ROW.findall(text)]


def test_the_table_lists_the_codes_that_are_used_with_their_severities() -> None:
    documented = _documented()
    assert len(documented) == len({code for code, _ in documented})
    used = {
        code: ", ".join(one for one in _SEVERITIES if one in severities)
        for code, severities in _used().items()
    }
    assert dict(documented) == used


def test_codes_have_the_form_of_one() -> None:
    for code in _used():
        assert Notice(code, "text").code == code


def test_findings_and_checks_have_codes() -> None:
    assert set(finding._CODES) == set(get_args(finding.Kind))
    for state in get_args(check.State):
        for name in check._CODES:
            (notice,) = check.Check(name, state, "text").notices
            assert str(notice) == f"{name}: text"
