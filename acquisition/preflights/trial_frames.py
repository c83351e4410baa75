"""Pre-flight of the image: light, focus and linearity of trial frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.preflights.check import Check
from rig.arrays import Bool, Float32, UInt16

_NEAR, _FAR = 2, 8  # even, so that compared samples have the same colour under a Bayer filter
# An image without structure finer than the far distance has a detail of 0.0625.
_BLURRED = 0.08
_CONTRAST = 0.002
_CLIPPED = 0.01
_DIM = 0.2
_ROOM = 0.02
# Beyond these a recording is useless: share of saturated samples, of full scale, of an LED's light.
_MOSTLY_CLIPPED = 0.1
_DARK = 0.02
_BRIGHT_ROOM = 0.5
_BENT, _STRONGLY_BENT = 0.02, 0.05
_UNSTEADY = 0.01
_LEAST_LIGHT_DN = 2.0
PWM_PERIOD_US = 1024.0


@dataclass(frozen=True, eq=False)
class Trials:
    """Trial frames of one LED, with the exposure times that the camera reported.

    Parameters
    ----------
    led
        The LED.
    black
        Mean of a frame with all LEDs off at the shortest exposure, grey values.
    white_dn
        Grey value from which a sample is saturated.
    lit
        Two frames under the LED at its longest exposure.
    unlit
        Frame with all LEDs off at the same exposure.
    half
        Frame under the LED at about half that exposure.
    half_unlit
        Frame with all LEDs off at about half that exposure.
    lit_us, half_us
        The two exposure times, microseconds.
    """

    led: int
    black: float
    white_dn: float
    lit: tuple[UInt16, UInt16]
    unlit: UInt16
    half: UInt16
    half_unlit: UInt16
    lit_us: float
    half_us: float


def check_response(trials: Trials) -> Check:
    """Check that twice the exposure gives twice the signal: no auto exposure, no gamma."""
    valid = (trials.lit[0] < 0.9 * trials.white_dn) & (trials.half < 0.9 * trials.white_dn)
    if valid.mean() < 0.01:
        text = "nearly every sample is saturated: shorten the exposure"
        return Check("response", "not done", text)
    long_dn = _mean(trials.lit[0], valid) - _mean(trials.unlit, valid)
    short_dn = _mean(trials.half, valid) - _mean(trials.half_unlit, valid)
    if short_dn < _LEAST_LIGHT_DN:
        text = f"LED {trials.led} gives too little light: lengthen the exposure"
        return Check("response", "not done", text)
    bend = (long_dn / short_dn) / (trials.lit_us / trials.half_us) - 1
    values = {"deviation": round(bend, 4), "led": trials.led}
    finding = (
        f"from {trials.half_us:g} to {trials.lit_us:g} us the light of LED {trials.led} grows by "
        f"a factor of {long_dn / short_dn:.3f}, expected {trials.lit_us / trials.half_us:.3f}"
    )
    if abs(bend) <= _BENT:
        return Check("response", "ok", f"{finding}: linear", values)
    return Check(
        "response",
        "failed" if abs(bend) > _STRONGLY_BENT else "warning",
        f"{finding}: turn off the camera's automatic functions (auto exposure, auto gain, gamma, "
        "black-level and shading correction), or let the LEDs warm up",
        values,
    )


def check_exposure(
    frames: list[tuple[float, UInt16]], black: float, white_dn: float, limit: float
) -> Check:
    """Check the frames of all brackets: the longest is not too dark, the shortest not saturated.

    Parameters
    ----------
    frames
        Exposure time and frame of each bracket under one LED.
    black
        Grey value without light.
    white_dn
        Grey value from which a sample is saturated.
    limit
        The plan's ``max_clipped_fraction``; frames above it are rejected.
    """
    clipped = {us: float(np.mean(pixels >= white_dn)) for us, pixels in frames}
    long_us, longest = max(frames, key=lambda frame: frame[0])
    short_us = min(clipped)
    level = (float(np.percentile(longest, 99.5)) - black) / (white_dn - black)
    values = {
        "level": round(level, 4),
        "clipped_fraction": clipped[short_us],
        "most_clipped_fraction": max(clipped.values()),
    }
    finding = f"{level:.0%} of full scale at {long_us:g} us, {clipped[short_us]:.2%} saturated"
    if len(frames) > 1:
        finding += f" at {short_us:g} us"
    if max(clipped.values()) > limit:
        text = (
            f"{max(clipped.values()):.2%} of a frame is saturated, the plan allows {limit:.2%} and "
            "the recording would end there: shorten the exposure, or meter"
        )
        return Check("exposure", "failed", text, values)
    if clipped[short_us] > _CLIPPED:
        text = f"{finding}: shorten the exposure, add a shorter bracket, or meter"
        doubt = "exposure-saturated" if clipped[short_us] > _MOSTLY_CLIPPED else ""
        return Check("exposure", "warning", text, values, doubt=doubt)
    if level < _DIM:
        text = f"{finding}: lengthen the exposure, or meter"
        doubt = "exposure-too-dark" if level < _DARK else ""
        return Check("exposure", "warning", text, values, doubt=doubt)
    return Check("exposure", "ok", finding, values)


def detail(one: UInt16, other: UInt16) -> tuple[float, float]:
    """Return the detail and the contrast of an image.

    Detail is the mean squared difference of samples 2 apart divided by that of samples 8 apart: 1
    for structure down to single pixels, 0.0625 without structure finer than 8 pixels. The
    differences of two frames of the same scene are multiplied, so that their noise averages out.
    Contrast is the square root of the value for samples 8 apart, divided by the mean.
    """
    first, second = (pixels.astype(np.float32) for pixels in (one, other))
    near, far = _energy(first, second, _NEAR), _energy(first, second, _FAR)
    mean = max(float(first.mean()), 1e-9)
    return near / far if far > 0 else 0.0, max(far, 0.0) ** 0.5 / mean


def check_focus(trials: Trials) -> Check:
    """Check that there is fine detail in the image."""
    value, contrast = detail(*trials.lit)
    values = {"detail": round(value, 4), "contrast": round(contrast, 4)}
    if contrast < _CONTRAST:
        text = "there is nothing to focus on: put the object, or a ruler, under the camera"
        return Check("focus", "warning", text, values)
    finding = f"detail {value:.2f} (1: down to single pixels, 0.06: none finer than 8 pixels)"
    if value < _BLURRED:
        text = f"{finding}: focus the lens; an object without fine structure gives the same value"
        return Check("focus", "warning", text, values)
    return Check("focus", "ok", finding, values)


def check_room(trials: Trials) -> Check:
    """Compare the light of the room with that of an LED."""
    room_dn = float(trials.unlit.mean()) - trials.black
    light_dn = float(trials.lit[0].mean()) - float(trials.unlit.mean())
    if light_dn <= 0:
        text = (
            f"LED {trials.led} gives no light to compare with: check the LED, or lengthen the "
            "exposure"
        )
        return Check("room light", "failed", text)
    share = room_dn / light_dn
    finding = f"{max(share, 0.0):.1%} of the light of LED {trials.led}"
    values = {"share": round(share, 4), "room_dn": room_dn}
    if share > _ROOM:
        text = f"{finding}: darken the room; dark or ambient frames correct steady light only"
        doubt = "room-light-strong" if share > _BRIGHT_ROOM else ""
        return Check("room light", "warning", text, values, doubt=doubt)
    return Check("room light", "ok", finding, values)


def check_steadiness(led: int, frames: list[UInt16], unlit: UInt16, exposure_us: float) -> Check:
    """Check that equal shots at the shortest exposure of the plan give equal light."""
    off_dn = float(unlit.mean())
    light_dn = np.array([float(pixels.mean()) - off_dn for pixels in frames])
    if light_dn.mean() < _LEAST_LIGHT_DN / 4:
        text = f"LED {led} gives too little light at {exposure_us:g} us: lengthen the exposure"
        return Check("steadiness", "not done", text)
    spread = float(light_dn.std(ddof=1) / light_dn.mean())
    values = {"spread": round(spread, 5), "exposure_us": exposure_us}
    finding = f"{len(frames)} shots of LED {led} at {exposure_us:g} us vary by {spread:.2%}"
    if spread <= _UNSTEADY:
        return Check("steadiness", "ok", finding, values)
    periods = max(1, round(exposure_us / PWM_PERIOD_US))
    text = (
        f"{finding}: if the LEDs are dimmed by PWM, expose for a multiple of its period "
        f"({PWM_PERIOD_US:g} us for a TLC5947: {periods * PWM_PERIOD_US:g} us here), or set full "
        "brightness; otherwise check their power supply"
    )
    return Check("steadiness", "warning", text, values)


def _mean(pixels: UInt16, where: Bool) -> float:
    return float(pixels[where].mean(dtype=np.float64))


def _energy(first: Float32, second: Float32, distance: int) -> float:
    total, count = 0.0, 0
    for one, other in ((first, second), (first.T, second.T)):
        steps = one[distance:] - one[:-distance], other[distance:] - other[:-distance]
        total += float((steps[0] * steps[1]).sum(dtype=np.float64))
        count += steps[0].size
    return total / count if count else 0.0
