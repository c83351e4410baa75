"""LEDs whose light comes from elsewhere, or from two places, judged by a fit to all images."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from rig._selftest.finding import Finding
from rig._selftest.near_light import Array, Fit, mixtures

# How much more light than one LED two give at least, against the prediction.
_DOUBLE = 1.45
# The same of a second LED that is dimmer, and its least share; the images must be all the clearer.
_MORE, _LEAST_SHARE, _CLEARER = 1.15, 0.15, 1.7
# How much better an explanation must be to be believed,
_BETTER = 1.5
# and by so much of the image at least: two that fit so well are both right.
_BETTER_BY = 0.005


def judge_places(
    leds: tuple[int, ...], made: Fit, equal: Iterable[tuple[int, int]]
) -> list[Finding]:
    """Find doubles, LEDs that are elsewhere, and those of which neither can be told.

    Parameters
    ----------
    leds
        Number of the LED of each position.
    made
        The fit.
    equal
        Pairs of positions whose LEDs' images do not differ.
    """
    doubles = _doubles(leds, made, equal)
    single = np.array([row not in doubles for row in made.rows])
    found = [finding for finding in doubles.values() if finding is not None]
    return found + _elsewhere(leds, made.rows[single], made.misfit[single])


def burn_together(led: int, other: int, *, sure: bool) -> Finding:
    """Say that two LEDs burn together."""
    what = "burn together" if sure else "seem to burn together"
    return Finding(
        "double",
        (led, other),
        f"LEDs {led} and {other} {what}: under LED {led} the camera sees the light of both; look "
        "for a short between their wires",
    )


def _doubles(
    leds: tuple[int, ...], made: Fit, equal: Iterable[tuple[int, int]]
) -> dict[int, Finding | None]:
    """Return a finding for each row that shows two LEDs; None where its pair has it already."""
    nearest = made.misfit.argmin(axis=1)
    usual = float(np.median(np.take_along_axis(made.scale, nearest[:, None], axis=1)))
    partners = {a: b for one, two in equal for a, b in ((one, two), (two, one))}
    found: dict[int, Finding | None] = {}
    for index, row in enumerate(made.rows.tolist()):
        single = made.misfit[index].min()
        rests, mixed = mixtures(made.ratios[index], made.predicted, row)
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
            found[row] = burn_together(leds[row], named, sure=partner is not None)
    return found


def _elsewhere(leds: tuple[int, ...], rows: npt.NDArray[np.intp], misfit: Array) -> list[Finding]:
    """Match images and positions one to one, and tell which are not each other's own."""
    if len(rows) == 0:
        return []
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
            f"LED {leds[row]} shines from where LED {leds[place]} should be: plugs or wires are "
            "swapped, or led_positions_mm in the rig file is in another order",
        )
        for row, place in zip(rows[moved].tolist(), matched[moved].tolist(), strict=True)
    ]
    if moved.sum() > len(rows) / 2:
        text = (
            f"{moved.sum()} of {len(rows)} LEDs shine from elsewhere: check mounting and "
            "led_positions_mm in the rig file before any plug"
        )
        found = [Finding("elsewhere", _named(leds, rows[moved]), text)]
    best = others.min(axis=1)
    vague = ~moved & ~_better(np.minimum(own, best), np.maximum(own, best))
    if vague.any():
        unsure = _named(leds, rows[vague])
        text = (
            f"under LEDs {', '.join(map(str, unsure))} the view looks as it would under another, "
            "so a swap would not be seen: put something larger or less flat under the camera"
        )
        found.append(Finding("not told apart", unsure, text, fault=False))
    return found


def _named(leds: tuple[int, ...], rows: npt.NDArray[np.intp]) -> tuple[int, ...]:
    return tuple(sorted(leds[row] for row in rows))


def _better(one: Array, other: Array) -> npt.NDArray[np.bool_]:
    """Tell where a misfit is so much smaller than another that it is believed."""
    return (other > _BETTER * one) & (other > one + _BETTER_BY)
