"""Writing of sessions: recorded frames are never lost, unfinished writes never count."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Self

from acquisition._errors import DataError, StorageError
from acquisition.files.storage import write_durably
from acquisition.pixels.frame_quality import FrameQuality
from acquisition.plan.planned_shot import PlannedShot
from acquisition.session.event_details import check_event
from acquisition.session.files_aside import clear_frames
from acquisition.session.frame_check import measure_frame
from acquisition.session.frame_file import FrameNames, store_frame
from acquisition.session.journal import Echo, EventLine, FrameLine
from acquisition.session.journal_file import AnyLine, Clock, utc_now
from acquisition.session.layout import COMPLETE, FRAMES, completion_mark
from acquisition.session.light_proof import BOARD, wrong_light
from acquisition.session.manifest import Manifest
from acquisition.session.open_shots import OpenShots
from acquisition.session.opening import OpenSession, begin, take_up
from acquisition.session.session import examine
from acquisition.session.session_frame import SessionFrame
from acquisition.session.shared_files import SharedUse
from rig import Progress, no_progress, pluralize
from rig.arrays import UInt16
from rig.host import filesystem, threads


@dataclass(frozen=True)
class CameraReport:
    """What a camera reported with a frame; None if unknown.

    Parameters
    ----------
    exposure_us
        Exposure time, microseconds; if None, the planned one is recorded.
    gain_db
        Gain, dB.
    frame_id
        Number that the camera gave the frame.
    timestamp_ns
        Time of the frame on the camera's clock, nanoseconds.
    temperature_c
        Temperature of the camera, degrees Celsius.
    """

    exposure_us: float | None = None
    gain_db: float | None = None
    frame_id: int | None = None
    timestamp_ns: int | None = None
    temperature_c: float | None = None


class SessionWriter:
    """The only writer of a session: `create` a new one or `reopen` an interrupted one.

    A frame is written to a temporary file, flushed and renamed; only then its journal line is
    written and flushed. A crash at any moment therefore leaves every frame that has a line, at most
    one file without a line per writing thread, and at most one torn line. As a context manager, it
    closes the session at the end.

    Several threads may write at the same time: frames are written in parallel, lines one by one. If
    one thread closes the session while another is still writing, that write finishes without adding
    a line, and only then the lock is released.

    Attributes
    ----------
    shots
        The shots of the plan that are still to be taken.
    proofs
        The checks of all frames, which `complete` requires.
    """

    def __init__(self, opened: OpenSession) -> None:
        self.folder, self.manifest, session = opened.folder, opened.manifest, opened.session
        self.set_aside_events = opened.set_aside_events
        self._journal, self._lock, self.proofs = opened.journal, opened.lock, opened.proofs
        self._use = SharedUse(self.folder, self._release)
        self._order = threads.Lock()  # held while a line is written
        self._sound = True
        self.shots = OpenShots(self.manifest.plan, session)
        self._version: int = self.manifest.format_version
        frames: list[SessionFrame] = []
        if session is not None:
            self._version = session.format_version
            frames = [*session.recorded, *(one.frame for one in session.set_aside)]
        names = (Path(frame.line.file).name for frame in frames)
        self._names = FrameNames(self.folder / FRAMES, self.manifest.plan, names)

    @classmethod
    def create(cls, folder: str | Path, manifest: Manifest, *, clock: Clock = utc_now) -> Self:
        """Create a session in a new or empty folder and lock it for this process alone.

        Parameters
        ----------
        folder
            Created with its parents if it does not exist.
        manifest
            Content of ``session.toml``.
        clock
            Returns the time of each line.

        Raises
        ------
        DataError
            If a text of the manifest or the name of the folder cannot be encoded in UTF-8.
        StorageError
            If the folder is not empty or is inside a session, another process records into it, or
            the disk refuses.
        """
        return cls(begin(Path(folder), manifest, clock))

    @classmethod
    def reopen(
        cls,
        folder: str | Path,
        *,
        set_aside_damaged: bool = False,
        on_progress: Progress = no_progress,
    ) -> Self:
        """Reopen an interrupted session and lock it for this process alone.

        Recovery loses nothing that was intact: a torn last line is moved into a ``reopened`` event,
        files without a line move to ``derived/unrecorded/``, and files of unfinished writes are
        deleted.

        Parameters
        ----------
        folder
            The session.
        set_aside_damaged
            Read back every recorded frame first. Damaged or lost ones are set aside: their files
            move to ``derived/set_aside/``, they no longer count, and their shots are missing again.
            A complete session with such a frame is reopened; one of version 2 is upgraded.
        on_progress
            Receives the stage ``checking recorded frames``, one step per frame.

        Raises
        ------
        MissingPathError
            If the folder does not exist.
        DataError
            If it is not a session, is damaged, is already complete, or has another format version.
        StorageError
            If another process records into it, or the disk refuses.
        """
        folder = Path(folder)
        return cls(take_up(folder, set_aside_damaged=set_aside_damaged, on_progress=on_progress))

    @property
    def missing(self) -> tuple[PlannedShot, ...]:
        """Planned shots that are required and not recorded yet, in plan order."""
        return self.shots.missing

    def measure(self, shot: PlannedShot, pixels: UInt16) -> FrameQuality:
        """Measure a frame, and check that it belongs to this session.

        Raises
        ------
        DataError
            If the pixels do not agree with the manifest, or the shot is not in the plan.
        """
        self.shots.planned(shot, self.folder)
        return measure_frame(pixels, self.manifest.camera, self.folder, shot.file)

    def write_frame(
        self,
        shot: PlannedShot,
        pixels: UInt16,
        *,
        report: CameraReport = CameraReport(),
        echo: Echo | None = None,
        status: Literal["ok", "rejected"] = "ok",
        origin: str | None = None,
        quality: FrameQuality | None = None,
        above_dark: float | None = None,
        before_line: Callable[[], None] = lambda: None,
    ) -> FrameLine:
        """Store a frame and its line; when this returns, both are safe on disk.

        A second frame of the same shot is a retake: it gets a new file, and the last one counts.

        Parameters
        ----------
        shot
            The planned shot.
        pixels
            ``(H, W)`` or ``(H, W, 3)`` uint16 as described in the manifest, raw values in the low
            bits.
        report
            What the camera reported with the frame.
        echo
            Reply of the LED board.
        status
            A frame with status ``rejected`` is kept but does not count.
        origin
            Name of the source file of an imported frame.
        quality
            Result of `measure` for these pixels; by default it is measured here.
        above_dark
            Difference of a lit frame from the dark frame, if known; see `FrameLine`.
        before_line
            Called after the file and before the line is written, so that a caller that writes
            several frames at once can put their lines in order.

        Raises
        ------
        DataError
            If the pixels do not agree with the manifest, the shot is not in the plan, or the board
            turned on another LED than the planned one, or sent no echo although the session has
            ``echoes``.
        StorageError
            If the disk refuses. Frames recorded before stay intact.
        """
        planned = self.shots.planned(shot, self.folder)
        lit = {} if echo is None else {BOARD: echo.led}
        conflict = wrong_light(planned, lit, echoes=bool(self.manifest.echoes))
        if conflict is not None:
            raise DataError(f"{self.folder}: {shot.file} {conflict}; it was not recorded")
        quality = quality or self.measure(shot, pixels)
        exposure_us = shot.exposure_us if report.exposure_us is None else report.exposure_us
        values = {
            "role": shot.role,
            "led": shot.key[1],  # the LED of a flat is in its echo
            "bracket": shot.bracket,
            "repeat": shot.repeat,
            "exposure_us": _number(exposure_us),
            "gain_db": _number(report.gain_db),
            "frame_id": report.frame_id,
            "timestamp_ns": report.timestamp_ns,
            "temperature_c": _number(report.temperature_c),
            "echo": echo,
            **asdict(quality),
            "above_dark": _number(above_dark),
            "status": status,
            "origin": origin,
        }
        with self._used(), self._names.reserve(shot) as path:
            stored = store_frame(path, pixels)
            values |= {"file": f"{FRAMES}/{path.name}", **asdict(stored)}
            before_line()
            line = self._append(FrameLine, values)
            self.proofs.written(SessionFrame.recorded(path, line, self.manifest.camera.shape))
            return line

    def write_event(self, event: str, **details: Any) -> EventLine:
        """Store an event. Its name has lower-case words joined by ``_``; details must fit JSON.

        After ``left_out``, the missing shots of its ``leds`` are no longer required.

        Raises
        ------
        DataError
            If name or details are invalid, or the event is one that only a repair, a compaction or
            `reopen` may write.
        StorageError
            If the disk refuses.
        """
        with self._used():
            check_event(event, details, self._version, self.folder)
            return self._append(EventLine, {"event": event, "details": details})

    def complete(self) -> None:
        """Mark the recording as complete, and close the session.

        Frames of earlier processes that `check_next` has not read back are read now; see
        `FrameProofs` for those that this process wrote. Files of failed writes, which have no line,
        move to ``derived/unrecorded/``.

        Raises
        ------
        DataError
            If planned shots are missing, or a recorded frame is lost or damaged.
        StorageError
            If the disk refuses, or another program changed the journal.
        """
        missing = self.missing
        if missing:
            raise DataError(
                f"{self.folder}: "
                f"{pluralize(len(missing), 'planned frame is', 'planned frames are')} missing, "
                f"first {missing[0].file}; take them before completing"
            )
        with self._used():
            self.proofs.check_all()
            self.proofs.check_undamaged()
        with self._used(), self._order:
            mark = completion_mark(self._journal.read_back())
            session = examine(self.folder).sound()
            clear_frames(session)
            write_durably(self.folder / COMPLETE, mark)
            self.close()  # before another thread can append a line

    def close(self) -> None:
        """Close the session, complete or not; harmless if repeated. Does not wait for writers."""
        self._use.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _used(self) -> Iterator[None]:
        """Keep the session's files open inside the block; refuse if no line can be appended."""
        with self._use.held():
            if not self._sound:
                raise StorageError(
                    f"{self.folder}: writing an earlier line was interrupted; reopen the session"
                )
            yield

    def _release(self) -> None:
        self._journal.close()
        filesystem.close(self._lock)

    def _append(self, kind: type[AnyLine], values: Mapping[str, Any]) -> AnyLine:
        with self._order:
            self._use.check_open()
            try:
                line = self._journal.append(kind, values)
            finally:
                self._sound = self._journal.sound
        self.shots.note(line)
        return line


def _number(value: float | None) -> float | None:
    """Return a plain float: cameras and arrays may deliver other number types."""
    return None if value is None else float(value)
