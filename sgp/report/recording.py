"""How a result was recorded: its images, small, with exposures, and its lights."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final, Literal

import numpy as np

import acquisition
import rig
from rig.arrays import AnyArray, Float32, Int64
from sgp.pictures import Crop
from sgp.report.folder import Inputs, ResultFolder, changed_notice, noted
from sgp.report.maps import Embedded
from sgp.report.prerendered import jpeg, reduced
from sgp.results import recordings_of, records_of, sha256

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
    known
        Whether the records of the result prove that it was computed from this image.
    source
        Address of the picture, which contains it.
    """

    name: str
    light_id: str
    role: str
    exposure_us: float | None
    status: Literal["kept", "rejected"]
    known: bool
    source: str


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
    identities
        What the recording was of.
    source
        The recording itself; None if it is not shown.
    """

    images: Sequence[Image] = ()
    total: int = 0
    lights: acquisition.Lights | None = None
    aligned: bool = False
    notices: list[rig.Notice] = field(default_factory=list)
    identities: Sequence[acquisition.Identity] = ()
    source: acquisition.Source | None = None


def read_recording(folder: ResultFolder, maps: Embedded | None, max_pixels: int) -> Recording:
    """Read the recording of a result, as far as it is still there; its images show the maps.

    Files whose hashes are not those of the records are left out.
    """
    notices: list[rig.Notice] = []
    inputs = Inputs(folder)
    lights = _lights(folder, inputs, notices)
    named = folder.source
    if named is None:
        return Recording(lights=lights, notices=notices)
    try:
        source = acquisition.read_source(named, lights=lights, max_pixels=max_pixels)
        shots = _unchanged(source, list(_shots(source)), inputs, notices)
    except (acquisition.DataError, acquisition.MissingPathError, OSError, ValueError) as error:
        text, shots = f"the recording is not shown: {error}", []
        notices.append(rig.Notice("recording-unreadable", text))
    if not shots:
        return Recording(lights=lights, notices=notices)
    return _recording(source, shots, _region(folder, maps, shots[0].shape), lights, notices)


def read_bare_recording(path: Path, max_pixels: int) -> Recording:
    """Read a recording that has no result.

    Raises
    ------
    DataError
        If the folder is not a recording that can be read.
    """
    source = acquisition.read_source(path, max_pixels=max_pixels)
    missing = ["there are no normals, no detail and no surface yet: sgp run computes them"]
    if source.lights is None:
        missing.append("the directions of the lights are not known: sgp calibrate finds them")
    notices = [*source.warnings, *(rig.Notice("result-unfinished", text) for text in missing)]
    return _recording(source, list(_shots(source)), None, None, notices)


def _recording(
    source: acquisition.Source,
    shots: Sequence[_Shot],
    region: Crop | None,
    lights: acquisition.Lights | None,
    notices: list[rig.Notice],
) -> Recording:
    chosen = [shots[i] for i in _evenly(len(shots))]
    images = _images(source, chosen, region or Crop(slice(0, None), slice(0, None)), notices)
    known, identities = lights or source.lights, recordings_of(source.files)
    return Recording(images, len(shots), known, region is not None, notices, identities, source)


def _lights(
    folder: ResultFolder, inputs: Inputs, notices: list[rig.Notice]
) -> acquisition.Lights | None:
    stated = folder.parameter("lights")
    # `rig` is not a path; strengths that were estimated for its LEDs are in lights.json.
    path = _own_lights(folder) if stated in (None, "rig") else folder.located(str(stated))
    if path is None:
        return None
    if inputs.state(path) == "changed":
        notices.append(changed_notice([path], "the lights are not shown"))
        return None
    with noted(notices, "recording", "the lights are not shown: "):
        return acquisition.read_lights(path)
    return None


def _own_lights(folder: ResultFolder) -> Path | None:
    """Return the lights that were estimated with the result, or with the one it measures."""
    path = folder.file("lights.json")
    if path is None and folder.roughness is not None:
        # A record of a stage is in a folder of the result.
        places = [(folder.path / name).parent for name in folder.records]
        above = (place / "lights.json" for one in places for place in (one, one.parent))
        path = next((one for one in above if _as_recorded(one)), None)
    return path


def _as_recorded(path: Path) -> bool:
    """Return whether a record next to a file states its hash."""
    files = [record.files.get(path.name) for _, record in records_of(path)]
    return any(one is not None and one.sha256 == sha256(path) for one in files)


@dataclass(frozen=True, eq=False)
class _Shot:
    """An image of a recording; ``known`` if the records of the result rest on it."""

    frame: acquisition.Frame | acquisition.session.SessionFrame
    read: Callable[[], AnyArray]
    shape: tuple[int, ...]
    status: Literal["kept", "rejected"] = "kept"
    known: bool = True


def _shots(source: acquisition.Source) -> Iterator[_Shot]:
    """Yield all images of a source, upright; of a session, also the rejected ones."""
    yield from (_Shot(frame, frame.read, frame.shape) for frame in source.frames)
    if source.kind != "session":
        return
    session = acquisition.Session.open(source.path, damaged_frames=True)
    mounting = session.manifest.mounting
    counted = {frame.path for frame in session.frames}
    for frame in session.recorded:
        if frame.path not in counted:
            read = partial(_upright, frame, mounting)
            yield _Shot(frame, read, mounting.upright_shape(frame.shape), "rejected")


def _upright(frame: acquisition.session.SessionFrame, mounting: rig.Mounting) -> AnyArray:
    return mounting.upright(frame.read())


def _unchanged(
    source: acquisition.Source, shots: list[_Shot], inputs: Inputs, notices: list[rig.Notice]
) -> list[_Shot]:
    """Return the images that the records of the result name, or that a file named there proves.

    The mark COMPLETE of a session contains the hash of its journal, and the journal those of the
    images, which are checked when they are read.
    """
    images = {shot.frame.path for shot in shots}
    others = [path for path in source.files if path not in images]
    wrong = [path for path in others if inputs.state(path) == "changed"]
    if wrong:
        notices.append(changed_notice(wrong, "the recording is not shown"))
        return []
    states = {path: inputs.state(path) for path in images}
    proven = source.kind == "session" and any(inputs.state(path) == "same" for path in others)
    if not proven and "same" not in states.values() and "changed" not in states.values():
        text = (
            f"{source.path}: the records name no file of the recording with its hash: the "
            "recording is not shown"
        )
        notices.append(rig.Notice("recording-unreadable", text))
        return []
    changed = sorted(path for path, state in states.items() if state == "changed")
    if changed:
        notices.append(changed_notice(changed, "they are not shown"))
    return [
        replace(shot, known=proven or states[shot.frame.path] == "same")
        for shot in shots
        if states[shot.frame.path] != "changed"
    ]


def _evenly(count: int) -> Int64:
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_IMAGES)).round().astype(np.int64))


def _region(folder: ResultFolder, maps: Embedded | None, shape: Sequence[int]) -> Crop | None:
    """Return the rectangle of the images that the maps show; None if it is not known."""
    if maps is None:
        return None
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
    pictures: list[tuple[_Shot, Float32]] = []
    bright: dict[float | None, float] = {}
    for shot in shots:
        with noted(notices, "recording"):
            part = shot.read()[region.rows, region.columns]
            signal = (reduced(part, _SIDE_PX) - source.black_level) / span
            picture = source.transfer.light(signal).astype(np.float32)
            pictures.append((shot, picture))
            key = shot.frame.exposure_us
            bright[key] = max(bright.get(key, 1e-6), float(np.percentile(picture, _BRIGHT)))
    found = []
    for shot, picture in pictures:
        frame = shot.frame
        recorded = frame.path.name, frame.light_id, frame.role, frame.exposure_us
        light = np.clip(picture / bright[frame.exposure_us], 0, 1)
        found.append(Image(*recorded, shot.status, shot.known, jpeg(light, _QUALITY)))
    return found
