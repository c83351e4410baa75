"""Plain folders of images, and folders of images with an .lp file."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from acquisition._errors import DataError, missing_path
from acquisition.pixels.camera_raw import RawLevels, read_levelled, read_raw
from acquisition.pixels.images import read_image_with_alpha
from acquisition.pixels.mask_files import above_half, read_mask_of
from acquisition.pixels.stated_facts import ImageFacts, image_facts
from acquisition.source.nominal_camera import nominal_camera
from acquisition.source.series_facts import (
    exposure_times,
    orientation_notices,
    part_notices,
    raw_preferred_notice,
    reference_notices,
    reference_times,
    split_references,
)
from acquisition.source.source import Frame, ReadOptions, Reference, Source
from acquisition.value_files.lights import read_lights
from acquisition.values.image_names import IMAGE_SUFFIXES, SAME_NAME, SUFFIXES, is_raw
from acquisition.values.running_numbers import Numbered, numbers_in, numbers_of, start_of
from rig import Notice, pluralize

# What else cameras and programs write, with the remedy.
_UNREAD = {
    "HEIF image": (
        (".heic", ".heif", ".hif", ".avif"),
        "save them as JPEG, or let the camera save RAW",
    ),
    "PFM image": ((".pfm",), "save them as EXR or as TIFF with float samples"),
    "GIF image": ((".gif",), "save them as PNG or TIFF"),
    "Photoshop file": ((".psd",), "save them as PNG or TIFF"),
    "video": ((".mp4", ".mov", ".avi", ".mkv"), "save the frames as PNG or TIFF"),
}


def read_images(folder: Path, options: ReadOptions) -> Source:
    """Read a plain folder: its largest series of numbered images, in their order."""
    files, twins = without_twins(_checked_files(folder))
    masks = [path for path in files if _is_mask(path)]
    images, references = split_references([path for path in files if path not in masks])
    series = numbered_series(images)
    if not series:
        raise DataError(f"{folder}: {_why_no_series(files)}")
    source = images_source(folder, series, options, masks, references)
    source = replace(source, warnings=(*source.warnings, *_restarted(folder, series)))
    return with_ignored(source, folder, twins)


def lp_files(folder: Path) -> list[Path]:
    """Return the .lp files of a folder."""
    return [path for path in _files(folder) if path.suffix.lower() == ".lp"]


def read_lp_folder(folder: Path, lp: Path, options: ReadOptions) -> Source:
    """Read the images that an .lp file lists, or the numbered images if it lists none of them."""
    lights = read_lights(lp)
    files = _checked_files(folder)
    masks = [path for path in files if _is_mask(path)]
    images = [path for path in files if _is_image(path) and path not in masks]
    # A name with its suffix may list either of a pair.
    pairs, (images, twins) = images, without_twins(images)
    tables = [
        (same, _grouped(same, images if same("a.png") == "a" else pairs)) for same in SAME_NAME
    ]
    listed: dict[str, Path | None] = {}
    for name in lights.ids:
        found = next((table[same(name)] for same, table in tables if same(name) in table), [])
        if len(found) > 1:
            raise DataError(
                f"{lp}: {name} may be {found[0].name} or {found[1].name}: list the name of the file"
            )
        listed[name] = found[0] if found else None
    present = [path for path in listed.values() if path is not None]
    if present and len(set(present)) < len(listed):
        absent = next((name for name, path in listed.items() if path is None), lights.ids[-1])
        raise DataError(
            f"{lp}: lists {pluralize(len(listed), 'image')}, but only {len(set(present))} of them "
            f"{'is' if len(set(present)) == 1 else 'are'} there, "
            f"{absent} is not: add the image or remove its line"
        )
    unlisted, references = split_references(
        [path for path in images if path not in present], len(present)
    )
    series = present or numbered_series(unlisted)
    if not series:
        lack = f"{folder}: no images for the {pluralize(len(lights), 'light')} of {lp.name}"
        why = "add the images" if images else _why_no_series(files)
        raise DataError(f"{lack}: {why}")
    source = images_source(folder, series, options, masks, references)
    restarted = () if present else _restarted(folder, series)
    source = replace(
        source,
        kind="lp",
        lights=lights,
        files=(*source.files, lp),
        warnings=(*source.warnings, *restarted),
    )
    return with_ignored(source, folder, twins if set(present) <= set(images) else [])


def images_source(
    path: Path,
    series: Sequence[Path],
    options: ReadOptions = ReadOptions(),
    masks: Sequence[Path] = (),
    references: Mapping[Path, Reference] = {},
) -> Source:
    """Build a source from image files that belong together.

    Parameters
    ----------
    path
        Folder or file that the caller named.
    series
        Images, in order.
    options
        Mask, limit and transfer curve that the caller states. Without a curve: the one that the
        metadata of the images state, else that of their kind.
    masks
        Masks next to the images, if the caller states none; more than one is an error.
    references
        Dark and ambient frames, with their roles. One that states no exposure time has that of the
        images if theirs are equal; a notice reports this.

    Raises
    ------
    DataError
        If an image cannot be read or differs from the first in size, type, transfer curve,
        sensitivity, aperture, orientation or data window, or states no exposure time although
        those of others differ; if the mask has another size or orientation, if there are several
        masks, or if without a mask the alpha channels of the images leave no pixel.
    """
    max_pixels, transfer = options.max_pixels, options.transfer
    masks = [options.mask_path] if options.mask_path else masks
    files = (*series, *references)
    facts = {file: image_facts(file, max_pixels=max_pixels) for file in files}
    first = facts[series[0]]
    for each in facts.values():
        # Without light, neither the aperture nor the place of the camera matters.
        dark = references.get(each.path) == "dark"
        shot = replace(each.shot, f_number=None, orientation=None) if dark else each.shot
        replace(each, shot=shot).check_alike(first)
        if transfer is None:
            _check_curve(each, first)
    raw = read_raw(first.path, max_pixels=max_pixels) if is_raw(first.path) else None
    shape = first.shape if raw is None else raw.pixels.shape
    load = None
    if raw is not None:
        levels = RawLevels(first.path.name, raw.cfa, raw.black_level_dn, raw.white_level_dn)
        load = partial(read_levelled, levels=levels, max_pixels=max_pixels)
        white = raw.white_level_dn
    elif first.dtype.kind == "f":
        white = np.inf
    else:
        white = float(np.iinfo(first.dtype.name).max)
    if len(masks) > 1:
        raise DataError(
            f"{path}: {masks[0].name} and {masks[1].name} are both masks: choose one of them"
        )
    times = exposure_times([facts[file] for file in series], path)
    size = (shape[0], shape[1])
    camera, of_camera = nominal_camera([facts[file] for file in series], size, path)
    others_us, assumed = reference_times([facts[file] for file in references], times)
    frames = tuple(
        Frame(
            file,
            file.stem,
            shape,
            references.get(file, "light"),
            exposure_us=time_us,
            load=None if load is None else partial(load, file),
            max_pixels=max_pixels,
            exposure_sigma=sigma,
        )
        for file, time_us, sigma in zip(
            files,
            (*times.us, *others_us),
            (*times.sigma, *(0.0 for _ in references)),
            strict=True,
        )
    )
    source = Source(
        path=path,
        kind="images",
        frames=frames,
        mask=read_mask_of(masks[0], first, size) if masks else None,
        mask_path=masks[0] if masks else None,
        camera=camera,
        camera_nominal=camera is not None,
        cfa=None if raw is None else raw.cfa,
        black_level=0.0 if raw is None else raw.black_level_dn,
        white_level=white,
        transfer=transfer or first.transfer.curve,
        transfer_origin="given" if transfer else first.transfer.origin,
        files=(*files, *masks),
        warnings=(
            *reference_notices(path, references, assumed),
            *times.notices,
            *orientation_notices(first, str(path)),
            *part_notices(first, str(path)),
            *of_camera,
        ),
    )
    transparent = tuple(file for file in series if facts[file].alpha)
    return _with_alpha_mask(source, transparent, max_pixels)


def with_ignored(source: Source, folder: Path, twins: Sequence[Path] = ()) -> Source:
    """Add the names of the files in the folder that the source does not use.

    ``twins`` are other images of the same exposures, which are reported in one notice.
    """
    used = {path for file in source.files for path in (file, *file.parents)}
    unused = [path.name for path in _files(folder) if path not in used and path not in twins]
    notices = () if not twins else (raw_preferred_notice(len(twins), str(folder)),)
    return replace(source, ignored=tuple(unused), warnings=(*source.warnings, *notices))


def without_twins(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Split off the images that have a camera RAW file of the same name (``IMG_1.CR2``, ``.JPG``).

    Cameras that write pairs store the same exposure in both.
    """
    raw = {path.stem.casefold() for path in files if is_raw(path)}
    twins = [
        path
        for path in files
        if path.suffix.lower() in IMAGE_SUFFIXES and path.stem.casefold() in raw
    ]
    return [path for path in files if path not in twins], twins


def numbered_series(files: Sequence[Path]) -> list[Path]:
    """Return the largest series of images that differ only in one number, in the order of it.

    If the first number that differs does so in all images, their further numbers may differ too.
    If the counter restarted (9999, 0001), the images before that come first.

    Raises
    ------
    DataError
        If two series are equally long, or two images of the series have the same number.
    """
    files = [path for path in files if _is_image(path)]
    series: dict[str, dict[Path, Numbered]] = defaultdict(dict)
    for path in files:
        for number in numbers_in(path.name):
            series[f"{number.series}{path.suffix.lower()}"][path] = number
    if not series:
        return []
    series[""] = dict(zip(files, _first_differing(files), strict=False))
    lengths = {name: len(set(each.values())) for name, each in series.items()}
    longest = max(lengths.values())
    ties = [name for name in series if lengths[name] == longest]
    for other in ties:
        if series[other].keys() != series[ties[0]].keys():
            raise DataError(
                f"{files[0].parent}: {longest} images {ties[0]} and {longest} images {other}: put "
                "each series into a folder of its own"
            )
    rising = sorted((number, path) for path, number in series[ties[0]].items())
    for (number, path), (next_number, other_path) in pairwise(rising):
        if number.value == next_number.value:
            raise DataError(
                f"{path} and {other_path.name} have the same number: remove one of them, or list "
                "the right one in an .lp file"
            )
    start, certain = start_of([number for number, _ in rising])
    paths = [path for _, path in rising]
    return [*paths[start:], *paths[:start]] if certain else paths


def _first_differing(files: Sequence[Path]) -> Sequence[Numbered]:
    """Return the first number that differs between files whose names differ only in numbers.

    None if it does not differ between all of them: then it counts series.
    """
    runs = [numbers_in(path.name) for path in files]
    forms = {
        (re.sub("[0-9]+", "#", path.name.casefold()), len(run))
        for path, run in zip(files, runs, strict=True)
    }
    for column in zip(*runs, strict=True) if len(forms) == 1 else ():
        values = {number.value for number in column}
        if len(values) > 1:
            alike = [number._replace(series="") for number in column]
            return alike if len(values) == len(files) else ()
    return ()


def _restarted(folder: Path, series: Sequence[Path]) -> tuple[Notice, ...]:
    """Return the notice about a counter that restarted within a series."""
    numbers = numbers_of([path.name for path in series])
    for before, after in pairwise(zip(numbers, series, strict=True)) if numbers else ():
        if before[0].value > after[0].value:
            text = f"the counter restarted: {after[1].name} comes after {before[1].name}"
            return (Notice("counter-restarted", text, str(folder), "info"),)
    return ()


def _grouped(same: Callable[[str], str], images: Sequence[Path]) -> dict[str, list[Path]]:
    """Return the images by what makes two names the same."""
    found: dict[str, list[Path]] = defaultdict(list)
    for path in images:
        found[same(path.name)].append(path)
    return found


def _why_no_series(files: Sequence[Path]) -> str:
    """Return why the files of a folder contain no series of images, and what to do."""
    if not files:
        return "the folder is empty: choose another folder"
    for kind, (suffixes, remedy) in _UNREAD.items():
        if unread := [path for path in files if path.suffix.lower() in suffixes]:
            count = pluralize(len(unread), kind)
            return f"{count} ({unread[0].name}), which cannot be read: {remedy}"
    folders = [path for path in files if path.is_dir()]
    inner = next((path for path in folders if any(map(_is_image, _files(path)))), None)
    if inner is not None:
        return f"no images here, but there are some in {inner.name}: choose that folder"
    if images := [path for path in files if _is_image(path)]:
        return (
            f"{pluralize(len(images), 'image')} ({images[0].name}), but none with a number in its "
            "name: name them name.0.png, name.1.png and so on, or list them in an .lp file"
        )
    return "no numbered images (name.0.png, name.1.png, ...): choose another folder"


def _check_curve(facts: ImageFacts, first: ImageFacts) -> None:
    mine, firsts = facts.transfer, first.transfer
    if mine.curve != firsts.curve:
        raise DataError(
            f"{facts.path}: {mine.curve.name} ({mine.origin}), but {first.path.name} is "
            f"{firsts.curve.name} ({firsts.origin}): give the transfer curve"
        )


def _files(folder: Path) -> list[Path]:
    """Return the files and folders in a folder, without hidden ones."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise DataError(f"{folder}: cannot be listed ({error.strerror})") from error


def _checked_files(folder: Path) -> list[Path]:
    """Return the same as `_files`, and refuse what has the name of an image but is no file."""
    files = _files(folder)
    for path in files:
        if path.suffix.lower() in SUFFIXES and not path.is_file():
            if not path.exists():
                raise DataError(str(missing_path(path, "file")))
            what = "a folder" if path.is_dir() else "not a regular file"
            raise DataError(f"{path}: has the name of an image, but is {what}: rename or remove it")
    return files


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES and path.is_file()


def _is_mask(path: Path) -> bool:
    stem = path.stem.casefold()
    return (stem == "mask" or stem.endswith(".mask")) and _is_image(path)


def _with_alpha_mask(source: Source, images: Sequence[Path], max_pixels: int) -> Source:
    """Return a source without a mask with that of its alpha channels: what no image cuts out.

    Alpha channels that are opaque everywhere are ignored.

    Parameters
    ----------
    source
        The recording, without a mask.
    images
        Its images with an alpha channel; they are decoded.
    max_pixels
        Largest allowed number of pixels per image.

    Raises
    ------
    DataError
        If an image cannot be read, or the alpha channels leave no pixel.
    """
    if source.mask is not None or not images:
        return source
    inside = np.ones(source.size, np.bool_)
    for path in images:
        _, alpha = read_image_with_alpha(path, max_pixels=max_pixels)
        if alpha is not None:
            inside &= above_half(alpha)
    if inside.all():
        return source
    count = int(np.count_nonzero(inside))
    if not count:
        raise DataError(
            f"{images[0]}: the alpha channel of the images leaves no pixel: save them without "
            "alpha, or give a mask"
        )
    text = f"the alpha channel of the images is the mask, {count} of {inside.size} pixels"
    notice = Notice("alpha-is-mask", text, str(source.path), "info")
    return replace(source, mask=inside, mask_origin="alpha", warnings=(*source.warnings, notice))
