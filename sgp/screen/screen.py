"""What the page asks of the station, carried out; and the pictures that it shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

import acquisition
from acquisition.preview import Region
from rig.arrays import UInt8
from sgp.screen import actions
from sgp.screen.desk import Desk
from sgp.screen.station import Light, Station
from sgp.screen.tasks import check, look, meter

# Width of a thumbnail in px.
_THUMBNAIL = 96


class Screen:
    """Carries out the actions of a page.

    Parameters
    ----------
    station
        The station.
    desk
        Its desk.
    out
        Folder for recordings; each gets a folder of its own in it.
    """

    def __init__(self, station: Station, desk: Desk, out: Path) -> None:
        self._station, self._desk, self._out = station, desk, out
        self._pictures: dict[str, UInt8] = {}
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
            case actions.Look() if self._recording is not None:
                self._station.request("computing normals", look(self._recording, self._keep))
            case actions.Answer(question=question, yes=yes):
                self._desk.answer(question, yes)
            case actions.Stop():
                self._station.stop("the page")
            case _:
                raise ValueError("nothing has been recorded yet")

    def picture(self, name: str) -> UInt8 | None:
        """Return a picture by name: ``look``, or the file of a recorded frame; None without it."""
        if name == "look" or self._recording is None:
            return self._pictures.get(name)
        try:
            session = acquisition.Session.open(self._recording)
            frame = next(one for one in session.frames if one.path.name == name)
            return _thumbnail(frame.read(), session.manifest.camera.white_dn)
        except (acquisition.DataError, StopIteration):
            return None

    def _keep(self, picture: UInt8) -> None:
        self._pictures["look"] = picture


def _thumbnail(pixels: Any, white_dn: float) -> UInt8:
    height, width = pixels.shape[:2]
    size = _THUMBNAIL, max(1, round(_THUMBNAIL * height / width))
    small = cv2.resize(pixels.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(255 * np.clip(small / white_dn, 0, 1) ** (1 / 2.2)), np.uint8)
