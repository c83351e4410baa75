"""Messages of the packages below sgp name no option of the command line: callers have none."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.quick_sample import quick

ROOT = Path(__file__).parents[2]
ROOMS = ("rig", "acquisition", "calibration", "processing", "simulator")
_OPTION = re.compile(r"(?<![\w-])--[a-z]")
# A text that is nothing else is an argument of another program, such as a compiler.
_ARGUMENT = re.compile(r"--[a-z-]+")


def options(tree: ast.AST) -> Iterator[int]:
    """Yield the lines of texts that name an option; docstrings and arguments do not count."""
    silent = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):
            silent.add(node.value)
        elif isinstance(node, (ast.List, ast.Tuple, ast.Call)):
            parts = node.args if isinstance(node, ast.Call) else node.elts
            silent |= {
                part
                for part in parts
                if isinstance(part, ast.Constant) and _ARGUMENT.fullmatch(str(part.value))
            }
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) and node not in silent else None
        if isinstance(text, str) and _OPTION.search(text):
            yield node.lineno


@pytest.mark.parametrize("room", quick(ROOMS, every=3))
def test_no_message_names_an_option(room: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in sorted((ROOT / room).rglob("*.py"))
        for line in options(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("code", "lines"),
    [
        ('raise DataError("give a mask (--mask)")', [1]),
        ('x = f"{name}: use --gamma {kind}"', [1]),
        ('text = "--force"', [1]),
        ('subprocess.run([cc, "--version"])', []),
        ('def f():\n    """Call with --debug."""', []),
        ('text = "a -- b, -x, well--known"', []),
    ],
    ids=["message", "formatted", "alone", "argument", "docstring", "dashes"],
)
def test_the_search_finds_options(code: str, lines: list[int]) -> None:
    assert list(options(ast.parse(code))) == lines
