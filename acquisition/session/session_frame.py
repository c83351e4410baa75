"""One recorded frame: its file, its journal line and its pixels; and damage of one."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition._errors import DataError, MissingPathError
from acquisition.files.storage import sha256_of
from acquisition.pixels.images import read_frame
from acquisition.pixels.plain_rows import PlainRows, plain_rows
from acquisition.plan.planned_shot import Role
from acquisition.session.journal import FrameLine
from acquisition.values.lights import led_id
from rig import Notice, short_repr
from rig.arrays import UInt16


@dataclass(frozen=True, eq=False)
class SessionFrame:
    """One recorded frame.

    Parameters
    ----------
    path
        The image file.
    line
        Its line in the journal.
    bytes, file_sha256
        Current size and hash of the file; after compaction they differ from those of the line.
    shape
        Array shape according to the session.
    """

    path: Path
    line: FrameLine
    bytes: int
    file_sha256: str
    shape: tuple[int, ...]

    @classmethod
    def recorded(cls, path: Path, line: FrameLine, shape: tuple[int, ...]) -> SessionFrame:
        """Return a frame whose file is the one of its line."""
        return cls(path, line, line.bytes, line.file_sha256, shape)

    def __repr__(self) -> str:
        led = "" if self.led is None else f", LED {self.led}"
        exposure = "" if self.exposure_us is None else f", {self.exposure_us:g} us"
        return f"SessionFrame({self.path.name}, {self.role}{led}{exposure}, shape {self.shape})"

    @property
    def role(self) -> Role:
        """``light``, ``dark``, ``ambient``, ``flat`` or ``repeat``."""
        return self.line.role

    @property
    def led(self) -> int | None:
        """Number from 0 of the LED that was on, None if all were off or if it is unknown.

        The LED of a flat is known if the board reported it.
        """
        if self.role == "flat":
            return None if self.line.echo is None else self.line.echo.led
        return self.line.led

    @property
    def light_id(self) -> str:
        """``L07`` for a light frame of LED 7, otherwise the stem of the file."""
        if self.role != "light" or self.line.led is None:
            return Path(self.line.file).stem
        return led_id(self.line.led)

    @property
    def bracket(self) -> int:
        """Index of the bracket from 0."""
        return self.line.bracket

    @property
    def exposure_us(self) -> float | None:
        """Exposure time that the camera reported, microseconds."""
        return self.line.exposure_us

    def read(self) -> UInt16:
        """Return the raw pixels of the sensor, ``(H, W)`` or ``(H, W, 3)`` uint16.

        Raises
        ------
        DataError
            If the file is missing or unreadable, or its pixels differ from those recorded.
        """
        if self.path.exists() and not self.path.is_file():
            # Reading a pipe, for instance, might never end.
            raise DataError(f"{self.path}: is not a regular file; restore it")
        try:
            pixels = read_frame(self.path, self.shape)
        except MissingPathError as error:
            raise DataError(f"{self.path}: is in the journal but not there; restore it") from error
        if pixels_sha256(pixels) != self.line.pixels_sha256:
            raise self._differs()
        return pixels

    def check_rows(self) -> PlainRows | None:
        """Check the hash of the pixels without decoding them, so that rows can be read later.

        Returns
        -------
        PlainRows | None
            The rows; None if the file is not stored as it was recorded: `read` then reads it, or
            says what is wrong.

        Raises
        ------
        DataError
            If the pixels differ from those recorded.
        """
        digest = hashlib.sha256()
        rows = plain_rows(self.path, self.shape, digest.update)
        if rows is not None and digest.hexdigest() != self.line.pixels_sha256:
            raise self._differs()
        return rows

    def _differs(self) -> DataError:
        return DataError(
            f"{self.path}: its pixels differ from those recorded; restore the file or retake the "
            "shot"
        )


def pixels_sha256(pixels: UInt16) -> str:
    """Return the hash of samples as 16-bit little-endian, row by row, channels innermost."""
    return sha256_of(np.ascontiguousarray(pixels, dtype="<u2").data.cast("B"))


@dataclass(frozen=True, eq=False)
class Damage:
    """A frame that differs from its recording, or that contradicts the journal.

    Parameters
    ----------
    frame
        The frame.
    reason
        Description of the damage, as the end of a sentence that begins with ``where``.
    where
        The damaged file: the frame's file or the journal.
    """

    frame: SessionFrame
    reason: str
    where: Path

    __repr__ = short_repr

    @property
    def notice(self) -> Notice:
        """The damage as a notice: the file, the damage, and what to do."""
        in_file = self.where == self.frame.path
        remedy = "restore the file or retake the shot" if in_file else "retake the shot"
        return Notice("frame-damaged", f"{self.reason}; {remedy}", str(self.where), "error")

    @property
    def text(self) -> str:
        """One line with the file, the damage, and what to do."""
        return str(self.notice)
