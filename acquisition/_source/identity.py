"""What a recording is of: the labels, the date and the origin that its files state."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from acquisition._errors import convert_read_errors, missing_path
from acquisition._session.layout import MANIFEST
from acquisition._session.manifest import Manifest, parse_manifest
from acquisition._source.recording_json import RECORD_FILE, RecordingNotes, read_recording_notes
from rig import MAX_TOML_BYTES, read_bounded


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
    >>> from acquisition import Labels, import_frames, read_identity, read_source, write_png
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
        stated.object,
        stated.operator,
        stated.place,
        stated.notes,
        stated.rights,
        stated.started_utc.isoformat(),
        stated.simulated,
    )
