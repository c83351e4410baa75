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
_NOTICED = re.compile(r"Notice\(|Cause\(")
# Codes of other notices or causes, which have their own place.
_COPIED = ("cause.name", "notice.code")
_ROW = re.compile(r"^\| `([^`]+)` \| (.+) \| (.+) \|$", re.MULTILINE)


def _codes(tree: ast.Module) -> Iterator[str]:
    """Yield the codes of the notices of a module: literals, or the values of its `_CODES`.

    The names of causes are codes, too.
    """
    table: list[str] = []
    indirect = False
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if name not in ("Notice", "Cause"):
                continue
            words = ("code", "name")
            given = next((word.value for word in node.keywords if word.arg in words), None)
            if given is None and not node.args:  # `Notice(**stored)`: read back from a file
                continue
            code = given if given is not None else node.args[0]
            if isinstance(code, ast.Constant):
                yield code.value
            elif ast.unparse(code) not in _COPIED:
                assert ast.unparse(code).startswith("_CODES["), ast.unparse(node)
                indirect = True
        elif (
            isinstance(node, ast.AnnAssign)
            and isinstance(node.value, ast.Dict)
            and ast.unparse(node.target) == "_CODES"
        ):
            table = [ast.literal_eval(value) for value in node.value.values]
    if indirect:
        assert table
        yield from table


@cache
def _used() -> dict[str, set[str]]:
    """Return the modules that use each code."""
    used: dict[str, set[str]] = {}
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            for code in _codes(ast.parse(text)) if _NOTICED.search(text) else ():
                used.setdefault(code, set()).add(str(path.relative_to(ROOT)))
    return used


def _documented() -> list[str]:
    text = (ROOT / "docs/notices.md").read_text(encoding="utf-8")
    return [row[0] for row in _ROW.findall(text)]


def test_the_table_lists_the_codes_that_are_used() -> None:
    documented = _documented()
    assert len(documented) == len(set(documented))
    assert set(documented) == set(_used())


def test_codes_have_the_form_of_one() -> None:
    for code in _used():
        assert Notice(code, "text").code == code


def test_findings_and_checks_have_codes() -> None:
    assert set(finding._CODES) == set(get_args(finding.Kind))
    for state in get_args(check.State):
        for name in check._CODES:
            (notice,) = check.Check(name, state, "text").notices
            assert str(notice) == f"{name}: text"
