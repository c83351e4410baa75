"""First stage of the commands that process a recording."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import acquisition
import processing
import rig
from sgp.cli.console import Stages
from sgp.cli.exit import UsageError
from sgp.cli.options import RIG_LIGHTS, RecordingOptions, transfer_files, transfer_of
from sgp.results import input_hashes
from sgp.rigs import given_lights, led_positions, rig_notices, rig_with_positions
from sgp.stages.spheres import SphereLights, light_by_spheres

_FEWEST_IMAGES = 3


def open_source(
    path: Path,
    *,
    lights: Path | None = None,
    rig_option: Path | None = None,
    camera: Path | None = None,
    mask: Path | None = None,
    gamma: str = "auto",
    flat: Path | None = None,
    others: Sequence[Path] = (),
    without: Sequence[str] = (),
    max_pixels: int = rig.MAX_PIXELS,
    hashed: bool = True,
) -> tuple[acquisition.Source, list[Path]]:
    """Read a source with the files given as options; return it and all its files, for hashing.

    They are ``hashed`` at once, see `input_hashes`, unless the command does that or keeps no hash.
    ``others`` are files that the command reads itself; they may be in the folder of the source.
    ``without`` names images that are left out, and ``rig_option`` the rig of ``--lights rig``.

    Raises
    ------
    MissingPathError, DataError, RigError, UsageError
        If a file is missing, cannot be read, or does not match the images; as `given_lights`.
    """
    given_by = None if lights is None else given_lights(lights, [path], rig_option)
    source = acquisition.read_source(
        path,
        lights=None if given_by is None else given_by.lights,
        mask_path=mask,
        transfer=transfer_of(gamma),
        without=without,
        max_pixels=max_pixels,
    )
    if given_by is not None:
        lights = given_by.file
    if camera is not None:
        given_camera = acquisition.read_camera(camera, source.size)
        doubts = acquisition.source.lens_notices(source, given_camera)
        source = acquisition.source.with_camera(source, given_camera)
        source = replace(source, warnings=(*source.warnings, *doubts))
    parts = [] if flat is None else acquisition.value_files.flat_files(flat)
    if flat is not None:
        source = _flattened(source, flat, max_pixels)
    given = (lights, camera, mask, *transfer_files(gamma), *parts, *others)
    options = [option for option in given if option is not None]
    used = {option.resolve() for option in options}
    unused = [name for name in source.ignored if (source.path / name).resolve() not in used]
    if unused:
        source = replace(source, warnings=(*source.warnings, not_used(path, unused)))
    files = list(dict.fromkeys([*source.files, *filter(Path.is_file, options)]))
    if hashed:
        input_hashes(files)
    return source, files


def open_sources(
    paths: Sequence[Path], **options: Any
) -> tuple[list[acquisition.Source], list[Path]]:
    """Read several sources as `open_source` does; return them and all their files, each once."""
    opened = [open_source(path, **options) for path in paths]
    files = dict.fromkeys(file for _, read in opened for file in read)
    return [source for source, _ in opened], list(files)


def _flattened(source: acquisition.Source, flat: Path, max_pixels: int) -> acquisition.Source:
    read = acquisition.value_files.read_flat(flat, max_pixels=max_pixels)
    try:
        return acquisition.source.apply_flat(source, read)
    except acquisition.DataError as error:
        error.add_note(f"the flat is {flat}")
        raise


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as the options say.

    Parameters
    ----------
    source
        The part to process.
    files
        All files that were read, for hashing.
    lit_by
        The spheres from which the lights were estimated; None if the lights were known.
    """

    source: acquisition.Source
    files: list[Path]
    lit_by: SphereLights | None = None

    def pixel_mm(self, stated: float | None) -> float | None:
        """Return the stated size of a pixel of the frames, or the one by the spheres."""
        if stated is None and self.lit_by is not None:
            return self.lit_by.estimate.pixel_mm
        return stated


def open_recording(path: Path, options: RecordingOptions, *, follow: bool = True) -> Recording:
    """Read a recording as its options say; ``follow`` a camera that drifted by its spheres.

    Raises
    ------
    UsageError
        If fewer than 3 images are left, both lights and spheres are given, or an option about
        spheres without spheres; if the rig has no positions of LEDs.
    RigError
        If the rig to compare with is not found or invalid.
    MissingPathError, DataError
        If a file is missing, cannot be read, or does not match the images, or the options name an
        image or a region that does not exist.
    EstimateError
        If the spheres do not give lights.
    """
    if options.spheres and options.lights is not None:
        raise UsageError("--lights and --spheres both give the lights: give only one of them")
    if options.radius_mm and not options.spheres:
        raise UsageError("--radius-mm is the radius of spheres: give --spheres as well")
    if options.rig is not None:
        if not options.spheres and options.lights != RIG_LIGHTS:
            raise UsageError(
                "--rig is for the lights of its LEDs, or to compare those of spheres: give "
                "--lights rig, or --spheres"
            )
        rig_with_positions(options.rig)  # a mistake is reported before the images are read
    source, files = open_source(
        path,
        lights=options.lights,
        hashed=False,
        rig_option=options.rig,
        camera=options.camera,
        mask=options.mask,
        gamma=options.gamma,
        others=[] if options.sensor is None else [options.sensor],
        flat=options.flat,
        without=options.excluded_by_name,
        max_pixels=options.max_pixels,
    )
    if options.sensor is not None:
        source = acquisition.source.with_sensor(
            source, acquisition.value_files.read_sensor(options.sensor)
        )
    left = len(source.light_ids)
    if options.excluded_by_name and left < _FEWEST_IMAGES:
        raise UsageError(
            f"--exclude leaves {rig.pluralize(left, 'image')}: normals need at least "
            f"{_FEWEST_IMAGES}"
        )
    lit_by = None
    if options.spheres:
        places_mm = led_positions(options.rig, source.setup.rig)
        source, lit_by = light_by_spheres(source, options.radius_mm, places_mm, follow=follow)
        compared = rig_notices(lit_by.estimate.lights, options.rig, source.setup.rig)
        lit_by = replace(lit_by, warnings=(*lit_by.warnings, *compared))
    if options.crop is not None:
        source = acquisition.crop(source, *options.crop)
    return Recording(acquisition.downscale(source, options.downscale), files, lit_by)


def with_scale(
    source: acquisition.Source, pixel_mm: float | None
) -> tuple[acquisition.Source, float | None]:
    """Return a source and the size of its pixels, from that of a pixel of the frames.

    A camera without a working distance gets the one that follows from the size.
    """
    if pixel_mm is None:
        return source, None
    size = pixel_mm if source.reduction is None else pixel_mm * source.reduction.factor
    camera = source.camera
    if camera is None or camera.working_distance_mm is not None:
        return source, size
    camera = replace(camera, working_distance_mm=size * camera.focal_px)
    return replace(source, camera=camera), None


def compute_normals(
    source: acquisition.Source,
    stage: processing.recording.NormalsStage,
    files: processing.recording.MapFiles | None = None,
) -> processing.Reconstruction:
    """Compute normals and show the progress; a notice that an option answers names the option."""
    if source.lights is None:
        raise acquisition.DataError(
            f"{source.path}: these images have no lights: give a list of them (--lights), or find "
            "them in chrome spheres next to the object (--spheres)"
        )
    with Stages() as progress:
        made = stage.run(source, files, progress)
    verdict, warnings = with_options(made.verdict, made.warnings)
    return replace(made, verdict=verdict, warnings=warnings)


def with_options(
    verdict: processing.checks.Verdict, warnings: Iterable[rig.Notice]
) -> tuple[processing.checks.Verdict, tuple[rig.Notice, ...]]:
    """Return remedies and notices that name the options which answer them.

    Strengths and room light are not estimated while single images are wrong, or something else that
    is not known: the estimates would be those of a wrong model.
    """
    names = {cause.name for cause in verdict.causes} | {one.code for one in verdict.notices}
    disturbed = any(name.startswith("image") or name in _DISTURBING for name in names)

    def answered(code: str, text: str) -> str:
        option = _OPTIONS.get(code)
        if code == "transfer-curve-doubtful":
            curve = text.rpartition(" ")[2].lower()  # what does not matter has no remedy
            option = f"--gamma {curve}" if curve in ("srgb", "linear") else "--gamma"
        if not option or not text or (disturbed and option in _ESTIMATES):
            return text
        return f"{text} ({option})"

    causes = tuple(
        replace(cause, remedy=answered(cause.name, cause.remedy)) for cause in verdict.causes
    )
    notices = tuple(replace(notice, text=answered(notice.code, notice.text)) for notice in warnings)
    return replace(verdict, causes=causes), notices


_DISTURBING = {"light-moved", "residual-unexplained"}
_ESTIMATES = {"--ambient estimate", "--semi-calibrated"}
_OPTIONS = {
    "ambient-light": "--ambient estimate",
    "brightness-gradient": "--semi-calibrated",
    "light-brightness": "--semi-calibrated",
    "lights-fading": "--semi-calibrated",
    "lights-not-distant": "--light-distance-mm D or estimate",
    "light-distance-uncertain": "--light-distance-mm",
    "height-doubtful": "--height-mm, --rests-on-plane",
    "height-not-determined": "--height-mm, --rests-on-plane",
    "image-disagrees": "--exclude auto",
    "image-duplicate": "--exclude auto",
    "image-clipped": "--exclude auto",
    "image-striped": "--exclude auto",
    "light-moved": "--exclude auto",
}


def not_used(folder: Path, names: Sequence[str]) -> rig.Notice:
    """Return the notice about files of a source that were not used."""
    return rig.Notice("files-not-used", f"not used: {', '.join(names)}", str(folder), "info")


class Stopwatch:
    """Duration of each stage in seconds, in the order in which the stages ran."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure one stage."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - begin, 3)
