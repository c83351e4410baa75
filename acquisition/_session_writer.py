"""Sessions on disk, written: nothing journalled is lost, nothing half-written counts."""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._images import write_tiff
from acquisition._journal import Echo, EventLine, FrameLine
from acquisition._journal_file import Clock, JournalFile
from acquisition._manifest import Manifest
from acquisition._plan import PlannedShot, ShotKey
from acquisition._quality import measure_quality
from acquisition._session import (
    COMPLETE,
    DERIVED,
    FRAMES,
    JOURNAL,
    MANIFEST,
    completion_mark,
    examine,
    leaves,
)
from acquisition._session_frame import pixels_sha256
from acquisition._software import software_version
from acquisition._storage import (
    disk,
    is_part,
    lock_folder,
    make_folder,
    part_path,
    publish,
    sha256_of,
    sync_folder,
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

    Not for several threads at once.
    """

    def __init__(self, folder: Path, manifest: Manifest, journal: JournalFile, lock: int) -> None:
        self.folder = folder
        self.manifest = manifest
        self._journal = journal
        self._lock: int | None = lock
        shots = () if manifest.plan is None else manifest.plan.shots()
        self._planned = {shot.key for shot in shots}
        self._missing: dict[ShotKey, PlannedShot] = {shot.key: shot for shot in shots}
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
            If it is no session, is damaged, or is complete already.
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
            aside = _set_aside(folder, {frame.path.name for frame in session.recorded})
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
        writer._names = {Path(frame.line.file).name for frame in session.recorded}
        return writer

    @property
    def missing(self) -> tuple[PlannedShot, ...]:
        """Planned shots that are not recorded yet, in plan order."""
        return tuple(self._missing.values())

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

        Raises
        ------
        DataError
            If the pixels are not what the manifest states, or the shot is not in the plan.
        StorageError
            If the disk refuses. What was recorded before stays whole.
        """
        if self.manifest.plan is not None and shot.key not in self._planned:
            raise DataError(f"{self.folder}: {shot.file} is not in the plan of this session")
        self._check_pixels(shot, pixels)
        camera = self.manifest.camera
        quality = measure_quality(
            pixels, white_level_dn=camera.white_dn, black_level_dn=camera.black_level_dn
        )
        if quality.percentiles_dn["100"] >= 2**camera.bit_depth:
            raise DataError(
                f"{self.folder}: {shot.file} has a value of {quality.percentiles_dn['100']}, more "
                f"than {camera.bit_depth} bits hold; set the camera to deliver low-aligned samples"
            )
        path = self._free_path(shot)
        size, file_sha256 = self._store(path, pixels)
        values = {
            "role": shot.role,
            "led": shot.led,
            "bracket": shot.bracket,
            "repeat": shot.repeat,
            "exposure_us": shot.exposure_us if exposure_us is None else exposure_us,
            "gain_db": gain_db,
            "file": f"{FRAMES}/{path.name}",
            "bytes": size,
            "file_sha256": file_sha256,
            "pixels_sha256": pixels_sha256(pixels),
            "frame_id": frame_id,
            "timestamp_ns": timestamp_ns,
            "temperature_c": temperature_c,
            "echo": echo,
            "clipped_fraction": quality.clipped_fraction,
            "percentiles_dn": quality.percentiles_dn,
            "sharpness": quality.sharpness,
            "status": status,
            "origin": origin,
        }
        line = self._journal.append(FrameLine, values)
        self._names.add(path.name)
        if status == "ok":
            self._missing.pop(shot.key, None)
        return line

    def write_event(self, event: str, **details: Any) -> EventLine:
        """Store an event, a name of lower-case words with ``_``, with details JSON can hold.

        Raises
        ------
        DataError
            If name or details do not fit the journal.
        StorageError
            If the disk refuses.
        """
        return self._journal.append(EventLine, {"event": event, "details": details})

    def complete(self) -> None:
        """Declare the recording brought to its end, and close.

        Raises
        ------
        DataError
            If planned shots are missing.
        StorageError
            If the disk refuses, or another program changed the journal.
        """
        if self._missing:
            raise DataError(
                f"{self.folder}: {len(self._missing)} planned frames are missing, first "
                f"{self.missing[0].file}; take them before completing"
            )
        write_durably(self.folder / COMPLETE, completion_mark(self._journal.read_back()))
        self.close()

    def close(self) -> None:
        """Let go of the session, complete or not; harmless when repeated."""
        self._journal.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _check_pixels(self, shot: PlannedShot, pixels: npt.NDArray[np.uint16]) -> None:
        shape = self.manifest.camera.shape
        if pixels.dtype != np.uint16 or pixels.shape != shape:
            raise DataError(
                f"{self.folder}: {shot.file} has {pixels.dtype} pixels of shape {pixels.shape}; "
                f"this session holds uint16 of {shape}"
            )

    def _free_path(self, shot: PlannedShot) -> Path:
        """Return the file for the next take; numbers of planned repeats are kept for them."""
        plan = self.manifest.plan
        number, retake = shot.repeat, 1 if plan is None else plan.repeats
        while True:
            path = self.folder / FRAMES / shot.take_file(number)
            if path.name not in self._names and not path.exists():
                return path
            number, retake = retake, retake + 1

    def _store(self, path: Path, pixels: npt.NDArray[np.uint16]) -> tuple[int, str]:
        self._journal.check_open()
        part = part_path(path)
        try:
            try:
                write_tiff(part, pixels)
            except (MissingPathError, DataError, StorageError) as error:
                raise StorageError(f"{path}: {str(error).removeprefix(f'{part}: ')}") from error
            with disk(path, "read back"):
                data = part.read_bytes()
            publish(part, path)
        except BaseException:
            with suppress(OSError):
                part.unlink(missing_ok=True)
            raise
        return len(data), sha256_of(data)


def _set_aside(folder: Path, recorded: set[str]) -> list[str]:
    """Move files without a line out of ``frames/``, delete rests of unfinished writes."""
    frames, shelf = folder / FRAMES, folder / DERIVED / "unrecorded"
    if leaves(frames, folder):
        raise DataError(f"{frames}: is a link that leaves the session; put the folder itself there")
    make_folder(frames)
    aside: list[str] = []
    with disk(frames, "clear up"):
        for path in sorted(frames.iterdir()):
            if path.name in recorded:
                continue
            if is_part(path):
                path.unlink()
                continue
            make_folder(shelf)
            target = next(
                free
                for number in count()
                if not (free := shelf / f"{number:03d}_{path.name}").exists()
            )
            os.rename(path, target)
            sync_folder(shelf)
            aside.append(target.relative_to(folder).as_posix())
        sync_folder(frames)
    return aside
