"""Pre-flight of the picture: what trial frames say about light, focus and the camera's honesty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition._preflight.check import Check

Pixels = npt.NDArray[np.uint16]

_NEAR, _FAR = 2, 8  # even, so that samples compared have the same colour under a Bayer filter
# The detail of an image without any structure finer than the far distance is 0.0625.
_BLURRED = 0.08
_CONTRAST = 0.002
_CLIPPED = 0.01
_DIM = 0.2
_ROOM = 0.02
_BENT, _STRONGLY_BENT = 0.02, 0.05
_UNSTEADY = 0.01
_LEAST_LIGHT_DN = 2.0
PWM_PERIOD_US = 1024.0


@dataclass(frozen=True, eq=False)
class Trials:
    """Trial frames of one LED, with the exposures that the camera reported.

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
        One with all LEDs off at the same exposure.
    half
        One under the LED at about half of it.
    half_unlit
        One with all LEDs off at that.
    lit_us, half_us
        The exposures.
    """

    led: int
    black: float
    white_dn: float
    lit: tuple[Pixels, Pixels]
    unlit: Pixels
    half: Pixels
    half_unlit: Pixels
    lit_us: float
    half_us: float


def check_response(trials: Trials) -> Check:
    """Check that twice the exposure gives twice the light: no automatic, no gamma at work."""
    name = "response"
    sound = (trials.lit[0] < 0.9 * trials.white_dn) & (trials.half < 0.9 * trials.white_dn)
    if sound.mean() < 0.01:
        return Check(name, "not done", "nearly every sample is saturated: expose shorter")
    long_dn = _mean(trials.lit[0], sound) - _mean(trials.unlit, sound)
    short_dn = _mean(trials.half, sound) - _mean(trials.half_unlit, sound)
    if short_dn < _LEAST_LIGHT_DN:
        return Check(
            name, "not done", f"LED {trials.led} gives too little light: expose longer", {}
        )
    bend = (long_dn / short_dn) / (trials.lit_us / trials.half_us) - 1
    values: dict[str, float | int | str | None] = {"deviation": round(bend, 4), "led": trials.led}
    said = (
        f"from {trials.half_us:g} to {trials.lit_us:g} us the light of LED {trials.led} grows "
        f"{long_dn / short_dn:.3f} times instead of {trials.lit_us / trials.half_us:.3f}"
    )
    if abs(bend) <= _BENT:
        return Check(name, "ok", f"{said}: linear", values)
    return Check(
        name,
        "failed" if abs(bend) > _STRONGLY_BENT else "warning",
        f"{said}: turn off what the camera does by itself (auto exposure, auto gain, gamma, "
        "black-level and shading correction), or let the LEDs warm up",
        values,
    )


def check_exposure(
    frames: list[tuple[float, Pixels]], black: float, white_dn: float, limit: float
) -> Check:
    """Check the frames of all brackets: none black, the shortest not saturated.

    Parameters
    ----------
    frames
        Exposure and frame of each bracket under one LED.
    black
        Grey value without light.
    white_dn
        Grey value from which a sample is saturated.
    limit
        The plan's ``max_clipped_fraction``; frames beyond it are rejected.
    """
    name = "exposure"
    clipped = {us: float(np.mean(pixels >= white_dn)) for us, pixels in frames}
    long_us, longest = max(frames, key=lambda frame: frame[0])
    short_us = min(clipped)
    level = (float(np.percentile(longest, 99.5)) - black) / (white_dn - black)
    values: dict[str, float | int | str | None] = {
        "level": round(level, 4),
        "clipped_fraction": clipped[short_us],
        "most_clipped_fraction": max(clipped.values()),
    }
    said = f"{level:.0%} of full scale at {long_us:g} us, {clipped[short_us]:.2%} saturated"
    if len(frames) > 1:
        said += f" at {short_us:g} us"
    if max(clipped.values()) > limit:
        text = (
            f"{max(clipped.values()):.2%} of a frame is saturated, the plan allows {limit:.2%} and "
            "the recording would end there: expose shorter, or meter"
        )
        return Check(name, "failed", text, values)
    if clipped[short_us] > _CLIPPED:
        text = f"{said}: expose shorter, add a shorter bracket, or meter"
        return Check(name, "warning", text, values)
    if level < _DIM:
        return Check(name, "warning", f"{said}: expose longer, or meter", values)
    return Check(name, "ok", said, values)


def detail(one: Pixels, other: Pixels) -> tuple[float, float]:
    """Return how fine the structures of an image are, and its contrast.

    The mean squared difference of samples 2 apart over that of samples 8 apart: 1 where there is
    structure down to single pixels, 0.0625 where there is none finer than 8 pixels. Two frames of
    the same are multiplied, so that their noise does not count. The contrast is the root of the
    latter over the mean.
    """
    first, second = (pixels.astype(np.float32) for pixels in (one, other))
    near, far = _energy(first, second, _NEAR), _energy(first, second, _FAR)
    mean = max(float(first.mean()), 1e-9)
    return near / far if far > 0 else 0.0, max(far, 0.0) ** 0.5 / mean


def check_focus(trials: Trials) -> Check:
    """Check that there is fine detail in the image."""
    name = "focus"
    value, contrast = detail(*trials.lit)
    values: dict[str, float | int | str | None] = {
        "detail": round(value, 4),
        "contrast": round(contrast, 4),
    }
    if contrast < _CONTRAST:
        text = "there is nothing to focus on: put the object, or a ruler, under the camera"
        return Check(name, "warning", text, values)
    said = f"detail {value:.2f} (1: down to single pixels, 0.06: none finer than 8 pixels)"
    if value < _BLURRED:
        text = f"{said}: focus the lens; an object without fine structure looks like this too"
        return Check(name, "warning", text, values)
    return Check(name, "ok", said, values)


def check_room(trials: Trials) -> Check:
    """Check the light in the room against that of an LED."""
    name = "room light"
    room_dn = float(trials.unlit.mean()) - trials.black
    light_dn = float(trials.lit[0].mean()) - float(trials.unlit.mean())
    if light_dn <= 0:
        text = f"LED {trials.led} gives no light to compare with: check the LED, expose longer"
        return Check(name, "failed", text)
    share = room_dn / light_dn
    said = f"{max(share, 0.0):.1%} of the light of LED {trials.led}"
    values: dict[str, float | int | str | None] = {"share": round(share, 4), "room_dn": room_dn}
    if share > _ROOM:
        text = f"{said}: darken the room; dark or ambient frames take off only what is steady"
        return Check(name, "warning", text, values)
    return Check(name, "ok", said, values)


def check_steadiness(led: int, frames: list[Pixels], unlit: Pixels, exposure_us: float) -> Check:
    """Check that equal shots give equal light, at the shortest exposure of the plan."""
    name = "steadiness"
    off_dn = float(unlit.mean())
    light_dn = np.array([float(pixels.mean()) - off_dn for pixels in frames])
    if light_dn.mean() < _LEAST_LIGHT_DN / 4:
        text = f"LED {led} gives too little light at {exposure_us:g} us to tell"
        return Check(name, "not done", text)
    spread = float(light_dn.std(ddof=1) / light_dn.mean())
    values: dict[str, float | int | str | None] = {
        "spread": round(spread, 5),
        "exposure_us": exposure_us,
    }
    said = f"{len(frames)} shots of LED {led} at {exposure_us:g} us vary by {spread:.2%}"
    if spread <= _UNSTEADY:
        return Check(name, "ok", said, values)
    periods = max(1, round(exposure_us / PWM_PERIOD_US))
    text = (
        f"{said}: where LEDs are dimmed by pulses expose for a multiple of their period "
        f"({PWM_PERIOD_US:g} us for a TLC5947: {periods * PWM_PERIOD_US:g} us here), or drive them "
        "fully; else check their supply"
    )
    return Check(name, "warning", text, values)


def _mean(pixels: Pixels, where: npt.NDArray[np.bool_]) -> float:
    return float(pixels[where].mean(dtype=np.float64))


def _energy(
    first: npt.NDArray[np.float32], second: npt.NDArray[np.float32], distance: int
) -> float:
    total, count = 0.0, 0
    for one, other in ((first, second), (first.T, second.T)):
        steps = one[distance:] - one[:-distance], other[distance:] - other[:-distance]
        total += float((steps[0] * steps[1]).sum(dtype=np.float64))
        count += steps[0].size
    return total / count if count else 0.0
