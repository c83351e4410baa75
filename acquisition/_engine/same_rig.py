"""Check that a session is resumed with the plan, rig and camera that it was started with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from acquisition._errors import DataError
from acquisition._plan.plan import CapturePlan
from acquisition._session.manifest import Manifest, RigRecord


def check_same(
    folder: Path, begun: Manifest, now: Manifest, plan: CapturePlan | None = None
) -> None:
    """Refuse to mix frames of different rigs, cameras or plans in one session.

    More LEDs may be listed as dead than before, but not fewer.

    Parameters
    ----------
    folder
        The session, for the message.
    begun
        Manifest of the session.
    now
        Manifest that the session would have if it started now.
    plan
        The requested plan, if there is one.

    Raises
    ------
    DataError
        If anything differs; the message names each difference.
    """
    differences = [
        *_differences("rig", begun.rig, _with_dead_of(begun.rig, now.rig)),
        *_differences("camera", begun.camera, now.camera),
        *(() if plan is None else _differences("plan", begun.plan, plan)),
    ]
    if differences:
        raise DataError(
            f"{folder}: was started with another {' and another '.join(_kinds(differences))}: "
            f"{'; '.join(text for _, text in differences)}; use the original ones, or record into "
            "a new folder"
        )


def _with_dead_of(begun: RigRecord | None, now: RigRecord | None) -> RigRecord | None:
    if begun is None or now is None or not set(begun.dead_leds) <= set(now.dead_leds):
        return now
    return now.model_copy(update={"dead_leds": begun.dead_leds})


def _kinds(differences: list[tuple[str, str]]) -> dict[str, None]:
    return dict.fromkeys(kind for kind, _ in differences)


def _differences(
    kind: str, begun: BaseModel | None, now: BaseModel | None
) -> Iterator[tuple[str, str]]:
    before = {} if begun is None else begun.model_dump()
    after = {} if now is None else now.model_dump()
    options = before.pop("options", None) or {}, after.pop("options", None) or {}
    for what, one, other in ((kind, before, after), (f"{kind} option", *options)):
        for name in dict.fromkeys((*one, *other)):
            if one.get(name) != other.get(name):
                change = f"was {_text(one.get(name))} and is {_text(other.get(name))}"
                yield kind, f"{what} {name} {change}"


def _text(value: object) -> str:
    return "not stated" if value is None or value == "" else str(value)
