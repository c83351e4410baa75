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
    """

    lines: tuple[dict[str, Any], ...]
    torn: bytes
    complete: bool
    files: dict[str, str]
    kept: frozenset[str]

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
        )

    @property
    def set_aside(self) -> set[int]:
        """Numbers of the frame lines that an event has set aside."""
        events = (line for line in self.lines if line.get("event") == "set_aside")
        return {line["details"]["frame_seq"] for line in events}

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
        if not seal or tail != own + b'"}\n':
            break
        line = json.loads(text)
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


def lit_after(periods: Sequence[LitPeriod], end_ns: int) -> Iterator[str]:
    """Yield the LEDs that were on after a time."""
    for period in periods:
        if period.end_ns > max(end_ns, period.start_ns):
            late_s = (period.end_ns - end_ns) / 1e9
            yield f"LED {period.led} was on until {late_s:.3f} s after it should be off"
