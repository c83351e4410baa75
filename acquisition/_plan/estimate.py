"""What a plan costs: shots, time and bytes."""

from __future__ import annotations

from dataclasses import dataclass

from acquisition._plan.plan import CapturePlan


@dataclass(frozen=True)
class PlanEstimate:
    """What a plan costs.

    Parameters
    ----------
    shots
        Frames.
    exposure_s
        Sum of the exposures, seconds.
    seconds
        Exposures, and for each frame what it takes beside its exposure.
    bytes
        Of the frames, uncompressed.
    """

    shots: int
    exposure_s: float
    seconds: float
    bytes: int


def estimate_plan(
    plan: CapturePlan, *, width: int, height: int, frame_s: float = 0.0
) -> PlanEstimate:
    """Work out what a plan costs without retakes.

    Parameters
    ----------
    plan
        The plan.
    width, height
        Of a frame of 16-bit samples, pixels.
    frame_s
        What a frame takes beside its exposure, seconds: settling, readout, commands.
    """
    shots = plan.shots()
    exposure_s = sum(shot.exposure_us or 0.0 for shot in shots) / 1e6
    size = len(shots) * frame_bytes(width, height)
    return PlanEstimate(len(shots), exposure_s, exposure_s + len(shots) * frame_s, size)


def frame_bytes(width: int, height: int) -> int:
    """Bytes of a frame of 16-bit samples, uncompressed; cameras deliver grey or mosaics."""
    return 2 * width * height
