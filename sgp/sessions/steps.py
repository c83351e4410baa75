"""Optional steps before a recording: metering, checks, a dry run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

import acquisition
import rig as rigs
from sgp.cli.console import note, with_progress
from sgp.cli.exit import UsageError
from sgp.cli.options import Real
from sgp.results import Result
from sgp.sessions.acceptance import Acceptance

Metering = Literal["each", "one"]
_Percentile = Annotated[Real, Parameter(validator=Number(gt=0, lte=100))]
_Level = Annotated[Real, Parameter(validator=Number(gt=0, lte=0.95))]
_Share = Annotated[Real, Parameter(validator=Number(gte=0, lte=1))]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MeterOptions:
    """Options for metering the exposure times.

    Parameters
    ----------
    meter
        Meter the exposure times instead of using those of the plan: one for each LED, or one for
        all LEDs.
    meter_percentile
        Percentile of raw values to place at the target level (--meter-fraction); default: 99.5.
    meter_fraction
        Target level, as a share of the range from black to white level; default: 0.7.
    max_clipped
        Largest share of saturated pixels when metering, unless the plan's max_clipped_fraction is
        smaller; default: 0.005.
    """

    meter: Metering | None = None
    meter_percentile: _Percentile | None = None
    meter_fraction: _Level | None = None
    max_clipped: _Share | None = None

    def goal(self) -> acquisition.metering.MeteringGoal | None:
        """Return the goal of metering, or None without ``--meter``.

        Raises
        ------
        UsageError
            If another metering option was given without ``--meter``.
        """
        details = {
            "percentile": self.meter_percentile,
            "fraction": self.meter_fraction,
            "max_clipped_fraction": self.max_clipped,
        }
        stated = {name: value for name, value in details.items() if value is not None}
        if self.meter is None:
            if stated:
                raise UsageError(
                    "--meter-percentile, --meter-fraction and --max-clipped require --meter each "
                    "or --meter one"
                )
            return None
        return acquisition.metering.MeteringGoal(each=self.meter == "each", **stated)


@dataclass
class Preparation:
    """Events before a recording, for its journal, and warnings for the operator."""

    events: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    warnings: list[rigs.Notice] = field(default_factory=list)


def metered(
    rig: rigs.Rig,
    plan: acquisition.CapturePlan,
    goal: acquisition.metering.MeteringGoal,
    prepared: Preparation,
) -> acquisition.CapturePlan:
    """Return the plan with metered exposure times."""
    metering = with_progress(acquisition.metering.meter)(rig, plan, goal)
    prepared.events.append(("metered", metering.details()))
    if metering.dead_leds:
        reason = "gave no light when metered"
        prepared.events.append(("left_out", {"leds": list(metering.dead_leds), "reason": reason}))
    prepared.warnings += metering.warnings
    return metering.plan


def checked_wiring(rig: rigs.Rig, plan: acquisition.CapturePlan) -> acquisition.preflights.Check:
    """Test every LED before metering, which skips dead LEDs but cannot see swapped ones.

    Raises
    ------
    RigError
        If LEDs of the plan are swapped, doubled or cannot be tested.
    """
    check = acquisition.preflights.check_leds(rig, plan, metered=False)
    if check.state == "failed":
        take_findings(acquisition.preflights.Preflight((check,)), Preparation(), Acceptance())
    return check


class CheckFailedError(rigs.RigError):
    """A check before a recording failed; ``--json`` prints its `findings`."""

    def __init__(self, message: str, findings: list[str]) -> None:
        super().__init__(message)
        self.findings = findings


def take_findings(
    preflight: acquisition.preflights.Preflight, prepared: Preparation, accepting: Acceptance
) -> None:
    """Add the findings of a pre-flight check to `prepared`; raise if a recording would be useless.

    Raises
    ------
    RigError
        If a check failed.
    NotAcceptedError
        If a finding makes a recording useless and is not accepted.
    """
    complaints = [notice for check in preflight.failed for notice in check.notices]
    if len(complaints) > 1:
        for complaint in complaints:
            note(f"- {complaint}")
        raise CheckFailedError(
            f"the check before recording failed: see the {len(complaints)} findings above",
            [str(complaint) for complaint in complaints],
        )
    if complaints:
        raise rigs.RigError(f"the check before recording failed: {complaints[0]}")
    for check in preflight.doubtful:
        for finding in check.notices:
            accepting.require(finding)
    accepted = [check.doubt for check in preflight.doubtful]
    stated = {"accepted": accepted} if accepted else {}
    prepared.events.append(("checked", {**preflight.details(), **stated}))
    warned = (check for check in preflight.checks if check.state == "warning")
    prepared.warnings += [notice for check in warned for notice in check.notices]


def dry_run(
    rig: rigs.Rig, plan: acquisition.CapturePlan, shots: Sequence[acquisition.plan.PlannedShot]
) -> Result:
    """Take shots with all LEDs off without recording them."""
    seconds = with_progress(acquisition.engine.rehearse)(rig, plan, shots=shots)
    count, info = len(shots), rig.camera.info
    size = count * info.width * info.height * 2
    return Result(
        metrics={"shots": count, "seconds": seconds, "bytes": size, "recorded": False},
        summary=[
            f"dry run: {rigs.pluralize(count, 'shot')} in {seconds:.1f} s with all LEDs off, "
            f"nothing was recorded; they would take {size / 1e6:.0f} MB"
        ],
    )
