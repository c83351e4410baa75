"""recording.json: metadata of exported images, so that they can be read without any loss.

The labels that it has, or a session, say what a recording is of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AwareDatetime, Field

from acquisition._errors import DataError, convert_read_errors, missing_path
from acquisition.files.storage import write_durably
from acquisition.files.text_files import parse_json, read_text
from acquisition.plan.planned_shot import Role
from acquisition.session.layout import MANIFEST
from acquisition.session.manifest import CameraRecord, Manifest, parse_manifest
from acquisition.session.value_records import Table, TransferRecord
from acquisition.source.nominal_camera import with_camera
from acquisition.source.source import Source
from acquisition.value_files.camera import read_camera
from acquisition.value_files.lights import read_lights
from acquisition.values.setup import Setup
from acquisition.values.transfer_curve import LINEAR
from rig import Notice, pluralize, read_bounded
from rig.files import MAX_TOML_BYTES

RECORD_FILE: Final = "recording.json"
# Fields of a session and of an export that say what they are of.
LABELS: Final = ("object", "operator", "place", "notes", "rights")

Values = Literal["raw", "linear"]
# Name of a file in the same folder.
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=255)]
# Other files of an export, which hold no further data.
_FOR_OTHERS = ("export.json", "alicevision_lights.json")


class ExportedFrame(Table):
    """One image: its file in the folder, and the shot of the session that it shows.

    ``led`` is the LED of a light, None for the other roles.
    """

    file: _Name
    role: Role
    led: Annotated[int, Field(ge=0)] | None
    bracket: Annotated[int, Field(ge=0)]
    repeat: Annotated[int, Field(ge=0)]
    exposure_us: Annotated[float, Field(gt=0)] | None
    gain_db: float | None


class RecordingNotes(Table):
    """Metadata that the layouts of other programs cannot hold.

    ``camera`` describes the samples of the exported files: if ``values`` is raw, samples and
    levels are those of the session; linear samples have black level 0 and white level 1 (EXR) or
    65535. ``subtracted`` names the offset that was subtracted. ``lights_file`` and
    ``camera_file`` name the files with the full data of the lights and of the camera model.
    ``transfer`` is the transfer curve of the samples, if they are not linear. ``origin`` is stated
    if rig or camera are simulated; earlier programs named only the camera.
    """

    format: Literal["sgp-recording"] = "sgp-recording"
    version: Literal[1] = 1
    values: Values
    subtracted: str
    object: str
    operator: str
    place: str
    notes: str
    rights: str
    started_utc: AwareDatetime
    camera: CameraRecord
    origin: Literal["simulated"] | None = None
    transfer: TransferRecord | None = None
    lights_file: _Name | None
    camera_file: _Name | None
    remarks: tuple[str, ...]
    frames: Annotated[tuple[ExportedFrame, ...], Field(min_length=1)]

    @property
    def simulated(self) -> bool:
        """Whether rig or camera are simulated, as far as the notes state it."""
        return self.origin == "simulated" or self.camera.simulated


def write_recording_notes(folder: Path, notes: RecordingNotes) -> Path:
    """Write the notes into the folder of an export; return the path of the file."""
    path = folder / RECORD_FILE
    left_out = {name for name in ("origin", "transfer") if getattr(notes, name) is None}
    write_durably(path, (notes.model_dump_json(indent=1, exclude=left_out) + "\n").encode())
    return path


def read_recording_notes(folder: Path) -> RecordingNotes | None:
    """Read the notes of an export; return None if the folder has no notes.

    Raises
    ------
    DataError
        If the file exists but is invalid.
    """
    path = folder / RECORD_FILE
    if not path.is_file():
        return None
    hint = "; restore the file, or delete it to read only the images"
    return parse_json(RecordingNotes, read_text(path), path, hint)


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
    lights = source.lights
    if notes.lights_file in present:
        lights = read_lights(folder / notes.lights_file)
    if notes.camera_file in present:
        source = with_camera(source, read_camera(folder / notes.camera_file))
    ours = (RECORD_FILE, *present)
    source = _with_facts(source, notes)
    return replace(
        source,
        frames=tuple(
            replace(frame, exposure_us=noted[frame.path.name].exposure_us)
            for frame in source.frames
        ),
        lights=lights,
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


@dataclass(frozen=True)
class Identity:
    """Object, circumstances and rights of a recording, for people; empty if not known.

    Parameters
    ----------
    object, operator, place, notes, rights
        As `Labels`.
    started_utc
        Start of the recording in ISO 8601 format.
    simulated
        Whether the rig or the camera was simulated.
    """

    object: str = ""
    operator: str = ""
    place: str = ""
    notes: str = ""
    rights: str = ""
    started_utc: str = ""
    simulated: bool = False


def read_identity(path: str | Path) -> Identity | None:
    """Return the identity that a file of a recording states.

    Parameters
    ----------
    path
        ``session.toml`` of a session or ``recording.json`` of an export.

    Returns
    -------
    Identity or None
        None for a file of another name.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If it is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Labels, import_frames, read_source, write_png
    >>> from acquisition.source import read_identity
    >>> write_png("card.png", np.full((4, 5), 700, np.uint16))
    >>> session = import_frames(read_source("card.png"), "session", Labels(object_name="card"))
    >>> read_identity("session/session.toml").object
    'card'
    """
    path = Path(path)
    if path.name == MANIFEST:
        with convert_read_errors(path):
            stated: Manifest | RecordingNotes = parse_manifest(
                read_bounded(path, MAX_TOML_BYTES), path
            )
    elif path.name == RECORD_FILE:
        notes = read_recording_notes(path.parent)
        if notes is None:
            raise missing_path(path, "file")
        stated = notes
    else:
        return None
    return Identity(
        **stated.model_dump(include=set(LABELS)),
        started_utc=stated.started_utc.isoformat(timespec="seconds"),
        simulated=stated.simulated,
    )
