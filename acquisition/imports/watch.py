"""Tethered capture: images that a camera saves into a folder are recorded as they appear."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition._errors import DataError, MissingPathError
from acquisition.imports.frames import camera_metadata, camera_of, write_imported
from acquisition.imports.image import ImportedImage
from acquisition.imports.watch_files import Recorded, WatchedFolder
from acquisition.imports.watch_match import Arrival, Match, Rule, follows_gap, match_shots
from acquisition.imports.watch_shots import Watch, lights_of_shots, shots_by_name
from acquisition.pixels.high_bits import high_bits_notice, high_bits_of, white_level_of
from acquisition.pixels.stated_facts import ImageFacts, ShotFacts
from acquisition.plan.planned_shot import PlannedShot
from acquisition.session.journal import FrameLine
from acquisition.session.layout import is_session
from acquisition.session.manifest import Calibrations, Labels, Manifest
from acquisition.session.session import Session
from acquisition.session.session_frame import pixels_sha256
from acquisition.session.value_records import TransferRecord
from acquisition.session.writer import SessionWriter
from acquisition.source.series_facts import orientation_notices, transfer_notices
from acquisition.values.image_names import is_raw
from acquisition.values.lights import Lights
from acquisition.values.running_numbers import running_number
from acquisition.values.transfer_curve import LINEAR, TransferCurve
from rig import Notice, Progress, no_progress, pluralize, short_repr
from rig.host import clock

_POLL_S: Final = 0.2
_WATCHED: Final = "watched"
# Settings of the first image that the event of a watch records.
_SETTINGS: Final = ("iso", "f_number", "orientation")


@dataclass(frozen=True, eq=False)
class WatchResult:
    """Result of `watch_folder`.

    Parameters
    ----------
    session
        Recorded session; complete if every shot has its image.
    missing
        Shots without an image.
    warnings
        One notice for each gap, each image without a free shot, and each other remark.
    """

    session: Session
    missing: tuple[PlannedShot, ...]
    warnings: tuple[Notice, ...]

    __repr__ = short_repr


def watch_folder(
    watch: Watch,
    out: str | Path,
    *,
    lights: Lights | None = None,
    on_message: Callable[[str], None] = lambda line: None,
    on_progress: Progress = no_progress,
    labels: Labels = Labels(),
) -> WatchResult:
    """Record images as they appear, until every shot has one or the timeout has passed.

    An image is recorded as soon as its file is complete: the file has not changed for a while, and
    it decodes. The running number in its name gives its shot, counted from the nearest recorded
    number of the same series; a missing number leaves a shot empty. Images without a running number
    get the next shot in order of arrival. Pauses and restarts have no effect. If `Watch.interval_s`
    is given, times show gaps too: those that the camera wrote into the images, or else those of the
    files. An image named after a shot (``L12.CR2``) is always recorded as that shot.

    Parameters
    ----------
    watch
        Folder and shots.
    out
        New folder, or the incomplete session of an earlier watch, which is then continued.
    lights
        Lights of the LEDs, matched by id (``L07``) or by order.
    on_message
        Called with each line of text for the user.
    on_progress
        Receives the stage ``watching``, one step per image.
    labels
        Texts for people, of a new session.

    Returns
    -------
    WatchResult
        Result with a complete session, or with an incomplete one that can be continued.

    Raises
    ------
    MissingPathError
        If the folder does not exist.
    DataError
        If an image differs in kind from the first, if its number is below that of the first, if an
        earlier watch was for other shots, or if no image appeared at all.
    StorageError
        If the session cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition import make_folder, watch_folder, write_png
    >>> from acquisition.imports import Watch, lights_in_order
    >>> make_folder(Path("tethered"))
    >>> for i in range(2):
    ...     write_png(f"tethered/IMG_{i}.png", np.full((4, 5), 700, np.uint16))
    >>> watch = Watch(Path("tethered"), lights_in_order(2), settle_s=0.1, timeout_s=10)
    >>> watch_folder(watch, "session").session.complete
    True
    """
    if not watch.folder.is_dir():
        raise MissingPathError(f"{watch.folder}: no such folder")
    with closing(_Watcher(watch, Path(out), lights, on_message, on_progress, labels)) as watcher:
        return watcher.run()


@dataclass(eq=False)
class _Watcher:
    """A watch in progress; parameters as in `watch_folder`."""

    watch: Watch
    out: Path
    lights: Lights | None
    tell: Callable[[str], None]
    on_progress: Progress
    labels: Labels

    def __post_init__(self) -> None:
        watch = self.watch
        self._lights = lights_of_shots(watch.shots, self.lights)
        self._called = shots_by_name(watch.shots)
        self._shot_files = [shot.file for shot in watch.shots]
        self._said: dict[Notice, None] = {}
        self._files = WatchedFolder(
            watch.folder, watch.settle_s, self._say, watch.max_pixels, watch.pair_s
        )
        if self.lights is not None:
            self._say(*self.lights.warnings)
        self._recorded: dict[str, int] = {}
        self._earlier: frozenset[str] = frozenset()
        self._names: dict[str, str] = {}  # of files, by the hash of their pixels
        self._copies: set[str] = set()
        self._first: ImportedImage | None = None
        self._writer: SessionWriter | None = None
        if is_session(self.out):
            self._continue_session()

    def run(self) -> WatchResult:
        """Poll the folder until all shots are recorded or the timeout has passed."""
        changed_s = clock.monotonic()
        while self._missing:
            if self._files.scan():
                changed_s = clock.monotonic()
            self._files.report_overwritten()
            late = clock.monotonic() - changed_s >= self.watch.timeout_s
            if late:
                self._files.wait_no_longer()
            recorded = self._record(self._match(decide=late))
            if late:
                break
            if not recorded:
                clock.sleep(_POLL_S)
        return self._result()

    def close(self) -> None:
        """Close the session."""
        if self._writer is not None:
            self._writer.close()

    @property
    def _missing(self) -> tuple[PlannedShot, ...]:
        recorded = set(self._recorded.values())
        return tuple(shot for i, shot in enumerate(self.watch.shots) if i not in recorded)

    def _continue_session(self) -> None:
        """Continue the session of an earlier watch if it was for the same shots."""
        session = Session.open(self.out)
        begun = next((line.details for line in session.events if line.event == _WATCHED), None)
        # A watch that was killed at once left a session without any line.
        blank = session.manifest.rig is None and not (session.recorded or session.events)
        if not blank and (begun is None or begun.get("shots") != self._shot_files):
            raise DataError(
                f"{self.out}: was not started by watching a folder for these shots: choose a new "
                "folder, or give the same LEDs or the same plan"
            )
        self._writer = SessionWriter.reopen(self.out)
        if begun is None:
            self._writer.write_event(_WATCHED, shots=self._shot_files)
        indices = {shot.key: index for index, shot in enumerate(self.watch.shots)}
        # Read the session again: from here on no other watch can add to it.
        session = Session.open(self.out)
        for frame in session.frames:
            line = frame.line
            if line.origin is None:
                continue
            if line.key not in indices:
                raise DataError(
                    f"{frame.path}: does not match any shot for which this session was started: "
                    "restore the session from a copy, or choose a new folder"
                )
            self._mark(line, line.origin, indices[line.key])
        if session.frames:
            camera = session.manifest.camera
            # Each image states all 16 bits; how many are in use was decided for the session.
            full = camera.bit_depth == 16 and camera.white_dn in map(white_level_of, (10, 12, 14))
            first = session.frames[0]
            stated: dict[str, Any] = {name: (begun or {}).get(name) for name in _SETTINGS}
            facts = ImageFacts(first.path, ShotFacts(**stated))
            if not is_raw(Path(first.line.origin or "")):
                dtype = np.dtype(np.uint8 if camera.bit_depth == 8 else np.uint16)
                facts = replace(facts, shape=first.shape, dtype=dtype)
            self._first = ImportedImage(
                facts,
                first.read(),
                bit_depth=camera.bit_depth,
                cfa=camera.cfa,
                black_level_dn=camera.black_level_dn,
                white_level_dn=65535.0 if full else camera.white_dn,
            )
        self._earlier = frozenset(self._recorded)
        text = f"continued with {pluralize(len(self._recorded), 'image')}"
        last = max(self._recorded.values(), default=-1)
        if last + 1 < len(self.watch.shots):
            text += f"; {Path(self._shot_files[last + 1]).stem} is next"
        self._say(Notice("watch-continued", text, str(self.out), "info"))

    def _mark(self, line: FrameLine, name: str, index: int) -> None:
        """Note that a file is recorded."""
        time_s = datetime.fromisoformat(line.time_utc).timestamp()
        self._recorded[name] = index
        self._names[line.pixels_sha256] = name
        self._files.mark(name, Recorded(time_s, line.pixels_sha256))

    def _match(self, *, decide: bool) -> Match:
        """Match the complete files in the folder to shots."""
        series: list[Arrival] = []
        named: dict[str, int] = {}
        waiting: list[str] = []
        by_number = self.watch.gaps and self.watch.interval_s is None
        for name in self._files.names:
            if name in self._copies:
                continue
            index = self._called.get(Path(name).stem.casefold())
            arrival = self._files.arrival(name)
            if arrival is None:
                if index is None:
                    waiting.append(name)
            elif index is not None:
                named[name] = index
            # An image that only its order assigns waits for the incomplete ones before it.
            elif not waiting or (by_number and running_number(name)) or name in self._recorded:
                series.append(arrival)
        interval_s = self.watch.interval_s
        if interval_s is not None and not decide and series:
            last = series[-1].name
            before = {arrival.name for arrival in series[-2:-1]}
            new = last not in self._recorded and before - self._earlier
            # If the next image arrives early, there is no gap: this one was only delayed.
            if new and follows_gap(series, interval_s) and self._files.age_s(last) < 2 * interval_s:
                series.pop()
        series_recorded = {
            name: index
            for name, index in self._recorded.items()
            if Path(name).stem.casefold() not in self._called
        }
        named |= {n: i for n, i in self._recorded.items() if n not in series_recorded}
        match = match_shots(
            series,
            [Path(file).stem for file in self._shot_files],
            series_recorded,
            Rule(self.watch.gaps, interval_s),
            named=named,
            waiting=waiting,
            earlier=self._earlier,
        )
        match.shots = {n: i for n, i in named.items() if n not in self._recorded} | match.shots
        return match

    def _record(self, match: Match) -> bool:
        """Record the matched images; return whether there were any."""
        self._say(*match.unused)
        new = list(match.shots.items())
        for name, index in new:
            image = self._files.take(name)
            other = self._names.get(pixels_sha256(image.pixels))
            if other is not None and image.pixels.min() < image.pixels.max():
                if name in match.by_order and Path(other).stem in Path(name).stem:
                    text = f"not recorded: it is a copy of {other}"
                    self._copies.add(name)
                    self._say(Notice("image-without-shot", text, name))
                    return True  # the files after it have to be matched again
                text = f"has the same pixels as {other}: the camera or the program repeats an image"
                self._say(Notice("image-repeated", text, name))
            self._say(*match.notices.get(name, ()))
            line = write_imported(self._open(image), self.watch.shots[index], image)
            self._mark(line, name, index)
            self.tell(f"{name} is {Path(line.file).stem}")
            shots = len(self.watch.shots)
            self.on_progress("watching", shots - len(self._missing), shots)
        missing = self._missing
        if new and missing and len(self.watch.shots) - 1 in self._recorded.values():
            text = (
                "the last shot is recorded, but "
                f"{pluralize(len(missing), 'shot before it is', 'shots before it are')} missing: "
                f"save an image as {Path(missing[0].file).stem}{Path(new[-1][0]).suffix} to add "
                "the first"
            )
            self._say(Notice("shots-without-image", text))
        return bool(new)

    def _open(self, image: ImportedImage) -> SessionWriter:
        """Return the writer; the first image determines the camera of the session."""
        if self._first is None:
            self._first = image
            self._say(*orientation_notices(image.facts, image.path.name))
        image.facts.check_alike(self._first.facts)
        image.check_like(self._first)
        transfer = self._transfer(image)
        if self._writer is None:
            if image.bit_depth == 8:
                text = "8 bits, probably not linear: record camera RAW"
                self._say(Notice("image-8-bit", text, image.path.name))
            camera = camera_of(image)
            bits = None if image.cfa else high_bits_of(image.pixels)
            if bits is not None:
                self._say(high_bits_notice(bits, image.path.name))
                camera["white_level_dn"] = white_level_of(bits)
            manifest = Manifest.begin(
                self.out,
                camera=camera,
                plan=self.watch.plan,
                labels=self.labels,
                calibrations=Calibrations(lights=self._lights),
                transfer=TransferRecord.of(transfer),
            )
            self._writer = SessionWriter.create(self.out, manifest)
            details = camera_metadata(image)
            self._writer.write_event(_WATCHED, shots=self._shot_files, **details)
        return self._writer

    def _transfer(self, image: ImportedImage) -> TransferCurve:
        """Return the transfer curve of an image, which must be that of the session."""
        stated = image.facts.transfer
        if self.watch.transfer is not None:
            curve, why = self.watch.transfer, "given"
        else:
            curve, why = stated.curve, stated.origin
            if self._writer is None:
                white, name = image.white_level_dn, image.path.name
                self._say(*transfer_notices(curve, why, white, name))
        if self._writer is None:
            return curve
        record = self._writer.manifest.transfer
        recorded = LINEAR if record is None else record.value()
        if recorded != curve:
            raise DataError(
                f"{image.path}: {curve.name} ({why}), but the session is {recorded.name}: "
                "give the transfer curve of the session"
            )
        return curve

    def _say(self, *notices: Notice) -> None:
        """Report notices, but each only once."""
        for notice in notices:
            if notice not in self._said:
                self._said[notice] = None
                self.tell(str(notice))

    def _result(self) -> WatchResult:
        if self._writer is None:
            reason = next((f"{line}; " for line in self._files.damaged), "")
            raise DataError(
                f"{reason}{self.watch.folder}: no image appeared within {self.watch.timeout_s:g} s"
            )
        if not self._missing:
            self._writer.complete()
        self._writer.close()
        return WatchResult(Session.open(self.out), self._missing, tuple(self._said))
