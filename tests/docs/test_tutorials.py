"""The tutorials: their commands work in an empty folder, and print what the pages state."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted({*(ROOT / "docs/tutorials").glob("*.md")} - {ROOT / "docs/tutorials/index.md"})
_BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MOST_WORDS = 900


def steps(page: Path) -> list[tuple[str, list[str]]]:
    """Return the blocks of commands, each with the lines that the page says it prints."""
    found: list[tuple[str, list[str]]] = []
    for kind, text in _BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "sh":
            found.append((text, []))
        else:
            assert not found[-1][1], "two outputs of one block"
            found[-1][1].extend(text.splitlines())
    return found


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """Return a folder with `sgp` and `capture` of this checkout."""
    folder = tmp_path / "programs"
    folder.mkdir()
    for name, words in (("sgp", ""), ("capture", "capture")):
        program = folder / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m sgp {words} "$@"\n')
        program.chmod(0o755)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_prints_what_it_states(page: Path, programs: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment["PATH"] = f"{programs}{os.pathsep}{environment['PATH']}"
    environment.pop("SGP_RIG", None)
    wrong = []
    for commands, stated in steps(page):
        done = subprocess.run(
            ["bash", "-c", commands],
            cwd=empty,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert done.returncode == 0, done.stdout
        printed = done.stdout.splitlines()
        missing = [line for line in stated if line not in printed]
        wrong += [f"{commands}does not print\n{line}\nbut\n{done.stdout}" for line in missing]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_is_short_and_states_figures(page: Path) -> None:
    assert len(page.read_text(encoding="utf-8").split()) <= MOST_WORDS
    assert all(stated for _, stated in steps(page))
