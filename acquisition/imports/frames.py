"""Import of recordings from elsewhere into a session."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from acquisition._errors import DataError
from acquisition.files.storage import disk, make_folder
from acquisition.imports.image import ImportedImage, imported_image, read_for_import
from acquisition.pixels.images import write_exr
from acquisition.pixels.mask_files import write_mask
from acquisition.pixels.stated_facts import image_facts
from acquisition.plan.planned_shot import PlannedShot
from acquisition.session.journal import FrameLine
from acquisition.session.layout import MASK, TRUE_NORMALS
from acquisition.session.manifest import Calibrations, Labels, Manifest
from acquisition.session.session import Session
from acquisition.session.value_records import TransferRecord
from acquisition.session.writer import CameraReport, SessionWriter
from acquisition.source.reader import read_source
from acquisition.source.recording_json import RecordingNotes, read_recording_notes
from acquisition.source.source import Frame, Source
from acquisition.values.camera_model import CameraModel
from acquisition.values.image_names import is_raw
from acquisition.values.lights import Lights, led_id, led_of
from acquisition.values.running_numbers import order_doubt
from acquisition.values.transfer_curve import TransferCurve
from rig import MAX_PIXELS, Progress, no_progress

# Larger numbers are those of a camera (L1000001.DNG).
_LAST_LED = 9999
_IMPORTED = "imported"


def read_import(
    path: str | Path,
    *,
    lights: Lights | None = None,
    camera: CameraModel | None = None,
    mask_path: Path | None = None,
    transfer: TransferCurve | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Source:
    """Read a source for import.

    Parameters and errors are those of `read_source`. In addition, a DataError is raised if the
    source is an export of floats, which a session cannot hold.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import write_png
    >>> from acquisition.imports import read_import
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> read_import("card.png")
    Source(card.png, images, 1 frame of 5 x 4 px)
    """
    path = Path(path)
    notes = read_recording_notes(_folder(path)) if path.exists() else None
    if notes is not None and Path(notes.frames[0].file).suffix == ".exr":
        raise DataError(
            f"{path}: an EXR stack holds floats, but a session holds whole numbers: "
            "export the session as lp, diligent or alicevision to import it again"
        )
    return read_source(
        path,
        lights=lights,
        camera=camera,
        mask_path=mask_path,
        transfer=transfer,
        max_pixels=max_pixels,
    )


def import_frames(
    source: Source,
    folder: str | Path,
    labels: Labels = Labels(),
    *,
    on_progress: Progress = no_progress,
) -> Session:
    """Write the frames of a source into a new session without changing any sample.

    Parameters
    ----------
    source
        Source from `read_import` or `read_source`: images, camera RAW or a DiLiGenT folder. 8-bit
        samples keep their values in 16-bit files, with white level 255. The transfer curve is
        recorded, and CFA pattern, black and white level, exposures, lights and camera if known.
        Mask and true normals are written into ``derived/``, where `read_source` finds them.
    folder
        New or empty folder.
    labels
        Texts for people. An empty one is taken from the ``recording.json`` of an export.
    on_progress
        Receives the stage ``importing``, one step per frame.

    Returns
    -------
    Session
        Complete session without a plan or a rig. Image i is recorded as LED i, or as the LED that
        ``recording.json`` or the file name gives (``L07.png``); its light is named after the same
        LED, and the journal keeps the name of the original file. An ``imported`` event records the
        metadata that has no other place in the format: sensitivity, black level by colour, the
        focal length of `Source.camera_nominal`.

    Raises
    ------
    DataError
        If the source is already a session or holds float samples, if an image is damaged or of
        another kind than the first, or if the order of the images cannot be known.
    StorageError
        If the folder is not empty or cannot be written.

    Notes
    -----
    If an image is refused midway, nothing remains of the session. After another error an incomplete
    session remains, as a note of the error states. The images are unchanged.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Labels, import_frames, read_source, write_png
    >>> for i in range(3):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 700, np.uint16))
    >>> import_frames(read_source("."), "session", Labels(object_name="card"))
    Session(session, 3 frames, complete)
    """
    if source.kind == "session":
        raise DataError(f"{source.path}: is already a session: copy the folder")
    record = _notes_of(source)
    # Fail before a folder is created if the images are of another kind or the first is damaged.
    first = _read(source.frames[0], source)
    shots = _shots(source, record)
    lights = source.lights
    if lights is not None:
        leds = [shot.led or 0 for shot in shots if shot.role == "light"]
        lights = replace(lights, ids=tuple(map(led_id, leds)))
    others: dict[str, Any] = {"origin": "simulated" if source.simulated else None}
    if record is not None:
        noted = Labels(record.operator, record.object, record.place, record.notes, record.rights)
        labels = replace(noted, **{name: text for name, text in asdict(labels).items() if text})
        others["started_utc"] = record.started_utc
    manifest = Manifest.begin(
        folder,
        camera=_camera(first, source, record),
        labels=labels,
        calibrations=Calibrations(camera_model=source.calibrated_camera, lights=lights),
        transfer=TransferRecord.of(source.transfer),
        **others,
    )
    there = Path(folder).exists()
    writer = SessionWriter.create(folder, manifest)
    try:
        with writer:
            _write_maps(source, writer.folder)
            metadata = camera_metadata(first)
            if source.camera is not None and source.camera_nominal and source.reduction is None:
                metadata["focal_length_px"] = source.camera.focal_px
            writer.write_event(_IMPORTED, **metadata, source=source.path.name)
            for done, (frame, shot) in enumerate(zip(source.frames, shots, strict=True), 1):
                image = first if done == 1 else _read(frame, source)
                image.check_like(first)
                write_imported(writer, shot, image, exposure_us=frame.exposure_us)
                on_progress("importing", done, len(shots))
            writer.complete()
    except DataError:
        _remove_session(Path(folder), there=there)
        raise
    except BaseException as error:
        error.add_note(f"{folder}: an incomplete session remains: delete it, then import again")
        raise
    return Session.open(folder)


def _remove_session(folder: Path, *, there: bool) -> None:
    """Remove a session that this process has begun in a new or empty folder, which was there."""
    with disk(folder, "remove"):
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        if not there:
            folder.rmdir()


def write_imported(
    writer: SessionWriter,
    shot: PlannedShot,
    image: ImportedImage,
    *,
    exposure_us: float | None = None,
) -> FrameLine:
    """Store an image as a frame, with the exposure and time that its camera recorded.

    ``exposure_us``, if given, replaces the exposure from the file. Errors are those of
    `SessionWriter.write_frame`.
    """
    taken = image.facts.shot.taken
    return writer.write_frame(
        shot,
        image.pixels,
        report=CameraReport(
            exposure_us=image.facts.shot.time_us if exposure_us is None else exposure_us,
            timestamp_ns=None if taken is None else round(taken.timestamp()) * 10**9,
        ),
        origin=image.path.name,
    )


def camera_metadata(image: ImportedImage) -> dict[str, Any]:
    """Return the camera metadata of an image as details of an event."""
    shot = image.facts.shot
    return {
        "iso": shot.iso,
        "f_number": shot.f_number,
        "orientation": shot.orientation,
        "black_levels_dn": list(image.black_levels_dn),
        "vendor": shot.vendor,
        "model": shot.model,
    }


def camera_of(image: ImportedImage) -> dict[str, Any]:
    """Return the fields of `CameraRecord` for an image."""
    height, width = image.pixels.shape[:2]
    return {
        "width": width,
        "height": height,
        "channels": 3 if image.pixels.ndim == 3 else 1,
        "bit_depth": image.bit_depth,
        "cfa": image.cfa,
        "vendor": image.facts.shot.vendor,
        "model": image.facts.shot.model,
        "black_level_dn": image.black_level_dn,
        "white_level_dn": image.white_level_dn,
        "black_levels_dn": image.black_levels_dn if len(set(image.black_levels_dn)) > 1 else None,
    }


def _camera(first: ImportedImage, source: Source, record: RecordingNotes | None) -> dict[str, Any]:
    camera = camera_of(first) | {
        "cfa": source.cfa,
        "black_level_dn": source.black_level,
        "white_level_dn": source.white_level,
    }
    if record is not None:
        kept = record.camera.model_dump(include={"bit_depth", "vendor", "model", "serial"})
        camera |= {name: value for name, value in kept.items() if value}
    return camera


def _folder(path: Path) -> Path:
    return path if path.is_dir() else path.parent


def _notes_of(source: Source) -> RecordingNotes | None:
    """Return the notes of an export if they list all frames of the source, else None."""
    notes = read_recording_notes(_folder(source.path))
    if notes is None:
        return None
    noted = {frame.file for frame in notes.frames}
    return notes if all(frame.path.name in noted for frame in source.frames) else None


def _shots(source: Source, record: RecordingNotes | None) -> list[PlannedShot]:
    """Return the shot that each image shows."""
    frames = source.frames
    if record is not None:
        noted = {frame.file: frame for frame in record.frames}
        return [
            PlannedShot(shot.role, shot.led, shot.bracket, shot.repeat, shot.exposure_us)
            for shot in (noted[frame.path.name] for frame in frames)
        ]
    lit = [frame for frame in frames if frame.role == "light"]
    leds = list(range(len(lit)))
    names = [frame.path.name for frame in lit]
    by_name = [led for name in names if (led := led_of(name)) is not None]
    if len(by_name) == len(lit) == len(set(by_name)) and max(by_name) <= _LAST_LED:
        leds = by_name
    # Other sources list their images in order, and lights belong to names.
    elif source.kind == "images" and source.lights is None and (doubt := order_doubt(names)):
        raise DataError(f"{source.path}: {doubt}")
    shots = {
        frame.path: PlannedShot("light", led, 0, 0, frame.exposure_us)
        for led, frame in zip(leds, lit, strict=True)
    }
    repeats: Counter[str] = Counter()
    for frame in frames:
        if frame.role != "light":
            repeat = repeats[frame.role]
            repeats[frame.role] += 1
            shots[frame.path] = PlannedShot(frame.role, None, 0, repeat, frame.exposure_us)
    return [shots[frame.path] for frame in frames]


def _read(frame: Frame, source: Source) -> ImportedImage:
    if is_raw(frame.path):
        return read_for_import(frame.path, max_pixels=frame.max_pixels)
    facts = image_facts(frame.path, max_pixels=frame.max_pixels)
    return imported_image(facts, frame.read_stored())


def _write_maps(source: Source, folder: Path) -> None:
    if source.mask is not None:
        make_folder((folder / MASK).parent)
        write_mask(folder / MASK, source.mask)
    if source.normals_truth is not None:
        make_folder((folder / TRUE_NORMALS).parent)
        write_exr(folder / TRUE_NORMALS, source.normals_truth)
