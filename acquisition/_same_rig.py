"""Whether a session can be gone on with: the plan, rig and camera are those it was begun with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from acquisition._errors import DataError
from acquisition._manifest import Manifest
from acquisition._plan import CapturePlan


def check_same(
    folder: Path, begun: Manifest, now: Manifest, plan: CapturePlan | None = None
) -> None:
    """Refuse to mix what two rigs, two cameras or two plans gave.

    Parameters
    ----------
    folder
        The session, for the message.
    begun
        What it says.
    now
        What it would say if it began now.
    plan
        The plan that was asked for, where one was.

    Raises
    ------
    DataError
        If anything differs; the message says what, and how.
    """
    differences = [
        *_differences("rig", begun.rig, now.rig),
        *_differences("camera", begun.camera, now.camera),
        *(() if plan is None else _differences("plan", begun.plan, plan)),
    ]
    if differences:
        raise DataError(
            f"{folder}: was begun with another {' and another '.join(_kinds(differences))}: "
            f"{'; '.join(text for _, text in differences)}; use those it was begun with, or record "
            "into a new folder"
        )


def _kinds(differences: list[tuple[str, str]]) -> dict[str, None]:
    return dict.fromkeys(kind for kind, _ in differences)


def _differences(
    kind: str, begun: BaseModel | None, now: BaseModel | None
) -> Iterator[tuple[str, str]]:
    before = {} if begun is None else begun.model_dump()
    after = {} if now is None else now.model_dump()
    for name in dict.fromkeys((*before, *after)):
        one, other = before.get(name), after.get(name)
        if one != other:
            yield kind, f"{kind} {name} was {_text(one)} and is {_text(other)}"


def _text(value: object) -> str:
    return "not stated" if value is None or value == "" else str(value)
