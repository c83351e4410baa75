"""Texts use the words of docs/glossary.md, and none of the words that it lists as avoided."""

from __future__ import annotations

import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GLOSSARY = "docs/glossary.md"
FOLDERS = (
    "rig",
    "acquisition",
    "calibration",
    "processing",
    "simulator",
    "sgp",
    "benchmarks",
    "docs",
    "tests",
)
# They quote avoided words, and source code of the firmware.
QUOTING = {"tests/sgp/test_words.py", "tests/rig/test_firmware_planted_faults.py"}
# Code within texts: fences, inline code, targets of links.
_CODE = re.compile(r"```.*?```|``[^`]*``|`[^`]*`|\]\([^)]*\)", re.DOTALL)


def avoided() -> re.Pattern[str]:
    """Return what matches a word of the glossary's second table."""
    table = (ROOT / GLOSSARY).read_text().partition("## Words we avoid")[2]
    rows = re.findall(r"^\| ([^|]+) \|", table, re.MULTILINE)[1:]
    words = [re.escape(word) for row in rows for word in row.split(", ")]
    return re.compile(rf"\b({'|'.join(words)})\b", re.IGNORECASE)


AVOIDED = avoided()


def found_in(text: str) -> list[str]:
    plain = " ".join(_CODE.sub(" ", text).split())
    # `None` is a value of Python, not the word.
    return [found for found in AVOIDED.findall(plain) if "None" not in found]


def python_texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each comment and of each literal that is more than a key."""
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(file.readline):
            literal = token.type == tokenize.STRING and " " in token.string
            if literal or token.type == tokenize.COMMENT:
                yield token.start[0], token.string


def tracked(*patterns: str) -> list[Path]:
    names = subprocess.run(
        ["git", "ls-files", "-z", *patterns], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    return [ROOT / name for name in names.split("\0") if name]


@pytest.mark.parametrize("folder", FOLDERS)
def test_texts_of_a_package_have_no_avoided_word(folder: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {word}"
        for path in tracked(f"{folder}/*.py")
        if path.relative_to(ROOT).as_posix() not in QUOTING
        for line, text in python_texts(path)
        for word in found_in(text)
    ]
    assert not found, "\n".join(found)


def test_documents_have_no_avoided_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in tracked("*.md")
        if path.relative_to(ROOT).as_posix() != GLOSSARY
        for word in found_in(path.read_text())
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("The LED burned for 5 ms", ["burned"]),
        ("a name\n    that is none", ["is none"]),
        ("`told` is a key, [a link](told.md)", []),
        ("Going\non", ["Going on"]),
        ("retold", []),
        ("the value is None", []),
    ],
    ids=["word", "phrase over lines", "code", "case", "part of a word", "a value"],
)
def test_the_search_finds_words_not_code(text: str, words: list[str]) -> None:
    assert found_in(text) == words
