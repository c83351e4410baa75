"""Reading of sessions: recorded frames, frames that count, and missing shots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from acquisition._errors import DataError, MissingPathError
from acquisition.files.storage import is_hidden, sha256_of
from acquisition.plan.planned_shot import PlannedShot
from acquisition.session.clock_steps import clock_steps
from acquisition.session.comparisons import comparison_notices
from acquisition.session.journal import EventLine, Journal, StartLine, parse_journal
from acquisition.session.journal_frames import SetAsideFrame, recorded_frames
from acquisition.session.layout import (
    ASIDE,
    COMPLETE,
    FRAMES,
    JOURNAL,
    MANIFEST,
    WRITERS,
    completion_mark,
    is_session,
    leaves,
)
from acquisition.session.manifest import Manifest, parse_manifest
from acquisition.session.session_frame import Damage, SessionFrame
from acquisition.values.camera_model import CameraModel
from acquisition.values.lights import Lights
from acquisition.values.noise_model import NoiseModel
from acquisition.values.transfer_curve import LINEAR, TransferCurve
from rig import Notice, SgpError, UnreadableError, pluralize, read_bounded
from rig.files import MAX_TEXT_BYTES, MAX_TOML_BYTES

# Enough for a million frames.
_MAX_JOURNAL_BYTES: Final = 1 << 30


@dataclass(frozen=True, eq=False)
class Session:
    """A recording.

    Parameters
    ----------
    folder
        Folder of the session.
    manifest
        Content of ``session.toml``.
    format_version
        Format version: that of ``session.toml``, or the one that the session was upgraded to.
    recorded
        All frames of the journal in order of recording, including retaken and rejected ones, but
        not those set aside.
    set_aside
        Damaged frames whose files are kept elsewhere.
    frames
        Frames that count, at most one per shot: the last take that was not rejected, unless it was
        set aside.
    events
        Event lines in order.
    complete
        True if the recording was completed.
    missing
        Planned shots without a frame that counts, except those left out.
    left_out
        Planned shots without a frame that counts that are not required, because their LED is dead.
    warnings
        Tolerated irregularities.
    """

    folder: Path
    manifest: Manifest
    format_version: int
    recorded: tuple[SessionFrame, ...]
    set_aside: tuple[SetAsideFrame, ...]
    frames: tuple[SessionFrame, ...]
    events: tuple[EventLine, ...]
    complete: bool
    missing: tuple[PlannedShot, ...]
    left_out: tuple[PlannedShot, ...]
    warnings: tuple[Notice, ...]

    def __repr__(self) -> str:
        state = "complete" if self.complete else f"incomplete, {len(self.missing)} missing"
        return f"Session({self.folder}, {pluralize(len(self.frames), 'frame')}, {state})"

    @classmethod
    def open(cls, folder: str | Path, *, damaged_frames: bool = False) -> Session:
        """Open a session, complete or not. Frames are read and checked only when requested.

        Parameters
        ----------
        folder
            The session.
        damaged_frames
            Open the session even if single frames contradict the plan, the board's report or other
            lines.

        Raises
        ------
        MissingPathError
            If the folder does not exist.
        DataError
            If it is not a session, has another format version, or is damaged.
        """
        return examine(Path(folder)).sound(but_for_frames=damaged_frames)

    def missing_without(self, frames: Iterable[SessionFrame]) -> tuple[PlannedShot, ...]:
        """Return the shots that would be missing if these frames were set aside, in plan order."""
        plan = self.manifest.plan
        gone = {frame.line.seq for frame in frames}
        kept = {frame.line.key for frame in self.frames if frame.line.seq not in gone}
        dead = _dead_leds(self.events, self.manifest)
        shots = () if plan is None else plan.shots()
        return tuple(s for s in shots if s.key not in kept and s.led not in dead)

    @property
    def lost_lines(self) -> Notice | None:
        """The warning that the journal seems to have lost its last lines, if there is one."""
        return next((one for one in self.warnings if one.code == "journal-lines-lost"), None)

    @property
    def camera_model(self) -> CameraModel | None:
        """The geometric camera model, if known."""
        record = self.manifest.camera_model
        return None if record is None else record.value()

    @property
    def sensor(self) -> NoiseModel | None:
        """The sensor's noise model, if known."""
        record = self.manifest.sensor
        return None if record is None else record.value()

    @property
    def transfer(self) -> TransferCurve:
        """The transfer curve of the frames; linear unless the session records another one."""
        record = self.manifest.transfer
        return LINEAR if record is None else record.value()

    @property
    def lights(self) -> Lights | None:
        """The calibrated lights stored with the session, if known."""
        record = self.manifest.lights
        return None if record is None else record.value()


@dataclass(frozen=True, eq=False)
class Examination:
    """A session with all its errors, except those in the contents of its frame files.

    Parameters
    ----------
    session
        The session; None if ``session.toml`` cannot be read.
    journal
        Valid part of the journal.
    names
        Names of all files in ``frames/`` that lines of the journal name.
    toml_sha256
        Current hash of ``session.toml``.
    problems
        Errors of the session, one line each.
    flaws
        Errors of single frames, by the ``seq`` of their lines.
    """

    session: Session | None
    journal: Journal
    names: frozenset[str]
    toml_sha256: str
    problems: tuple[str, ...]
    flaws: Mapping[int, Damage]

    def sound(self, *, but_for_frames: bool = False) -> Session:
        """Return the session, or raise its first problem as a DataError.

        With ``but_for_frames``, errors of single frames are ignored: these can be set aside.
        """
        flaws = () if but_for_frames else self.flaws.values()
        problems = (*self.problems, *(flaw.text for flaw in flaws))
        if self.session is None or problems:
            raise DataError(problems[0])
        return self.session


def examine(folder: Path) -> Examination:
    """Read a session and collect all errors instead of stopping at the first.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If it is not a session, or cannot be read.
    """
    try:
        return _examine(folder)
    except SgpError:
        raise
    except OSError as error:
        where = error.filename or folder
        raise DataError(f"{where}: cannot be read: {error.strerror}; check the disk") from error


def _examine(folder: Path) -> Examination:
    if not folder.exists():
        raise MissingPathError(f"{folder}: no such folder")
    if not is_session(folder):
        raise DataError(f"{folder}: is not a session: it has no {MANIFEST}")
    found: list[str | Notice] = [*_links(folder)]
    manifest, toml_sha256 = _manifest(folder, found)
    data, mark = _journal_and_mark(folder)
    journal, complete = parse_journal(data or b""), mark is not None
    found += _check_journal(folder, journal, toml_sha256)
    found += _check_mark(folder, mark, data, journal)
    if manifest is None:
        return Examination(None, journal, frozenset(), toml_sha256, _problems(found), {})
    found += clock_steps(folder, manifest, journal)
    planned = () if manifest.plan is None else manifest.plan.shots()
    recorded = recorded_frames(folder, manifest, planned, journal)
    found += recorded.problems
    counted = recorded.counted()
    found += _unmatched_lights(folder, manifest, counted.values())
    events = tuple(line for line in journal.lines if isinstance(line, EventLine))
    # Older versions do not check the details of this event.
    if recorded.version >= 5 and not recorded.problems:
        found += comparison_notices(folder, events)
    dead = _dead_leds(events, manifest)
    absent = [shot for shot in planned if shot.key not in counted]
    missing = tuple(shot for shot in absent if shot.led not in dead)
    if complete and missing and journal.damage is None:
        found.append(
            f"{folder / COMPLETE}: exists although "
            f"{pluralize(len(missing), 'planned frame is', 'planned frames are')} missing, "
            f"first {missing[0].file}"
        )
    if not complete and journal.lines and journal.damage is None:
        found += _unrecorded_hint(folder, recorded.names)
    session = Session(
        folder=folder,
        manifest=manifest,
        format_version=recorded.version,
        recorded=tuple(recorded.frames.values()),
        set_aside=tuple(recorded.set_aside.values()),
        frames=tuple(counted.values()),
        events=events,
        complete=complete,
        missing=missing,
        left_out=tuple(shot for shot in absent if shot.led in dead),
        warnings=tuple(one for one in found if isinstance(one, Notice)),
    )
    names = frozenset(recorded.names)
    return Examination(session, journal, names, toml_sha256, _problems(found), recorded.flaws)


def _problems(found: Iterable[str | Notice]) -> tuple[str, ...]:
    return tuple(one for one in found if isinstance(one, str))


def _dead_leds(events: Iterable[EventLine], manifest: Manifest) -> frozenset[int]:
    """Return the LEDs whose missing shots are not required."""
    # Version 1 does not have the event left_out.
    lines = events if manifest.format_version > 1 else ()
    return frozenset[int]().union(*(line.left_out for line in lines))


def _unmatched_lights(
    folder: Path, manifest: Manifest, frames: Iterable[SessionFrame]
) -> Iterator[str]:
    """Report stored lights that are not those of the frames: no reader could use them."""
    ids = dict.fromkeys(frame.light_id for frame in frames if frame.role == "light")
    if manifest.lights is None or not ids:
        return
    try:
        manifest.lights.value().match(tuple(ids))
    except DataError as error:
        yield f"{folder / MANIFEST}: lights: {error}"


def _links(folder: Path) -> Iterator[str]:
    """Report files of the session that are links to other folders."""
    for path in (folder / name for name in (MANIFEST, JOURNAL, COMPLETE, FRAMES)):
        if path.is_symlink() and leaves(path, folder):
            yield f"{path}: is a link that leaves the session; replace the link by its target"


def _unrecorded_hint(folder: Path, recorded: set[str]) -> Iterator[Notice]:
    """Report files without a line, which may be suspiciously many."""
    files = [path.name for path in _names(folder / FRAMES) if path.name not in recorded]
    if not files:
        return
    many = len(files) > WRITERS
    explained = "written when the recording was interrupted; files without a line do not count"
    lost = (
        f"an interruption leaves {WRITERS} at most, so the journal may have lost its last lines: "
        f"restore {JOURNAL} and {COMPLETE} from a copy before you continue; files without a line "
        "do not count"
    )
    text = (
        f"{pluralize(len(files), 'file')} without a line in the journal, first {files[0]}: "
        f"{lost if many else explained}"
    )
    if many:
        yield Notice("journal-lines-lost", text, str(folder / FRAMES))
    else:
        yield Notice("frames-without-line", text, str(folder / FRAMES), "info")


def _bytes(path: Path, most_bytes: int) -> bytes | None:
    """Return the bytes of a file, None if it does not exist."""
    try:
        return read_bounded(path, most_bytes)
    except FileNotFoundError:
        return None
    except UnreadableError as error:
        raise DataError(f"{path}: {error}") from error


def _journal_and_mark(folder: Path) -> tuple[bytes | None, bytes | None]:
    """Return journal and COMPLETE in a consistent state, even while another process writes."""
    data = _bytes(folder / JOURNAL, _MAX_JOURNAL_BYTES)
    while True:
        mark = _bytes(folder / COMPLETE, MAX_TEXT_BYTES)
        again = _bytes(folder / JOURNAL, _MAX_JOURNAL_BYTES)
        if again == data:
            return data, mark
        data = again


def _manifest(folder: Path, problems: list[str | Notice]) -> tuple[Manifest | None, str]:
    path = folder / MANIFEST
    data = _bytes(path, MAX_TOML_BYTES)
    if data is None:
        problems.append(f"{path}: is missing; restore it")
        return None, ""
    try:
        return parse_manifest(data, path), sha256_of(data)
    except DataError as error:
        problems.append(str(error))
        return None, sha256_of(data)


def _check_journal(folder: Path, journal: Journal, toml_sha256: str) -> Iterator[str | Notice]:
    path = folder / JOURNAL
    if journal.damage is not None:
        yield f"{path}: {journal.damage}; restore the file, its frames may be intact"
    if journal.torn:
        text = (
            f"writing the last line was interrupted ({len(journal.torn)} bytes); it does not count"
        )
        yield Notice("journal-line-torn", text, str(path))
    if journal.unterminated:
        text = "the last line lacks its newline but is intact; it counts"
        yield Notice("journal-line-unterminated", text, str(path))
    if journal.lines:
        start = journal.lines[0]
        if isinstance(start, StartLine) and toml_sha256 != start.session_toml_sha256:
            path = folder / MANIFEST
            yield f"{path}: differs from the one that the journal belongs to; restore it"
    elif journal.damage is None:
        # The process was killed between the first two writes: nothing was recorded yet.
        if (folder / COMPLETE).exists() or any(_names(folder / FRAMES)):
            yield f"{path}: is missing or empty although frames exist; restore it"
        else:
            text = "the recording ended before its first line"
            yield Notice("journal-empty", text, str(path))


def _check_mark(
    folder: Path, mark: bytes | None, data: bytes | None, journal: Journal
) -> Iterator[str | Notice]:
    path = folder / COMPLETE
    if mark is None:
        if (folder / ASIDE).is_file():
            text = "a compaction was interrupted: compact the session again"
            yield Notice("compaction-interrupted", text, str(folder))
    elif mark != completion_mark(data or b""):
        yield f"{path}: does not match {JOURNAL}; one of the two was changed, restore it"
    elif journal.torn or journal.unterminated:
        yield f"{folder / JOURNAL}: ends in an incomplete line although the session is complete"


def _names(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder, if it exists, except those of unfinished writes."""
    if folder.is_dir():
        yield from sorted(path for path in folder.iterdir() if not is_hidden(path))
