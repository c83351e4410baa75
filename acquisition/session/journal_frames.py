"""The frames of a journal, the current place of their files, and contradictions between lines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Final

from acquisition.plan.planned_shot import PlannedShot, ShotKey
from acquisition.session.event_details import Compacted, SetAside, Upgraded, details_complaint
from acquisition.session.journal import (
    COMPACTED,
    SET_ASIDE,
    UPGRADED,
    EventLine,
    FrameLine,
    Journal,
)
from acquisition.session.layout import JOURNAL, leaves
from acquisition.session.light_proof import BOARD, wrong_light
from acquisition.session.manifest import Manifest
from acquisition.session.session_frame import Damage, SessionFrame

# Keys that every line must have from version 2.
_FRAME_KEYS_2: Final = frozenset({"mean_dn", "above_dark"})
_ECHO_KEYS_2: Final = frozenset({"lit_us", "active_us"})


@dataclass(frozen=True, eq=False)
class SetAsideFrame:
    """A damaged frame that no longer counts.

    Parameters
    ----------
    frame
        The frame as recorded; `SessionFrame.path` is the path where its file was found damaged.
    kept
        Path where the file is kept; None if it was lost.
    reason
        Description of the damage.
    """

    frame: SessionFrame
    kept: Path | None
    reason: str


@dataclass
class Recorded:
    """State of a session after all lines of its journal.

    Parameters
    ----------
    version
        Format version after the last line of the journal.
    frames
        Frames by the ``seq`` of their lines, in order, without those set aside.
    set_aside
        Frames that were set aside, by the ``seq`` of their lines, in order.
    names
        Names of all files in ``frames/`` that lines name, set aside or not.
    problems
        Errors in the journal.
    flaws
        Errors of single frames, by their ``seq``; setting the frame aside resolves the error.
    """

    version: int
    frames: dict[int, SessionFrame] = field(default_factory=dict)
    set_aside: dict[int, SetAsideFrame] = field(default_factory=dict)
    names: set[str] = field(default_factory=set)
    problems: list[str] = field(default_factory=list)
    flaws: dict[int, Damage] = field(default_factory=dict)

    def counted(self) -> dict[ShotKey, SessionFrame]:
        """Return the frame that counts for each shot: the last take that was not rejected.

        If that take was set aside, no frame counts: the takes that it replaced stay replaced.
        """
        takes = sorted((*self.frames.items(), *((s, a.frame) for s, a in self.set_aside.items())))
        last = {frame.line.key: seq for seq, frame in takes if frame.line.status == "ok"}
        return {key: self.frames[seq] for key, seq in last.items() if seq in self.frames}


def recorded_frames(
    folder: Path, manifest: Manifest, planned: Iterable[PlannedShot], journal: Journal
) -> Recorded:
    """Check every line of a journal against the format and against the other lines.

    Parameters
    ----------
    folder
        The session.
    manifest
        Its ``session.toml``.
    planned
        Shots of its plan; empty if it has no plan.
    journal
        Valid part of the journal.
    """
    reading = _Reading(folder, manifest, planned)
    for line in journal.lines:
        if isinstance(line, FrameLine):
            reading.frame(line)
        elif isinstance(line, EventLine):
            reading.event(line)
    return reading.recorded


class _Reading:
    def __init__(self, folder: Path, manifest: Manifest, planned: Iterable[PlannedShot]) -> None:
        self._folder = folder
        self._camera = manifest.camera
        self._echoes = bool(manifest.echoes)
        self._shots = {shot.key: shot for shot in planned}
        self._has_plan = manifest.plan is not None
        # First frame of each file name. Some file systems treat names as equal that differ only in
        # case or by a dot at the end.
        self._named: dict[str, int] = {}
        self.recorded = Recorded(manifest.format_version)

    def frame(self, line: FrameLine) -> None:
        """Process a frame line."""
        complaint = self._complaint(line)
        if complaint is not None:
            self._problem(line, complaint)
        path = self._folder / line.file
        self.recorded.frames[line.seq] = SessionFrame.recorded(path, line, self._camera.shape)
        shot = self._shots.get(line.key) or line.shot
        reported = {} if line.echo is None else {BOARD: line.echo.led}
        conflict = wrong_light(shot, reported, echoes=self._echoes)
        if conflict is not None:
            self._flaw(line.seq, line, f"{line.file} {conflict}")
        self._take_file(line.seq, line, line.file)

    def event(self, line: EventLine) -> None:
        """Process an event line."""
        complaint = details_complaint(line.event, line.details, self.recorded.version)
        if complaint is not None:
            self._problem(line, f"event {line.event} is not understood: {complaint}")
            return
        if line.event == COMPACTED:
            self._compacted(line, Compacted.model_validate(line.details))
        elif line.event == UPGRADED and self.recorded.version >= 2:
            self._upgraded(line, Upgraded.model_validate(line.details))
        elif line.event == SET_ASIDE and self.recorded.version >= 3:
            self._set_aside(line, SetAside.model_validate(line.details))

    def _compacted(self, line: EventLine, details: Compacted) -> None:
        frame = self.recorded.frames.get(details.frame_seq)
        if frame is None:
            self._problem(line, "compacts a frame that does not exist")
            return
        path = self._folder / details.file
        self.recorded.frames[details.frame_seq] = replace(
            frame, path=path, bytes=details.bytes, file_sha256=details.file_sha256
        )
        self._take_file(details.frame_seq, line, details.file)

    def _upgraded(self, line: EventLine, details: Upgraded) -> None:
        if details.from_version != self.recorded.version:
            self._problem(
                line,
                f"upgrades the session from version {details.from_version}, but it has version "
                f"{self.recorded.version}",
            )
            return
        self.recorded.version = details.to_version

    def _set_aside(self, line: EventLine, details: SetAside) -> None:
        seq = details.frame_seq
        frame = self.recorded.frames.get(seq)
        if frame is None or frame.path.name != PurePosixPath(details.file).name:
            self._problem(line, f"sets {details.file} aside, which is not the file of frame {seq}")
            return
        kept = None if details.kept is None else self._folder / details.kept
        self.recorded.set_aside[seq] = SetAsideFrame(frame, kept, details.reason)
        del self.recorded.frames[seq]
        self.recorded.flaws.pop(seq, None)

    def _complaint(self, line: FrameLine) -> str | None:
        """Return how a line contradicts ``session.toml``; None if it does not."""
        camera = self._camera
        keys = _FRAME_KEYS_2 & line.model_fields_set
        if line.echo is not None:
            keys |= _ECHO_KEYS_2 & line.echo.model_fields_set
        required = _FRAME_KEYS_2 | (frozenset() if line.echo is None else _ECHO_KEYS_2)
        if self.recorded.version == 1 and keys:
            return f"format version 1 has no key {min(keys)!r}"
        if self.recorded.version > 1 and keys != required:
            return f"the key {min(required - keys)!r} is missing"
        if line.role == "repeat" and self.recorded.version < 5:
            return f"format version {self.recorded.version} has no role 'repeat'"
        if self._has_plan and line.key not in self._shots:
            return f"{line.file} is not in the plan of session.toml"
        if line.percentiles_dn["100"] >= 2**camera.bit_depth:
            return (
                f"{line.file} has a value of {line.percentiles_dn['100']}, which exceeds "
                f"{camera.bit_depth} bits"
            )
        if line.bytes < camera.frame_bytes:
            return (
                f"{line.file} has {line.bytes} bytes, too few for {camera.width} x "
                f"{camera.height} pixels"
            )
        return None

    def _take_file(self, seq: int, line: FrameLine | EventLine, file: str) -> None:
        """Note the frame of a file; no two frames may have the same file."""
        path = self._folder / file
        self.recorded.names.add(path.name)
        name = path.name.rstrip(".").casefold()
        if name in self._named:
            for one in (self._named[name], seq):
                self._flaw(one, line, f"names {file}, which an earlier line names too")
        self._named.setdefault(name, seq)
        if path.is_symlink() and leaves(path, self._folder):
            self._flaw(seq, line, f"{file} is a link that leaves the session")

    def _problem(self, line: FrameLine | EventLine, text: str) -> None:
        self.recorded.problems.append(f"{self._folder / JOURNAL}: line {line.seq + 1}: {text}")

    def _flaw(self, seq: int, line: FrameLine | EventLine, text: str) -> None:
        frame = self.recorded.frames.get(seq)
        if frame is not None:
            flaw = Damage(frame, f"line {line.seq + 1}: {text}", self._folder / JOURNAL)
            self.recorded.flaws.setdefault(seq, flaw)
