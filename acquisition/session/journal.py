"""The journal: one line per frame or event, chained by hashes of the bytes of the lines.

A line is a JSON object in ASCII whose last key is ``line_sha256``. Its value is SHA-256(P + T),
with T the bytes of the line before ``,"line_sha256"`` and P the 64 digits of the previous line (64
zeros for the first line). This reveals a change of any byte and a missing line.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any, Literal, NoReturn, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from acquisition.files.storage import sha256_of
from acquisition.pixels.frame_quality import PERCENTILE_NAMES
from acquisition.plan.planned_shot import PlannedShot, Role, ShotKey
from rig.messages import validation_message

GENESIS = "0" * 64
# Settings of the camera, when a recording starts or is resumed.
CAMERA_SETTINGS = "camera_settings"
# Comparison of two frames of the same light.
COMPARED = "compared"
# A finding of such a comparison after which the recording continued.
ACCEPTED = "accepted"
# Events that readers act on.
COMPACTED = "compacted"
LEFT_OUT = "left_out"
REOPENED = "reopened"
SET_ASIDE = "set_aside"
UPGRADED = "upgraded"

_SEAL = re.compile(rb'(.*),"line_sha256":"([0-9a-f]{64})"\}', re.DOTALL)

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
# Directly in frames/, no further separators, no leading dot: a path that cannot leave the session.
FramePath = Annotated[str, Field(pattern=r"^frames/[A-Za-z0-9_][A-Za-z0-9._-]*$")]
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,6})?(Z|[+-]\d\d:\d\d)?")
# The mean is stored with four decimals.
_MEAN_SLACK_DN = 1e-4


def _checked_time(text: str) -> str:
    if _TIME.fullmatch(text) is None:
        raise ValueError("is not a date and time in ISO 8601 format")
    try:
        datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"is not a date and time: {error}") from error
    return text


def _checked_percentiles(values: dict[str, int]) -> dict[str, int]:
    if set(values) != set(PERCENTILE_NAMES):
        raise ValueError(f"must have exactly the keys {', '.join(PERCENTILE_NAMES)}")
    ordered = [values[name] for name in PERCENTILE_NAMES]
    if sorted(ordered) != ordered:
        raise ValueError("must not decrease from 0 to 100 per cent")
    return values


# Bounded so that every number fits the integer types of other libraries.
Index = Annotated[int, Field(ge=0, lt=2**31)]
_Wide = Annotated[int, Field(ge=-(2**63), lt=2**64)]
_Microseconds = Annotated[int, Field(ge=0, lt=2**63)]
_Exposure = Annotated[float, Field(gt=0, le=1e12)]
_Fraction = Annotated[float, Field(ge=0, le=1)]
_Sample = Annotated[int, Field(ge=0, le=65535)]
_Percentiles = Annotated[dict[str, _Sample], AfterValidator(_checked_percentiles)]


class LinePart(BaseModel):
    """Part of a line that readers act on: unknown keys are refused.

    Types are strict: the text "3", 3.0 and true are not the integer 3.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class _Line(LinePart):
    seq: Annotated[int, Field(ge=0)]
    time_utc: Annotated[str, AfterValidator(_checked_time)]


class StartLine(_Line):
    """The first line; it links the journal to its ``session.toml``."""

    kind: Literal["session"] = "session"
    session_toml_sha256: Sha256


class Echo(LinePart):
    """Reply of the LED board: its sequence number and the LED that was on.

    ``lit_us`` is the time for which the LED was on, and ``active_us`` the time for which the
    camera's exposure-active output was high meanwhile, both in microseconds by the board's clock;
    None if not measured.
    """

    seq: _Wide
    led: Index | None
    lit_us: _Microseconds | None = None
    active_us: _Microseconds | None = None


class FrameLine(_Line):
    """A frame that is safe on disk. A frame without a complete line does not exist.

    ``led`` is part of the identity: the LED of a light or repeat, None for other roles; the LED of
    a flat is in ``echo``. ``exposure_us`` is the exposure time that the camera reported,
    ``origin`` the source file of an imported frame. A frame with status ``rejected`` is kept but
    does not count. ``mean_dn`` is the mean grey value. ``above_dark`` of a lit frame is the
    difference of its mean from that of the frame with all LEDs off at the same exposure, as a
    fraction of the range from black to white. None stands for unknown values.
    """

    kind: Literal["frame"] = "frame"
    role: Role
    led: Index | None
    bracket: Index
    repeat: Index
    exposure_us: _Exposure | None
    gain_db: float | None
    file: FramePath
    bytes: Annotated[int, Field(ge=1, lt=2**63)]
    file_sha256: Sha256
    pixels_sha256: Sha256
    frame_id: _Wide | None
    timestamp_ns: _Wide | None
    temperature_c: float | None
    echo: Echo | None
    clipped_fraction: _Fraction
    percentiles_dn: _Percentiles
    sharpness: Annotated[float, Field(ge=0)]
    mean_dn: float | None = None
    above_dark: float | None = None
    status: Literal["ok", "rejected"]
    origin: str | None

    def __repr__(self) -> str:
        return f"FrameLine({self.seq}, {self.file}, {self.status})"

    @property
    def key(self) -> ShotKey:
        """Identity of the shot, as in `PlannedShot.key`."""
        return self.role, self.led, self.bracket, self.repeat

    @property
    def shot(self) -> PlannedShot:
        """The shot by itself, without a plan."""
        return PlannedShot(self.role, self.led, self.bracket, self.repeat, self.exposure_us)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.led is None) is (self.role in ("light", "repeat")):
            needed = "needs an LED" if self.led is None else f"has no LED, not {self.led}"
            raise ValueError(f"a {self.role} frame {needed}")
        if self.role in ("dark", "ambient") and self.above_dark is not None:
            raise ValueError(f"a {self.role} frame has no above_dark")
        low, high = self.percentiles_dn["0"], self.percentiles_dn["100"]
        if self.mean_dn is not None and not (
            low - _MEAN_SLACK_DN <= self.mean_dn <= high + _MEAN_SLACK_DN
        ):
            raise ValueError(f"mean_dn {self.mean_dn:g} is not between percentiles 0 and 100")
        return self


class EventLine(_Line):
    """An event between frames; ``details`` depend on the event."""

    kind: Literal["event"] = "event"
    event: Annotated[str, Field(pattern=r"^[a-z][a-z_]*$")]
    details: dict[str, JsonValue]

    def __repr__(self) -> str:
        return f"EventLine({self.seq}, {self.event})"

    @property
    def left_out(self) -> frozenset[int]:
        """LEDs whose shots a ``left_out`` event no longer requires; empty for other events."""
        leds = self.details.get("leds") if self.event == LEFT_OUT else None
        if not isinstance(leds, list):
            return frozenset()
        return frozenset(led for led in leds if type(led) is int)


Line = StartLine | FrameLine | EventLine
_LINE: TypeAdapter[Line] = TypeAdapter(Annotated[Line, Field(discriminator="kind")])


@dataclass(frozen=True)
class Journal:
    """The valid part of a journal.

    Parameters
    ----------
    lines
        Intact lines up to the first damage.
    text
        Bytes of these lines, each with its newline.
    last_sha256
        Hash of the last intact line.
    torn
        Bytes of a last line whose writing was interrupted; it does not count.
    unterminated
        True if the last line is intact except for its missing newline.
    damage
        Description of the first damage, starting with the line number; None without damage.
    """

    lines: tuple[Line, ...]
    text: bytes
    last_sha256: str
    torn: bytes = b""
    unterminated: bool = False
    damage: str | None = None


def encode_line(record: Mapping[str, Any], previous_sha256: str) -> tuple[bytes, str]:
    """Encode a record as a line with its hash.

    Returns
    -------
    line
        Bytes with the final newline.
    sha256
        Hash of the line, which the next line includes in its own.

    Examples
    --------
    >>> from acquisition.session import GENESIS, encode_line
    >>> line, sha256 = encode_line({"seq": 0, "kind": "event"}, GENESIS)
    >>> line[:8], len(sha256)
    (b'{"seq":0', 64)
    """
    text = json.dumps(record, separators=(",", ":"), allow_nan=False)[:-1].encode("ascii")
    own = _chained(previous_sha256, text)
    return text + f',"line_sha256":"{own}"}}\n'.encode("ascii"), own


def parse_journal(data: bytes) -> Journal:
    """Parse the bytes of a journal into intact, torn and damaged parts. Raises no errors.

    Examples
    --------
    >>> from acquisition.session import parse_journal
    >>> parse_journal(b"half a line").torn
    b'half a line'
    """
    lines: list[Line] = []
    kept: list[bytes] = []
    previous = GENESIS

    def journal(**state: Any) -> Journal:
        return Journal(tuple(lines), b"".join(kept), previous, **state)

    def fault(piece: bytes) -> str:
        """Keep an intact line, or return what is wrong with it."""
        nonlocal previous
        own = _seal_of(piece, previous)
        if own is None:
            return "is damaged: its hash does not match"
        line = _understood(piece, len(lines))
        if isinstance(line, str):
            return f"is not understood: {line}"
        lines.append(line)
        kept.append(piece + b"\n")
        previous = own
        return ""

    pieces = data.split(b"\n")
    tail = pieces.pop()
    for number, piece in enumerate(pieces, 1):
        if wrong := fault(piece):
            return journal(damage=f"line {number} {wrong}")
    if not tail:
        return journal()
    number = len(lines) + 1
    # A power loss may leave a zero in place of the newline.
    line = tail.removesuffix(b"\0")
    if _seal_of(line, previous) is not None:
        wrong = fault(line)
        return journal(damage=f"line {number} {wrong}") if wrong else journal(unterminated=True)
    # An interrupted write leaves the beginning of a line. A complete line followed by one other
    # byte was not interrupted: its newline was changed afterwards.
    if _seal_of(tail[:-1], previous) is not None:
        return journal(damage=f"line {number} is damaged: its newline was changed")
    return journal(torn=tail)


def _chained(previous_sha256: str, text: bytes) -> str:
    return sha256_of(previous_sha256.encode("ascii") + text)


def _seal_of(piece: bytes, previous_sha256: str) -> str | None:
    """Return the hash of a line if it matches the line, otherwise None."""
    match = _SEAL.fullmatch(piece)
    if match is None:
        return None
    own = match[2].decode("ascii")
    return own if own == _chained(previous_sha256, match[1]) else None


def _understood(piece: bytes, seq: int) -> Line | str:
    """Return the parsed line, or the reason why a line with a valid hash is invalid."""
    try:
        text = piece.decode("ascii")
        record = json.loads(text, object_pairs_hook=_each_once, parse_constant=_refuse)
        del record["line_sha256"]
        line = _LINE.validate_python(record)
    except ValidationError as error:
        return validation_message(error)
    except _RefusedError as error:
        return str(error)
    except (ValueError, TypeError, KeyError, RecursionError):
        return "it is not a JSON object"
    if line.seq != seq:
        return f"its seq is {line.seq} and should be {seq}"
    if isinstance(line, StartLine) != (seq == 0):
        return "the first line, and no other, must be of kind session"
    return line


class _RefusedError(Exception):
    pass


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build an object; refuse repeated keys, because programs differ in which one they use."""
    record = dict(pairs)
    if len(record) < len(pairs):
        raise _RefusedError("a key appears twice")
    return record


def _refuse(constant: str) -> NoReturn:
    raise _RefusedError(f"{constant} is not JSON")
