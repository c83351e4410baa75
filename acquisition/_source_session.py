"""A session as a source."""

from __future__ import annotations

from pathlib import Path

from acquisition._errors import DataError
from acquisition._mask_files import read_mask
from acquisition._session import Session
from acquisition._source import Frame, Source


def read_session(folder: Path, mask_path: Path | None = None) -> Source:
    """Read a session, complete or not: what is missing becomes a warning.

    Raises
    ------
    DataError
        If it is damaged or holds no frame.
    """
    session = Session.open(folder)
    device = session.manifest.camera
    # The session's own reader checks the hash of the pixels.
    frames = tuple(
        Frame(
            recorded.path,
            recorded.light_id,
            recorded.shape,
            recorded.role,
            recorded.bracket,
            recorded.exposure_us,
            recorded.read,
        )
        for recorded in session.frames
    )
    if not frames:
        raise DataError(f"{folder}: a session without any frame: record or resume it")
    warnings = list(session.warnings)
    if not session.complete:
        warnings.append(f"{folder}: the recording was not brought to its end")
    if session.missing:
        warnings.append(
            f"{folder}: {len(session.missing)} planned frames are missing, first "
            f"{session.missing[0].file}"
        )
    return Source(
        path=folder,
        kind="session",
        frames=frames,
        lights=session.lights,
        mask=read_mask(mask_path, (device.height, device.width)) if mask_path else None,
        camera=session.camera_model,
        cfa=device.cfa,
        black_level=device.black_level_dn,
        white_level=device.white_dn,
        warnings=tuple(warnings),
    )
