"""The first stages of `sgp run`, shared with the commands that run one of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights, Source, read_camera, read_lights, read_source
from calibration import EstimateError, linear_stack
from processing import (
    AngularError,
    PhotometricStereoResult,
    angular_error,
    object_mask,
    photometric_stereo,
)
from rig import MAX_PIXELS
from sgp._console import progress
from sgp._options import SourceOptions

# An image whose brightest parts stay below this share of the others' is not lit at all.
_BLACK = 0.02


@dataclass(frozen=True, eq=False)
class NormalsStage:
    """What photometric stereo made of a source, with what it was made from.

    Parameters
    ----------
    source, lights, mask
        What went in; the mask may have been made from the images.
    solved
        Normals, albedo, residual.
    error
        Against the source's ground truth, where it has one.
    previews
        The first and the last linear image, ``(H, W)``.
    warnings
        One line each.
    """

    source: Source
    lights: Lights
    mask: npt.NDArray[np.bool_]
    solved: PhotometricStereoResult
    error: AngularError | None
    previews: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]
    warnings: tuple[str, ...]


def open_source(
    path: Path,
    *,
    lights: Path | None = None,
    camera: Path | None = None,
    mask: Path | None = None,
    max_pixels: int = MAX_PIXELS,
) -> tuple[Source, list[Path]]:
    """Read a SOURCE with the files that options add to it; return it and every file, for hashing.

    Raises
    ------
    MissingPathError, DataError
        If a file is missing, not understood, or does not fit the images.
    """
    source = read_source(
        path,
        lights=None if lights is None else read_lights(lights),
        mask_path=mask,
        max_pixels=max_pixels,
    )
    if camera is not None:
        source = replace(source, camera=read_camera(camera, source.size))
    if source.ignored:
        told = f"{path}: not used: {', '.join(source.ignored)}"
        source = replace(source, warnings=(*source.warnings, told))
    options = [option for option in (lights, camera, mask) if option is not None]
    return source, list(dict.fromkeys([*source.files, *filter(Path.is_file, options)]))


def compute_normals(source: Source, options: SourceOptions) -> NormalsStage:
    """Run photometric stereo on a source: linear stack, mask, normals, error where truth is known.

    Raises
    ------
    DataError
        If the source has no lights, or lights with positions and no camera.
    EstimateError
        If the images or lights do not determine normals.
    """
    lights, points = _lights(source, distant=options.distant)
    with progress("reading") as advance:
        stack = linear_stack(source, gamma=options.gamma, on_progress=advance)
    values = stack.values
    warnings = [*source.warnings, *stack.warnings]
    mask = source.mask
    if mask is None:
        found = object_mask(values)
        mask = found.mask
        warnings.append(
            f"no mask came with the images: one was made, the object is {found.contrast:.0f} times "
            "as bright as its background"
        )
    lit = _lit(values, mask)
    if not lit.all():
        names = [name for name, on in zip(lights.ids, lit, strict=True) if not on]
        warnings.append(f"left out, since nothing is lit in them: {', '.join(names)}")
        values, lights = values[lit], lights.take([int(i) for i in np.flatnonzero(lit)])
    with progress("normals") as advance:
        solved = photometric_stereo(
            values, lights, mask, method=options.method, points_mm=points,
            on_progress=advance,
        )  # fmt: skip
    if float(np.mean(solved.normal_map.normals[solved.normal_map.mask, 2])) < 0:
        raise EstimateError(
            f"{source.path}: the normals face away from the camera: do the light directions point "
            "from the object toward the lights, with z toward the camera?"
        )
    truth = source.normals_truth
    return NormalsStage(
        source=source,
        lights=lights,
        mask=mask,
        solved=solved,
        error=None if truth is None else angular_error(solved.normal_map, truth, mask),
        previews=(values[0].copy(), values[-1].copy()),
        warnings=(*warnings, *solved.warnings),
    )


def _lights(source: Source, *, distant: bool) -> tuple[Lights, npt.NDArray[np.float64] | None]:
    """Return a source's lights, and for near ones the points of the working plane, in mm."""
    if source.lights is None:
        raise DataError(f"{source.path}: no lights are known for these images: give --lights")
    lights = source.lights.distant() if distant else source.lights
    if not lights.near:
        return lights, None
    if source.camera is None or source.camera.working_distance_mm is None:
        raise DataError(
            f"{source.path}: lights with positions need a camera with a working distance: "
            "give --camera, or --distant to use their directions alone"
        )
    return lights, source.camera.points_on_plane()


def _lit(values: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Tell images with light on the object from black ones: a dead LED, a lost trigger."""
    bright = np.zeros(len(values))
    for i, image in enumerate(values):
        inside = image[mask]
        bright[i] = np.quantile(np.nan_to_num(inside, nan=1.0), 0.99)
    lit: npt.NDArray[np.bool_] = bright > _BLACK * np.median(bright)
    return lit


class Stopwatch:
    """Seconds by stage, in the order in which the stages ran."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure one stage."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - begin, 3)
