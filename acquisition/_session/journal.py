"""The journal: one line per frame or event, chained by hashes over the very bytes of the lines.

A line is a JSON object in ASCII whose last key is ``line_sha256``. With T the bytes of the line
before ``,"line_sha256"`` and P the 64 digits of the line before (64 zeros for the first line), its
value is SHA-256(P + T). A change of any byte therefore shows, and so does a line that is missing.
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

from acquisition._pixels.quality import PERCENTILE_NAMES
from acquisition._plan.planned_shot import Role, ShotKey
from acquisition._storage import sha256_of
from rig import complaints

GENESIS = "0" * 64
# Events that readers act on.
COMPACTED = "compacted"
LEFT_OUT = "left_out"
REOPENED = "reopened"
SET_ASIDE = "set_aside"
UPGRADED = "upgraded"

_SEAL = re.compile(rb'(.*),"line_sha256":"([0-9a-f]{64})"\}', re.DOTALL)

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
# One folder deep, no separators, no leading dot: a path that cannot leave the session.
FramePath = Annotated[str, Field(pattern=r"^frames/[A-Za-z0-9_][A-Za-z0-9._-]*$")]
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,6})?(Z|[+-]\d\d:\d\d)?")
# The mean is stored with four decimals.
_MEAN_SLACK_DN = 1e-4


def _checked_time(text: str) -> str:
    if _TIME.fullmatch(text) is None:
        raise ValueError("is not a date and time as ISO 8601 writes them")
    try:
        datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"is not a date and time: {error}") from error
    return text


def _checked_percentiles(values: dict[str, int]) -> dict[str, int]:
    if set(values) != set(PERCENTILE_NAMES):
        raise ValueError(f"must hold exactly {', '.join(PERCENTILE_NAMES)}")
    ordered = [values[name] for name in PERCENTILE_NAMES]
    if sorted(ordered) != ordered:
        raise ValueError("must not decrease from 0 to 100 per cent")
    return values


# Bounded so that no reader meets a number that its other libraries cannot hold.
Index = Annotated[int, Field(ge=0, lt=2**31)]
_Wide = Annotated[int, Field(ge=-(2**63), lt=2**64)]
_Microseconds = Annotated[int, Field(ge=0, lt=2**63)]
_Exposure = Annotated[float, Field(gt=0, le=1e12)]
_Fraction = Annotated[float, Field(ge=0, le=1)]
_Sample = Annotated[int, Field(ge=0, le=65535)]
_Percentiles = Annotated[dict[str, _Sample], AfterValidator(_checked_percentiles)]


class _Part(BaseModel):
    """Values are taken as JSON has them: the text "3", 3.0 and true are not the number 3."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class _Line(_Part):
    seq: Annotated[int, Field(ge=0)]
    time_utc: Annotated[str, AfterValidator(_checked_time)]


class StartLine(_Line):
    """The first line: ties the journal to its ``session.toml``."""

    kind: Literal["session"] = "session"
    session_toml_sha256: Sha256


class Echo(_Part):
    """What the LED board answered: its sequence number and the LED it acted on.

    ``lit_us`` is how long the LED was on and ``active_us`` how long the camera's exposure-active
    output was up meanwhile, both by the board's clock and in microseconds; None where not measured.
    """

    seq: _Wide
    led: Index | None
    lit_us: _Microseconds | None = None
    active_us: _Microseconds | None = None


class FrameLine(_Line):
    """A frame that is safe on disk. A frame without a whole line does not exist.

    ``exposure_us`` is what the camera reported, ``origin`` the file an imported frame came from.
    A frame with status ``rejected`` is kept and does not count. ``mean_dn`` is the mean grey value;
    ``above_dark``, of a lit frame, how far it is above the frame of its exposure with all LEDs off,
    as a fraction of the range from black to white. None where not known.
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

    @property
    def key(self) -> ShotKey:
        """What identifies the shot, as in `PlannedShot.key`."""
        return self.role, self.led, self.bracket, self.repeat

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.led is None) is (self.role == "light"):
            needed = "needs an LED" if self.led is None else f"has no LED, not {self.led}"
            raise ValueError(f"a {self.role} frame {needed}")
        if self.role in ("dark", "ambient") and self.above_dark is not None:
            raise ValueError(f"a {self.role} frame has no above_dark")
        low, high = self.percentiles_dn["0"], self.percentiles_dn["100"]
        if self.mean_dn is not None and not (
            low - _MEAN_SLACK_DN <= self.mean_dn <= high + _MEAN_SLACK_DN
        ):
            raise ValueError(f"mean_dn {self.mean_dn:g} is not between the least and the greatest")
        return self


class EventLine(_Line):
    """Something that happened between frames; ``details`` depend on the event."""

    kind: Literal["event"] = "event"
    event: Annotated[str, Field(pattern=r"^[a-z][a-z_]*$")]
    details: dict[str, JsonValue]

    @property
    def left_out(self) -> frozenset[int]:
        """LEDs whose shots are not demanded from this line on; of a ``left_out`` event only."""
        leds = self.details.get("leds") if self.event == LEFT_OUT else None
        if not isinstance(leds, list):
            return frozenset()
        return frozenset(led for led in leds if type(led) is int)


Line = StartLine | FrameLine | EventLine
_LINE: TypeAdapter[Line] = TypeAdapter(Annotated[Line, Field(discriminator="kind")])


@dataclass(frozen=True)
class Journal:
    """A journal as far as it can be trusted.

    Parameters
    ----------
    lines
        The whole lines up to the first damage.
    text
        Their bytes, each with its newline.
    last_sha256
        Hash of the last whole line.
    torn
        Bytes of a last line whose writing was cut off; it never counted.
    unterminated
        True where the last line is whole but for its newline.
    damage
        The first thing wrong, in words that start with the line number; None if all is well.
    """

    lines: tuple[Line, ...]
    text: bytes
    last_sha256: str
    torn: bytes = b""
    unterminated: bool = False
    damage: str | None = None


def encode_line(record: Mapping[str, Any], previous_sha256: str) -> tuple[bytes, str]:
    """Seal a record into a line.

    Returns
    -------
    line
        Bytes with the final newline.
    sha256
        Its hash, which the next line is chained to.
    """
    text = json.dumps(record, separators=(",", ":"), allow_nan=False)[:-1].encode("ascii")
    own = _chained(previous_sha256, text)
    return text + f',"line_sha256":"{own}"}}\n'.encode("ascii"), own


def parse_journal(data: bytes) -> Journal:
    """Read a journal's bytes and tell what is whole, torn and damaged. Raises nothing."""
    lines: list[Line] = []
    kept: list[bytes] = []
    previous = GENESIS

    def journal(**state: Any) -> Journal:
        return Journal(tuple(lines), b"".join(kept), previous, **state)

    pieces = data.split(b"\n")
    tail = pieces.pop()
    for number, piece in enumerate(pieces, 1):
        own = _seal_of(piece, previous)
        if own is None:
            return journal(damage=f"line {number} is damaged: its hash does not hold")
        line = _understood(piece, len(lines))
        if isinstance(line, str):
            return journal(damage=f"line {number} is not understood: {line}")
        lines.append(line)
        kept.append(piece + b"\n")
        previous = own
    if not tail:
        return journal()
    number = len(lines) + 1
    own = _seal_of(tail, previous)
    if own is not None:
        line = _understood(tail, len(lines))
        if isinstance(line, str):
            return journal(damage=f"line {number} is not understood: {line}")
        lines.append(line)
        kept.append(tail + b"\n")
        previous = own
        return journal(unterminated=True)
    # A write that was cut off is a beginning of a line. A whole line with one byte more was not
    # cut off: its newline was changed afterwards.
    if _seal_of(tail[:-1], previous) is not None:
        return journal(damage=f"line {number} is damaged: its newline was changed")
    return journal(torn=tail)


def _chained(previous_sha256: str, text: bytes) -> str:
    return sha256_of(previous_sha256.encode("ascii") + text)


def _seal_of(piece: bytes, previous_sha256: str) -> str | None:
    """Return the hash a line carries if it holds."""
    match = _SEAL.fullmatch(piece)
    if match is None:
        return None
    own = match[2].decode("ascii")
    return own if own == _chained(previous_sha256, match[1]) else None


def _understood(piece: bytes, seq: int) -> Line | str:
    """Return the line, or why a line whose hash holds makes no sense."""
    try:
        text = piece.decode("ascii")
        record = json.loads(text, object_pairs_hook=_each_once, parse_constant=_refuse)
        del record["line_sha256"]
        line = _LINE.validate_python(record)
    except ValidationError as error:
        return complaints(error)
    except _RefusedError as error:
        return str(error)
    except (ValueError, TypeError, KeyError, RecursionError):
        return "it is not a JSON object"
    if line.seq != seq:
        return f"its seq is {line.seq} and should be {seq}"
    if isinstance(line, StartLine) != (seq == 0):
        return "a journal has one line of kind session, the first"
    return line


class _RefusedError(Exception):
    pass


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build an object; programs differ in which of two equal keys they take."""
    record = dict(pairs)
    if len(record) < len(pairs):
        raise _RefusedError("it has a key twice")
    return record


def _refuse(constant: str) -> NoReturn:
    raise _RefusedError(f"{constant} is not JSON")
