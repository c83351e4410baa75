"""Finds LEDs whose light is from another place, or from two places, by a fit to all images."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from acquisition.selftests.finding import Finding
from acquisition.selftests.near_light import Fit, mixtures
from rig.arrays import Bool, Float64, Intp

# Least ratio of light to the prediction for one LED, from which on two LEDs are assumed.
_DOUBLE = 1.45
# The same for a dimmer second LED, its least share, and by how much better its fit must be.
_MORE, _LEAST_SHARE, _CLEARER = 1.15, 0.15, 1.7
# Least ratio of two misfits for the smaller one to be preferred,
_BETTER = 1.5
# and least difference, as a share of the image: below it both explanations are equally good.
_BETTER_BY = 0.005
# With fewer LEDs than this, one swap disturbs the fit of the scene.
_MANY = 12


def judge_places(
    leds: tuple[int, ...], fitted: Fit, equal: Iterable[tuple[int, int]]
) -> list[Finding]:
    """Find double LEDs, LEDs in another place, and LEDs that cannot be judged.

    Parameters
    ----------
    leds
        Number of the LED of each position.
    fitted
        The fit.
    equal
        Pairs of positions whose LEDs have equal images.
    """
    doubles = _doubles(leds, fitted, equal)
    single = np.array([row not in doubles for row in fitted.rows])
    found = [finding for finding in doubles.values() if finding is not None]
    return found + _elsewhere(leds, fitted.rows[single], fitted.misfit[single])


def both_on(led: int, other: int, *, sure: bool) -> Finding:
    """Return the finding that two LEDs are on at the same time."""
    what = "are" if sure else "seem to be"
    text = (
        f"LEDs {led} and {other} {what} on at the same time: under LED {led} the camera sees the "
        "light of both; look for a short between their wires"
    )
    return Finding("double", (led, other), text)


def _doubles(
    leds: tuple[int, ...], fitted: Fit, equal: Iterable[tuple[int, int]]
) -> dict[int, Finding | None]:
    """Return a finding for each row that shows two LEDs; None if its partner already has one."""
    nearest = fitted.misfit.argmin(axis=1)
    usual = float(np.median(np.take_along_axis(fitted.scale, nearest[:, None], axis=1)))
    partners = {a: b for one, two in equal for a, b in ((one, two), (two, one))}
    found: dict[int, Finding | None] = {}
    for index, row in enumerate(fitted.rows.tolist()):
        single = fitted.misfit[index].min()
        rests, mixed = mixtures(fitted.ratios[index], fitted.predicted, row)
        other = int(rests.argmin())
        rest, light = rests[other], mixed[other].sum() / usual
        share = mixed[other].min() / max(mixed[other].sum(), 1e-9)
        twice = light > _DOUBLE and _better(rest, single)
        clearly = share > _LEAST_SHARE and light > _MORE and _better(_CLEARER * rest, single)
        if not (twice or clearly):
            continue
        partner = partners.get(row)
        if partner in found:
            found[row] = None
        else:
            named = leds[other if partner is None else partner]
            found[row] = both_on(leds[row], named, sure=partner is not None)
    return found


def _elsewhere(leds: tuple[int, ...], rows: Intp, misfit: Float64) -> list[Finding]:
    """Match images to positions one to one, and report those that do not belong together."""
    if len(rows) == 0:
        return []
    # Imported here: it takes half a second, and only the self-test needs it.
    from scipy.optimize import linear_sum_assignment

    index = np.arange(len(rows))
    own = misfit[index, rows]
    others = misfit.copy()
    others[index, rows] = np.inf
    _, matched = linear_sum_assignment(misfit)
    moved = (matched != rows) & _better(misfit[index, matched], own)
    found = [
        Finding(
            "elsewhere",
            (leds[row], leds[place]),
            f"the light of LED {leds[row]} is from the place of LED {leds[place]}: plugs or wires "
            "are swapped, or led_positions_mm in the rig file has another order: correct it",
        )
        for row, place in zip(rows[moved].tolist(), matched[moved].tolist(), strict=True)
    ]
    if moved.sum() > len(rows) / 2:
        text = (
            f"the light of {moved.sum()} of {len(rows)} LEDs is from another place: check mounting "
            "and led_positions_mm in the rig file before any plug"
        )
        found = [Finding("elsewhere", leds_of(leds, rows[moved]), text)]
    best = others.min(axis=1)
    vague = ~moved & ~_better(np.minimum(own, best), np.maximum(own, best))
    if vague.any():
        unsure = leds_of(leds, rows[vague])
        # Two wrong ones of a few pull the fit, and other LEDs than theirs become vague.
        scope = "would" if len(rows) >= _MANY else "of these or of other LEDs would"
        text = (
            f"under LEDs {', '.join(map(str, unsure))} the view looks the same as under another, "
            f"so a swap {scope} not be noticed: put something larger or less flat under the camera"
        )
        found.append(Finding("ambiguous", unsure, text, fault=False))
    return found


def leds_of(leds: tuple[int, ...], rows: Iterable[int]) -> tuple[int, ...]:
    """Return the numbers of the LEDs in these rows, in order."""
    return tuple(sorted(leds[row] for row in rows))


def _better(one: Float64, other: Float64) -> Bool:
    """Return where a misfit is clearly smaller than another."""
    return (other > _BETTER * one) & (other > one + _BETTER_BY)
