"""Describe a session: figures, and lines for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import acquisition
import rig
from sgp._result import Result


def describe(session: acquisition.Session, warnings: Iterable[rig.Notice] = ()) -> Result:
    """Describe the contents of a session.

    Parameters
    ----------
    session
        Complete or incomplete session.
    warnings
        Additional warnings.

    Returns
    -------
    Result
        Folder and figures of the session, its origin, and a line for each frame.
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
        f"session   {session.folder} ({'complete' if session.complete else 'INCOMPLETE'})",
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
    if events:
        summary.append(f"events    {', '.join(f'{n} x {name}' for name, n in events.items())}")
    if session.frames:
        summary.append(f"  {'file':<24} {'role':<8} {'exposure':>12} {'99 % DN':>8} {'lit DN':>7}")
    dark_dn = _dark_dn(session)
    summary += [_row(frame.line, dark_dn) for frame in session.frames]
    return Result(
        outputs={"session": session.folder},
        metrics=metrics,
        warnings=list(dict.fromkeys([*session.warnings, *warnings])),
        summary=summary,
    )


def _dark_dn(session: acquisition.Session) -> dict[float | None, int]:
    """Return the 99th percentile of the frames with all LEDs off, by exposure time."""
    unlit = sorted(
        (frame.line for frame in session.frames if frame.role in ("dark", "ambient")),
        key=lambda line: line.role == "ambient",
    )
    return {line.exposure_us: line.percentiles_dn["99"] for line in unlit}


def _row(line: acquisition.FrameLine, dark_dn: Mapping[float | None, int]) -> str:
    exposure = "-" if line.exposure_us is None else f"{line.exposure_us:g} us"
    bright_dn = line.percentiles_dn["99"]
    lit = ""
    if line.role in ("light", "flat") and line.exposure_us in dark_dn:
        lit = str(bright_dn - dark_dn[line.exposure_us])
    return (
        f"  {line.file:<24} {line.role:<8} {exposure:>12} {bright_dn:>8} {lit:>7}  "
        f"clipped {line.clipped_fraction:.3%}"
    )
