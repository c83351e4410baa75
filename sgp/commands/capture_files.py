"""``capture``: compact, export and import sessions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

import acquisition
import rig
from sgp.cli import options
from sgp.cli.console import note, with_progress
from sgp.cli.exit import UsageError
from sgp.commands.capture_info import info
from sgp.results import ExportMetrics, Result, check_folder, earlier_files, writes_folder
from sgp.rigs import chosen_operator, given_lights
from sgp.stages import not_used

_RECORD = "export.json"

Bracket = Annotated[options.Whole, Parameter(validator=Number(gte=0, lte=1000))]


def compact(session: options.Input) -> Result:
    """Compress the frames of a session without changing a pixel.

    Each frame is compressed, read back and compared before its old file is deleted. If the command
    is interrupted, the session is intact: run the command again.

    For example:

        capture compact recordings/owl

    Parameters
    ----------
    session
        Folder of the session.
    """
    done = with_progress(acquisition.session.compact_session)(session)
    ratio = done.bytes_before / max(done.bytes_after, 1)
    kept = "" if done.complete else ", the session is still incomplete"
    return Result(
        outputs={"session": done.folder},
        metrics={
            "frames": done.frames,
            "compacted": done.compacted,
            "bytes_before": done.bytes_before,
            "bytes_after": done.bytes_after,
            "ratio": ratio,
            "complete": done.complete,
        },
        summary=[
            f"{session}: {done.compacted} of {done.frames} frames compacted, "
            f"{done.bytes_before / 1e6:.1f} MB reduced to {done.bytes_after / 1e6:.1f} MB "
            f"(ratio {ratio:.2f}){kept}"
        ],
    )


@writes_folder(_RECORD)
def export(
    session: options.Input,
    *,
    layout: Annotated[Literal["diligent", "lp", "exr", "alicevision"], Parameter(name="format")],
    out: Path,
    values: Literal["raw", "linear"] = "raw",
    bracket: Bracket = 0,
    lights: options.OptionalLights = None,
    mask: options.OptionalInput = None,
    force: bool = False,
) -> Result:
    """Export a session for other programs; `capture import` reads all formats except exr.

    recording.json describes the images: levels, exposure times, LEDs, operator, object, and all
    data for which the format has no place. lights.json contains all data of the lights. `sgp
    normals` and `sgp run` read both files, so an export gives the same results as the session
    (except exr).

    For example:

        capture export recordings/owl --format diligent --out owl-diligent
        capture export recordings/owl --format exr --values linear --out owl-exr

    Parameters
    ----------
    session
        Folder of the session.
    layout
        diligent: 16-bit PNGs, light directions and intensities, mask, Normal_gt.mat. lp: PNGs and
        lights.lp. exr: every frame as float, with attributes. alicevision: PNGs and lights JSON.
    out
        New folder.
    values
        raw: values as recorded. linear: transfer curve removed, dark frame or black level
        subtracted, white level at full scale.
    bracket
        Number of the bracket, from 0, to export if the format has one image per light.
    lights
        Lights file: lights.json, .lp, CSV or DiLiGenT text; default: the lights of the session.
    mask
        Mask image of the object; default: the mask of the session.
    force
        Write into a folder that contains an earlier export.
    """
    given = None if lights is None else given_lights(lights, [session])
    chosen = None if given is None else given.lights
    prepared = acquisition.exports.prepare_export(
        session, layout, values=values, bracket=bracket, lights=chosen, mask_path=mask
    )
    written = with_progress(prepared.write)(out, replaced=earlier_files(out, _RECORD))
    notes = prepared.notes
    images = len(notes.frames)
    return Result(
        outputs={path.name: path for path in written},
        metrics=ExportMetrics(
            images=images,
            values=notes.values,
            subtracted=notes.subtracted,
            black_level_dn=notes.camera.black_level_dn,
            white_level_dn=notes.camera.white_dn,
            exposures_us=sorted({f.exposure_us for f in notes.frames if f.exposure_us}),
        ),
        warnings=[*(() if given is None else given.lights.warnings), *prepared.warnings],
        summary=[
            f"{out}: {rig.pluralize(images, 'image')}, {notes.values} values, "
            f"subtracted: {notes.subtracted}"
        ],
        inputs=[*prepared.inputs, *([] if given is None else [given.file])],
    )


def import_(
    source: options.Input,
    *,
    out: Path,
    lights: options.OptionalLights = None,
    camera: options.OptionalInput = None,
    working_distance_mm: options.Positive | None = None,
    light_axes: Literal["opencv", "opengl", "house"] | None = None,
    mask: options.OptionalInput = None,
    object_name: str = "",
    operator: str | None = None,
    place: str = "",
    notes: str = "",
    rights: str = "",
    watch: bool = False,
    leds: str | None = None,
    led_count: options.Leds | None = None,
    plan: options.OptionalInput = None,
    interval_s: options.Positive | None = None,
    gaps: Annotated[bool, Parameter(negative="--no-gaps")] = True,
    timeout_s: options.Positive = 600.0,
    gamma: options.Gamma = "auto",
    max_pixels: options.Pixels = rig.MAX_PIXELS,
) -> Result:
    """Import photographs into a session.

    Camera RAW files stay linear: black and white level and the colour filter pattern are recorded.
    Other images keep their samples, and their transfer curve is recorded.
    With --watch, each image is imported as soon as a tethered camera has delivered it. The number
    in its name gives its LED, so pauses and restarts change nothing, and a missing number leaves an
    LED empty. Ctrl-C stops; run the same command again to continue.

    For example:

        capture import photographs/ --lights lights.lp --out recordings/vase
        capture import near/ --lights light.mat --camera camera.json --out near
        capture import tethered/ --watch --leds 0-35 --out recordings/vase

    Parameters
    ----------
    source
        Folder of images with or without an .lp file, DiLiGenT object folder, export, or one image
        file.
    out
        New folder for the session; with --watch also an incomplete session to continue.
    lights
        Lights file: lights.json, .lp, DiLiGenT text, or a calibration of near lights (.mat or text
        with positions S, axes Dir, mu, Phi).
    camera
        Camera model: camera.json, OpenCV YAML, COLMAP, or .mat or text with K.
    working_distance_mm
        Distance from the camera to the object, for a camera file without one.
    light_axes
        Axes of a calibration of near lights: opencv (Y down, Z away from the camera), opengl (Y up,
        Z toward the camera), both with the origin in the camera, or house; default: opencv.
    mask
        Mask image of the object; default: the mask of the source.
    object_name
        Name of the object.
    operator
        Name of the operator; default: that of the export, and with --watch `operator` in the
        configuration file.
    place
        Place of the recording.
    notes
        Free text.
    rights
        Holder of the rights, and the licence.
    watch
        Wait for images to arrive in the folder.
    leds
        With --watch: LEDs as a list with ranges (0-35); expect one image of each, in this order.
    led_count
        With --watch: number of LEDs; expect one image of each LED, in order.
    plan
        With --watch: plan file; expect its shots, in order.
    interval_s
        With --watch: seconds between shots, so that longer pauses count as missing images.
    gaps
        With --watch: --no-gaps counts images in order of arrival and ignores their numbers.
    timeout_s
        With --watch: seconds to wait for the next image.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    """
    # Files that exist may be from someone else, so the configured operator counts only in a watch.
    operator_name = chosen_operator(operator) if watch else operator or ""
    labels = acquisition.Labels(operator_name, object_name, place, notes, rights)
    of_import = {
        "--mask": mask,
        "--camera": camera,
        "--working-distance-mm": working_distance_mm,
        "--light-axes": light_axes,
    }
    of_watch = {
        "--leds": leds,
        "--led-count": led_count,
        "--plan": plan,
        "--interval-s": interval_s,
    }
    for name, given in of_import.items() if watch else of_watch.items():
        if given is not None:
            refused = "cannot be used with --watch: leave it out"
            required = f"requires --watch: add --watch, or leave {name} out"
            raise UsageError(f"{name} {refused if watch else required}")
    if watch:
        listed = led_count if leds is None else options.led_list("--leds", leds)
        if leds is not None and led_count is not None:
            raise UsageError("--leds and --led-count both give the LEDs: give only one")
        if (listed is None) == (plan is None):
            text = "--watch requires either --leds, --led-count or --plan, which give the shots"
            raise UsageError(text)
        if interval_s is not None and not gaps:
            raise UsageError("--no-gaps ignores the time between images: leave out --interval-s")
        # The camera and its lights are operated by hand, one image for each light.
        chosen = None if plan is None else acquisition.read_plan(plan).changed(repeat=False)
        in_order = acquisition.imports.lights_in_order(listed or 0)
        asked = acquisition.imports.Watch(
            source,
            in_order if chosen is None else chosen.shots(),
            chosen,
            interval_s,
            gaps,
            timeout_s,
            transfer=options.transfer_of(gamma),
            max_pixels=max_pixels,
        )
        return _import_watched(asked, out, lights, labels)
    if working_distance_mm is not None and camera is None:
        raise UsageError("--working-distance-mm requires --camera: add it")
    check_folder(out)

    def opened_with(
        lights: acquisition.Lights | None = None, camera: acquisition.CameraModel | None = None
    ) -> acquisition.Source:
        return acquisition.imports.read_import(
            source,
            lights=lights,
            camera=camera,
            mask_path=mask,
            transfer=options.transfer_of(gamma),
            max_pixels=max_pixels,
        )

    model = None
    if camera is not None:
        model = acquisition.read_camera(camera, opened_with().size)
        if working_distance_mm is not None:
            model = replace(model, working_distance_mm=working_distance_mm)
    near = None
    if lights not in (None, options.RIG_LIGHTS) and acquisition.value_files.is_near_lights(lights):
        distance = None if model is None else model.working_distance_mm
        if distance is None and light_axes != "house":
            missing = "--camera" if model is None else "--working-distance-mm"
            raise UsageError(f"{lights}: near lights in the camera's axes: add {missing}")
        near = acquisition.value_files.read_near_lights(lights, model, axes=light_axes)
    elif light_axes is not None:
        raise UsageError("--light-axes requires a calibration of near lights as --lights")
    stated = None if lights is None or near else given_lights(lights).lights
    opened = opened_with(near.lights if near else stated, model)
    with_progress(acquisition.import_frames)(opened, out, labels)
    result = info(out)
    used = {option.resolve() for option in (lights, camera, mask) if option is not None}
    others = [name for name in opened.ignored if (source / name).resolve() not in used]
    unused = [not_used(source, others)] if others else []
    of_lights = [] if near is None else [near.notice]
    result.warnings[:0] = [*of_lights, *opened.warnings, *unused]
    return result


def _import_watched(
    watch: acquisition.imports.Watch, out: Path, lights: Path | None, labels: acquisition.Labels
) -> Result:
    if not (out / "session.toml").is_file():
        check_folder(out)
    chosen = None if lights is None else given_lights(lights).lights
    printed: list[str] = []

    def report(line: str) -> None:
        printed.append(line)
        note(line)

    try:
        watched = with_progress(acquisition.watch_folder)(
            watch, out, lights=chosen, on_message=report, labels=labels
        )
    except BaseException as error:
        if printed:
            _note_how_to_continue(out, watch.folder, interrupted=not isinstance(error, Exception))
        raise
    result = info(out)
    result.ok = watched.session.complete
    missing = [shot.file for shot in watched.missing]
    result.metrics = {**result.metrics, "missing": missing}
    result.warnings += [n for n in watched.warnings if str(n) not in printed]
    if watched.missing:
        result.summary.append(
            f"{out}: INCOMPLETE, {len(watched.missing)} of {len(watch.shots)} shots missing, "
            f"first {watched.missing[0].file}; run the same command again to continue"
        )
    return result


def _note_how_to_continue(out: Path, folder: Path, *, interrupted: bool) -> None:
    try:
        session = acquisition.Session.open(out)
    except (acquisition.DataError, acquisition.MissingPathError):
        if interrupted:
            note(f"{folder}: nothing was recorded yet; run the same command again to continue")
        return
    intact = rig.pluralize(len(session.frames), "frame is", "frames are")
    note(f"{out}: {intact} intact; run the same command again to continue")
