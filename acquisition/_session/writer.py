"""Sessions on disk, written: nothing journalled is lost, nothing half-written counts."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError, StorageError
from acquisition._pixels.quality import FrameQuality
from acquisition._plan.planned_shot import PlannedShot
from acquisition._session.creation import begin
from acquisition._session.damage import Damage
from acquisition._session.event_details import check_event
from acquisition._session.frame_check import measure_frame
from acquisition._session.frame_names import FrameNames
from acquisition._session.frame_proofs import FrameProofs
from acquisition._session.journal import Echo, EventLine, FrameLine
from acquisition._session.journal_file import AnyLine, Clock, JournalFile, utc_now
from acquisition._session.layout import COMPLETE, FRAMES, completion_mark
from acquisition._session.light_proof import BOARD, wrong_light
from acquisition._session.manifest import Manifest
from acquisition._session.open_shots import OpenShots
from acquisition._session.recovery import take_up
from acquisition._session.session import Session, examine
from acquisition._session.session_frame import SessionFrame
from acquisition._session.shared_use import SharedUse
from acquisition._session.stored_frame import store_frame
from acquisition._storage import write_durably
from rig import Progress, no_progress


class SessionWriter:
    """The one writer of a session: `create` a new one or `reopen` one that was interrupted.

    A frame goes to a temporary file, is flushed, gets its name, and only then its line in the
    journal, flushed too. So a crash at any moment leaves every frame that has a line, and at most
    one file without a line and one line cut short. A context manager; leaving it closes.

    Several threads may write at once: frames go to the disk side by side, lines one by one. If
    one of them is still writing when another closes, what it has begun ends by itself, adds no line
    any more, and only then is the session free for others.
    """

    def __init__(
        self,
        folder: Path,
        manifest: Manifest,
        journal: JournalFile,
        lock: int,
        begun: Session | None = None,
        proofs: FrameProofs | None = None,
        set_aside_events: tuple[EventLine, ...] = (),
    ) -> None:
        self.folder = folder
        self.manifest = manifest
        self.set_aside_events = set_aside_events
        self._journal = journal
        self._lock = lock
        self._use = SharedUse(folder, self._release)
        self._order = threading.Lock()  # held while a line is written
        self._sound = True
        self._shots = OpenShots(manifest.plan, begun)
        self._version = manifest.format_version if begun is None else begun.format_version
        self._proofs = proofs or FrameProofs(manifest.camera)
        recorded = () if begun is None else begun.recorded
        aside = () if begun is None else begun.set_aside
        frames = (*recorded, *(one.frame for one in aside))
        names = (Path(frame.line.file).name for frame in frames)
        self._names = FrameNames(folder / FRAMES, manifest.plan, names)

    @classmethod
    def create(cls, folder: str | Path, manifest: Manifest, *, clock: Clock = utc_now) -> Self:
        """Begin a session in a new or empty folder and take it for this process alone.

        Parameters
        ----------
        folder
            Created with its parents where it does not exist.
        manifest
            What ``session.toml`` is to hold.
        clock
            Gives the time of each line.

        Raises
        ------
        DataError
            If a text of the manifest is none, or the name of the folder.
        StorageError
            If the folder holds anything, another process records into it, or the disk refuses.
        """
        journal, lock = begin(Path(folder), manifest, clock)
        return cls(Path(folder), manifest, journal, lock)

    @classmethod
    def reopen(
        cls,
        folder: str | Path,
        *,
        set_aside_damaged: bool = False,
        on_progress: Progress = no_progress,
    ) -> Self:
        """Go on with a session that was interrupted, and take it for this process alone.

        Recovery loses nothing that was whole: a torn last line is moved into a ``reopened`` event,
        files written but not recorded move to ``derived/unrecorded/``, and rests of unfinished
        writes are deleted.

        Parameters
        ----------
        folder
            The session.
        set_aside_damaged
            Read every recorded frame back first. Those that are damaged or lost are set aside:
            their files move to ``derived/set_aside/``, they count no more, and their shots are
            missing again. A complete session with such a frame is reopened; one of version 2 is
            upgraded.
        on_progress
            Receives the stage ``checking recorded frames``, one step per frame.

        Raises
        ------
        MissingPathError
            If the folder does not exist.
        DataError
            If it is no session, is damaged, is complete already, or is of another format version.
        StorageError
            If another process records into it, or the disk refuses.
        """
        found = take_up(Path(folder), set_aside_damaged=set_aside_damaged, on_progress=on_progress)
        session = found.session
        return cls(
            session.folder,
            session.manifest,
            found.journal,
            found.lock,
            session,
            found.proofs,
            found.events,
        )

    @property
    def missing(self) -> tuple[PlannedShot, ...]:
        """Planned shots that are demanded and not recorded yet, in plan order."""
        return self._shots.missing

    @property
    def demanded(self) -> int:
        """How many shots there must be in the end: all of the plan, less those left out."""
        return self._shots.demanded

    @property
    def checked(self) -> tuple[int, int]:
        """How many frames of earlier processes were read back, and how many there are."""
        return self._proofs.checked

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What was found damaged when it was read back, in order of recording."""
        return self._proofs.damage

    def check_next(self) -> bool:
        """Read one frame of an earlier process back, for `complete`; False where none is left.

        May be called from any thread, while frames are written too.
        """
        return self._proofs.check_next()

    def check_undamaged(self) -> None:
        """Raise DataError where a frame that was read back is damaged."""
        if damage := self.damage:
            more = f"; {len(damage)} frames are damaged" if len(damage) > 1 else ""
            raise DataError(f"{damage[0].text}{more}")

    def measure(self, shot: PlannedShot, pixels: npt.NDArray[np.uint16]) -> FrameQuality:
        """Measure a frame, and check that it is one of this session.

        Raises
        ------
        DataError
            If the pixels are not what the manifest states, or the shot is not in the plan.
        """
        self._shots.planned(shot, self.folder)
        return measure_frame(pixels, self.manifest.camera, self.folder, shot.file)

    def write_frame(
        self,
        shot: PlannedShot,
        pixels: npt.NDArray[np.uint16],
        *,
        exposure_us: float | None = None,
        gain_db: float | None = None,
        frame_id: int | None = None,
        timestamp_ns: int | None = None,
        temperature_c: float | None = None,
        echo: Echo | None = None,
        status: Literal["ok", "rejected"] = "ok",
        origin: str | None = None,
        quality: FrameQuality | None = None,
        above_dark: float | None = None,
        before_line: Callable[[], None] = lambda: None,
    ) -> FrameLine:
        """Store a frame and its line; on return both are safe on disk.

        A second frame of the same shot is a retake: it gets a new file, and the last one counts.

        Parameters
        ----------
        shot
            What was planned.
        pixels
            ``(H, W)`` or ``(H, W, 3)`` uint16 as the manifest states, raw values in the low bits.
        exposure_us
            Exposure the camera reported; default the planned one.
        gain_db, frame_id, timestamp_ns, temperature_c
            What the camera reported; None where not known.
        echo
            What the LED board answered.
        status
            ``rejected`` keeps the frame without counting it.
        origin
            Name of the file an imported frame came from.
        quality
            What `measure` gave for these pixels; it is called otherwise.
        above_dark
            How far a lit frame is above the dark one, where that is known; see `FrameLine`.
        before_line
            Called when the file is there and the line is not: who writes several frames at once
            can put their lines in order.

        Raises
        ------
        DataError
            If the pixels are not what the manifest states, the shot is not in the plan, or the
            board turned another LED on than the planned one.
        StorageError
            If the disk refuses. What was recorded before stays whole.
        """
        planned = self._shots.planned(shot, self.folder)
        conflict = wrong_light(planned, {} if echo is None else {BOARD: echo.led})
        if conflict is not None:
            raise DataError(f"{self.folder}: {shot.file} {conflict}; it was not recorded")
        quality = quality or self.measure(shot, pixels)
        values = {
            "role": shot.role,
            "led": shot.led,
            "bracket": shot.bracket,
            "repeat": shot.repeat,
            "exposure_us": _number(shot.exposure_us if exposure_us is None else exposure_us),
            "gain_db": _number(gain_db),
            "frame_id": frame_id,
            "timestamp_ns": timestamp_ns,
            "temperature_c": _number(temperature_c),
            "echo": echo,
            "clipped_fraction": quality.clipped_fraction,
            "percentiles_dn": quality.percentiles_dn,
            "sharpness": quality.sharpness,
            "mean_dn": quality.mean_dn,
            "above_dark": _number(above_dark),
            "status": status,
            "origin": origin,
        }
        with self._used(), self._names.reserve(shot) as path:
            stored = store_frame(path, pixels)
            values |= {"file": f"{FRAMES}/{path.name}", **asdict(stored)}
            before_line()
            line = self._append(FrameLine, values)
            camera = self.manifest.camera
            self._proofs.written(
                SessionFrame(path, line, line.bytes, line.file_sha256, camera.shape)
            )
            return line

    def write_event(self, event: str, **details: Any) -> EventLine:
        """Store an event, a name of lower-case words with ``_``, with details JSON can hold.

        After ``left_out`` the shots of its ``leds`` that are missing are not demanded any more.

        Raises
        ------
        DataError
            If name or details do not fit the journal, or the event is one that only a repair, a
            compaction or `reopen` may write.
        StorageError
            If the disk refuses.
        """
        with self._used():
            check_event(event, details, self._version, self.folder)
            return self._append(EventLine, {"event": event, "details": details})

    def complete(self) -> None:
        """Declare the recording brought to its end, and close.

        Frames of earlier processes that `check_next` has not read back are read now; see
        `FrameProofs` for those that this process wrote.

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
                f"{self.folder}: {len(missing)} planned frames are missing, first "
                f"{missing[0].file}; take them before completing"
            )
        with self._used():
            self._proofs.check_all()
            self.check_undamaged()
        with self._used(), self._order:
            mark = completion_mark(self._journal.read_back())
            examine(self.folder).sound()
            write_durably(self.folder / COMPLETE, mark)
        self.close()

    def close(self) -> None:
        """Let go of the session, complete or not; harmless when repeated. Waits for nobody."""
        self._use.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @contextmanager
    def _used(self) -> Iterator[None]:
        """Keep the session's files open meanwhile, and refuse where no line could follow."""
        with self._use.held():
            if not self._sound:
                raise StorageError(
                    f"{self.folder}: an earlier line was cut short; reopen the session"
                )
            yield

    def _release(self) -> None:
        self._journal.close()
        os.close(self._lock)

    def _append(self, kind: type[AnyLine], values: Mapping[str, Any]) -> AnyLine:
        with self._order:
            self._use.check_open()
            try:
                line = self._journal.append(kind, values)
            finally:
                self._sound = self._journal.sound
        self._shots.note(line)
        return line


def _number(value: float | None) -> float | None:
    """Return a plain number: what cameras and arrays give may be of other kinds."""
    return None if value is None else float(value)
