"""Views of a calibration board from sessions, folders and images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import acquisition
import calibration
import rig
from rig.arrays import Float32
from sgp.cli.console import shown
from sgp.stages import open_source


@dataclass
class FoundViews:
    """Views of the board in the given sources.

    Parameters
    ----------
    views
        Views that show enough of the board.
    images
        Number of images that were searched.
    sources
        The sources.
    files
        Files that were read, for hashing.
    notices
        Notices of the sources, and one for each image that was not used.
    """

    views: list[calibration.camera.BoardView] = field(default_factory=list)
    images: int = 0
    sources: list[acquisition.Source] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    notices: list[rig.Notice] = field(default_factory=list)


def find_views(
    paths: Sequence[Path], board: calibration.CharucoBoard, *, gamma: str, max_pixels: int
) -> FoundViews:
    """Find the board in every image; the images of a session are averaged, as they show one view.

    Raises
    ------
    EstimateError
        If no image shows the board; the message has the reason for the first one.
    DataError
        If a source cannot be read.
    """
    found = FoundViews()
    images: list[tuple[acquisition.Source, tuple[acquisition.Frame, ...]]] = []
    for path in paths:
        source, files = open_source(path, gamma=gamma, max_pixels=max_pixels)
        found.sources.append(source)
        found.files += files
        found.notices += source.warnings
        lit = tuple(frame for frame in source.frames if frame.role == "light")
        images += [(source, (one,)) for one in lit] if source.kind == "images" else [(source, lit)]
    found.files = list(dict.fromkeys(found.files))
    found.images = len(images)
    reasons = []
    for source, frames in shown("finding the board", images):
        name = str(frames[0].path if len(frames) == 1 else source.path)
        try:
            image = mean_image(source, frames)
            found.views.append(calibration.find_board(image, board, name))
        except calibration.EstimateError as error:
            reasons.append(str(error))
            text = str(error).removeprefix(f"{name}: ")
            found.notices.append(rig.Notice("board-not-found", f"not used: {text}", name))
    if not found.views:
        more = f" (and {len(reasons) - 1} more images)" if len(reasons) > 1 else ""
        raise calibration.EstimateError(f"{reasons[0]}{more}")
    return found


def mean_image(source: acquisition.Source, frames: Sequence[acquisition.Frame]) -> Float32:
    """Return the mean of frames as gray values that are proportional to light."""
    linear = acquisition.source.Linearizer(source)
    total = None
    for signal in _grays(source, linear, frames):
        total = signal if total is None else total + signal
    if total is None:
        raise acquisition.DataError(f"{source.path}: has no image with a light: give an image")
    return np.asarray(total / np.float32(len(frames)), np.float32)


def _grays(
    source: acquisition.Source,
    linear: acquisition.source.Linearizer,
    frames: Sequence[acquisition.Frame],
) -> Iterator[Float32]:
    for frame in frames:
        signal = linear.signal(frame)
        if source.cfa is not None:
            signal = calibration.radiance.demosaic(signal, source.cfa)
        yield calibration.radiance.luma(signal) if signal.ndim == 3 else signal
