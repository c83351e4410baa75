"""Metadata from recording.json, which an export writes because its layout cannot hold them."""

from __future__ import annotations

from dataclasses import replace

from acquisition._errors import DataError
from acquisition._source.recording_json import RECORD_FILE, RecordingNotes, read_recording_notes
from acquisition._source.source import Source
from acquisition._value_files.camera import read_camera
from acquisition._value_files.lights import read_lights
from acquisition._values.setup import Setup
from acquisition._values.transfer_curve import LINEAR
from rig import Notice, pluralize

# Other files of an export, which hold no further data.
_FOR_OTHERS = ("export.json", "alicevision_lights.json")


def with_export_notes(source: Source) -> Source:
    """Take levels, filter pattern, curve, exposures, lights and camera from a ``recording.json``.

    The file is in the folder of the images. Without it, and for an EXR stack, whose floats have no
    saturation level, the source is returned unchanged; but floats with another transfer curve get
    this curve and its levels.

    Raises
    ------
    DataError
        If the file, or an existing file that it names, is invalid, or if an image that it lists is
        missing.
    """
    folder = source.path if source.path.is_dir() else source.path.parent
    notes = None if source.kind == "session" else read_recording_notes(folder)
    if notes is None:
        return source
    if source.frames[0].path.suffix.lower() == ".exr":
        source = _with_facts(source, notes)
        if source.transfer == LINEAR:
            return source
        black, white = notes.camera.black_level_dn, notes.camera.white_dn
        return replace(source, black_level=black, white_level=white)
    noted = {frame.file: frame for frame in notes.frames}
    strange = next((f.path for f in source.frames if f.path.name not in noted), None)
    if strange is not None:
        text = f"is not in {RECORD_FILE} of the same folder, which is not used"
        notice = Notice("image-not-in-record", text, str(strange))
        return replace(source, simulated=notes.simulated, warnings=(*source.warnings, notice))
    missing = [frame.file for frame in notes.frames if not (folder / frame.file).is_file()]
    if missing:
        words = (f"image that {RECORD_FILE} lists is", f"images that {RECORD_FILE} lists are")
        raise DataError(
            f"{folder}: {pluralize(len(missing), *words)} missing, the first is "
            f"{missing[0]}: restore them, or export the session again"
        )
    named = [name for name in (notes.lights_file, notes.camera_file) if name is not None]
    present = [name for name in named if (folder / name).is_file()]
    lost = tuple(
        Notice(
            "export-file-missing",
            f"{name}, which {RECORD_FILE} names, is missing: the data of the layout are used",
            str(folder),
        )
        for name in named
        if name not in present
    )
    lights, camera = source.lights, source.camera
    if notes.lights_file in present:
        lights = read_lights(folder / notes.lights_file)
    if notes.camera_file in present:
        camera = read_camera(folder / notes.camera_file)
    ours = (RECORD_FILE, *present)
    source = _with_facts(source, notes)
    return replace(
        source,
        frames=tuple(
            replace(frame, exposure_us=noted[frame.path.name].exposure_us)
            for frame in source.frames
        ),
        lights=lights,
        camera=camera,
        cfa=notes.camera.cfa,
        black_level=notes.camera.black_level_dn,
        white_level=notes.camera.white_dn,
        files=(*source.files, *(folder / name for name in present)),
        ignored=tuple(name for name in source.ignored if name not in (*ours, *_FOR_OTHERS)),
        warnings=(*source.warnings, *lost),
    )


def _with_facts(source: Source, notes: RecordingNotes) -> Source:
    """Return the source with camera, time, origin and transfer curve of the notes.

    A transfer curve that the caller gave stays.
    """
    camera = notes.camera
    setup = Setup("", camera.vendor, camera.model, camera.serial)
    folder = source.path if source.path.is_dir() else source.path.parent
    source = replace(
        source,
        setup=setup,
        recorded_utc=notes.started_utc,
        simulated=notes.simulated,
        files=(*source.files, folder / RECORD_FILE),
    )
    if source.transfer_origin == "given":
        return source
    curve = LINEAR if notes.transfer is None else notes.transfer.value()
    return replace(source, transfer=curve, transfer_origin=RECORD_FILE)
