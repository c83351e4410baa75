"""What the page may ask of the station: one model for each action."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from acquisition.plan.plan import MOST_LEDS

_Led = Annotated[int, Field(ge=0, lt=MOST_LEDS)]
_Pixel = Annotated[int, Field(ge=0, le=100_000)]
_Side = Annotated[int, Field(ge=1, le=100_000)]
_Text = Annotated[str, Field(max_length=4000)]


class _Action(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class SetLight(_Action):
    """Choose LEDs, exposure time and gain of the live picture."""

    do: Literal["light"]
    mode: Literal["one", "cycle", "all"]
    leds: Annotated[list[_Led], Field(max_length=4096)]
    exposure_us: Annotated[float, Field(gt=0, le=1e9, strict=False)]
    gain_db: Annotated[float, Field(ge=0, le=100, strict=False)] = 0.0


class SetRegion(_Action):
    """Choose the region of the focus measure."""

    do: Literal["region"]
    left: _Pixel
    top: _Pixel
    width: _Side
    height: _Side


class Pause(_Action):
    """Stop or continue the live picture."""

    do: Literal["pause"]
    paused: bool


class WritePlan(_Action):
    """Replace the text of the plan."""

    do: Literal["plan"]
    text: Annotated[str, Field(max_length=60_000)]


class Meter(_Action):
    """Meter the plan's exposure times: one for each LED, or one for all."""

    do: Literal["meter"]
    each: bool


class Check(_Action):
    """Check rig, picture and LEDs for the plan."""

    do: Literal["check"]


class Record(_Action):
    """Record the object."""

    do: Literal["record"]
    object: _Text
    notes: _Text = ""
    check: bool = True


class Resume(_Action):
    """Take the missing shots of the recording on display."""

    do: Literal["resume"]


class Look(_Action):
    """Compute normals at a reduced size from the recording on display."""

    do: Literal["look"]


class Answer(_Action):
    """Answer the question on display."""

    do: Literal["answer"]
    question: int
    yes: bool


class Stop(_Action):
    """Turn all LEDs off, and end the task."""

    do: Literal["stop"]


Action = (
    SetLight
    | SetRegion
    | Pause
    | WritePlan
    | Meter
    | Check
    | Record
    | Resume
    | Look
    | Answer
    | Stop
)
ACTION: TypeAdapter[Action] = TypeAdapter(Annotated[Action, Field(discriminator="do")])
