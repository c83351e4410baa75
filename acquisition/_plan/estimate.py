"""Cost of a plan: shots, time and bytes."""

from __future__ import annotations

from dataclasses import dataclass

from acquisition._plan.plan import CapturePlan


@dataclass(frozen=True)
class PlanEstimate:
    """Cost of a plan.

    Parameters
    ----------
    shots
        Number of frames.
    exposure_s
        Sum of the exposure times, seconds.
    seconds
        Total duration: exposure times plus the overhead of each frame.
    bytes
        Size of the uncompressed frames.
    """

    shots: int
    exposure_s: float
    seconds: float
    bytes: int


def estimate_plan(
    plan: CapturePlan, *, width: int, height: int, frame_s: float = 0.0
) -> PlanEstimate:
    """Estimate the cost of a plan without retakes.

    Parameters
    ----------
    plan
        The plan.
    width, height
        Size of a frame of 16-bit samples, pixels.
    frame_s
        Overhead of a frame in addition to its exposure, seconds: settling, readout, commands.

    Examples
    --------
    >>> from acquisition import CapturePlan, estimate_plan
    >>> plan = CapturePlan(leds="0-35", exposures_us=(10_000.0,))
    >>> estimate_plan(plan, width=640, height=512)
    PlanEstimate(shots=37, exposure_s=0.37, seconds=0.37, bytes=24248320)
    """
    shots = plan.shots()
    exposure_s = sum(shot.exposure_us or 0.0 for shot in shots) / 1e6
    size = len(shots) * frame_bytes(width, height)
    return PlanEstimate(len(shots), exposure_s, exposure_s + len(shots) * frame_s, size)


def frame_bytes(width: int, height: int) -> int:
    """Return the bytes of an uncompressed frame with one 16-bit sample per pixel."""
    return 2 * width * height
