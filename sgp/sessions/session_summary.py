"""Describe a session: figures, and lines for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import acquisition
import rig
from sgp.results import Result

_MOST_GROUPS = 8


def describe(
    session: acquisition.Session, warnings: Iterable[rig.Notice] = (), *, frames: bool = False
) -> Result:
    """Describe the contents of a session.

    Parameters
    ----------
    session
        Complete or incomplete session.
    warnings
        Additional warnings.
    frames
        Whether to add a line for each frame, before the others.

    Returns
    -------
    Result
        Folder and figures of the session, its origin, and a line for each role and exposure time.
    """
    manifest, camera = session.manifest, session.manifest.camera
    events = Counter(line.event for line in session.events)
    metrics: dict[str, Any] = {
        "complete": session.complete,
        "simulated": manifest.simulated,
        "frames": len(session.frames),
        "missing": [shot.file for shot in session.missing],
        "rejected": [f.line.file for f in session.recorded if f.line.status == "rejected"],
        "set_aside": [aside.frame.line.file for aside in session.set_aside],
        "events": dict(events),
        "started_utc": manifest.started_utc.isoformat(),
        **{name: getattr(manifest, name) for name in ("object", "operator", "place", "rights")},
        "camera": camera.model_dump(),
        "transfer": session.transfer.record(),
        "lights": None if session.lights is None else len(session.lights),
    }
    # Without a plan the number of frames that should exist is not known.
    missing = "" if manifest.plan is None else f"{len(session.missing)} missing, "
    texts = (("place", manifest.place), ("rights", manifest.rights), ("notes", manifest.notes))
    summary = [
        *(_frame_table(session) if frames else ()),
        *["origin    SIMULATED, with a virtual board or camera"] * manifest.simulated,
        f"object    {manifest.object or '-'}, by {manifest.operator or '-'}, "
        f"{manifest.started_utc:%Y-%m-%d %H:%M} UTC",
        *(f"{name:<10}{text}" for name, text in texts if text),
        f"camera    {' '.join(filter(None, (camera.vendor, camera.model, camera.serial))) or '-'}, "
        f"{camera.width} x {camera.height}, {camera.bit_depth} bit"
        + (f", colour filter {camera.cfa}" if camera.cfa else "")
        + (f", {session.transfer.name}" if session.transfer != acquisition.LINEAR else ""),
        f"frames    {len(session.frames)}, {missing}{len(metrics['rejected'])} rejected"
        + (f", {len(session.set_aside)} damaged and set aside" if session.set_aside else ""),
    ]
    summary += _groups(session)
    if events:
        summary.append(f"events    {', '.join(f'{n} x {name}' for name, n in events.items())}")
    state = "complete" if session.complete else "INCOMPLETE"
    summary.append(f"session   {session.folder} ({state})")
    return Result(
        outputs={"session": session.folder},
        metrics=metrics,
        warnings=list(dict.fromkeys([*session.warnings, *warnings])),
        summary=summary,
    )


def left_out_notices(session: acquisition.Session) -> list[rig.Notice]:
    """Return a notice about planned shots that were skipped because their LED died."""
    leds = dict.fromkeys(str(shot.led) for shot in session.left_out)
    if not leds:
        return []
    text = f"LED {', '.join(leds)} died: {rig.pluralize(len(session.left_out), 'shot')} skipped"
    return [rig.Notice("frames-left-out", text)]


def _groups(session: acquisition.Session) -> list[str]:
    """Return a line for the frames of each role and exposure time; if there are many, per role."""
    lines = [frame.line for frame in session.frames]
    exposures = {(line.role, line.exposure_us) for line in lines}
    many = len(exposures) > _MOST_GROUPS
    groups: dict[tuple[str, float | None], list[acquisition.session.FrameLine]] = {}
    for line in lines:
        groups.setdefault((line.role, None if many else line.exposure_us), []).append(line)
    return [f"{role:<9} {_group(group)}" for (role, _), group in groups.items()]


def _group(lines: list[acquisition.session.FrameLine]) -> str:
    exposures = sorted({line.exposure_us for line in lines if line.exposure_us is not None})
    bright = sorted(line.percentiles_dn["99"] for line in lines)
    clipped = max(line.clipped_fraction for line in lines)
    shown = [f"{us:g}" for us in dict.fromkeys((*exposures[:1], *exposures[-1:]))]
    at = f" at {' to '.join(shown)} us" if shown else ""
    levels = " to ".join(map(str, dict.fromkeys((bright[0], bright[-1]))))
    return (
        f"{rig.pluralize(len(lines), 'frame')}{at}, 99 % below {levels} DN, "
        f"clipped up to {clipped:.2%}"
    )


def _frame_table(session: acquisition.Session) -> list[str]:
    if not session.frames:
        return []
    width = max(20, *(len(frame.line.file) for frame in session.frames))
    unlit_dn = dark_dn(session)
    names = f"{'role':<7} {'exposure':>11} {'99 % DN':>8} {'lit DN':>7} {'clipped':>9}"
    head = f"{'file':<{width}} {names}"
    return [head, *(_row(frame.line, unlit_dn, width) for frame in session.frames)]


def dark_dn(session: acquisition.Session, percentile: str = "99") -> dict[float | None, int]:
    """Return a percentile of the frames with all LEDs off, by exposure time."""
    unlit = sorted(
        (frame.line for frame in session.frames if frame.role in ("dark", "ambient")),
        key=lambda line: line.role == "ambient",
    )
    return {line.exposure_us: line.percentiles_dn[percentile] for line in unlit}


def _row(
    line: acquisition.session.FrameLine, dark_dn: Mapping[float | None, int], width: int
) -> str:
    exposure = "-" if line.exposure_us is None else f"{line.exposure_us:g} us"
    bright_dn = line.percentiles_dn["99"]
    lit = ""
    if line.role not in ("dark", "ambient") and line.exposure_us in dark_dn:
        lit = str(bright_dn - dark_dn[line.exposure_us])
    return (
        f"{line.file:<{width}} {line.role:<7} {exposure:>11} {bright_dn:>8} {lit:>7} "
        f"{line.clipped_fraction:>9.3%}"
    )
