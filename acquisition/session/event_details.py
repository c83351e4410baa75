"""Details of events: one schema for each event of the format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, model_validator

from acquisition._errors import DataError
from acquisition.session.journal import (
    ACCEPTED,
    CAMERA_SETTINGS,
    COMPACTED,
    COMPARED,
    LEFT_OUT,
    REOPENED,
    SET_ASIDE,
    UPGRADED,
    FramePath,
    Index,
    LinePart,
    Sha256,
)
from rig.messages import validation_message

# Events that change the meaning of earlier lines. Only the code that performs the change writes
# them.
RESERVED: Final = frozenset({COMPACTED, REOPENED, SET_ASIDE, UPGRADED})

_Fraction = Annotated[float, Field(ge=0, le=1)]
_Exposure = Annotated[float, Field(gt=0)]
_Count = Annotated[int, Field(ge=0)]
_Seconds = Annotated[float, Field(ge=0)]
_Pair = Annotated[list[float | None], Field(min_length=2, max_length=2)]
FrameName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9._-]*$")]
_Device = Literal["board", "camera"]
_Setting = bool | int | float | str
_KeptPath = Annotated[str, Field(pattern=r"^derived/set_aside/[A-Za-z0-9_][A-Za-z0-9._-]*$")]


class _AtLeast(BaseModel):
    """Details for people: additional keys are allowed."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)


class Compacted(LinePart):
    """The file of a frame was compressed without loss."""

    frame_seq: _Count
    file: FramePath
    bytes: Annotated[int, Field(ge=1, lt=2**63)]
    file_sha256: Sha256


class SetAside(LinePart):
    """A frame no longer counts; its file, unless it is lost, is kept elsewhere."""

    frame_seq: _Count
    file: FramePath
    kept: _KeptPath | None
    reason: str


class Upgraded(LinePart):
    """Lines of a newer version may follow."""

    from_version: Literal[2]
    to_version: Literal[3]
    software_version: str


class _Check(_AtLeast):
    name: str
    state: Literal["ok", "warning", "failed", "not done"]
    text: str


class _MeteredLight(_AtLeast):
    led: Index
    exposure_us: _Exposure
    level: float
    clipped_fraction: _Fraction
    shots: _Count
    state: str


class _Metered(_AtLeast):
    percentile: Annotated[float, Field(gt=0, le=100)]
    fraction: _Fraction
    max_clipped_fraction: _Fraction
    each: bool
    start_us: _Exposure
    longest_us: _Exposure
    black_dn: float
    white_dn: float
    lights: list[_MeteredLight]
    dead_leds: list[Index]


class _Retake(_AtLeast):
    reason: str
    led: Index | None
    file: str | None = None
    failures: _Count | None = None


class _FramesLost(_AtLeast):
    file: str
    led: Index | None
    started: _Count | None = None
    delivered: _Count | None = None
    underrun: _Count | None = None
    buffers: _Count | None = None


class _Ended(_AtLeast):
    reason: str
    leds_confirmed_off: bool | None = None


class _Compared(_AtLeast):
    file: FrameName | None
    light: FrameName
    shift_px: _Pair
    shift_sigma_px: _Pair
    gain: float | None
    gain_sigma: float | None
    focus: float | None
    focus_sigma: float | None
    other_fraction: _Fraction | None
    other_box: Annotated[list[int], Field(min_length=4, max_length=4)] | None
    same_object: bool
    gain_spread: float | None = None
    gain_spread_sigma: float | None = None
    unlike_fraction: _Fraction | None = None
    lights_before: _Count | None = None

    @model_validator(mode="after")
    def _located(self) -> Self:
        if self.other_fraction is not None and not self.same_object and self.other_box is None:
            raise ValueError("other_box is missing")
        return self


class _FromFiles(_AtLeast):
    iso: float | None = None
    f_number: float | None = None
    orientation: int | None = None
    black_levels_dn: list[float] = []
    vendor: str = ""
    model: str = ""


class _Imported(_FromFiles):
    source: str


class _Watched(_FromFiles):
    shots: list[str]


def _fields(**kinds: Any) -> type[BaseModel]:
    """Return the schema of details that must have these fields."""
    required: dict[str, Any] = {name: (kind, ...) for name, kind in kinds.items()}
    return create_model("Details", __base__=_AtLeast, **required)


# Each schema with the first format version in which it is checked. Details that readers act on are
# checked in all versions that have the event. Details for people are checked from version 3, whose
# writers check them, too: sessions of older versions must stay readable.
_SCHEMAS: Final[dict[str, tuple[type[BaseModel], int]]] = {
    COMPACTED: (Compacted, 1),
    LEFT_OUT: (_fields(leds=list[Index]), 2),
    UPGRADED: (Upgraded, 2),
    SET_ASIDE: (SetAside, 3),
    REOPENED: (_fields(software_version=str, torn=str, unrecorded=list[str]), 3),
    CAMERA_SETTINGS: (_fields(turned_off=list[str], settings=dict[str, _Setting]), 3),
    "checked": (_fields(checks=list[_Check]), 3),
    "metered": (_Metered, 3),
    "retake": (_Retake, 3),
    "frames_lost": (_FramesLost, 3),
    "no_light_seen": (_fields(led=Index, exposure_us=_Exposure), 3),
    "paused": (_fields(reason=str, waiting=_Count), 3),
    "resumed": (_fields(seconds=_Seconds), 3),
    COMPARED: (_Compared, 5),
    ACCEPTED: (_fields(file=FrameName, code=str), 6),
    "device_lost": (_fields(device=_Device, reason=str), 3),
    "device_returned": (_fields(device=_Device, seconds=_Seconds), 3),
    "not_sequenced": (_fields(reason=str), 3),
    "interrupted": (_Ended, 3),
    "failed": (_Ended, 3),
    "imported": (_Imported, 3),
    "watched": (_Watched, 3),
}


def details_complaint(event: str, details: dict[str, Any], version: int) -> str | None:
    """Return a description of the error in the details of an event; None if they are valid.

    Parameters
    ----------
    event
        Name of the event. The details of unknown events are not checked.
    details
        Details as parsed from JSON.
    version
        Format version of the session at this event.
    """
    schema, since = _SCHEMAS.get(event, (None, 0))
    if schema is None or version < since:
        return None
    try:
        schema.model_validate(details)
    except ValidationError as error:
        return validation_message(error)
    return None


def check_event(event: str, details: Mapping[str, Any], version: int, folder: Path) -> None:
    """Refuse an event that must not be written into a session, or has invalid details.

    Parameters
    ----------
    event, details, version
        As for `details_complaint`.
    folder
        The session, for the message.

    Raises
    ------
    DataError
        If its details do not follow the format, or only a repair, a compaction or the reopening of
        a session may write it.
    """
    if event in RESERVED:
        raise DataError(f"{folder}: the event {event!r} is reserved and cannot be written directly")
    complaint = details_complaint(event, dict(details), version)
    if complaint is not None:
        raise DataError(f"{folder}: the event {event!r} is invalid: {complaint}")
