"""Reader for a session as a source."""

from __future__ import annotations

from functools import partial
from math import inf, isqrt
from pathlib import Path

import numpy as np

from acquisition._errors import DataError
from acquisition.pixels.camera_raw import level_black
from acquisition.pixels.images import Image, read_image
from acquisition.pixels.mask_files import read_mask, read_mask_of
from acquisition.pixels.stated_facts import ImageFacts, ShotFacts
from acquisition.session.layout import COMPLETE, JOURNAL, MANIFEST, MASK, TRUE_MASK, TRUE_NORMALS
from acquisition.session.manifest import CameraRecord
from acquisition.session.session import Session
from acquisition.session.session_frame import SessionFrame
from acquisition.source.nominal_camera import of_focal_length
from acquisition.source.source import Frame, ReadOptions, Source
from acquisition.values.noise_model import NoiseModel
from acquisition.values.setup import Setup
from rig import Mounting, Notice, pluralize
from rig.arrays import Bool, Float32


def read_session(folder: Path, options: ReadOptions) -> Source:
    """Read a session, complete or not; missing frames become a warning.

    Frames are turned upright when they are read. Everything else refers to the upright image: the
    mask and the true normals from ``derived/``, if they exist, the camera and the filter pattern.

    Raises
    ------
    DataError
        If the session is damaged or has no frame, or if its frames have more pixels than
        allowed.
    """
    session, mask_path = Session.open(folder), options.mask_path
    device, mounting = session.manifest.camera, session.manifest.mounting
    if device.width * device.height > options.max_pixels:
        raise DataError(
            f"{folder}: frames of {device.width} x {device.height} pixels, {options.max_pixels} "
            "are allowed: raise the limit on pixels"
        )
    stored = mounting == Mounting() and device.black_levels_dn is None
    # Frames are loaded by the session, which checks the hash of the pixels.
    frames = tuple(
        Frame(
            recorded.path,
            recorded.light_id,
            mounting.upright_shape(recorded.shape),
            recorded.role,
            recorded.bracket,
            recorded.exposure_us,
            recorded.read if stored else partial(_read_upright, recorded, mounting, device),
            check_rows=recorded.check_rows if stored else None,
            gain_db=recorded.line.gain_db,
        )
        for recorded in session.frames
        if recorded.role != "repeat"
    )
    if not frames:
        raise DataError(f"{folder}: the session has no frames: record or resume it")
    warnings = list(session.warnings)
    if not session.complete:
        text = "the recording is not complete"
        warnings.append(Notice("session-incomplete", text, str(folder)))
    if session.missing:
        text = (
            f"{pluralize(len(session.missing), 'planned frame is', 'planned frames are')} missing, "
            f"the first is {session.missing[0].file}"
        )
        warnings.append(Notice("frames-missing", text, str(folder)))
    if session.left_out:
        leds = dict.fromkeys(str(shot.led) for shot in session.left_out)
        text = (
            f"{pluralize(len(session.left_out), 'planned frame was', 'planned frames were')} left "
            f"out because {'this LED' if len(leds) == 1 else 'these LEDs'} failed: "
            f"{', '.join(leds)}"
        )
        warnings.append(Notice("frames-left-out", text, str(folder)))
    height, width, *_ = mounting.upright_shape((device.height, device.width))
    size = (height, width)
    if mask_path is None:
        masks = (folder / MASK, folder / TRUE_MASK)
        mask_path = next((path for path in masks if path.exists()), None)
    camera, nominal = session.camera_model, _stated_focal_px(session)
    if camera is None and nominal is not None:
        camera, of_camera = of_focal_length(nominal, size, "Exif, when imported", folder)
        warnings += of_camera
    truth = folder / TRUE_NORMALS
    others = [folder / name for name in (MANIFEST, JOURNAL, COMPLETE)] + [truth]
    return Source(
        path=folder,
        kind="session",
        frames=frames,
        lights=session.lights,
        mask=_mask(session, mask_path, size) if mask_path else None,
        mask_path=mask_path,
        camera=camera,
        camera_nominal=session.camera_model is None and camera is not None,
        normals_truth=_true_normals(truth, size) if truth.exists() else None,
        cfa=_upright_cfa(session, folder),
        black_level=device.black_level_dn,
        white_level=device.white_dn,
        simulated=session.manifest.simulated,
        setup=Setup(
            "" if session.manifest.rig is None else session.manifest.rig.name,
            device.vendor,
            device.model,
            device.serial,
        ),
        recorded_utc=session.manifest.started_utc,
        noise=_noise_at_gain(session),
        transfer=options.transfer or session.transfer,
        transfer_origin="given" if options.transfer else MANIFEST,
        files=(
            *(frame.path for frame in frames),
            *([mask_path] if mask_path else []),
            *(path for path in others if path.exists()),
        ),
        warnings=tuple(warnings),
    )


def _mask(session: Session, path: Path, size: tuple[int, int]) -> Bool:
    """Return a mask; one that is not part of the session must be turned as its images are."""
    if session.folder in path.parents:
        return read_mask(path, size)
    tags = (line.details.get("orientation") for line in session.events)
    shot = ShotFacts(orientation=next((tag for tag in tags if isinstance(tag, int)), 1))
    return read_mask_of(path, ImageFacts(path, shot), size)


def _stated_focal_px(session: Session) -> float | None:
    """Return the focal length that imported images stated."""
    stated = (line.details.get("focal_length_px") for line in session.events)
    return next((one for one in stated if isinstance(one, float) and 0 < one < inf), None)


def _noise_at_gain(session: Session) -> NoiseModel | None:
    """Return the sensor at the gain of the frames; None if it is unknown or gains differ."""
    gains_db = {frame.line.gain_db or 0.0 for frame in session.frames}
    if session.sensor is None or len(gains_db) > 1:
        return None
    return session.sensor.at_gain(gains_db.pop())


def _read_upright(recorded: SessionFrame, mounting: Mounting, device: CameraRecord) -> Image:
    pixels = recorded.read()
    if device.black_levels_dn is not None:
        side = isqrt(len(device.black_levels_dn))
        levels = np.reshape(device.black_levels_dn, (side, side))
        pixels = level_black(pixels, levels, device.black_level_dn, device.white_dn)
    return mounting.upright(pixels)


def _upright_cfa(session: Session, folder: Path) -> str | None:
    device, mounting = session.manifest.camera, session.manifest.mounting
    if device.cfa is None or mounting == Mounting():
        return device.cfa
    try:
        return mounting.upright_cfa(device.cfa, (device.height, device.width))
    except ValueError as error:
        raise DataError(f"{folder / MANIFEST}: {error}: correct cfa in [camera]") from error


def _true_normals(path: Path, size: tuple[int, int]) -> Float32:
    normals = read_image(path, max_pixels=size[0] * size[1])
    if normals.dtype != np.float32 or normals.shape != (*size, 3):
        raise DataError(
            f"{path}: {normals.dtype} of shape {normals.shape} are not normals of images of "
            f"{size[1]} x {size[0]} pixels: delete the file"
        )
    return normals.astype(np.float32, copy=False)
