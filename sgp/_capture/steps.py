"""What comes before a recording, as an operator asked for it: metering, checks, a dry run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from acquisition import CapturePlan, MeteringGoal, PlannedShot, Preflight, rehearse
from acquisition import meter as meter_plan
from rig import Rig, RigError
from sgp._console import Stages
from sgp._exit import UsageError
from sgp._options import Real
from sgp._result import Result

Metering = Literal["each", "one"]
_Percentile = Annotated[Real, Parameter(validator=Number(gt=0, lte=100))]
_Level = Annotated[Real, Parameter(validator=Number(gt=0, lte=0.95))]
_Share = Annotated[Real, Parameter(validator=Number(gte=0, lte=1))]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MeterOptions:
    """Whether exposures are chosen on the spot, and how.

    Parameters
    ----------
    meter
        Choose the exposures on the spot instead: each LED its own, or one for all.
    meter_percentile
        Of the raw values, which is to be at --meter-fraction; default: 99.5.
    meter_fraction
        Where it is to be, of the range from black to white; default: 0.7.
    max_clipped
        Largest share of saturated samples when metering, where the plan's
        max_clipped_fraction is not less; default: 0.005.
    """

    meter: Metering | None = None
    meter_percentile: _Percentile | None = None
    meter_fraction: _Level | None = None
    max_clipped: _Share | None = None

    def goal(self) -> MeteringGoal | None:
        """Return what to meter for, None where it was not asked for.

        Raises
        ------
        UsageError
            If details were given without ``--meter``.
        """
        details = {
            "percentile": self.meter_percentile,
            "fraction": self.meter_fraction,
            "max_clipped_fraction": self.max_clipped,
        }
        given = {name: value for name, value in details.items() if value is not None}
        if self.meter is None:
            if given:
                raise UsageError(
                    "--meter-percentile, --meter-fraction and --max-clipped say how to meter: "
                    "give --meter each or --meter one too"
                )
            return None
        return MeteringGoal(each=self.meter == "each", **given)


@dataclass
class Told:
    """What happened before a recording: for its journal, and for the operator."""

    events: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def metered(rig: Rig, plan: CapturePlan, goal: MeteringGoal, told: Told) -> CapturePlan:
    """Return the plan with the exposures found on the spot."""
    with Stages() as progress:
        found = meter_plan(rig, plan, goal, on_progress=progress)
    told.events.append(("metered", found.details()))
    if found.dead_leds:
        reason = "gave no light when metered"
        told.events.append(("left_out", {"leds": list(found.dead_leds), "reason": reason}))
    told.warnings += found.warnings
    return found.plan


def accept(found: Preflight, told: Told) -> None:
    """Note what a pre-flight found; refuse to go on where it fails.

    Raises
    ------
    RigError
        If a check failed.
    """
    if not found.ok:
        complaints = "; ".join(f"{check.name}: {check.text}" for check in found.failed)
        raise RigError(f"the check before recording failed: {complaints}")
    told.events.append(("checked", found.details()))
    told.warnings += [
        f"{check.name}: {check.text}" for check in found.checks if check.state == "warning"
    ]


def dry_run(rig: Rig, plan: CapturePlan, shots: Sequence[PlannedShot]) -> Result:
    """Take shots with all LEDs off, and record nothing."""
    with Stages() as progress:
        seconds = rehearse(rig, plan, on_progress=progress, shots=shots)
    count, info = len(shots), rig.camera.info
    size = count * info.width * info.height * 2
    return Result(
        metrics={"shots": count, "seconds": seconds, "bytes": size, "recorded": False},
        summary=[
            f"dry run: {count} shots in {seconds:.1f} s with all LEDs off, nothing was recorded; "
            f"they would take {size / 1e6:.0f} MB"
        ],
    )
