"""The frames of a journal: what was recorded, where each file lies now, and what contradicts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Final

from acquisition._plan.planned_shot import PlannedShot, ShotKey
from acquisition._session.damage import Damage
from acquisition._session.event_details import Compacted, SetAside, Upgraded, details_complaint
from acquisition._session.journal import (
    COMPACTED,
    SET_ASIDE,
    UPGRADED,
    EventLine,
    FrameLine,
    Journal,
)
from acquisition._session.layout import JOURNAL, leaves
from acquisition._session.light_proof import BOARD, wrong_light
from acquisition._session.manifest import Manifest
from acquisition._session.session_frame import SessionFrame

# Keys that lines have since version 2, all of them always.
_FRAME_KEYS_2: Final = frozenset({"mean_dn", "above_dark"})
_ECHO_KEYS_2: Final = frozenset({"lit_us", "active_us"})


@dataclass(frozen=True, eq=False)
class SetAsideFrame:
    """A frame that was found damaged and does not count any more.

    Parameters
    ----------
    frame
        As it was recorded; `SessionFrame.path` is where its file was found damaged.
    kept
        Where the file is kept; None where it was lost.
    reason
        What was wrong.
    """

    frame: SessionFrame
    kept: Path | None
    reason: str


@dataclass
class Recorded:
    """What the lines of a journal amount to.

    Parameters
    ----------
    version
        Of the format, at the end of the journal.
    frames
        By the ``seq`` of their lines, in order; those set aside are not among them.
    set_aside
        Those that were, likewise.
    names
        Every file in ``frames/`` that a line names, set aside or not.
    problems
        What is wrong with the journal.
    flaws
        What is wrong with single frames, by their ``seq``: setting them aside settles it.
    """

    version: int
    frames: dict[int, SessionFrame] = field(default_factory=dict)
    set_aside: dict[int, SetAsideFrame] = field(default_factory=dict)
    names: set[str] = field(default_factory=set)
    problems: list[str] = field(default_factory=list)
    flaws: dict[int, Damage] = field(default_factory=dict)

    def counted(self) -> dict[ShotKey, SessionFrame]:
        """Return the frame that counts of each shot: its last take that was not rejected.

        Where that take was set aside none counts: what it replaced does not come back.
        """
        takes = sorted((*self.frames.items(), *((s, a.frame) for s, a in self.set_aside.items())))
        last = {frame.line.key: seq for seq, frame in takes if frame.line.status == "ok"}
        return {key: self.frames[seq] for key, seq in last.items() if seq in self.frames}


def recorded_frames(
    folder: Path, manifest: Manifest, planned: Iterable[PlannedShot], journal: Journal
) -> Recorded:
    """Go through a journal and check every line against the format and against the others.

    Parameters
    ----------
    folder
        The session.
    manifest
        Its ``session.toml``.
    planned
        The shots of its plan; none where it has no plan.
    journal
        As far as it can be trusted.
    """
    reading = _Reading(folder, manifest, planned)
    for line in journal.lines:
        if isinstance(line, FrameLine):
            reading.frame(line)
        elif isinstance(line, EventLine):
            reading.event(line)
    return reading.found


class _Reading:
    def __init__(self, folder: Path, manifest: Manifest, planned: Iterable[PlannedShot]) -> None:
        self._folder = folder
        self._camera = manifest.camera
        self._shots = {shot.key: shot for shot in planned}
        self._has_plan = manifest.plan is not None
        # Which frame a file was named for first. Some disks take names for the same that differ in
        # case or by a dot at their end.
        self._named: dict[str, int] = {}
        self.found = Recorded(manifest.format_version)

    def frame(self, line: FrameLine) -> None:
        """Take a frame line."""
        complaint = self._complaint(line)
        if complaint is not None:
            self._problem(line, complaint)
        self.found.frames[line.seq] = SessionFrame(
            self._folder / line.file, line, line.bytes, line.file_sha256, self._camera.shape
        )
        shot = self._shots.get(line.key) or _shot_of(line)
        told = {} if line.echo is None else {BOARD: line.echo.led}
        conflict = wrong_light(shot, told)
        if conflict is not None:
            self._flaw(line.seq, line, f"{line.file} {conflict}")
        self._take_file(line.seq, line, line.file)

    def event(self, line: EventLine) -> None:
        """Take an event line."""
        complaint = details_complaint(line.event, line.details, self.found.version)
        if complaint is not None:
            self._problem(line, f"event {line.event} is not understood: {complaint}")
            return
        if line.event == COMPACTED:
            self._compacted(line, Compacted.model_validate(line.details))
        elif line.event == UPGRADED and self.found.version >= 2:
            self._upgraded(line, Upgraded.model_validate(line.details))
        elif line.event == SET_ASIDE and self.found.version >= 3:
            self._set_aside(line, SetAside.model_validate(line.details))

    def _compacted(self, line: EventLine, details: Compacted) -> None:
        known = self.found.frames.get(details.frame_seq)
        if known is None:
            self._problem(line, "compacts no frame")
            return
        self.found.frames[details.frame_seq] = SessionFrame(
            self._folder / details.file,
            known.line,
            details.bytes,
            details.file_sha256,
            self._camera.shape,
        )
        self._take_file(details.frame_seq, line, details.file)

    def _upgraded(self, line: EventLine, details: Upgraded) -> None:
        if details.from_version != self.found.version:
            self._problem(
                line,
                f"upgrades the session from version {details.from_version}, it is of version "
                f"{self.found.version}",
            )
            return
        self.found.version = details.to_version

    def _set_aside(self, line: EventLine, details: SetAside) -> None:
        seq = details.frame_seq
        known = self.found.frames.get(seq)
        if known is None or known.path.name != PurePosixPath(details.file).name:
            self._problem(line, f"sets {details.file} aside, which is the file of no frame {seq}")
            return
        kept = None if details.kept is None else self._folder / details.kept
        self.found.set_aside[seq] = SetAsideFrame(known, kept, details.reason)
        del self.found.frames[seq]
        self.found.flaws.pop(seq, None)

    def _complaint(self, line: FrameLine) -> str | None:
        """Say what in a line contradicts ``session.toml``."""
        camera = self._camera
        keys = _FRAME_KEYS_2 & line.model_fields_set
        if line.echo is not None:
            keys |= _ECHO_KEYS_2 & line.echo.model_fields_set
        wanted = _FRAME_KEYS_2 | (frozenset() if line.echo is None else _ECHO_KEYS_2)
        if self.found.version == 1 and keys:
            return f"format version 1 has no key {min(keys)!r}"
        if self.found.version > 1 and keys != wanted:
            return f"the key {min(wanted - keys)!r} is missing"
        if self._has_plan and line.key not in self._shots:
            return f"{line.file} is not in the plan of session.toml"
        if line.percentiles_dn["100"] >= 2**camera.bit_depth:
            return (
                f"{line.file} has a value of {line.percentiles_dn['100']}, more than "
                f"{camera.bit_depth} bits hold"
            )
        if line.bytes < camera.frame_bytes:
            return (
                f"{line.file} of {line.bytes} bytes cannot hold {camera.width} x {camera.height} "
                "pixels"
            )
        return None

    def _take_file(self, seq: int, line: FrameLine | EventLine, file: str) -> None:
        """Note which frame a file is of; no two may name one file, as none is written twice."""
        path = self._folder / file
        self.found.names.add(path.name)
        name = path.name.rstrip(".").casefold()
        if name in self._named:
            for one in (self._named[name], seq):
                self._flaw(one, line, f"names {file}, which an earlier line names too")
        self._named.setdefault(name, seq)
        if path.is_symlink() and leaves(path, self._folder):
            self._flaw(seq, line, f"{file} is a link that leaves the session")

    def _problem(self, line: FrameLine | EventLine, text: str) -> None:
        self.found.problems.append(f"{self._folder / JOURNAL}: line {line.seq + 1}: {text}")

    def _flaw(self, seq: int, line: FrameLine | EventLine, text: str) -> None:
        frame = self.found.frames.get(seq)
        if frame is not None:
            flaw = Damage(frame, f"line {line.seq + 1}: {text}", self._folder / JOURNAL)
            self.found.flaws.setdefault(seq, flaw)


def _shot_of(line: FrameLine) -> PlannedShot:
    """Return the shot of a line as if it had been planned."""
    return PlannedShot(line.role, line.led, line.bracket, line.repeat, line.exposure_us)
