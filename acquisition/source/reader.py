"""One reader for recordings of every kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from acquisition._errors import DataError, missing_path, named
from acquisition.files.staging import check_staging_finished
from acquisition.pixels.high_bits import high_bits_notice, high_bits_of, white_level_of
from acquisition.session.layout import MANIFEST, is_session
from acquisition.source.clipping import with_clipped
from acquisition.source.diligent import is_diligent, read_diligent
from acquisition.source.exclusion import exclude
from acquisition.source.image_folder import images_source, lp_files, read_images, read_lp_folder
from acquisition.source.nominal_camera import with_camera
from acquisition.source.recording_json import RECORD_FILE, with_export_notes
from acquisition.source.series_facts import transfer_notices, with_time_errors
from acquisition.source.session_source import read_session
from acquisition.source.source import MaskOrigin, ReadOptions, Source
from acquisition.values.camera_model import CameraModel
from acquisition.values.image_names import light_id
from acquisition.values.lights import Lights, led_of
from acquisition.values.transfer_curve import TransferCurve
from rig import MAX_PIXELS, Notice, listed

_FULL = 65535.0
_NAMED = 8


def read_source(
    path: str | Path,
    *,
    lights: Lights | None = None,
    mask_path: Path | None = None,
    camera: CameraModel | None = None,
    transfer: TransferCurve | None = None,
    without: Sequence[str] = (),
    max_pixels: int = MAX_PIXELS,
) -> Source:
    """Detect the kind of a recording and read everything except its pixels.

    The white level needs the pixels (docs/importing.md): they are read, but not kept.

    Parameters
    ----------
    path
        A session, a DiLiGenT object folder, a folder of images with an .lp file (or the .lp file
        itself), a plain folder of images, or one image file. In a plain folder the frames are the
        images that differ only in one number, in the order of it; ``mask.*`` or ``*.mask.*`` is the
        mask, or else the alpha channel of the images, unless it is opaque everywhere; ``dark*`` and
        ``ambient*`` are dark and ambient frames. In an export written by this package,
        ``recording.json`` gives levels, filter pattern and exposures, and names the files with the
        full data of lights and camera.
    lights
        Lights to use instead of those of the source: matched by id, or by number or order with a
        warning, as in `Lights.match`.
        Images whose light a calibration left out are not used, and named in a notice.
    mask_path
        Mask to use instead of that of the source.
    camera
        Camera to use instead of that of the source. Default: that of the session or of
        ``recording.json``; else one with the focal length that all images state in Exif, if they
        were not cropped (`Source.camera_nominal`); a notice reports it.
    transfer
        Transfer curve of the samples. Default: that of the session or of ``recording.json``; else
        the one that the metadata of the images state (ICC profile, Exif colour space, chunks of
        PNG); else sRGB for JPEG, WebP and JPEG XL with 8 bits, and linear for all others. A notice
        reports the choice, except linear for more than 8 bits.
    without
        Images to leave out, as in `exclude`. They need no light. Lights that are matched by order
        belong to all images if there are as many, else to those that are left.
    max_pixels
        Largest allowed number of pixels per image, checked before anything is decoded.

    Returns
    -------
    Source
        Recording whose frames are read one by one on request.

    Raises
    ------
    MissingPathError
        If ``path`` or ``mask_path`` does not exist.
    DataError
        If the path is not a recording of these kinds, its export was interrupted, or its parts do
        not match: counts of images and lights, sizes of images, mask, camera and true normals,
        transfer curves of images; or if an image has more than ``max_pixels`` pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights, read_source, write_png
    >>> for i in range(3):
    ...     write_png(f"cat.{i}.png", np.full((4, 5), 700, np.uint16))
    >>> source = read_source(".", lights=Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1]]))
    >>> source
    Source(., images, 3 frames of 5 x 4 px, lights)
    >>> source.light_ids
    ('cat.0', 'cat.1', 'cat.2')
    """
    path = Path(path)
    if not path.exists():
        raise missing_path(path)
    check_staging_finished(path if path.is_dir() else path.parent)
    options = ReadOptions(mask_path, max_pixels, transfer)
    source = with_export_notes(_dispatch(path, options))
    source = _with_notice(_with_high_bits(source))
    source = replace(source, mask_origin=_mask_origin(source, given=mask_path is not None))
    if camera is not None:
        source = with_camera(source, camera)
    if source.camera is not None and source.camera.size != source.size:
        height, width = source.size
        raise DataError(
            f"{path}: images of {width} x {height} pixels, but a camera of {source.camera.width} x "
            f"{source.camera.height}: give the camera that took them"
        )
    return with_clipped(_with_matched_lights(source, lights or source.lights, without))


def _dispatch(path: Path, options: ReadOptions) -> Source:
    if path.suffix.lower() == ".lp" and path.is_file():
        return read_lp_folder(path.parent, path, options)
    if not path.is_dir():
        return images_source(path, [path], options)
    if is_session(path):
        return read_session(path, options)
    if is_diligent(path):
        return read_diligent(path, options)
    lps = lp_files(path)
    if len(lps) > 1:
        raise DataError(f"{path}: has {lps[0].name} and {lps[1].name}: give one of these .lp files")
    if lps:
        return read_lp_folder(path, lps[0], options)
    return read_images(path, options)


def _with_notice(source: Source) -> Source:
    """Add the notice about the transfer curve if neither the caller nor our own files gave it."""
    origin = source.transfer_origin
    if origin in ("given", MANIFEST, RECORD_FILE):
        return source
    notices = transfer_notices(source.transfer, origin, source.white_level, str(source.path))
    return replace(source, warnings=(*source.warnings, *notices))


def _with_high_bits(source: Source) -> Source:
    """Set the white level of images whose samples are in the high bits, and add a notice."""
    if source.white_level != _FULL or source.kind == "session" or source.cfa is not None:
        return source
    first = next((frame for frame in source.frames if frame.role == "light"), source.frames[0])
    bits = None if first.load is not None else high_bits_of(first.read())
    if bits is None:
        return source
    notice = high_bits_notice(bits, str(source.path))
    warnings = (*source.warnings, notice)
    return replace(source, white_level=white_level_of(bits), warnings=warnings)


def _mask_origin(source: Source, *, given: bool) -> MaskOrigin | None:
    if source.mask is None or source.mask_origin == "alpha":
        return source.mask_origin
    if given:
        return "given"
    # An export may be a plain folder too, but its mask comes from a session.
    plain = source.kind == "images" and not (source.path / RECORD_FILE).exists()
    return "folder" if plain else "recording"


def _with_matched_lights(source: Source, lights: Lights | None, without: Sequence[str]) -> Source:
    """Assign one light to each light id of the frames, in their order and with their ids."""
    everything = source.light_ids
    source = replace(source, lights=None)
    if without:
        source = exclude(source, without)
    if lights is None or not everything:
        return source
    unlit = [name for name in _unlit(everything, lights) if name in source.light_ids]
    if unlit:
        source = _without(source, unlit)
    ids = source.light_ids
    with named(source.path):
        indices, by_name = _match(lights, everything, ids)
    warnings = (*source.warnings, *lights.warnings)
    if not by_name:
        by = "order" if indices == sorted(indices) else "the numbers in their names"
        text = (
            f"lights are matched to images by {by} because their names differ "
            f"({lights.ids[indices[0]]} to {ids[0]} and so on)"
        )
        warnings += (Notice("lights-matched-by-order", text, str(source.path)),)
    elif len(indices) < len(lights) and not without and source.kind != "session":
        unused = [name for i, name in enumerate(lights.ids) if i not in indices]
        text = f"no image is named after {listed(unused, _NAMED)}: these lights are not used"
        warnings += (Notice("lights-without-image", text, str(source.path), "info"),)
    lights = with_time_errors(replace(lights.take(indices), ids=ids), source.frames)
    return replace(source, lights=lights, warnings=warnings)


def _match(
    lights: Lights, everything: Sequence[str], left: Sequence[str]
) -> tuple[list[int], bool]:
    """Match lights to the images that are left, by order to all images if these have as many."""
    if len(everything) == len(lights) != len(left):
        try:
            indices, by_name = lights.match(everything)
        except DataError:
            by_name = True  # perhaps the images that were left out have other names
        if not by_name:
            return [at for at, name in zip(indices, everything, strict=True) if name in left], False
    return lights.match(left)


def _unlit(ids: Sequence[str], lights: Lights) -> list[str]:
    """Return images without a light, which a calibration left out.

    If a light belongs to no image by name, or most images have no light, these are other lights,
    and the result is empty. Names of lights that were not calibrated may only be their order.
    """
    if lights.calibrated is None:
        return []
    known = set(map(_light_of, lights.ids))
    lit = [name for name in ids if _light_of(name) in known]
    if len(lit) == len(lights) == len(known) < len(ids) <= 2 * len(lit):
        return [name for name in ids if name not in lit]
    return []


def _light_of(name: str) -> int | str:
    """Return the LED that a name contains, or its id without one."""
    led = led_of(name)
    return light_id(name) if led is None else led


def _without(source: Source, unlit: Sequence[str]) -> Source:
    """Return a source without images that have no light, with a notice that names them."""
    text = f"the calibration has no light for {listed(unlit, _NAMED)}: not used"
    notice = Notice("images-without-light", text, str(source.path))
    return replace(exclude(source, unlit), warnings=(*source.warnings, notice))
