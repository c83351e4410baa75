"""``capture``: record sessions and look after them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from acquisition import (
    CapturePlan,
    DataError,
    MissingPathError,
    Session,
    StorageError,
    import_frames,
    read_camera,
    read_lights,
    read_plan,
    record,
    verify_session,
)
from rig import RigError, open_rig
from sgp._console import note, progress
from sgp._options import Count
from sgp._output import check_folder
from sgp._result import Result
from sgp._stages import open_source

_DEFAULT_EXPOSURE_US = 20_000.0


def plan(
    plan: Path | None = None,
    *,
    leds: Count = 36,
    width: Count = 2448,
    height: Count = 2048,
) -> Result:
    """Show what a plan would record, without touching hardware.

    For example:

        capture plan plan.toml --width 2448 --height 2048

    Parameters
    ----------
    plan
        Plan file; default: every LED once at 20 ms, and a dark frame.
    leds
        LEDs of the board.
    width
        Width of a frame in pixels.
    height
        Height of a frame in pixels.
    """
    chosen = _plan(plan, tuple(range(leds)))
    chosen.check(leds)
    shots = chosen.shots()
    size = len(shots) * width * height * 2
    exposed = sum(shot.exposure_us or 0.0 for shot in shots) / 1e6
    return Result(
        metrics={
            "shots": [shot.file for shot in shots],
            "bytes": size,
            "exposure_seconds": exposed,
        },
        summary=[
            *(f"{shot.file:<16} {shot.role:<8} {shot.exposure_us:>10g} us" for shot in shots),
            f"{len(shots)} shots, {exposed:.2f} s of exposure, {size / 1e6:.0f} MB",
        ],
    )


def run(
    out: Path,
    *,
    rig: str = "simulated",
    plan: Path | None = None,
    object_name: str = "",
    operator: str = "",
    notes: str = "",
    camera: Path | None = None,
    lights: Path | None = None,
) -> Result:
    """Record a session on a rig.

    Every frame is on disk, hashed and journalled, before the next is taken. Ctrl-C turns the LEDs
    off and leaves what was recorded as a whole, incomplete session.

    For example:

        capture run recordings/owl --rig bench.toml --plan plan.toml --object-name owl

    Parameters
    ----------
    out
        New folder for the session. Nothing is ever recorded over a session.
    rig
        Name of a rig, or a rig.toml.
    plan
        Plan file; default: every working LED once at 20 ms, and a dark frame.
    object_name
        What is recorded.
    operator
        Who records it.
    notes
        Anything worth knowing later.
    camera
        Camera model to store with the session.
    lights
        Calibrated lights to store with the session.
    """
    check_folder(out)
    with open_rig(rig) as opened:
        info, config = opened.camera.info, opened.config
        working = tuple(led for led in range(config.leds) if led not in config.dead_leds)
        chosen = _plan(plan, working)
        model = None if camera is None else read_camera(camera, (info.height, info.width))
        with progress("recording") as advance:
            try:
                session = record(
                    opened,
                    chosen,
                    out,
                    operator=operator,
                    object_name=object_name,
                    notes=notes,
                    camera_model=model,
                    lights=None if lights is None else read_lights(lights),
                    on_frame=lambda line, done, total: advance(done, total),
                )
            except (KeyboardInterrupt, RigError, StorageError, DataError) as error:
                _tell_what_is_left(out, error)
                raise
    return _describe(session)


def verify(session: Path) -> Result:
    """Check every hash of a session and name what is damaged or missing.

    For example:

        capture verify recordings/owl

    Parameters
    ----------
    session
        The session's folder.
    """
    found = verify_session(session)
    result = Result(
        metrics={
            "whole": found.ok,
            "complete": found.complete,
            "frames": found.frames,
            "events": found.events,
            "bytes": found.bytes,
            "problems": list(found.problems),
            "missing": list(found.missing),
        },
        warnings=list(found.warnings),
        summary=list(found.problems),
        ok=found.ok and found.complete,
    )
    if found.problems:
        result.summary.append(f"{session}: DAMAGED, {len(found.problems)} problems")
    elif not found.complete:
        missing = f", first missing {found.missing[0]}" if found.missing else ""
        result.summary.append(
            f"{session}: incomplete, {found.frames} frames are whole, "
            f"{len(found.missing)} are missing{missing}"
        )
    else:
        result.summary.append(
            f"{session}: whole and complete, {found.frames} frames, {found.bytes / 1e6:.1f} MB"
        )
    return result


def info(session: Path) -> Result:
    """Tell what a session holds.

    For example:

        capture info recordings/owl

    Parameters
    ----------
    session
        The session's folder.
    """
    opened = Session.open(session)
    result = _describe(opened)
    gone = [frame.path.name for frame in opened.frames if not frame.path.is_file()]
    if gone:
        result.warnings.append(
            f"{len(gone)} frame files are not there, first {gone[0]}: see verify"
        )
    return result


def import_(
    source: Path,
    *,
    out: Path,
    lights: Path | None = None,
    object_name: str = "",
    operator: str = "",
    notes: str = "",
) -> Result:
    """Bring photographs into a session.

    Camera RAW stays linear: black and white level and the colour filter pattern are recorded.

    For example:

        capture import photographs/ --lights lights.lp --out recordings/vase
        capture import IMG_0001.CR2 --out recordings/one-frame

    Parameters
    ----------
    source
        A folder of images with or without an .lp, a DiLiGenT object folder, or one image file.
    out
        New folder for the session.
    lights
        lights.json, .lp or DiLiGenT text.
    object_name
        What was recorded.
    operator
        Who recorded it.
    notes
        Anything worth knowing later.
    """
    check_folder(out)
    opened, _ = open_source(source, lights=lights)
    with progress("importing") as advance:
        session = import_frames(
            opened,
            out,
            operator=operator,
            object_name=object_name,
            notes=notes,
            on_frame=lambda line, done, total: advance(done, total),
        )
    result = _describe(session)
    result.warnings[:0] = opened.warnings
    return result


def _plan(path: Path | None, leds: tuple[int, ...]) -> CapturePlan:
    if path is not None:
        return read_plan(path)
    return CapturePlan(leds=leds, exposures_us=(_DEFAULT_EXPOSURE_US,))


def _tell_what_is_left(out: Path, error: BaseException) -> None:
    """Say what a capture that stopped has left; why it stopped is said by the error itself."""
    try:
        session = Session.open(out)
    except (DataError, MissingPathError):
        return  # nothing had been recorded
    # The engine adds a note to the error where the board did not answer.
    lights = "see below for the LEDs" if hasattr(error, "__notes__") else "the LEDs are off"
    note(f"{out}: incomplete, {len(session.frames)} frames are whole; {lights}")


def _describe(session: Session) -> Result:
    manifest, camera = session.manifest, session.manifest.camera
    metrics: dict[str, Any] = {
        "complete": session.complete,
        "frames": len(session.frames),
        "missing": [shot.file for shot in session.missing],
        "started_utc": manifest.started_utc.isoformat(),
        "object": manifest.object,
        "operator": manifest.operator,
        "camera": camera.model_dump(),
        "lights": None if session.lights is None else len(session.lights),
    }
    summary = [
        f"session   {session.folder} ({'complete' if session.complete else 'INCOMPLETE'})",
        f"object    {manifest.object or '-'}, by {manifest.operator or '-'}, "
        f"{manifest.started_utc:%Y-%m-%d %H:%M} UTC",
        f"camera    {' '.join(filter(None, (camera.vendor, camera.model, camera.serial))) or '-'}, "
        f"{camera.width} x {camera.height}, {camera.bit_depth} bit"
        + (f", colour filter {camera.cfa}" if camera.cfa else ""),
        f"frames    {len(session.frames)}, {len(session.missing)} missing",
    ]
    for frame in session.frames:
        line = frame.line
        exposure = "-" if line.exposure_us is None else f"{line.exposure_us:g} us"
        summary.append(
            f"  {line.file:<24} {line.role:<8} {exposure:>10}  clipped {line.clipped_fraction:.3%}"
        )
    return Result(
        outputs={"session": session.folder},
        metrics=metrics,
        warnings=list(session.warnings),
        summary=summary,
    )
