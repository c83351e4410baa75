"""Sessions on disk, written: nothing journalled is lost, nothing half-written counts."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._pixels.quality import FrameQuality, measure_quality
from acquisition._plan.plan import PlannedShot, ShotKey
from acquisition._session.frame_file import store_frame
from acquisition._session.journal import Echo, EventLine, FrameLine
from acquisition._session.journal_file import AnyLine, Clock, JournalFile
from acquisition._session.manifest import Manifest
from acquisition._session.recovery import set_aside
from acquisition._session.session import (
    COMPLETE,
    FRAMES,
    JOURNAL,
    MANIFEST,
    completion_mark,
    examine,
)
from acquisition._software import software_version
from acquisition._storage import (
    disk,
    lock_folder,
    make_folder,
    part_path,
    sha256_of,
    write_durably,
)
from acquisition._toml import to_toml


def _now() -> datetime:
    return datetime.now(UTC)


class SessionWriter:
    """The one writer of a session: `create` a new one or `reopen` one that was interrupted.

    A frame goes to a temporary file, is flushed, gets its name, and only then its line in the
    journal, flushed too. So a crash at any moment leaves every frame that has a line, and at most
    one file without a line and one line cut short. A context manager; leaving it closes.

    Several threads may write at once: frames go to the disk side by side, lines one by one. If
    one of them is still writing when another closes, what it has begun ends by itself, adds no line
    any more, and only then is the session free for others.
    """

    def __init__(self, folder: Path, manifest: Manifest, journal: JournalFile, lock: int) -> None:
        self.folder = folder
        self.manifest = manifest
        self._journal = journal
        self._lock: int | None = lock
        # Held while a line is written; the other one only while these are looked at or changed.
        self._order = threading.Lock()
        self._state = threading.Lock()
        self._busy = 0
        self._closed = False
        self._sound = True
        shots = () if manifest.plan is None else manifest.plan.shots()
        self._planned = {shot.key for shot in shots}
        self._missing: dict[ShotKey, PlannedShot] = {shot.key: shot for shot in shots}
        self._demanded = len(self._missing)
        self._names: set[str] = set()

    @classmethod
    def create(cls, folder: str | Path, manifest: Manifest, *, clock: Clock = _now) -> Self:
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
            If a text of the manifest is none.
        StorageError
            If the folder holds anything, another process records into it, or the disk refuses.
        """
        folder = Path(folder)
        data = to_toml(manifest)
        make_folder(folder)
        lock = lock_folder(folder)
        try:
            with disk(folder, "list the folder"):
                found = sorted(path.name for path in folder.iterdir())
            # The rest of a creation that was killed is no content.
            if set(found) - {part_path(Path(MANIFEST)).name}:
                raise StorageError(
                    f"{folder}: is not empty (it holds {found[-1]}); choose a new folder"
                )
            write_durably(folder / MANIFEST, data)
            make_folder(folder / FRAMES)
            journal = JournalFile.begin(folder / JOURNAL, sha256_of(data), clock)
        except BaseException:
            os.close(lock)
            raise
        return cls(folder, manifest, journal, lock)

    @classmethod
    def reopen(cls, folder: str | Path, *, clock: Clock = _now) -> Self:
        """Go on with a session that was interrupted, and take it for this process alone.

        Recovery loses nothing that was whole: a torn last line is moved into a ``reopened`` event,
        files written but not recorded move to ``derived/unrecorded/``, and rests of unfinished
        writes are deleted.

        Raises
        ------
        MissingPathError
            If the folder does not exist.
        DataError
            If it is no session, is damaged, is complete already, or is of another format version.
        StorageError
            If another process records into it, or the disk refuses.
        """
        folder = Path(folder)
        if not folder.exists():
            raise MissingPathError(f"{folder}: no such folder")
        if not folder.is_dir():
            raise DataError(f"{folder}: is not a session: it is a file")
        lock = lock_folder(folder)
        try:
            found = examine(folder)
            session = found.session
            if session is None or found.problems:
                raise DataError(found.problems[0])
            if session.complete:
                raise DataError(f"{folder}: is complete; record into a new folder")
            session.manifest.check_current(folder)
            aside = set_aside(folder, {frame.path.name for frame in session.recorded})
            path = folder / JOURNAL
            if found.journal.lines:
                details = {"software_version": software_version(), "unrecorded": aside}
                journal = JournalFile.resume(path, found.journal, clock, details)
            else:
                journal = JournalFile.begin(path, found.toml_sha256, clock)
        except BaseException:
            os.close(lock)
            raise
        writer = cls(folder, session.manifest, journal, lock)
        writer._missing = {shot.key: shot for shot in session.missing}
        writer._demanded -= len(session.left_out)
        writer._names = {Path(frame.line.file).name for frame in session.recorded}
        return writer

    @property
    def missing(self) -> tuple[PlannedShot, ...]:
        """Planned shots that are demanded and not recorded yet, in plan order."""
        with self._state:
            return tuple(self._missing.values())

    @property
    def demanded(self) -> int:
        """How many shots there must be in the end: all of the plan, less those left out."""
        with self._state:
            return self._demanded

    def measure(self, shot: PlannedShot, pixels: npt.NDArray[np.uint16]) -> FrameQuality:
        """Measure a frame, and check that it is one of this session.

        Raises
        ------
        DataError
            If the pixels are not what the manifest states, or the shot is not in the plan.
        """
        if self.manifest.plan is not None and shot.key not in self._planned:
            raise DataError(f"{self.folder}: {shot.file} is not in the plan of this session")
        camera = self.manifest.camera
        if pixels.dtype != np.uint16 or pixels.shape != camera.shape:
            raise DataError(
                f"{self.folder}: {shot.file} has {pixels.dtype} pixels of shape {pixels.shape}; "
                f"this session holds uint16 of {camera.shape}"
            )
        quality = measure_quality(
            pixels, white_level_dn=camera.white_dn, black_level_dn=camera.black_level_dn
        )
        if quality.percentiles_dn["100"] >= 2**camera.bit_depth:
            raise DataError(
                f"{self.folder}: {shot.file} has a value of {quality.percentiles_dn['100']}, more "
                f"than {camera.bit_depth} bits hold; set the camera to deliver low-aligned samples"
            )
        return quality

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
            If the pixels are not what the manifest states, or the shot is not in the plan.
        StorageError
            If the disk refuses. What was recorded before stays whole.
        """
        quality = quality or self.measure(shot, pixels)
        values = {
            "role": shot.role,
            "led": shot.led,
            "bracket": shot.bracket,
            "repeat": shot.repeat,
            "exposure_us": shot.exposure_us if exposure_us is None else exposure_us,
            "gain_db": gain_db,
            "frame_id": frame_id,
            "timestamp_ns": timestamp_ns,
            "temperature_c": temperature_c,
            "echo": echo,
            "clipped_fraction": quality.clipped_fraction,
            "percentiles_dn": quality.percentiles_dn,
            "sharpness": quality.sharpness,
            "mean_dn": quality.mean_dn,
            "above_dark": above_dark,
            "status": status,
            "origin": origin,
        }
        with self._used(), self._name_for(shot) as path:
            stored = store_frame(path, pixels)
            values |= {"file": f"{FRAMES}/{path.name}", **asdict(stored)}
            before_line()
            return self._append(FrameLine, values)

    def write_event(self, event: str, **details: Any) -> EventLine:
        """Store an event, a name of lower-case words with ``_``, with details JSON can hold.

        After ``left_out`` the shots of its ``leds`` that are missing are not demanded any more.

        Raises
        ------
        DataError
            If name or details do not fit the journal.
        StorageError
            If the disk refuses.
        """
        with self._used():
            return self._append(EventLine, {"event": event, "details": details})

    def complete(self) -> None:
        """Declare the recording brought to its end, and close.

        Raises
        ------
        DataError
            If planned shots are missing.
        StorageError
            If the disk refuses, or another program changed the journal.
        """
        missing = self.missing
        if missing:
            raise DataError(
                f"{self.folder}: {len(missing)} planned frames are missing, first "
                f"{missing[0].file}; take them before completing"
            )
        with self._used(), self._order:
            write_durably(self.folder / COMPLETE, completion_mark(self._journal.read_back()))
        self.close()

    def close(self) -> None:
        """Let go of the session, complete or not; harmless when repeated. Waits for nobody."""
        with self._state:
            self._closed = True
            if not self._busy:
                self._release()

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
        """Keep the session's files open meanwhile."""
        with self._state:
            self._check_open()
            if not self._sound:
                raise StorageError(
                    f"{self.folder}: an earlier line was cut short; reopen the session"
                )
            self._busy += 1
        try:
            yield
        finally:
            with self._state:
                self._busy -= 1
                if self._closed and not self._busy:
                    self._release()

    def _check_open(self) -> None:
        if self._closed:
            raise StorageError(f"{self.folder}: is closed; reopen the session to go on")

    def _release(self) -> None:
        self._journal.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _append(self, kind: type[AnyLine], values: Mapping[str, Any]) -> AnyLine:
        with self._order:
            self._check_open()
            try:
                line = self._journal.append(kind, values)
            finally:
                self._sound = self._journal.sound
        if isinstance(line, FrameLine) and line.status == "ok":
            with self._state:
                self._missing.pop(line.key, None)
        elif isinstance(line, EventLine) and (dead := line.left_out):
            with self._state:
                for shot in [s for s in self._missing.values() if s.lit_led in dead]:
                    del self._missing[shot.key]
                    self._demanded -= 1
        return line

    @contextmanager
    def _name_for(self, shot: PlannedShot) -> Iterator[Path]:
        """Reserve the file for the next take; numbers of planned repeats are kept for them."""
        plan = self.manifest.plan
        number, retake = shot.repeat, 1 if plan is None else max(plan.repeats, plan.flats)
        with self._state:
            while True:
                path = self.folder / FRAMES / shot.take_file(number)
                if path.name not in self._names and not path.exists():
                    break
                number, retake = retake, retake + 1
            self._names.add(path.name)
        try:
            yield path
        except BaseException:
            # The file may be there by now, without a line; then it keeps its name.
            with self._state:
                self._names.discard(path.name)
            raise
