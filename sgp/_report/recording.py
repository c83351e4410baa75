"""How a result was recorded: its images, small, with exposures, and its lights."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

import acquisition
import rig
from sgp._panels.crop import Crop
from sgp._report.folder import ResultFolder
from sgp._report.maps import Embedded

Pixels = npt.NDArray[np.uint8]

_MOST_IMAGES: Final = 40
_SIDE_PX: Final = 420
_BRIGHT: Final = 99.7  # percentile of the images that is shown white
_QUALITY: Final = 78


@dataclass(frozen=True, eq=False)
class Image:
    """One image of a recording, as the page shows it.

    Parameters
    ----------
    name, light_id, role, exposure_us
        As recorded.
    status
        ``kept``, or ``rejected``: recorded, but it does not count.
    jpeg
        The picture in base64.
    """

    name: str
    light_id: str
    role: str
    exposure_us: float | None
    status: Literal["kept", "rejected"]
    jpeg: str


@dataclass(frozen=True, eq=False)
class Recording:
    """What a report shows of a recording.

    Parameters
    ----------
    images
        Those that are shown, in order.
    total
        Number of images that there are.
    lights
        The lights that the result was computed with; None if they are not known.
    aligned
        Whether the images show the same rectangle as the maps.
    notices
        What could not be read.
    """

    images: Sequence[Image] = ()
    total: int = 0
    lights: acquisition.Lights | None = None
    aligned: bool = False
    notices: list[rig.Notice] = field(default_factory=list)


def read_recording(folder: ResultFolder, maps: Embedded | None, max_pixels: int) -> Recording:
    """Read the recording of a result, as far as it is still there; its images show the maps."""
    notices: list[rig.Notice] = []
    lights = _lights(folder, notices)
    named = folder.parameter("source")
    if not isinstance(named, str):
        return Recording(lights=lights, notices=notices)
    try:
        source = acquisition.read_source(named, lights=lights, max_pixels=max_pixels)
        shots = list(_shots(source))
        lights = lights or source.lights
    except (acquisition.DataError, acquisition.MissingPathError, OSError, ValueError) as error:
        text = f"the recording is not shown: {error}"
        return Recording(
            lights=lights, notices=[*notices, rig.Notice("recording-unreadable", text)]
        )
    chosen = [shots[i] for i in _evenly(len(shots))]
    region = _region(folder, maps, shots[0].frame.shape) if maps and shots else None
    everything = Crop(slice(0, None), slice(0, None))
    images = _images(source, chosen, region or everything, notices)
    return Recording(images, len(shots), lights, region is not None, notices)


def _lights(folder: ResultFolder, notices: list[rig.Notice]) -> acquisition.Lights | None:
    stated = folder.parameter("lights")
    path = Path(stated) if isinstance(stated, str) else folder.file("lights.json")
    if path is None:
        return None
    try:
        return acquisition.read_lights(path)
    except (acquisition.DataError, acquisition.MissingPathError) as error:
        notices.append(rig.Notice("recording-unreadable", f"the lights are not shown: {error}"))
        return None


@dataclass(frozen=True, eq=False)
class _Shot:
    frame: acquisition.Frame | acquisition.SessionFrame
    status: Literal["kept", "rejected"] = "kept"


def _shots(source: acquisition.Source) -> Iterator[_Shot]:
    """Yield all images of a source; of a session, also the rejected ones."""
    if source.kind != "session":
        yield from map(_Shot, source.frames)
        return
    session = acquisition.Session.open(source.path, damaged_frames=True)
    counted = {frame.path for frame in session.frames}
    for frame in session.recorded:
        yield _Shot(frame, "kept" if frame.path in counted else "rejected")


def _evenly(count: int) -> npt.NDArray[np.int64]:
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_IMAGES)).round().astype(np.int64))


def _region(folder: ResultFolder, maps: Embedded, shape: Sequence[int]) -> Crop | None:
    """Return the rectangle of the images that the maps show; None if it is not known."""
    step, part = folder.parameter("downscale"), folder.parameter("crop")
    step = step if isinstance(step, int) and step > 0 else 1
    left, top = (0, 0)
    if isinstance(part, list) and len(part) == 4:
        left, top, width, height = part
    else:
        height, width = shape[:2]
    if (height // step, width // step) != maps.full:
        return None
    crop = maps.crop
    rows = slice(top + step * crop.rows.start, top + step * crop.rows.stop)
    columns = slice(left + step * crop.columns.start, left + step * crop.columns.stop)
    return Crop(rows, columns)


def _images(
    source: acquisition.Source, shots: Sequence[_Shot], region: Crop, notices: list[rig.Notice]
) -> list[Image]:
    span = source.white_level - source.black_level
    span = span if np.isfinite(span) else 1.0
    pictures: dict[int, npt.NDArray[np.float32]] = {}
    for number, shot in enumerate(shots):
        try:
            pixels = shot.frame.read()
        except (acquisition.DataError, acquisition.MissingPathError) as error:
            notices.append(rig.Notice("recording-unreadable", str(error)))
            continue
        signal = (_small(pixels, region) - source.black_level) / span
        pictures[number] = source.transfer.light(signal).astype(np.float32)
    bright: dict[tuple[str, float | None], float] = {}
    for number, picture in pictures.items():
        key = _group(shots[number])
        bright[key] = max(bright.get(key, 1e-6), float(np.percentile(picture, _BRIGHT)))
    found = []
    for number, picture in pictures.items():
        shot = shots[number]
        light = np.clip(picture / bright[_group(shot)], 0, 1)
        encoded = _srgb(light)
        jpeg = cv2.imencode(".jpg", encoded, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        frame = shot.frame
        found.append(
            Image(
                frame.path.name,
                frame.light_id,
                frame.role,
                frame.exposure_us,
                shot.status,
                base64.b64encode(jpeg.tobytes()).decode(),
            )
        )
    return found


def _group(shot: _Shot) -> tuple[str, float | None]:
    """Return what the images have in common that are shown at the same brightness."""
    return shot.frame.role, shot.frame.exposure_us


def _small(pixels: npt.NDArray[Any], region: Crop) -> npt.NDArray[np.float32]:
    part = pixels[region.rows, region.columns]
    rows, columns = part.shape[:2]
    share = min(1.0, _SIDE_PX / max(rows, columns))
    size = max(1, round(columns * share)), max(1, round(rows * share))
    small = cv2.resize(np.ascontiguousarray(part), size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def _srgb(light: npt.NDArray[np.float32]) -> Pixels:
    coded = np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light)
    samples: Pixels = np.rint(255 * coded).astype(np.uint8)
    return np.ascontiguousarray(samples[..., ::-1]) if samples.ndim == 3 else samples
