"""Most that a plan can cost after its exposures were metered."""

from __future__ import annotations

from acquisition._metering.metering import MOST_TRIALS
from acquisition._plan.estimate import PlanEstimate, frame_bytes
from acquisition._plan.plan import CapturePlan


def estimate_metered(
    plan: CapturePlan, *, each: bool, width: int, height: int, frame_s: float = 0.0
) -> tuple[PlanEstimate, int]:
    """Estimate the most that a plan costs if its exposures are metered.

    If each LED gets its own exposures, each needs its own dark and ambient frames; LEDs of nearly
    the same strength share them, so that fewer may be recorded. The exposure times are those of the
    plan, because metering has not been done.

    Parameters
    ----------
    plan
        The plan.
    each
        Whether each LED is metered, or one exposure is chosen for all.
    width, height
        Size of a frame of 16-bit samples, pixels.
    frame_s
        Overhead of a frame in addition to its exposure, seconds.

    Returns
    -------
    PlanEstimate, int
        Shots that are recorded, and the most trial shots, which are not; ``exposure_s`` and
        ``seconds`` include one trial shot of each LED, the least.

    Examples
    --------
    >>> from acquisition import CapturePlan, estimate_metered
    >>> plan = CapturePlan(leds="0-35", exposures_us=(10_000.0,))
    >>> estimate_metered(plan, each=True, width=640, height=512)
    (PlanEstimate(shots=72, exposure_s=1.08, seconds=1.08, bytes=47185920), 576)
    """
    shots = plan.shots()
    exposures_us = [shot.exposure_us or 0.0 for shot in shots]
    unlit_us = [shot.exposure_us or 0.0 for shot in shots if shot.role in ("dark", "ambient")]
    own_us = [plan.exposure_us(led, b) for led in plan.leds for b in range(len(plan.exposures_us))]
    if each:
        # As many unlit frames of each exposure time as the plan has, for those of all LEDs.
        roles = len(unlit_us) // len(plan.distinct_exposures_us)
        exposures_us = [
            *(shot.exposure_us or 0.0 for shot in shots if shot.role in ("light", "flat")),
            *own_us * roles,
        ]
    count = len(exposures_us)
    first_us = [plan.exposure_us(led, 0) for led in plan.leds]
    exposure_s = (sum(exposures_us) + sum(first_us)) / 1e6
    seconds = exposure_s + (count + len(first_us)) * frame_s
    size = count * frame_bytes(width, height)
    return PlanEstimate(count, exposure_s, seconds, size), MOST_TRIALS * len(plan.leds)
