"""Reconstruction of normals and height from a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from acquisition import DataError, MapRows, Source
from acquisition.files import BandStore, MemoryMaps, check_unfinished, rows_in_bands
from calibration import Stack, linear_stack, open_stack
from calibration.radiance import Channel, StackFiles, luma
from processing.colour.colour_albedo import (
    ColourSums,
    colour_albedo,
    coloured,
    may_have_colour,
)
from processing.images.mosaic import albedo_of_sites, gray_picture
from processing.images.viewing_rays import Perspective, lights_of
from processing.maps.metrics import AngularError, angular_error
from processing.maps.normal_map import NormalMap
from processing.noise.lens_blur import lens_blur
from processing.noise.sample_kind import Reason
from processing.recording.alignment import AlignChoice, find_alignment, lights_of_moved
from processing.recording.banded_normals import (
    GraySolver,
    ShownBySample,
    map_forms,
    solve_bands,
)
from processing.recording.channel_choice import choose_colours
from processing.recording.colour_normals import ColourSolver
from processing.recording.error_bars import (
    ErrorBarMaps,
    check_any_valid,
    common_deg_of,
    validity_notices,
)
from processing.recording.examination import (
    DistanceChoice,
    Examination,
    Geometry,
    check_facing,
    examination_of,
    geometry_of,
)
from processing.recording.reconstruction import (
    Reconstruction,
    finished_maps,
    with_common_error,
)
from processing.series.light_distance import LightDistance
from processing.stages.stage import Need
from processing.stereo.method import Estimator, Method, StereoChannel, method_name
from processing.stereo.normals_and_albedo import check_solved
from processing.surface.integration import integrate
from rig import Notice, Progress, check_type, no_progress, pluralize
from rig.arrays import Bool, Float32

# The interpreter, libraries and compiled kernels, and buffers of the threads.
_FIXED = 450_000_000
# Bytes per pixel: maps of a result in memory with what is computed of them, and what is in memory
# while the maps are on disk (mask, one gray reference, and one image with what is computed of it).
_MAPS = 134
_ON_DISK = 14
# Bytes per pixel of a band, besides the values of the images.
_OF_BAND = 300
# Largest stack that is in memory as a whole; bytes of a band otherwise.
_STACK, _BAND = 1_000_000_000, 128_000_000
_LEAST_ROWS = 8
# Bytes of a stack that is read at once; a larger one is solved in bands of rows.
_IN_MEMORY = 1_000_000_000
# Bytes of rows that are read together after the bands.
_READ = 32_000_000
# Whether a constant light is estimated.
AmbientChoice = Literal["none", "estimate"]


@dataclass(frozen=True)
class MapFiles:
    """Where the maps of a reconstruction are if they do not fit into memory.

    Parameters
    ----------
    path
        Future result. The maps are in a hidden folder next to it, see `BandStore`, until the
        caller removes them.
    identity
        What the result depends on besides the options of the stage, see `BandStore`.
    memory
        Bytes to use, at least those of `NormalsStage.need`.
    replace
        Begin again if there are maps of another identity.
    """

    path: Path
    identity: Mapping[str, object]
    memory: int
    replace: bool = False


@dataclass(frozen=True, kw_only=True)
class NormalsStage:
    """The computation of normals from a recording.

    The images are converted to linear radiance; a warning says if they fit the lights much better
    under another transfer curve, others if images, lights and normals do not agree (see
    `image_quality`), or if the lights were calibrated with another rig or camera. Images without
    light on the object are left out. Photometric stereo computes the normals, and their
    integration the height. Near lights are evaluated at the points of the surface: normals and
    height alternate, and the mean height is the one that explains the images best.

    Parameters
    ----------
    method
        Method of `photometric_stereo`.
    channel
        ``auto``: ``joint`` if a sample of images in colour shows that its normals are surer than
        those of ``gray``, else ``gray``; the notice ``colours-used`` says so.
        ``gray``: normals from gray images, for which a mosaic is demosaiced. ``rgb``: one solution
        per channel; the normals are averaged with weights from the noise. ``joint``: one normal and
        one albedo per channel that explain the samples of all channels best. ``mosaic``: normals of
        every site of a Bayer mosaic from its own samples, without interpolation, so that edges of
        colours are as sharp as others; the albedo in colour is interpolated afterwards.
    distant
        Treat lights with positions as distant lights.
    light_distance_mm
        Distance of lights that have only directions, such as those of a dome, from the middle of
        the object: the point of the working plane in the middle of the complete images, for which
        directions and intensities are stated. The lights are then near lights. ``estimate``: find
        it in the images, see `find_light_distance`.
    height_mm
        Mean height of the object above the working plane, if it is known. Only for near lights.
    rests_on_plane
        The lowest points of the object are in the working plane. Only for near lights.
    pixel_mm
        Distance between neighbouring pixels on the object, if the source has no camera with a
        working distance. Without a camera, the view is orthographic.
    ambient
        ``estimate``: find a constant light that is in all images, such as that of the room, and
        subtract it, see `find_ambient_light`.
    exclude_disagreeing
        Leave out images that the other images contradict (see `image_quality`), and divide those
        by a factor of which only the brightness is wrong, unless so many do that it is not known
        which are right.
    semi_calibrated
        Estimate the strengths of the lights, relative to given intensities; see `light_strengths`.
    interreflection
        Subtract the light that a matte object reflects onto itself, if attached shadows show it,
        see `processing.series.interreflection`; the notice ``light-reflected`` says so.
    align
        ``auto``: if camera or object surely moved while the images were taken, by more than
        0.15 px, move the images back by the shifts that `find_image_shifts` finds; the notice
        ``images-aligned`` says so. ``always``: also by less. ``off``: never. Sites of a mosaic
        cannot be moved.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition import Lights, read_source, write_png
    >>> from processing.recording import MapFiles, NormalsStage
    >>> lights = Lights(directions=[[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
    >>> for i in range(4):
    ...     write_png(f"card.{i}.png", np.pad(np.full((40, 60), 9000, np.uint16), 9))
    >>> source = read_source(".", lights=lights)
    >>> NormalsStage().run(source, MapFiles(Path("a"), {}, memory=10**9))
    Reconstruction(., NormalMap(float32[58, 78, 3], 2400 normals))
    """

    method: Method = "best"
    channel: StereoChannel = "auto"
    distant: bool = False
    light_distance_mm: DistanceChoice = None
    height_mm: float | None = None
    rests_on_plane: bool = False
    pixel_mm: float | None = None
    ambient: AmbientChoice = "none"
    exclude_disagreeing: bool = False
    semi_calibrated: bool = False
    interreflection: bool = False
    align: AlignChoice = "auto"

    def needs_whole(self, source: Source) -> bool:
        """Return whether the complete images and maps have to be in memory."""
        solved_as_one = self.channel in ("rgb", "joint", "mosaic") or self.semi_calibrated
        return solved_as_one or self._may_use_colours(source)

    def _may_use_colours(self, source: Source) -> bool:
        """Return whether the images decide if all colours are used."""
        values = 3 * len(source.light_ids) * math.prod(source.size)
        decides = self.channel == "auto" and not self.semi_calibrated
        # The result must not depend on the memory, so a large recording is never solved in colour.
        return (
            decides and may_have_colour(source) and source.cfa is None and 4 * values <= _IN_MEMORY
        )

    def need(self, source: Source) -> Need:
        """Return the memory for a recording, about."""
        three = self.channel in ("rgb", "joint") or self._may_use_colours(source)
        return _memory_need(source, 3 if three else 1, whole=self.needs_whole(source))

    def run(
        self, source: Source, files: MapFiles | None = None, on_progress: Progress = no_progress
    ) -> Reconstruction:
        """Compute the normals, with the maps in memory or in files.

        A band whose rows are in files is not computed again if the process is killed and the
        function is called with the same identity. Parameters and errors are those of
        `reconstruct`, and of `BandStore` for ``files``.
        """
        check_type("source", source, Source, "acquisition.read_source(path) returns one")
        self._check(source)
        geometry = geometry_of(
            source,
            self.pixel_mm,
            self.height_mm,
            rests_on_plane=self.rests_on_plane,
            distant=self.distant,
            light_distance_mm=self.light_distance_mm,
        )
        if self.channel == "auto":
            return self._run_chosen(source, geometry, files, on_progress)
        if geometry.lights.near and self.light_distance_mm is not None:
            source = replace(source, lights=geometry.lights)
        if files is not None and not files.replace:
            check_unfinished(files.path, files.identity)
        with ExitStack() as opened:
            store: BandStore | None = None
            source, frames, pattern, examined, of_images = self._examined(
                source, geometry, opened, on_progress, in_bands=files is not None
            )
            if self.light_distance_mm == "estimate" and geometry.view is not None:
                examined.find_light_distance(geometry.view)
            elif self.light_distance_mm is not None:
                examined.light_distance = LightDistance(float(self.light_distance_mm))
            if self.ambient == "estimate":
                examined.find_ambient()
            examined.find_surface(semi_calibrated=self.semi_calibrated)
            quality = examined.check(exclude_disagreeing=self.exclude_disagreeing)
            if self.interreflection:
                examined.subtract_reflected(self.method)
            in_colour = examined.images.in_colour
            colours = None
            if frames is not None and not in_colour and pattern is None:
                colours = _colours(source, frames, examined)
            mask = examined.mask
            forms = map_forms(mask.shape, len(examined.lights))
            if in_colour or colours is not None:
                forms["colour"] = ((*mask.shape, 3), np.float32)
            maps: MemoryMaps | BandStore = MemoryMaps(forms)
            if files is not None:
                forms["first"] = forms["last"] = (mask.shape, np.float32)
                maps = store = BandStore(files.path, files.identity, forms, replace=files.replace)
                opened.push(lambda error, *_: store.close() if error else None)
                previews: tuple[MapRows, ...] = store["first"], store["last"]
            else:
                previews = tuple(
                    np.array(image) if pattern is None else gray_picture(image, pattern)
                    for image in (examined.images[0], examined.images[-1])
                )
            shown = self._solve(examined, maps, files, colours, on_progress)
            valid, notices = _valid_pixels(maps, examined)
            known = shown.origin != "unknown"
            blur = lens_blur(maps["normals"], maps["noise"], valid) if known else None
            bars = ErrorBarMaps(maps)
            common = bars.common_variance()
            by_residuals = _median(bars.by_residuals(common, shown.origin))
            made = finished_maps(maps, valid, common, shown.origin, blur)
            check_facing(source, _sum_of_z(made["normals"], valid))
            # A blur leaves no residual, so it is no reason to doubt or to excuse one.
            verdict = examined.verdict(quality, by_residuals)
            made = with_common_error(made, common_deg_of(verdict))
            warnings = (
                *source.warnings,
                *examined.images.warnings,
                *of_images,
                *examined.warnings,
                *notices,
                *validity_notices(maps["reason"][:], mask, shown.origin, shown.correlation),
                *verdict.notices,
            )
            source, lights, near = examined.source, examined.lights, examined.near
            points, used = examined.points, examined.images.ids
            strengths, excluded = examined.strengths, examined.excluded
            rescaled = examined.rescaled
            light_distance, ambient = examined.light_distance, examined.ambient
            del examined  # by far the largest arrays; what follows does not need them
        if pattern is not None:
            albedo = albedo_of_sites(made["gray_albedo"][:], valid, pattern)
            made |= {"albedo": albedo, "gray_albedo": luma(albedo)}
        elif frames is None and not in_colour:
            normals = NormalMap.of_unit_vectors(made["normals"][:], valid)
            of_gray = made["gray_albedo"][:], made["residual"][:]
            found = colour_albedo(source, used, lights, normals, *of_gray, points, on_progress)
            if found is not None:
                bright = found if ambient is None else _as_bright(found, of_gray[0])
                made["albedo"] = bright
        return Reconstruction(
            source=source,
            lights=lights,
            mask=mask,
            valid=valid,
            maps=made,
            noise=shown.origin,
            neighbour_correlation=shown.correlation,
            quality=quality,
            verdict=verdict,
            excluded=excluded,
            strengths=strengths,
            light_distance=light_distance,
            ambient=ambient,
            blur=blur,
            rescaled=rescaled,
            error=_error(source, made["normals"], valid, mask),
            previews=previews,
            near_height=near,
            warnings=warnings,
            store=store,
        )

    def _examined(
        self,
        source: Source,
        geometry: Geometry,
        opened: ExitStack,
        on_progress: Progress,
        *,
        in_bands: bool,
    ) -> tuple[Source, StackFiles | None, str | None, Examination, list[Notice]]:
        """Open the images, align them if camera or object moved, and begin to examine them."""
        notices: list[Notice] = []
        # Spheres in the images show the lights as they are in each.
        aligned, decided = False, bool(source.shifts_px)
        while True:
            stack = self._opened(source, opened, on_progress, in_bands=in_bands)
            frames, pattern = stack.files, stack.pattern
            examined, of_mask = examination_of(source, stack, geometry, self.method, on_progress)
            del stack  # the examination may replace it
            examined.leave_out_unlit()
            done = aligned or (pattern is not None and self.align == "auto")
            alignment = find_alignment(
                examined.images,
                examined.lights,
                examined.mask,
                geometry.view,
                "off" if done else self.align,
                source.shifts_px,
            )
            notices += alignment.notices
            aligned = True
            if alignment.shifts_px not in ({}, source.shifts_px):
                source = replace(source, shifts_px=alignment.shifts_px)
                del examined  # its images are no longer needed
                continue
            before = geometry.lights
            if source.shifts_px and not decided and geometry.view is not None and before.near:
                decided = True
                lights, doubts = lights_of_moved(
                    examined.images, before, examined.mask, geometry.view, source.shifts_px
                )
                notices += doubts
                geometry = geometry._replace(lights=lights)
            if geometry.lights is before:
                return source, frames, pattern, examined, [*notices, *of_mask]
            source = replace(source, lights=geometry.lights)
            del examined  # its images are no longer needed

    def _run_chosen(
        self, source: Source, geometry: Geometry, files: MapFiles | None, on_progress: Progress
    ) -> Reconstruction:
        """Run in gray, or from all colours if these are better."""
        colours = None
        if files is None and self._may_use_colours(source):
            colours = choose_colours(source, geometry.lights, geometry.view, self.method)
        chosen = replace(self, channel="gray" if colours is None else "joint")
        made = chosen.run(source, files, on_progress)
        return made if colours is None else replace(made, warnings=(*made.warnings, colours))

    def _check(self, source: Source) -> None:
        """Refuse choices that exclude each other, or do not fit the lights, by `DataError`."""
        positions = lights_of(source, distant=self.distant).near
        if self.light_distance_mm is not None and (positions or self.distant):
            kind = "distant lights" if self.distant else "lights with positions"
            raise DataError(
                f"{source.path}: a distance is for lists of directions, not for {kind}: leave it "
                "out"
            )
        near = positions or self.light_distance_mm is not None
        if not near and (self.height_mm is not None or self.rests_on_plane):
            raise DataError(
                f"{source.path}: a height matters only under lights with positions: leave it out"
            )
        estimated = {
            "their distance": self.light_distance_mm == "estimate",
            "a constant light": self.ambient == "estimate",
        }
        both = next((name for name, asked in estimated.items() if asked), None)
        if both is not None and self.semi_calibrated:
            raise DataError(
                f"{source.path}: the strengths of the lights and {both} cannot both be estimated: "
                "estimate one of them"
            )

    def _solve(
        self,
        examined: Examination,
        maps: MemoryMaps | BandStore,
        files: MapFiles | None,
        colours: Stack | None,
        on_progress: Progress,
    ) -> ShownBySample:
        """Fill the maps; ``colours`` are gray images in colour, for the albedo."""
        solver: GraySolver | ColourSolver
        if isinstance(maps, MemoryMaps) and examined.images.in_colour:
            joint = self.channel == "joint"
            solver = ColourSolver(examined, self.method, maps, joint=joint)
        else:
            solver = GraySolver(examined, self.method, maps)
        rows = None
        if files is not None:
            count, colour = len(examined.lights), colours is not None
            rows = _rows_of_band(examined.source, count, files.memory, colour=colour)

        def on_band(band: slice) -> None:
            if colours is not None:
                found = _albedo_in_colour(maps, colours, examined, band)
                if examined.ambient is not None:
                    found = _as_bright(found, maps["albedo"][band])
                maps["colour"][band] = found

        solve_bands(examined, solver, on_progress, maps, rows, on_band)
        if isinstance(solver, ColourSolver):
            solver.finish()
        return solver.shown

    def _opened(
        self, source: Source, opened: ExitStack, on_progress: Progress, *, in_bands: bool
    ) -> Stack:
        """Return the stack of a source, in bands if it is large and not needed as a whole."""
        channel: Channel = "rgb" if self.channel in ("rgb", "joint") else "gray"
        if self.channel == "mosaic":
            channel = self.channel
        values = len(source.light_ids) * math.prod(source.size) * (3 if channel == "rgb" else 1)
        if not in_bands and (self.semi_calibrated or 4 * values <= _IN_MEMORY):
            return linear_stack(source, channel=channel, on_progress=on_progress)
        return opened.enter_context(open_stack(source, channel=channel, on_progress=on_progress))


def reconstruct(
    source: Source,
    *,
    method: str | Estimator = "best",
    channel: StereoChannel = "auto",
    distant: bool = False,
    light_distance_mm: DistanceChoice = None,
    height_mm: float | None = None,
    rests_on_plane: bool = False,
    pixel_mm: float | None = None,
    ambient: AmbientChoice = "none",
    exclude_disagreeing: bool = False,
    semi_calibrated: bool = False,
    interreflection: bool = False,
    align: AlignChoice = "auto",
    surface: bool = True,
    on_progress: Progress = no_progress,
) -> Reconstruction:
    """Compute normals and height of a recorded object.

    The images are converted to linear radiance; a warning says if they fit the lights much better
    under another transfer curve, others if images, lights and normals do not agree (see
    `image_quality`), or if the lights were calibrated with another rig or camera. Images without
    light on the object are left out. Photometric stereo computes the normals, and their
    integration the height. Near lights are evaluated at the points of the surface: normals and
    height alternate, and the mean height is the one that explains the images best.

    Parameters
    ----------
    source
        Source with lights, as returned by `acquisition.read_source`. If it has no mask, one is
        computed from its images, see `object_mask`.
    method
        Method of `photometric_stereo`.
    channel
        ``auto``: ``joint`` if a sample of images in colour shows that its normals are surer than
        those of ``gray``, else ``gray``; the notice ``colours-used`` says so.
        ``gray``: normals from gray images, for which a mosaic is demosaiced. ``rgb``: one solution
        per channel; the normals are averaged with weights from the noise. ``joint``: one normal and
        one albedo per channel that explain the samples of all channels best. ``mosaic``: normals of
        every site of a Bayer mosaic from its own samples, without interpolation, so that edges of
        colours are as sharp as others; the albedo in colour is interpolated afterwards.
    distant
        Treat lights with positions as distant lights.
    light_distance_mm
        Distance of lights that have only directions, such as those of a dome, from the middle of
        the object: the point of the working plane in the middle of the complete images, for which
        directions and intensities are stated. The lights are then near lights. ``estimate``: find
        it in the images, see `find_light_distance`.
    height_mm
        Mean height of the object above the working plane, if it is known. Only for near lights.
    rests_on_plane
        The lowest points of the object are in the working plane. Only for near lights.
    pixel_mm
        Distance between neighbouring pixels on the object, if the source has no camera with a
        working distance. Without a camera, the view is orthographic.
    ambient
        ``estimate``: find a constant light that is in all images, such as that of the room, and
        subtract it, see `find_ambient_light`.
    exclude_disagreeing
        Leave out images that the other images contradict (see `image_quality`), and divide those
        by a factor of which only the brightness is wrong, unless so many do that it is not known
        which are right.
    semi_calibrated
        Estimate the strengths of the lights, relative to given intensities; see `light_strengths`.
    interreflection
        Subtract the light that a matte object reflects onto itself, if attached shadows show it,
        see `processing.series.interreflection`; the notice ``light-reflected`` says so.
    align
        ``auto``: if camera or object surely moved while the images were taken, by more than
        0.15 px, move the images back by the shifts that `find_image_shifts` finds; the notice
        ``images-aligned`` says so. ``always``: also by less. ``off``: never. Sites of a mosaic
        cannot be moved.
    surface
        Also integrate the normals.
    on_progress
        Callback that receives the progress of the stages ``reading``, ``normals`` and, for images
        in colour, ``error bars`` and ``colour``.

    Returns
    -------
    Reconstruction
        Normals, height and the data they were computed from.

    Raises
    ------
    DataError
        If the source has no lights, or lights with positions and no scale: neither a camera with a
        working distance nor a size of its pixels.
    EstimateError
        If the images or the lights do not determine the normals, or the normals face away from the
        camera.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights, read_source, write_png
    >>> from processing import reconstruct
    >>> lights = Lights(directions=[[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
    >>> y, x = np.mgrid[1:-1:24j, -1:1:24j]
    >>> normals = np.dstack([x, y, 0 * x + 2]) / np.sqrt(x**2 + y**2 + 4)[..., None]
    >>> ball = np.pad(normals @ lights.unit_directions.T, [(8, 8), (8, 8), (0, 0)])
    >>> for i in range(4):
    ...     write_png(f"ball.{i}.png", (60_000 * ball[:, :, i]).astype(np.uint16))
    >>> reconstruct(read_source(".", lights=lights))
    Reconstruction(., NormalMap(float32[40, 40, 3], 572 normals), height in px)
    """
    stage = NormalsStage(
        method=method_name(method),
        channel=channel,
        distant=distant,
        light_distance_mm=light_distance_mm,
        height_mm=height_mm,
        rests_on_plane=rests_on_plane,
        pixel_mm=pixel_mm,
        ambient=ambient,
        exclude_disagreeing=exclude_disagreeing,
        semi_calibrated=semi_calibrated,
        interreflection=interreflection,
        align=align,
    )
    made = stage.run(source, on_progress=on_progress)
    if not surface:
        return made
    depth = None if made.near_height is None else made.near_height.depth
    camera, size = made.source.camera, pixel_mm
    geometry = geometry_of(
        made.source, pixel_mm, height_mm, rests_on_plane=rests_on_plane, distant=distant
    )
    if isinstance(geometry.view, Perspective):
        camera, size = geometry.view.camera, None  # the camera has the scale
    height = integrate(made.normals, camera=camera, pixel_mm=size, depth_mm=depth)
    return replace(made, surface=height, warnings=(*made.warnings, *height.warnings))


def _colours(source: Source, frames: StackFiles, examined: Examination) -> Stack | None:
    """Return the images in colour; None if they have none."""
    if not may_have_colour(source):
        return None
    colours = frames.in_channel("rgb")
    first = colours.ids.index(examined.images.ids[0])
    height, width = source.size
    bands = rows_in_bands(height, 12 * width, _READ)
    return colours if any(coloured(colours.values[first, rows]) for rows in bands) else None


def _albedo_in_colour(
    maps: MemoryMaps | BandStore, colours: Stack, examined: Examination, rows: slice
) -> Float32:
    """Return rows of the albedo in colour, from the rows of the other maps."""
    normals, albedo, residual = (maps[name][rows] for name in ("normals", "albedo", "residual"))
    valid = (albedo > 0) & (maps["reason"][rows] == Reason.VALID)
    points = None if examined.points is None else examined.points.of(rows)
    sums = ColourSums(NormalMap.of_unit_vectors(normals, valid), albedo, residual, points)
    ids, lights = examined.images.ids, examined.lights
    for i, name in enumerate(ids):
        sums.add(colours.values[colours.ids.index(name), rows], lights.take([i]), len(ids))
    return sums.albedo()


def _as_bright(colour: Float32, gray: Float32) -> Float32:
    """Return an albedo in colour whose luma is the gray one, without a constant light."""
    own = luma(colour)
    factor = np.divide(gray, own, out=np.zeros_like(own), where=own > 0)
    return np.asarray(colour * factor[..., None], np.float32)


def _valid_pixels(maps: MemoryMaps | BandStore, examined: Examination) -> tuple[Bool, list[Notice]]:
    """Return the pixels that have a normal, and notices about others."""
    mask = examined.mask
    solved, reason = np.zeros(mask.shape, np.bool_), maps["reason"][:]
    most_used = 0
    for rows in _bands(mask, 6):
        solved[rows] = maps["albedo"][rows] > 0
        used = maps["used"][rows][mask[rows]]
        most_used = max(most_used, int(used.max(initial=0)))
    notices = check_solved(solved, mask, most_used, examined.images)
    valid = solved & (reason == Reason.VALID)
    check_any_valid(valid, reason, solved)
    return valid, list(notices)


def _sum_of_z(normals: MapRows, valid: Bool) -> float:
    return sum(float(normals[rows][..., 2].sum(dtype=np.float64)) for rows in _bands(valid, 12))


def _median(values: MapRows) -> float:
    """Return the median of the finite values, of which one copy is in memory; NaN without any."""
    height, width = values.shape
    parts = (values[rows] for rows in rows_in_bands(height, 4 * width, _READ))
    finite = np.concatenate([part[np.isfinite(part)] for part in parts])
    return float(np.median(finite, overwrite_input=True)) if finite.size else math.nan


def _error(source: Source, normals: MapRows, valid: Bool, mask: Bool) -> AngularError | None:
    # True normals are in memory, so these can be, too.
    if source.normals_truth is None:
        return None
    return angular_error(NormalMap(normals[:], valid), source.normals_truth, mask)


def _bands(mask: Bool, pixel_bytes: int) -> list[slice]:
    height, width = mask.shape
    return rows_in_bands(height, pixel_bytes * width, _READ)


def _memory_need(source: Source, channels: int, *, whole: bool) -> Need:
    """Return the memory for the normals of a source, about.

    Parameters
    ----------
    source
        The recording.
    channels
        3 if the images are solved in colour, else 1.
    whole
        Whether the complete maps are needed.
    """
    (height, width), count = source.size, len(source.light_ids)
    pixels, row = height * width, _row_bytes(source, count, colour=False)
    stack = 4 * channels * count * pixels
    most = (
        _FIXED + (_MAPS + 16 * (channels - 1)) * pixels + (stack if stack <= _STACK else 2 * _BAND)
    )
    least = _FIXED + _on_disk(source) + _LEAST_ROWS * row
    of = f"{pluralize(count, 'image')} of {width} x {height} pixels"
    return Need(most, most if whole else least, of)


def _rows_of_band(source: Source, lights: int, memory: int, *, colour: bool) -> int:
    """Return the rows of a band for which a number of bytes is enough."""
    free = memory - _FIXED - _on_disk(source)
    most = _BAND // (4 * lights * source.size[1])
    rows = free // _row_bytes(source, lights, colour=colour)
    return max(1, min(rows, most))


def _on_disk(source: Source) -> int:
    """Return the bytes besides bands while the maps are on disk."""
    references = {
        frame.exposure_us: 4 * math.prod(frame.shape)
        for frame in source.frames
        if frame.role in ("dark", "ambient")
    }
    # Images in gray and in colour have references of their own.
    kept = sum(references.values()) * (2 if may_have_colour(source) else 1)
    pixels = math.prod(source.size)
    return _ON_DISK * pixels + max(0, kept - 4 * pixels)


def _row_bytes(source: Source, lights: int, *, colour: bool) -> int:
    return (6 * lights + _OF_BAND + (60 if colour else 0)) * source.size[1]
