"""All numeric options of all commands, listed by the parser, with values that are not numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from cyclopts import App
from cyclopts.argument import Argument

import sgp.commands
from sgp.app import build
from tests.quick_sample import quick

NOT_FINITE = ("nan", "inf", "-inf", "1e400")
NO_NUMBERS = ("x", "1,5", "9" * 5000)
ODD = ("1e308", "-1e308", "1.5", "-1", "0")
TREE = build()


def leaves(app: App, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], App]]:
    names = [name for name in app if not name.startswith("-")]
    if not names:
        yield path, app
    for name in names:
        yield from leaves(app[name], (*path, name))


def numeric(hint: Any) -> bool:
    return hint in (int, float) or any(numeric(one) for one in get_args(hint))


def options() -> Iterator[Any]:
    for path, leaf in leaves(TREE):
        for argument in leaf.assemble_argument_collection():
            if numeric(argument.hint):
                yield pytest.param(path, argument, id=f"{'-'.join(path)}{argument.name}")


ALL = list(options())


def complete(app: App, path: tuple[str, ...], argument: Argument) -> list[str]:
    """Return the other required arguments, with valid values that name missing files."""
    leaf = app
    for name in path:
        leaf = leaf[name]
    needed = []
    for other in leaf.assemble_argument_collection():
        if other.required and other.name != argument.name:
            positional = other.field_info.is_positional
            chosen = next(iter(get_args(other.hint)), None)
            choice = chosen if isinstance(chosen, str | int) else "nowhere"
            value = "1" if numeric(other.hint) else choice
            needed += [value] if positional else [f"{other.name}={value}"]
    return needed


def test_options_are_found() -> None:
    """Check a list of known options: if the search failed, nothing would be tested."""
    found = {f"{' '.join(case.values[0])} {case.values[1].name}" for case in ALL}
    assert {
        "detail transfer --amplitude",
        "detail transfer --rotate-deg",
        "capture run --meter-fraction",
        "normals --max-pixels",
        "calibrate spheres --radius-mm",
        "rig light --led",
        "simulate --exposure-us",
        "capture plan --frame-ms",
    } <= found
    assert len(found) >= 45


def test_text_options_of_numbers_are_known() -> None:
    """Numbers inside text are not found by type: new options of this kind must be added here."""
    source = re.compile(r'(?:numbers|image_size|led_list)\("(--[a-z-]+)"')
    named = {
        match[1]
        for file in Path(sgp.commands.__path__[0]).parent.rglob("*.py")
        for match in source.finditer(file.read_text(encoding="utf-8"))
    }
    assert named == {
        "--at",
        "--ball",
        "--light",
        "--look",
        "--rotate-deg",
        "--sphere",
        "--size",
        "--leds",
    }


@pytest.mark.parametrize(("path", "argument"), quick(ALL, every=15))
def test_values_that_are_not_finite_are_named(sgp, tmp_path, monkeypatch, path, argument) -> None:
    monkeypatch.chdir(tmp_path)
    rest = complete(TREE, path, argument)
    for value in NOT_FINITE:
        line = sgp(*path, *rest, f"{argument.name}={value}").error_line(2)
        assert value in line
        known = r"is not (a (finite number|whole number|size of memory)|the number of an LED)"
        assert re.search(known, line), line
        assert argument.name.lstrip("-").upper() in line.upper()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("path", "argument"), quick(ALL, every=15))
def test_no_value_causes_an_internal_error(sgp, tmp_path, monkeypatch, path, argument) -> None:
    """The value is refused in one short line, or accepted; then the missing file is reported."""
    monkeypatch.chdir(tmp_path)
    rest = complete(TREE, path, argument)
    for value in NO_NUMBERS:
        line = sgp(*path, *rest, f"{argument.name}={value}").error_line(2)
        assert re.search(r"is not (a ((finite |whole )?number|size of memory)|the num)", line), line
        assert len(line) < 300
    # Commands may accept other values. Those that would then run get only the extreme values.
    works = path[0] in ("rig", "demo", "simulate") or path == ("capture", "plan")
    for value in ODD[:2] if works else ODD:
        assert len(sgp(*path, *rest, f"{argument.name}={value}").error_line(2)) < 300


@pytest.mark.parametrize("value", ["nan,1,2", "1,inf,2", "1,1e400,2", "1,2", "1,2,3,4", "", ",,"])
@pytest.mark.parametrize(
    "command",
    [
        ("calibrate", "spheres", "images", "--out=l.json", "--sphere={}"),
        (
            *("calibrate", "intensities", "images", "--lights=images", "--out=l.json"),
            *("--radius-mm=9", "--ball={}"),
        ),
        ("project", "a.obj", "--out=o", "--look={}"),
        ("project", "a.obj", "--out=o", "--rotate-deg={}"),
        ("detail", "transfer", "a", "b", "--out=o", "--at={}"),
        ("project", "a.obj", "--out=o", "--size={}"),
        ("simulate", "coin", "--out=o", "--size={}"),
        ("capture", "plan", "--size={}"),
        ("relight", "a", "--out=o.png", "--light={}"),
    ],
    ids=lambda words: "-".join(words[:1] + words[-1:]),
)
def test_numbers_inside_text(sgp, tmp_path, monkeypatch, command, value) -> None:
    if "--at={}" in command and value == "1,2":
        return
    monkeypatch.chdir(tmp_path)
    inputs = [tmp_path / word for word in command[1:] if word in ("images", "a.obj", "a", "b")]
    for path in inputs:
        path.touch()
    line = sgp(*(word.format(value) for word in command)).error_line(2)
    assert re.search(r"give (\d numbers|width)", line), line
    assert sorted(tmp_path.iterdir()) == inputs
