"""recording.json: what the images of an export are, so that reading them loses nothing of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from acquisition._json import parse_json
from acquisition._plan.planned_shot import Role
from acquisition._session.manifest import CameraRecord
from acquisition._storage import write_durably
from acquisition._text_files import read_text

RECORD_FILE: Final = "recording.json"

Values = Literal["raw", "linear"]
# A file in the same folder.
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=255)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ExportedFrame(_Record):
    """One image: its file in the folder, and the shot of the session it was made from."""

    file: _Name
    role: Role
    led: Annotated[int, Field(ge=0)] | None
    bracket: Annotated[int, Field(ge=0)]
    repeat: Annotated[int, Field(ge=0)]
    exposure_us: Annotated[float, Field(gt=0)] | None
    gain_db: float | None


class RecordingNotes(_Record):
    """Everything that the layouts of others have no place for.

    ``camera`` describes the samples of the files here: with ``values`` raw they are those of the
    session and its levels; linear ones have black 0, and 1 (EXR) or 65535 as white. ``subtracted``
    says what was taken off. ``lights_file`` and ``camera_file`` name the files with all that is
    known of the lights and of the camera as geometry.
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
    lights_file: _Name | None
    camera_file: _Name | None
    remarks: tuple[str, ...]
    frames: Annotated[tuple[ExportedFrame, ...], Field(min_length=1)]


def write_recording_notes(folder: Path, notes: RecordingNotes) -> Path:
    """Write the notes into the folder of an export; return the file."""
    path = folder / RECORD_FILE
    write_durably(path, (notes.model_dump_json(indent=1) + "\n").encode())
    return path


def read_recording_notes(folder: Path) -> RecordingNotes | None:
    """Read the notes of an export; None where the folder has none.

    Raises
    ------
    DataError
        If the file is there and is not understood.
    """
    path = folder / RECORD_FILE
    if not path.is_file():
        return None
    hint = "; restore the file, or delete it to read the images alone"
    return parse_json(RecordingNotes, read_text(path), path, hint)
