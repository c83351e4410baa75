"""Whether the frames of a session can be used, before anything is computed from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import isnan, nan

import numpy as np

import acquisition
import processing
import rig
from acquisition.session import FrameLine
from processing.checks import MISSING_DEG, Cause
from sgp.results import Result
from sgp.sessions.session_summary import dark_dn

# Normals need as many lights.
_FEWEST_LIGHTS = 3
# Shares of saturated samples at the shortest exposure time of a light: highlights have less than
# the first; with the second, the object itself is saturated.
_SATURATED, _LOST = 0.01, 0.1
# The brightest thousandth of a frame, an object or a part of it, above that of the frame without
# light, relative to the full scale.
_BRIGHTEST, _DARK = "99.9", 0.02
_LISTED = 6
_TRIED = ("frames-missing", "frames-dark", "frames-saturated", "dark-frames-missing")


def judge_frames(result: Result, session: acquisition.Session) -> Result:
    """Add a verdict about its frames to the description of a session."""
    causes = sorted(_causes(session), key=lambda cause: isnan(cause.normals_deg))
    result.verdict = processing.checks.Verdict(
        tuple(causes), sigma_deg=nan, residual=nan, noise=nan, tried=_TRIED
    )
    result.good = "all frames are there, and none is dark or saturated"
    return result


def _causes(session: acquisition.Session) -> Iterator[Cause]:
    """Yield what is wrong, and whether it leaves too few lights for normals."""
    lights: dict[str, list[FrameLine]] = {}
    for frame in session.frames:
        if frame.role == "light":
            lights.setdefault(frame.light_id, []).append(frame.line)
    unlit, bits = dark_dn(session, _BRIGHTEST), session.manifest.camera.bit_depth
    dark = [name for name, lines in lights.items() if _level(lines, unlit, bits) < _DARK]
    clipped = {name: _clipped(lines) for name, lines in lights.items()}
    lost = [name for name, share in clipped.items() if share > _LOST]
    effect = nan if len(lights.keys() - {*dark, *lost}) >= _FEWEST_LIGHTS else MISSING_DEG
    absent = [*session.missing, *session.left_out]
    if absent:
        names = dict.fromkeys(f"LED {shot.led}" for shot in absent if shot.led is not None)
        text = f"{rig.pluralize(len(absent), 'shot is', 'shots are')} missing{_listed(names)}"
        remedy = "resume the session, or repair the LED and record again"
        yield Cause("frames-missing", text, len(absent), "", nan, effect, nan, remedy)
    if dark:
        text = f"{rig.pluralize(len(dark), 'light is', 'lights are')} hardly visible{_listed(dark)}"
        remedy = "check these LEDs, or lengthen the exposure"
        yield Cause("frames-dark", text, len(dark), "", nan, effect, nan, remedy)
    share = float(np.median([*clipped.values()])) if clipped else 0.0
    if lost or share > _SATURATED:
        worst = max(clipped.values())
        text = (
            f"{share:.1%} of the samples are saturated at the shortest exposure time (median of "
            f"the lights; most {worst:.1%})"
        )
        remedy = "shorten the exposure, add a shorter bracket, or meter"
        if share > _LOST:
            effect = MISSING_DEG
        yield Cause("frames-saturated", text, 100 * share, "%", nan, effect, nan, remedy)
    times = {line.exposure_us for lines in lights.values() for line in lines}
    bare = [f"{us:g}" for us in sorted(us for us in times - unlit.keys() if us is not None)]
    if bare:
        text = f"there is no frame without light at {', '.join(bare[:_LISTED])} us"
        remedy = "add dark or ambient frames to the plan"
        yield Cause("dark-frames-missing", text, len(bare), "", nan, nan, nan, remedy)


def _level(lines: Iterable[FrameLine], unlit: Mapping[float | None, int], bits: int) -> float:
    """Return the level of a light in its brightest frame, relative to the full scale."""
    above = (line.percentiles_dn[_BRIGHTEST] - unlit.get(line.exposure_us, 0) for line in lines)
    return float(max(above) / (2**bits - 1))


def _clipped(lines: Iterable[FrameLine]) -> float:
    """Return the share of saturated samples in the frame of a light that has the fewest."""
    return min(line.clipped_fraction for line in lines)


def _listed(names: Iterable[str]) -> str:
    named = rig.listed(names, _LISTED)
    return f": {named}" if named else ""
