"""What the page asks of the station, carried out; and the pictures that it shows."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

import acquisition
from acquisition.preview import Region
from acquisition.session.layout import FRAMES
from rig.arrays import AnyArray, UInt8
from sgp.results import check_folder
from sgp.screen import actions
from sgp.screen.desk import Desk
from sgp.screen.recording import record, resume
from sgp.screen.station import Light, Station
from sgp.screen.tasks import check, look, meter
from sgp.sessions import Order

# Width of a thumbnail in px.
_THUMBNAIL = 96
# Bytes of a folder's name; file systems allow at least 255.
_LONGEST_NAME = 200


class Screen:
    """Carries out the actions of a page.

    Parameters
    ----------
    station
        The station.
    desk
        Its desk.
    order
        What sessions store.
    out
        Folder for recordings; each gets a folder in it, named after the object.
    pixel_mm
        Size of a pixel on the object, if it is known.
    """

    def __init__(
        self, station: Station, desk: Desk, order: Order, out: Path, pixel_mm: float | None = None
    ) -> None:
        self._station, self._desk, self._order, self._out = station, desk, order, out
        self._pixel_mm = pixel_mm
        desk.show(mm_per_px=pixel_mm)
        self._look: UInt8 | None = None
        self._thumbnails: dict[Path, UInt8] = {}
        self._recording: Path | None = None

    def perform(self, action: actions.Action) -> None:
        """Carry out an action, or request the task that it needs.

        Raises
        ------
        BusyError
            If another task is running, or the rig is not open.
        ValueError, UsageError
            If a value cannot be used.
        """
        match action:
            case actions.SetLight(mode=mode, leds=leds, exposure_us=us, gain_db=db):
                self._station.light(Light(mode, tuple(leds), us, db))
            case actions.SetRegion(left=left, top=top, width=width, height=height):
                self._station.look_at(Region(left, top, width, height))
            case actions.Pause(paused=paused):
                self._station.pause(paused)
            case actions.WritePlan(text=text):
                self._desk.sheet.write(text)
                self._desk.show()
            case actions.Meter(each=each):
                self._station.request("metering", meter(each=each))
            case actions.Check():
                self._station.request("checking", check(self._out / "recording"))
            case actions.Record(object=name, notes=notes, check=checked):
                folder = self._out / _folder_name(name)
                check_folder(folder)
                task = record(
                    self._order, self._order.labels(name.strip(), notes), folder, check=checked
                )
                self._station.request("recording", task)
                self._recording = folder
                self._thumbnails = {}
            case actions.Resume() if self._recording is not None:
                self._station.request("recording", resume(self._order, self._recording))
            case actions.Look() if self._recording is not None:
                self._station.request(
                    "computing normals", look(self._recording, self._pixel_mm, self._keep)
                )
            case actions.Answer(question=question, yes=yes):
                self._desk.answer(question, yes)
            case actions.Stop():
                self._station.stop("the page")
            case _:
                raise ValueError("nothing has been recorded yet")

    def picture(self, name: str) -> UInt8 | None:
        """Return a picture by name: ``look``, or the file of a recorded frame; None without it."""
        folder = self._recording
        if name == "look" or folder is None:
            return self._look
        file = folder / FRAMES / name
        if file not in self._thumbnails and file.parent == folder / FRAMES:
            # ValueError: a path that no file can have.
            with suppress(acquisition.DataError, acquisition.MissingPathError, ValueError):
                pixels = acquisition.read_image(file)
                self._thumbnails[file] = _thumbnail(pixels, self._station.white_dn)
        return self._thumbnails.get(file)

    def _keep(self, picture: UInt8) -> None:
        self._look = picture


def _folder_name(name: str) -> str:
    """Return the name of the folder for an object.

    Raises
    ------
    ValueError
        If the name is empty, or a path.
    """
    name = name.strip()
    if not name:
        raise ValueError("the object needs a name, after which its folder is named")
    if len(name.encode(errors="replace")) > _LONGEST_NAME:
        raise ValueError(f"the name is too long for a folder: use at most {_LONGEST_NAME} letters")
    if name.startswith(".") or not name.isprintable() or set(name) & set('/\\:*?"<>|'):
        raise ValueError(
            f'{name!r} cannot name a folder: leave out / \\ : * ? " < > | and a first dot'
        )
    return name


def _thumbnail(pixels: AnyArray, white_dn: float) -> UInt8:
    """Return a small picture of a frame."""
    height, width = pixels.shape[:2]
    size = _THUMBNAIL, max(1, round(_THUMBNAIL * height / width))
    small = cv2.resize(pixels.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(255 * np.clip(small / white_dn, 0, 1) ** (1 / 2.2)), np.uint8)
