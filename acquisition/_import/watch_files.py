"""Images in a folder that another program writes: which files are complete so far."""

from __future__ import annotations

import stat
import time
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from acquisition._errors import DataError, MissingPathError
from acquisition._import.image import ImportedImage, ShotData, read_for_import, read_shot_data
from acquisition._import.watch_match import Arrival, in_order
from acquisition._pixels.raw import is_raw
from acquisition._suffixes import IMAGE_SUFFIXES
from rig import MAX_PIXELS, Notice

# Number of images kept in memory between the check that they decode and their recording.
_KEPT: Final = 3


@dataclass
class _File:
    state: tuple[int, int]  # bytes, and time of the last write in ns
    since_s: float
    arrival: Arrival | None = None
    complaint: str = ""
    taken: bool = False
    image: ImportedImage | None = field(default=None, repr=False)


class WatchedFolder:
    """Images in a folder; an image counts when its file is unchanged for a while and decodes.

    Names that begin with a dot are ignored. If there are camera RAW files, all other images are
    ignored.

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
    """

    def __init__(
        self,
        folder: Path,
        settle_s: float,
        say: Callable[[Notice], None],
        max_pixels: int = MAX_PIXELS,
    ) -> None:
        self.folder = folder
        self._settle_s = settle_s
        self._say = say
        self._max_pixels = max_pixels
        self._files: dict[str, _File] = {}

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

        A file that was taken keeps its state, even if it is overwritten later.

        Raises
        ------
        DataError
            If the folder cannot be listed.
        """
        now = time.monotonic()
        files: dict[str, _File] = {}
        try:
            for path in self.folder.iterdir():
                if path.name.startswith(".") or not _is_picture(path):
                    continue
                try:
                    status = path.stat()
                except FileNotFoundError:  # renamed since it was listed
                    continue
                if not stat.S_ISREG(status.st_mode):
                    continue
                state = (status.st_size, status.st_mtime_ns)
                file = self._files.get(path.name)
                if file is None or not (file.taken or file.state == state):
                    file = _File(state, now)
                elif file.state != state:
                    text = (
                        "was overwritten after it was recorded; the session holds the earlier image"
                    )
                    self._say(Notice("image-overwritten", text, path.name))
                files[path.name] = file
        except OSError as error:
            raise DataError(f"{self.folder}: cannot be listed: {error.strerror}") from error
        if any(is_raw(Path(name)) for name in files):
            files = {name: file for name, file in files.items() if is_raw(Path(name))}
        changed = {name: file.state for name, file in files.items()} != {
            name: file.state for name, file in self._files.items()
        }
        self._files = files
        return changed

    def age_s(self, name: str) -> float:
        """Return the time for which a file has been unchanged, seconds."""
        return time.monotonic() - self._files[name].since_s

    def arrival(self, name: str, recorded: Container[str]) -> Arrival | None:
        """Return the arrival of a file for matching, or None if the file is not complete yet.

        For a file in ``recorded`` only the header is read, without waiting.
        """
        file, path = self._files[name], self.folder / name
        if file.arrival is None and not file.complaint:
            settled = self.age_s(name) >= self._settle_s and file.state[0] > 0
            try:
                if name in recorded:
                    file.arrival = _arrival(name, file, read_shot_data(path))
                elif settled:
                    image = read_for_import(path, max_pixels=self._max_pixels)
                    file.arrival = _arrival(name, file, image.data)
                    if sum(other.image is not None for other in self._files.values()) < _KEPT:
                        file.image = image
            except (DataError, MissingPathError) as error:
                file.complaint = str(error)
                text = f"waiting for the rest of the file: {error}"
                self._say(Notice("image-not-complete", text))
        return file.arrival

    def take(self, name: str) -> ImportedImage:
        """Return the image of a complete file and mark the file as taken.

        Raises
        ------
        DataError
            If the file has become damaged or has disappeared.
        """
        file, path = self._files[name], self.folder / name
        image, file.image = file.image, None
        file.taken = True
        try:
            return image or read_for_import(path, max_pixels=self._max_pixels)
        except MissingPathError as error:
            raise DataError(str(error)) from error


def _arrival(name: str, file: _File, data: ShotData) -> Arrival:
    taken_s = None if data.taken is None else data.taken.timestamp()
    return Arrival(name, file.state[1] / 1e9, taken_s)


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES or is_raw(path)
