"""What a case of `true_to_the_input.py` is, and how its outcome is judged."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Concatenate, Literal, NamedTuple, ParamSpec

P = ParamSpec("P")

Kind = Literal["right", "applied and stated", "refused by name", "vague", "wrong"]
GOOD: tuple[Kind, ...] = ("right", "applied and stated", "refused by name")


class Outcome(NamedTuple):
    """What happened: the kind, and the figure, notice or message that shows it."""

    kind: Kind
    text: str


# Makes the input of a case in an empty folder, runs the program and judges it.
Run = Callable[[Path], Outcome]


@dataclass(frozen=True)
class Case:
    """One input or event, and what is right for it.

    Parameters
    ----------
    name
        Short and unique in its module.
    section
        Number of the kind: 1 images, 2 values, 3 results, 4 camera, 5 installation.
    right
        What is right, in a few words.
    run
        Makes the input in an empty folder, runs the program and judges it.
    listed
        False for a further member of a kind, chosen before the repair.
    """

    name: str
    section: int
    right: str
    run: Run
    listed: bool = True


# Name of a case, what is right, and its run.
Row = tuple[str, str, Run]


def cases(section: int, listed: Iterable[Row], further: Iterable[Row] = ()) -> tuple[Case, ...]:
    """Return cases of one section: the listed ones, then further members of their kinds."""
    return tuple(
        Case(name, section, right, run, known)
        for known, rows in ((True, listed), (False, further))
        for name, right, run in rows
    )


def later(run: Callable[Concatenate[Path, P], Outcome]) -> Callable[P, Run]:
    """Return a function of the other arguments of a run, which gives what a case runs."""
    return lambda *args, **kwargs: lambda folder: run(folder, *args, **kwargs)


class Answer(NamedTuple):
    """Exit code and output of a command, and what it printed with ``--json``."""

    code: int
    out: str
    err: str

    @property
    def values(self) -> dict[str, Any]:
        return json.loads(self.out) if self.out.startswith("{") else {}

    @property
    def notices(self) -> list[tuple[str, str]]:
        return [(each["code"], each["text"]) for each in self.values.get("notices", [])]

    @property
    def message(self) -> str:
        lines = self.err.strip().splitlines()
        return lines[-1] if lines else ""


def sgp(*words: object) -> Answer:
    """Run a command of the program in this process, with ``--json``."""
    from sgp.app import build, run

    tokens = [*map(str, words), "--json"]
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run(build(tokens), tokens)
    return Answer(code, out.getvalue(), err.getvalue())


def judge(
    answer: Answer,
    figure: float | None = None,
    *,
    limit: float = 0.3,
    unit: str = "deg",
    names: Sequence[str] = (),
    codes: Sequence[str] = (),
    enough: Sequence[str] = (),
) -> Outcome:
    """Judge a command by its exit code, its notices and the figure of its result.

    Parameters
    ----------
    answer
        The answer of the command.
    figure, limit, unit
        Error of the result, the largest right one, and their unit. None: no result to judge.
    names
        What the message of a refusal must contain to be a refusal by name.
    codes
        Notices of which one must be there if the program applied something to a right result.
    enough
        Notices that make a wrong figure known, where the result cannot be right.
    """
    if answer.code:
        named = answer.code in (2, 3, 4, 5) and all(name in answer.message for name in names)
        return Outcome("refused by name" if named else "vague", answer.message)
    given = [code for code, _ in answer.notices]
    stated = next(((code, text) for code, text in answer.notices if code in codes), None)
    if figure is not None and not figure <= limit:
        known = [code for code in given if code in enough]
        text = f"{figure:.3g} {unit}, notices: {', '.join(given) or 'none'}"
        return Outcome("applied and stated" if known else "wrong", text)
    text = "" if figure is None else f"{figure:.3g} {unit}"
    if stated is not None:
        return Outcome("applied and stated", "; ".join(filter(None, (text, stated[1]))))
    return Outcome("wrong" if codes else "right", text or "accepted without a notice")


def emptied(folder: Path) -> Path:
    """Make a folder, or empty it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
