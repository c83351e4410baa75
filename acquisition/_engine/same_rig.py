"""Check that a session is resumed with the plan, rig and camera that it was started with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from acquisition._errors import DataError
from acquisition._plan.plan import CapturePlan
from acquisition._session.manifest import Manifest, RigRecord


def check_same(
    folder: Path, stored: Manifest, current: Manifest, plan: CapturePlan | None = None
) -> None:
    """Refuse to mix frames of different rigs, cameras or plans in one session.

    More LEDs may be listed as dead than before, but not fewer. The positions of the LEDs may have
    been measured since.

    Parameters
    ----------
    folder
        The session, for the message.
    stored
        Manifest of the session.
    current
        Manifest that the session would have if it started now.
    plan
        The requested plan, if there is one.

    Raises
    ------
    DataError
        If anything differs; the message names each difference.
    """
    differences = [
        *_differences("rig", stored.rig, _with_what_may_differ(stored.rig, current.rig)),
        *_differences("camera", stored.camera, current.camera),
        *(() if plan is None else _differences("plan", stored.plan, plan)),
    ]
    if differences:
        raise DataError(
            f"{folder}: was started with another {' and another '.join(_kinds(differences))}: "
            f"{'; '.join(text for _, text in differences)}; use the original ones, or record into "
            "a new folder"
        )


def _with_what_may_differ(stored: RigRecord | None, current: RigRecord | None) -> RigRecord | None:
    if stored is None or current is None:
        return current
    names = ["led_positions_mm", "led_positions_sigma_mm"]
    names += ["dead_leds"] if set(stored.dead_leds) <= set(current.dead_leds) else []
    return current.model_copy(update={name: getattr(stored, name) for name in names})


def _kinds(differences: list[tuple[str, str]]) -> dict[str, None]:
    return dict.fromkeys(kind for kind, _ in differences)


def _differences(
    kind: str, stored: BaseModel | None, current: BaseModel | None
) -> Iterator[tuple[str, str]]:
    before = {} if stored is None else stored.model_dump()
    after = {} if current is None else current.model_dump()
    options = before.pop("options", None) or {}, after.pop("options", None) or {}
    for what, one, other in ((kind, before, after), (f"{kind} option", *options)):
        for name in dict.fromkeys((*one, *other)):
            if one.get(name) != other.get(name):
                change = f"was {_text(one.get(name))} and is {_text(other.get(name))}"
                yield kind, f"{what} {name} {change}"


def _text(value: object) -> str:
    return "not stated" if value is None or value == "" else str(value)
