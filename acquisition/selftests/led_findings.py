"""Finds faults of the LEDs of a rig in one coarse image of each LED."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from acquisition.selftests.finding import Finding
from acquisition.selftests.led_places import both_on, judge_places, leds_of
from acquisition.selftests.near_light import Images, fit, known_mean, misfits
from rig.arrays import Bool, Float64

# Relative to the median LED.
_DEAD = 0.02
_DIM = 0.25
_UNSTEADY = 0.04
_FEWEST = 4
_NOISES = 5.0
# Least light with all LEDs off, relative to an LED, for an LED that may be always on.
_AN_LED = 0.5
# From here on the same is a number of times, not a percentage.
_TIMES = 3.0


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data of the self-test.

    Parameters
    ----------
    leds
        ``K`` numbers of the tested LEDs.
    light
        ``(2, K, B)`` coarse images of each LED in two passes, grey values above the dark frame's,
        NaN where saturated.
    dark
        ``(B,)`` grey values that are due to light with all LEDs off.
    places
        ``(B, 2)`` x to the right and y up in widths of the upright image, from its centre.
    positions_mm
        ``(K, 3)`` positions of these LEDs, None if not known.
    """

    leds: tuple[int, ...]
    light: Float64
    dark: Float64
    places: Float64
    positions_mm: Float64 | None = None


def findings(evidence: Evidence) -> list[Finding]:
    """Judge the LEDs; the list is empty if all LEDs are correct and could be distinguished."""
    judge = _Judge(evidence)
    found = [*judge.brightness(), *judge.steadiness()]
    if evidence.positions_mm is None:
        text = (
            "swapped LEDs cannot be found without their positions: give led_positions_mm in the "
            "rig file"
        )
        return [*found, *judge.equals(), Finding("ambiguous", (), text, fault=False)]
    if (alive := judge.alive.sum()) < _FEWEST:
        text = (
            f"swapped LEDs can be found only if at least {_FEWEST} LEDs give light, but {alive} "
            "did: repair the others first"
        )
        return [*found, Finding("ambiguous", (), text, fault=False)]
    return [*found, *judge.places(evidence.positions_mm)]


class _Judge:
    def __init__(self, evidence: Evidence) -> None:
        self._seen = evidence
        self._mean = known_mean(evidence.light, axis=0)
        # Saturated places are NaN and do not count in the means.
        self._strength = known_mean(self._mean, axis=1)
        difference = evidence.light[0] - evidence.light[1]
        spread = 1.4826 * np.nanmedian(np.abs(difference)) / np.sqrt(2)
        self._noise = float(spread / np.sqrt(evidence.light.shape[2])) + 1e-3
        least = max(_DEAD * float(np.median(self._strength)), _NOISES * self._noise)
        self.alive = self._strength > least
        self._typical = float(np.median(self._strength[self.alive])) if self.alive.any() else least
        self._unlit = known_mean(evidence.dark, axis=0)
        self._glows = bool(self._unlit > least)

    def _names(self, where: Bool) -> tuple[int, ...]:
        return tuple(led for led, true in zip(self._seen.leds, where, strict=True) if true)

    def brightness(self) -> Iterator[Finding]:
        """Find LEDs that are dead, dim or always on, and light of others."""
        named: tuple[int, ...] = ()
        if self._glows:
            glow = self._glow()
            named = glow.leds
            yield glow
        for led in self._names(~self.alive):
            if led not in named:
                text = (
                    f"LED {led} gives no light: check its plug, polarity and solder joints, or "
                    "list it in dead_leds of the rig file"
                )
                yield Finding("dead", (led,), text)
        dim = self.alive & (self._strength < _DIM * self._typical)
        for led in self._names(dim):
            share = self._strength[self._seen.leds.index(led)] / self._typical
            text = (
                f"LED {led} gives {share:.0%} of the light of the others: clean it, check its "
                "resistor, and check that nothing blocks its light"
            )
            yield Finding("dim", (led,), text)

    def _glow(self) -> Finding:
        """Judge the light with all LEDs off."""
        stuck = self._stuck()
        if stuck is not None:
            text = (
                f"LED {stuck} is on when all should be off, and its command changes nothing: look "
                "for a short to ground on its wire, or a broken driver output"
            )
            return Finding("always on", (stuck,), text)
        still = self._names(~self.alive)
        share = self._unlit / self._typical
        if not self.alive.any():
            text = (
                "the camera sees light with all LEDs off, and no LED changes it: an LED that is "
                "always on, or a lamp, outshines them; unplug the LEDs one by one to find it"
            )
            return Finding("always on", still, text)
        times = f"{share:.0%} of" if share < _TIMES else f"{share:.0f} times"
        if still and share > _AN_LED:
            text = (
                f"with all LEDs off there is {times} an LED's light, and the commands of "
                f"LED {', '.join(map(str, still))} change nothing: these are always on or dead; "
                "unplug them one by one, and look for a short or a broken driver output"
            )
            return Finding("always on", still, text)
        text = (
            f"with all LEDs off there is {times} an LED's light: darken the room, or look for a "
            "lamp or LED that the board does not switch"
        )
        return Finding("room light", (), text, fault=False)

    def steadiness(self) -> Iterator[Finding]:
        """Find LEDs that gave unequal light in two equal shots."""
        first, second = (known_mean(each, axis=1) for each in self._seen.light)
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.where(self.alive, np.abs(first - second) / self._strength, 0.0)
        limit = np.maximum(_UNSTEADY, _NOISES * self._noise / np.maximum(self._strength, 1e-9))
        for led in self._names(change > limit):
            text = (
                f"LED {led} gave {change[self._seen.leds.index(led)]:.0%} more light in one of two "
                "equal shots: check its plug and the supply"
            )
            yield Finding("unsteady", (led,), text)

    def equals(self) -> list[Finding]:
        """Find LEDs with equal images; LEDs in different places give different ones."""
        pairs, leds = self._pairs(), self._seen.leds
        alike = {row for pair in pairs for row in pair}
        # Faults are rare: if many LEDs look alike, the view cannot distinguish them.
        if len(alike) > max(_FEWEST, len(leds) / 3):
            text = (
                f"{len(alike)} LEDs look alike in this view: put something larger or less flat "
                "under the camera"
            )
            return [Finding("ambiguous", leds_of(leds, alike), text, fault=False)]
        return [both_on(leds[one], leds[other], sure=True) for one, other in pairs]

    def places(self, positions: Float64) -> list[Finding]:
        """Find LEDs whose light is from another place, or from two places."""
        rows = np.flatnonzero(self.alive)
        fitted = fit(Images(self._mean[rows], self._seen.places), positions, rows)
        return judge_places(self._seen.leds, fitted, self._pairs())

    def _pairs(self) -> list[tuple[int, int]]:
        """Return pairs of rows whose images are equal within the difference of the two passes."""
        rows = np.flatnonzero(self.alive)
        shape = self._mean[rows] / self._strength[rows, None]
        each = self._seen.light[:, rows] / known_mean(self._seen.light[:, rows], axis=2)[..., None]
        again = np.nanmedian(np.abs(each[0] - each[1]), axis=1)
        limit = 1.5 * float(np.median(again)) + 0.003
        return [
            (int(rows[j]), int(rows[i]))
            for i in range(len(rows))
            for j in range(i)
            if np.nanmedian(np.abs(shape[i] - shape[j])) < limit
        ]

    def _stuck(self) -> int | None:
        """Return the LED that is always on: its command does not change it."""
        still = np.flatnonzero(~self.alive)
        if len(still) == 0:
            return None
        positions = self._seen.positions_mm
        if positions is None or self.alive.sum() < _FEWEST:
            return self._seen.leds[int(still[0])] if len(still) == 1 else None
        rows = np.flatnonzero(self.alive)
        images = Images(self._mean[rows], self._seen.places)
        fitted = fit(images, positions, rows)
        misfit, _ = misfits((self._seen.dark / images.mean)[None], fitted.predicted)
        best = int(misfit[0].argmin())
        return self._seen.leds[best] if best in still else None
