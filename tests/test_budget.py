"""What the project may weigh: a change that needs more raises the table, with a reason."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")
# At most, for each package: code lines (without docstrings, comments and blanks), names at the
# top, modules.
BUDGET = {
    "rig": (4250, 49, 69),  # with `figure`, which all messages use
    "acquisition": (15900, 66, 158),
    "calibration": (10700, 30, 90),
    "processing": (27165, 66, 247),
    "simulator": (9050, 28, 77),
    "sgp": (18460, 0, 177),
}
WORDS_OF_DOCUMENTS = 59400
# Numbers of calibration/spheres that were chosen, not derived.
TUNED_CONSTANTS = 269
STRATA_OF_SGP = 7


def code_lines(text: str) -> int:
    """Return the lines of a module that are neither docstrings, comments nor blank."""
    documented = set[int]()
    for node in ast.walk(ast.parse(text)):
        kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        if isinstance(node, kinds) and ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            documented |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return sum(
        bool(line.strip()) and number not in documented and not line.lstrip().startswith("#")
        for number, line in enumerate(text.splitlines(), 1)
    )


def modules(folder: str) -> Iterator[str]:
    for path in sorted((ROOT / folder).rglob("*.py")):
        yield path.read_text(encoding="utf-8")


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_stays_within_its_budget(package: str) -> None:
    face = ROOT / package / "__init__.pyi"
    names = re.findall(r"\bas ([A-Za-z]\w*)", face.read_text() if face.exists() else "")
    texts = list(modules(package))
    weight = sum(map(code_lines, texts)), len(set(names)), len(texts)
    over = [have - most for have, most in zip(weight, BUDGET[package], strict=True)]
    assert max(over) <= 0, f"{package}: {weight} exceeds {BUDGET[package]}"


def test_documents_stay_within_their_budget() -> None:
    documents = {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")}
    # Pages that commands write are figures, not prose.
    documents -= {*(ROOT / "docs" / "measured").rglob("*.md")}
    words = sum(len(path.read_text(encoding="utf-8").split()) for path in documents)
    assert words <= WORDS_OF_DOCUMENTS, words


def test_no_constant_is_tuned_without_a_reason() -> None:
    tuned = re.compile(r"(?m)^_[A-Z][A-Z0-9_]*(?:, _[A-Z0-9_]+)* = [-\d(.]")
    found = sum(len(tuned.findall(text)) for text in modules("calibration/spheres"))
    assert found <= TUNED_CONSTANTS, found


def test_imports_of_sgp_have_few_strata() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(
        one["layers"] for one in contracts["contracts"] if one.get("containers") == ["sgp"]
    )
    assert len(layers) <= STRATA_OF_SGP, layers
