"""Recordings made elsewhere, brought into a session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._images import Image, write_exr, write_png
from acquisition._journal import FrameLine
from acquisition._lights import led_id
from acquisition._manifest import Manifest
from acquisition._plan import PlannedShot
from acquisition._session import MASK, TRUE_NORMALS, Session
from acquisition._session_writer import SessionWriter
from acquisition._source import Source
from acquisition._storage import make_folder


def import_frames(
    source: Source,
    folder: str | Path,
    *,
    operator: str,
    object_name: str,
    notes: str = "",
    on_frame: Callable[[FrameLine, int, int], None] | None = None,
) -> Session:
    """Write the frames of a source into a new session, sample for sample.

    Parameters
    ----------
    source
        What `read_source` made of images, camera RAW or a DiLiGenT folder. 8-bit samples keep
        their values in 16-bit files, with white level 255. CFA pattern, black and white level,
        lights and camera are recorded where known. Mask and true normals go into ``derived/``,
        where `read_source` finds them.
    folder
        New or empty folder.
    operator, object_name, notes
        Who imports what, for people.
    on_frame
        Called after each frame with its journal line, how many are done, and how many there are.

    Returns
    -------
    Session
        Complete, without a plan or a rig. Image i is filed under LED i and bracket 0, and its
        light is called so too; the journal keeps the name of the file it came from.

    Raises
    ------
    DataError
        If the source is a session already, or holds float samples, or an image is damaged.
    StorageError
        If the folder is not empty, or the disk refuses.

    Notes
    -----
    After an error in mid-way the session stays behind incomplete, of which a note of the error
    tells, and the images are as they were.
    """
    if source.kind == "session":
        raise DataError(f"{source.path}: is a session already: copy the folder")
    # Before a folder is made: images of another kind, or a first one that is damaged.
    _sixteen_bit(source.frames[0].read(), source.frames[0].path)
    height, width = source.size
    lights = source.lights
    if lights is not None:
        lights = replace(lights, ids=tuple(map(led_id, range(len(lights)))))
    manifest = Manifest.begin(
        folder,
        operator=operator,
        object=object_name,
        notes=notes,
        camera={
            "width": width,
            "height": height,
            "channels": 3 if len(source.frames[0].shape) == 3 else 1,
            "bit_depth": max(8, int(source.white_level).bit_length()),
            "cfa": source.cfa,
            "black_level_dn": source.black_level,
            "white_level_dn": source.white_level,
        },
        camera_model=source.camera,
        lights=lights,
    )
    with SessionWriter.create(folder, manifest) as writer:
        try:
            _write_maps(source, writer.folder)
            for led, frame in enumerate(source.frames):
                line = writer.write_frame(
                    PlannedShot("light", led, 0, 0, frame.exposure_us),
                    _sixteen_bit(frame.read(), frame.path),
                    origin=frame.path.name,
                )
                if on_frame is not None:
                    on_frame(line, led + 1, len(source.frames))
            writer.complete()
        except BaseException as error:
            error.add_note(
                f"{folder}: an incomplete session stays behind: delete it, then import again"
            )
            raise
    return Session.open(folder)


def _write_maps(source: Source, folder: Path) -> None:
    if source.mask is not None:
        make_folder((folder / MASK).parent)
        write_png(folder / MASK, source.mask.astype(np.uint8) * 255)
    if source.normals_truth is not None:
        make_folder((folder / TRUE_NORMALS).parent)
        write_exr(folder / TRUE_NORMALS, source.normals_truth)


def _sixteen_bit(pixels: Image, path: Path) -> npt.NDArray[np.uint16]:
    if pixels.dtype.kind != "u":
        raise DataError(f"{path}: a session holds whole numbers: save it as 8 or 16 bit")
    return pixels.astype(np.uint16)
