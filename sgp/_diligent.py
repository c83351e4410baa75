"""Write sessions as object folders of the DiLiGenT benchmark (Shi et al., 2016)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
import rig

_FULL = 65535


def write_diligent(
    folder: Path,
    session: acquisition.Session,
    lights: acquisition.Lights,
    *,
    normals: npt.NDArray[np.float32] | None = None,
    mask: npt.NDArray[np.bool_] | None = None,
    on_progress: rig.Progress = rig.no_progress,
) -> list[Path]:
    """Write 16-bit linear PNGs with file names, lights, mask and true normals.

    Each image is a frame minus the dark frame of its exposure time, scaled to 65535 at the white
    level. Saturated pixels stay saturated. Noise below zero is clipped, because the layout has
    neither dark frames nor a black level. The layout has light directions only: near lights are
    written as directions from the origin.

    Parameters
    ----------
    folder
        Existing output folder.
    session
        Session with grey frames. The first exposure of each light and its first repeat are used.
    lights
        One light for each LED of the session, by id.
    normals, mask
        True normals of shape ``(H, W, 3)`` and mask of shape ``(H, W)``, if known.
    on_progress
        Receives the stage ``images``, one step per image.

    Returns
    -------
    list of Path
        All files written.

    Raises
    ------
    DataError
        If the session has colour or a filter mosaic, lacks its dark frame, or a light is missing.
    StorageError
        If a file cannot be written.
    """
    camera = session.manifest.camera
    if camera.channels != 1 or camera.cfa is not None:
        raise acquisition.DataError(
            f"{session.folder}: colour frames cannot be written in the DiLiGenT layout: use the "
            "session itself"
        )
    shots: dict[str, acquisition.SessionFrame] = {}
    for shot in session.frames:
        if shot.role == "light":
            shots.setdefault(shot.light_id, shot)
    darks = {shot.exposure_us: shot.read() for shot in session.frames if shot.role == "dark"}
    indices, by_name = lights.match(tuple(shots))
    if not by_name:
        raise acquisition.DataError(
            f"{session.folder}: its LEDs do not match the lights: the ids must be the same"
        )
    matched = lights.take(indices)
    names = []
    for done, shot in enumerate(shots.values(), 1):
        if shot.exposure_us not in darks:
            raise acquisition.DataError(
                f"{shot.path}: no dark frame of the same exposure time: record one"
            )
        raw = shot.read().astype(np.float64)
        signal = (raw - darks[shot.exposure_us]) / (camera.white_dn - camera.black_level_dn)
        signal[raw >= camera.white_dn] = 1.0
        names.append(f"{done:03d}.png")
        acquisition.write_png(
            folder / names[-1], np.rint(np.clip(signal, 0, 1) * _FULL).astype(np.uint16)
        )
        on_progress("images", done, len(shots))
    files = [folder / name for name in names]
    if mask is not None:
        files.append(folder / "mask.png")
        acquisition.write_png(files[-1], mask.astype(np.uint8) * np.uint8(255))
    if normals is not None:
        files.append(folder / "Normal_gt.mat")
        acquisition.write_normals_mat(files[-1], normals)
    tables = {
        "light_directions.txt": _rows(matched.unit_directions),
        "light_intensities.txt": _rows(np.asarray(matched.intensities)),
        "filenames.txt": "".join(f"{name}\n" for name in names),
    }
    for name, text in tables.items():
        files.append(folder / name)
        acquisition.write_durably(files[-1], text.encode())
    return files


def _rows(table: npt.NDArray[np.float64]) -> str:
    return "".join(" ".join(f"{value:.10f}" for value in row) + "\n" for row in table)
