"""recording.json: metadata of exported images, so that they can be read without any loss."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from acquisition._json import parse_json
from acquisition._plan.planned_shot import Role
from acquisition._session.manifest import CameraRecord
from acquisition._session.value_records import TransferRecord
from acquisition._storage import write_durably
from acquisition._text_files import read_text

RECORD_FILE: Final = "recording.json"

Values = Literal["raw", "linear"]
# Name of a file in the same folder.
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=255)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ExportedFrame(_Record):
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


class RecordingNotes(_Record):
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
