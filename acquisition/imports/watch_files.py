"""Images in a folder that another program writes: which files are complete so far."""

from __future__ import annotations

import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from acquisition._errors import DataError, MissingPathError
from acquisition.imports.image import ImportedImage, read_for_import
from acquisition.imports.watch_match import Arrival
from acquisition.session.session_frame import pixels_sha256
from acquisition.source.series_facts import raw_preferred_notice
from acquisition.values.image_names import SUFFIXES, is_raw
from acquisition.values.running_numbers import in_order
from rig import MAX_PIXELS, Notice
from rig.host import clock

# Suffixes of the images that cameras store next to camera RAW.
_OF_PAIRS: Final = (".jpg", ".jpeg")
# Number of images kept in memory between the check that they decode and their recording.
_KEPT: Final = 3


@dataclass(frozen=True)
class Recorded:
    """What a session knows about a file: when it was recorded, seconds since 1970, and pixels."""

    time_s: float
    pixels_sha256: str


@dataclass
class _File:
    state: tuple[int, int]  # bytes, and time of the last write in ns
    since_s: float
    arrival: Arrival | None = None
    complaint: str = ""
    image: ImportedImage | None = field(default=None, repr=False)


@dataclass(eq=False)
class WatchedFolder:
    """Images in a folder; an image counts when its file is unchanged for a while and decodes.

    Names that begin with a dot are ignored. A session holds camera RAW files or other images, as
    its first one is; files of the other kind are ignored. Cameras that store each exposure twice
    may write the JPEG first, so until the kind is known a JPEG waits for a RAW file.

    Parameters
    ----------
    folder
        Existing folder.
    settle_s
        Time for which a file must stay unchanged, seconds.
    say
        Called with a notice for each file that is incomplete or was overwritten.
    max_pixels
        Largest allowed number of pixels per image.
    pair_s
        Time for which the first JPEGs wait for a camera RAW file, seconds.
    """

    folder: Path
    settle_s: float
    say: Callable[[Notice], None]
    max_pixels: int = MAX_PIXELS
    pair_s: float = 0.0

    def __post_init__(self) -> None:
        self._pair_since_s: float | None = None
        self._raw: bool | None = None  # whether the session holds camera RAW, if known
        self._files: dict[str, _File] = {}
        self._recorded: dict[str, Recorded] = {}
        self._unchanged: dict[str, tuple[int, int]] = {}

    @property
    def names(self) -> list[str]:
        """Names of all images, complete or not, in the order in which they were taken."""
        return in_order({name: file.state[1] / 1e9 for name, file in self._files.items()})

    @property
    def damaged(self) -> list[str]:
        """One line for each file that does not decode, with the reason."""
        return [file.complaint for file in self._files.values() if file.complaint]

    def scan(self) -> bool:
        """List the folder; return whether anything changed since the last scan.

        A recorded file keeps its times for matching, even if it is overwritten later.

        Raises
        ------
        DataError
            If the folder cannot be listed.
        """
        now = clock.monotonic()
        files: dict[str, _File] = {}
        try:
            for path in self.folder.iterdir():
                if path.name.startswith(".") or path.suffix.lower() not in SUFFIXES:
                    continue
                try:
                    status = path.stat()
                except FileNotFoundError:  # renamed since it was listed
                    continue
                if not stat.S_ISREG(status.st_mode):
                    continue
                state = (status.st_size, status.st_mtime_ns)
                file = self._files.get(path.name)
                if file is None or file.state != state:
                    earlier = file.arrival if file and path.name in self._recorded else None
                    file = _File(state, now, earlier)
                files[path.name] = file
        except OSError as error:
            raise DataError(f"{self.folder}: cannot be listed: {error.strerror}") from error
        files = self._of_one_kind(files, now)
        changed = {name: file.state for name, file in files.items()} != {
            name: file.state for name, file in self._files.items()
        }
        self._files = files
        return changed

    def _of_one_kind(self, files: dict[str, _File], now: float) -> dict[str, _File]:
        """Return the files of the session's kind, which is camera RAW as soon as there is one."""
        raw = {name: file for name, file in files.items() if is_raw(Path(name))}
        others = {name: file for name, file in files.items() if name not in raw}
        if raw and self._raw is None:
            self._raw = True
        if self._raw is None:
            if self._pair_since_s is None and any(map(_of_pair, others)):
                self._pair_since_s = now
                if self.pair_s > 0:
                    text = f"the first JPEG waits {self.pair_s:g} s for a camera RAW file"
                    self.say(Notice("raw-awaited", text, str(self.folder), "info"))
            return others
        twins = {Path(name).stem.casefold() for name in raw}
        twins &= {Path(name).stem.casefold() for name in others}
        if twins and self._raw:
            self.say(raw_preferred_notice(None, str(self.folder)))
        elif raw and not self._raw:
            text = (
                "camera RAW files are ignored, because the session began with other images: to "
                "record the RAW files, import the folder into a new session"
            )
            self.say(Notice("raw-too-late", text, str(self.folder)))
        return raw if self._raw else others

    def wait_no_longer(self) -> None:
        """Let JPEGs count although no camera RAW file has appeared."""
        self.pair_s = 0.0

    def _awaits_raw(self, name: str) -> bool:
        """Return whether the same exposure may still appear as camera RAW."""
        if self._raw is not None or self._pair_since_s is None or not _of_pair(name):
            return False
        return clock.monotonic() - self._pair_since_s < self.pair_s

    def age_s(self, name: str) -> float:
        """Return the time for which a file has been unchanged, seconds."""
        return clock.monotonic() - self._files[name].since_s

    def arrival(self, name: str) -> Arrival | None:
        """Return the arrival of a file for matching, or None if the file is not complete yet."""
        file = self._files[name]
        if name in self._recorded:
            file.arrival = file.arrival or Arrival(name, file.state[1] / 1e9)
        elif file.arrival is None and not file.complaint and not self._awaits_raw(name):
            image = self._settled_image(name)
            if image is not None:
                taken = image.facts.shot.taken
                taken_s = None if taken is None else taken.timestamp()
                file.arrival = Arrival(name, file.state[1] / 1e9, taken_s)
                if sum(other.image is not None for other in self._files.values()) < _KEPT:
                    file.image = image
        return file.arrival

    def take(self, name: str) -> ImportedImage:
        """Return the image of a complete file.

        Raises
        ------
        DataError
            If the file has become damaged or has disappeared.
        """
        image, self._files[name].image = self._files[name].image, None
        try:
            return image or read_for_import(self.folder / name, max_pixels=self.max_pixels)
        except MissingPathError as error:
            raise DataError(str(error)) from error

    def mark(self, name: str, recorded: Recorded) -> None:
        """Note that a file is recorded. It need not be in the folder any longer."""
        self._recorded[name] = recorded
        self._raw = is_raw(Path(name))
        if name in self._files:
            self._unchanged[name] = self._files[name].state

    def report_overwritten(self) -> None:
        """Report recorded files that have other pixels now; a session keeps the earlier ones."""
        for name in self._recorded.keys() & self._files.keys():
            file, recorded = self._files[name], self._recorded[name]
            older = name not in self._unchanged and file.state[1] / 1e9 <= recorded.time_s
            if older or self._unchanged.get(name) == file.state:
                self._unchanged[name] = file.state
                continue
            image = None if file.complaint else self._settled_image(name)
            if image is None:
                continue
            self._unchanged[name] = file.state
            if pixels_sha256(image.pixels) != recorded.pixels_sha256:
                text = "was overwritten after it was recorded; the session holds the earlier image"
                self.say(Notice("image-overwritten", text, name))

    def _settled_image(self, name: str) -> ImportedImage | None:
        """Return an image, or None if its file changes or does not decode, which is reported."""
        if self.age_s(name) < self.settle_s or not self._files[name].state[0]:
            return None
        try:
            return read_for_import(self.folder / name, max_pixels=self.max_pixels)
        except (DataError, MissingPathError) as error:
            self._files[name].complaint = str(error)
            text = f"waiting for the rest of the file: {error}"
            self.say(Notice("image-not-complete", text))
        return None


def _of_pair(name: str) -> bool:
    return name.lower().endswith(_OF_PAIRS)
