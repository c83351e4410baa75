"""Checks of a recording that share no code with what recorded it.

Each reads journal and files as the session format describes them (docs/session-format.md).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rig import Shot
from simulator.bench.state import LitPeriod
from simulator.world.camera import led_of

_SEAL = b',"line_sha256":"'
# Of the light of a complete exposure, a frame must show so much.
_LEAST_LIGHT = 0.9


@dataclass(frozen=True)
class SessionState:
    """What is on the disk.

    Parameters
    ----------
    lines
        Lines of the journal whose chain holds.
    torn
        What follows them.
    complete
        Whether COMPLETE states the hash of the journal.
    files
        Hash of every file in ``frames/`` by its name.
    kept
        Hashes of all files in ``frames/`` and ``derived/`` that are not hidden.
    shelved
        Paths of the files that were set aside, relative to the session.
    """

    lines: tuple[dict[str, Any], ...]
    torn: bytes
    complete: bool
    files: dict[str, str]
    kept: frozenset[str]
    shelved: frozenset[str]

    @classmethod
    def read(cls, folder: Path) -> SessionState:
        """Read a session; a folder without a journal has no lines."""
        journal = folder / "journal.jsonl"
        data = journal.read_bytes() if journal.exists() else b""
        lines, end = _chained(data)
        mark = folder / "COMPLETE"
        whole = hashlib.sha256(data).hexdigest().encode()
        found = {
            path: hashlib.sha256(path.read_bytes()).hexdigest()
            for path in (*folder.glob("frames/[!.]*"), *folder.glob("derived/*/[!.]*"))
        }
        return cls(
            tuple(lines),
            data[end:],
            mark.exists() and whole in mark.read_bytes(),
            {path.name: sha for path, sha in found.items() if path.parent.name == "frames"},
            frozenset(found.values()),
            frozenset(
                path.relative_to(folder).as_posix()
                for path in found
                if path.parent.name == "set_aside"
            ),
        )

    @property
    def set_aside(self) -> set[int]:
        """Numbers of the frame lines that an event has set aside."""
        return {details["frame_seq"] for details in self.set_aside_events}

    @property
    def set_aside_events(self) -> list[dict[str, Any]]:
        """Details of the events that have set frames aside."""
        return [line["details"] for line in self.lines if line.get("event") == "set_aside"]

    @property
    def frames(self) -> list[dict[str, Any]]:
        """Lines of frames that were not set aside."""
        aside = self.set_aside
        return [one for one in self.lines if one["kind"] == "frame" and one["seq"] not in aside]

    @property
    def taken(self) -> set[tuple[Any, ...]]:
        """Role, LED, bracket and repeat of the frames that count."""
        good = (one for one in self.frames if one["status"] == "ok")
        return {shot_of(one) for one in good}

    @property
    def damaged(self) -> list[str]:
        """Files that are not those that the journal describes."""
        return [
            one["file"]
            for one in self.frames
            if self.files.get(Path(one["file"]).name) != one["file_sha256"]
        ]


def shot_of(line: dict[str, Any]) -> tuple[Any, ...]:
    """Return the role, LED, bracket and repeat of a frame line."""
    return line["role"], line["led"], line["bracket"], line["repeat"]


def _chained(data: bytes) -> tuple[list[dict[str, Any]], int]:
    lines: list[dict[str, Any]] = []
    before, end = b"0" * 64, 0
    for text in data.splitlines(keepends=True):
        head, seal, tail = text.rpartition(_SEAL)
        own = hashlib.sha256(before + head).hexdigest().encode()
        # A last line counts with or without its newline.
        if not seal or tail.rstrip(b"\n\0") != own + b'"}':
            break
        line = json.loads(text.rstrip(b"\0"))
        if line["seq"] != len(lines):
            break
        lines.append(line)
        before, end = own, end + len(text)
    return lines, end


def lost(before: Iterable[tuple[int, str]], now: SessionState) -> Iterator[str]:
    """Yield frames that were reported as safe and are not in the journal.

    Parameters
    ----------
    before
        Number and hash of the lines of frames that the recording has reported as safe.
    now
        What is on the disk.
    """
    known = {one["seq"]: one["file_sha256"] for one in now.lines if one["kind"] == "frame"}
    for seq, sha256 in before:
        if known.get(seq) != sha256:
            yield f"frame line {seq} was reported as safe and is lost"


def misplaced(now: SessionState) -> Iterator[str]:
    """Yield files that are not where the journal states, and files that it does not explain."""
    places = {details["kept"] for details in now.set_aside_events} - {None}
    for path in sorted(now.shelved - places):
        yield f"{path} was set aside without an event"
    if now.complete:  # until then, a program may have been killed before it moved a file
        for path in sorted(places - now.shelved):
            yield f"{path} is missing, although an event states that a file is kept there"
        for name in sorted(now.files.keys() - {Path(one["file"]).name for one in now.frames}):
            yield f"complete, but no line that counts has the file {name}"


def wrong_frames(folder: Path, now: SessionState, black: float) -> Iterator[str]:
    """Yield frames that do not show the light that their line states."""
    brightest: dict[tuple[Any, ...], list[float]] = {}
    found: list[tuple[dict[str, Any], float]] = []
    damaged = set(now.damaged)
    for line in now.frames:
        if line["file"] in damaged or line["status"] != "ok":
            continue
        pixels = np.asarray(cv2.imread(str(folder / line["file"]), cv2.IMREAD_UNCHANGED))
        led = line["led"] if line["role"] in ("light", "repeat") else None
        if line["echo"] is not None and line["echo"]["led"] != led:
            yield f"{line['file']}: planned with LED {led}, the echo states {line['echo']['led']}"
        shown = led_of(pixels, black)
        if shown != led:
            yield f"{line['file']}: states LED {led}, the frame shows {shown}"
        if led is not None:
            light = float(np.mean(pixels)) - black
            brightest.setdefault((led, line["exposure_us"]), []).append(light)
            found.append((line, light))
    # The same light at the same exposure gives the same frame, if it was on for all of it.
    for line, light in found:
        expected = max(brightest[line["led"], line["exposure_us"]])
        same = [
            value * line["exposure_us"] / other["exposure_us"]
            for other, value in found
            if other["led"] == line["led"]
        ]
        if light < _LEAST_LIGHT * max(expected, max(same) if same else 0):
            yield f"{line['file']}: LED {line['led']} was on for only a part of the exposure"


def badly_lit(shots: Iterable[Shot], periods: Sequence[LitPeriod]) -> Iterator[str]:
    """Yield the shots whose LED was not on, alone, during the complete exposure."""
    for shot in shots:
        start_ns = shot.frame.timestamp_ns
        end_ns = start_ns + round(shot.frame.exposure_us * 1000)
        # Cancelled periods have no length.
        lit = [p for p in periods if p.start_ns < end_ns and p.end_ns > max(start_ns, p.start_ns)]
        whole = all(one.start_ns <= start_ns and one.end_ns >= end_ns for one in lit)
        if not whole or [one.led for one in lit] != [shot.led] * (shot.led is not None):
            yield f"the rig returned a frame of LED {shot.led} that was lit by {lit}"
        if shot.echo is not None and shot.echo.led != shot.led:
            yield f"the rig returned a frame of LED {shot.led}, the echo states {shot.echo.led}"


def lit_after(periods: Sequence[LitPeriod], end_ns: int) -> Iterator[str]:
    """Yield the LEDs that were on after a time."""
    for period in periods:
        if period.end_ns > max(end_ns, period.start_ns):
            late_s = (period.end_ns - end_ns) / 1e9
            yield f"LED {period.led} was on until {late_s:.3f} s after it should be off"
