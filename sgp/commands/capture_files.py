"""``capture``: sessions made smaller, written for other programs, and made from their images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from acquisition import (
    DataError,
    MissingPathError,
    PlannedShot,
    Session,
    Watch,
    compact_session,
    import_frames,
    lights_in_order,
    prepare_export,
    read_import,
    read_lights,
    read_plan,
    watch_folder,
)
from rig import MAX_PIXELS
from sgp._console import Stages, note
from sgp._exit import UsageError
from sgp._options import Leds, Pixels, Positive, Whole
from sgp._output import check_folder, earlier_files, writes_folder
from sgp._result import Result
from sgp.commands.capture import info

_RECORD = "export.json"

Bracket = Annotated[Whole, Parameter(validator=Number(gte=0, lte=1000))]


def compact(session: Path) -> Result:
    """Make a session smaller without changing a pixel.

    Each frame is compressed, read back and compared before its old file goes. When the command is
    cut off, everything is whole: run it again.

    For example:

        capture compact recordings/owl

    Parameters
    ----------
    session
        The session's folder.
    """
    with Stages() as progress:
        done = compact_session(session, on_progress=progress)
    ratio = done.bytes_before / max(done.bytes_after, 1)
    kept = "" if done.complete else ", incomplete as it was"
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
            f"{done.bytes_before / 1e6:.1f} MB are {done.bytes_after / 1e6:.1f} MB now "
            f"(ratio {ratio:.2f}){kept}"
        ],
    )


@writes_folder(_RECORD)
def export(
    session: Path,
    *,
    layout: Annotated[Literal["diligent", "lp", "exr", "alicevision"], Parameter(name="format")],
    out: Path,
    values: Literal["raw", "linear"] = "raw",
    bracket: Bracket = 0,
    lights: Path | None = None,
    mask: Path | None = None,
    force: bool = False,
) -> Result:
    """Write a session for other programs; `capture import` brings all but exr back.

    recording.json tells what the images are: levels, exposures, LEDs, who recorded what, and what
    the layout has no place for. lights.json has all that is known of the lights. `sgp normals` and
    `sgp run` read both, so they give of an export what they give of the session (not of exr).

    For example:

        capture export recordings/owl --format diligent --out owl-diligent
        capture export recordings/owl --format exr --values linear --out owl-exr

    Parameters
    ----------
    session
        The session's folder.
    layout
        diligent: 16-bit PNGs, light directions and intensities, mask, Normal_gt.mat. lp: PNGs and
        lights.lp. exr: every frame as float, with attributes. alicevision: PNGs and lights JSON.
    out
        New folder.
    values
        raw: samples as recorded. linear: less dark frames or black level, white at full scale.
    bracket
        Exposure to take, from 0, where the layout has one image a light.
    lights
        lights.json, .lp or DiLiGenT text; default: the session's own.
    mask
        Image of the object; default: the session's own.
    force
        Write into a folder that holds an earlier export.
    """
    chosen = None if lights is None else read_lights(lights)
    prepared = prepare_export(
        session, layout, values=values, bracket=bracket, lights=chosen, mask_path=mask
    )
    with Stages() as progress:
        written = prepared.write(out, on_progress=progress, replaced=earlier_files(out, _RECORD))
    notes = prepared.notes
    images = len(notes.frames)
    return Result(
        outputs={path.name: path for path in written},
        metrics={
            "images": images,
            "values": notes.values,
            "subtracted": notes.subtracted,
            "black_level_dn": notes.camera.black_level_dn,
            "white_level_dn": notes.camera.white_dn,
            "exposures_us": sorted({f.exposure_us for f in notes.frames if f.exposure_us}),
        },
        warnings=list(prepared.warnings),
        summary=[f"{out}: {images} images, {notes.values} values, subtracted: {notes.subtracted}"],
        inputs=[*prepared.inputs, *(path for path in (lights,) if path is not None)],
    )


def import_(
    source: Path,
    *,
    out: Path,
    lights: Path | None = None,
    mask: Path | None = None,
    object_name: str = "",
    operator: str = "",
    place: str = "",
    notes: str = "",
    rights: str = "",
    watch: bool = False,
    leds: Leds | None = None,
    plan: Path | None = None,
    interval_s: Positive | None = None,
    gaps: Annotated[bool, Parameter(negative="--no-gaps")] = True,
    timeout_s: Positive = 600.0,
    max_pixels: Pixels = MAX_PIXELS,
) -> Result:
    """Bring photographs into a session.

    Camera RAW stays linear: black and white level and the colour filter pattern are recorded.
    With --watch images are taken as a tethered camera delivers them; a pause of two intervals
    leaves a hole for the image that is missing. Ctrl-C ends it; the same command goes on.

    For example:

        capture import photographs/ --lights lights.lp --out recordings/vase
        capture import IMG_0001.CR2 --out recordings/one-frame
        capture import tethered/ --watch --leds 36 --out recordings/vase

    Parameters
    ----------
    source
        A folder of images with or without an .lp, a DiLiGenT object folder, an export, or one image
        file.
    out
        New folder for the session; with --watch also an incomplete one to go on with.
    lights
        lights.json, .lp or DiLiGenT text.
    mask
        Image of the object; default: the source's own.
    object_name
        What was recorded.
    operator
        Who recorded it.
    place
        Where.
    notes
        Anything worth knowing later.
    rights
        Who holds the rights, and the licence.
    watch
        Wait for images to appear in the folder.
    leds
        With --watch: one image of each LED from 0.
    plan
        With --watch: the shots of a plan, in its order.
    interval_s
        With --watch: seconds between shots; default: found from the first images.
    gaps
        With --watch: --no-gaps matches by order alone.
    timeout_s
        With --watch: how long to wait for the next image.
    max_pixels
        Refuse images of more pixels, before they are decoded.
    """
    texts = {
        "operator": operator,
        "object": object_name,
        "place": place,
        "notes": notes,
        "rights": rights,
    }
    if watch:
        if mask is not None:
            raise UsageError("--mask goes with images that are there: leave it out with --watch")
        asked = _watch(source, leds, plan, interval_s, gaps=gaps, timeout_s=timeout_s)
        asked = replace(asked, max_pixels=max_pixels)
        return _import_watched(asked, out, lights, texts)
    for option, given in (("--leds", leds), ("--plan", plan), ("--interval-s", interval_s)):
        if given is not None:
            raise UsageError(f"{option} is for --watch: add that, or leave it out")
    check_folder(out)
    chosen = None if lights is None else read_lights(lights)
    opened = read_import(source, lights=chosen, mask_path=mask, max_pixels=max_pixels)
    del texts["object"]
    with Stages() as progress:
        import_frames(
            opened,
            out,
            object_name=object_name,
            **texts,
            on_progress=progress,
        )
    result = info(out)
    told = [f"{source}: not used: {', '.join(opened.ignored)}"] if opened.ignored else []
    result.warnings[:0] = [*opened.warnings, *told]
    return result


def _watch(
    source: Path,
    leds: int | None,
    plan: Path | None,
    interval_s: float | None,
    *,
    gaps: bool,
    timeout_s: float,
) -> Watch:
    if (leds is None) == (plan is None):
        raise UsageError("--watch needs to know the shots: give --leds or --plan, one of the two")
    if interval_s is not None and not gaps:
        raise UsageError("--no-gaps takes no notice of time: leave out --interval-s")
    chosen = None if plan is None else read_plan(plan)
    shots: tuple[PlannedShot, ...]
    shots = lights_in_order(leds or 0) if chosen is None else chosen.shots()
    return Watch(source, shots, chosen, interval_s, gaps, timeout_s)


def _import_watched(watch: Watch, out: Path, lights: Path | None, texts: dict[str, str]) -> Result:
    if not (out / "session.toml").is_file():
        check_folder(out)
    chosen = None if lights is None else read_lights(lights)
    told: list[str] = []

    def tell(line: str) -> None:
        told.append(line)
        note(line)

    try:
        with Stages() as progress:
            watched = watch_folder(
                watch, out, lights=chosen, tell=tell, on_progress=progress, texts=texts
            )
    except BaseException:
        if told:
            _tell_how_to_go_on(out)
        raise
    result = info(out)
    result.ok = watched.session.complete
    result.metrics["missing"] = [shot.file for shot in watched.missing]
    result.warnings += [line for line in watched.warnings if line not in told]
    if watched.missing:
        result.summary.append(
            f"{out}: INCOMPLETE, {len(watched.missing)} of {len(watch.shots)} shots missing, "
            f"first {watched.missing[0].file}; the same command goes on"
        )
    return result


def _tell_how_to_go_on(out: Path) -> None:
    try:
        session = Session.open(out)
    except (DataError, MissingPathError):
        return  # nothing had been recorded
    note(f"{out}: {len(session.frames)} frames are whole; the same command goes on")
