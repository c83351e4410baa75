"""The plan that the operator edits as text."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import acquisition
import rig as rigs
from acquisition import CapturePlan
from acquisition.files.text_files import parse_toml, validated

# Messages name the text so.
_NAME = Path("plan")
# Overhead of a frame, for the estimate of the duration.
_FRAME_S = 0.07


class PlanSheet:
    """A plan as text, and what is wrong with it.

    Parameters
    ----------
    plan
        The first plan.
    config
        The rig that the plan must fit.
    """

    def __init__(self, plan: CapturePlan, config: rigs.RigConfig) -> None:
        self._config = config
        self._frame_s = _FRAME_S + config.settle_ms / 1000
        self._lock = threading.Lock()
        self._plan, self._text, self._error = plan, text_of(plan), ""

    @property
    def whole(self) -> CapturePlan:
        """The plan with all its LEDs.

        Raises
        ------
        DataError
            If the text is not a plan that fits the rig.
        """
        with self._lock:
            if self._error:
                raise acquisition.DataError(self._error)
            return self._plan

    @property
    def plan(self) -> CapturePlan:
        """The plan, without LEDs that are listed as dead.

        Raises
        ------
        DataError
            If the text is not a plan that fits the rig.
        """
        return self.whole.without(self._config.dead_leds)[0]

    def write(self, text: str) -> None:
        """Replace the text; a text that is no plan for this rig is kept, with its error."""
        try:
            plan = plan_from(text)
            plan.without(self._config.dead_leds)[0].check(self._config.leds)
        except acquisition.DataError as error:
            with self._lock:
                self._text, self._error = text, str(error)
            return
        with self._lock:
            self._plan, self._text, self._error = plan, text, ""

    def put(self, plan: CapturePlan) -> None:
        """Replace the plan."""
        with self._lock:
            self._plan, self._text, self._error = plan, text_of(plan), ""

    def state(self) -> dict[str, Any]:
        """Return text, error, number of shots and duration, in JSON types."""
        with self._lock:
            cost = acquisition.plan.estimate_plan(
                self._plan, width=1, height=1, frame_s=self._frame_s
            )
            return {
                "text": self._text,
                "error": self._error,
                "leds": list(self._plan.leds),
                "shots": cost.shots,
                "seconds": cost.seconds,
            }


def plan_from(text: str) -> CapturePlan:
    """Return the plan of a text in TOML.

    Raises
    ------
    DataError
        If the text is no plan; the message names key and value.
    """
    return validated(CapturePlan, parse_toml(text.encode(), _NAME), _NAME)


def text_of(plan: CapturePlan) -> str:
    """Return a plan as TOML, one line for each value, without the values that are the defaults."""
    values = plan.model_dump(exclude_defaults=True)
    values["leds"] = _ranges(plan.leds)
    tables = {"exposures_by_led": values.pop("exposures_by_led", {})}
    lines = [f"{name} = {json.dumps(value)}" for name, value in values.items()]
    for table, entries in tables.items():
        lines += [f"[{table}]"] * bool(entries)
        lines += [f"{led} = {json.dumps(exposures_us)}" for led, exposures_us in entries.items()]
    return "\n".join(lines) + "\n"


def _ranges(leds: tuple[int, ...]) -> str:
    """Return LED numbers as a text that `led_numbers` reads, in their order."""
    runs: list[list[int]] = []
    for led in leds:
        if runs and led == runs[-1][-1] + 1:
            runs[-1].append(led)
        else:
            runs.append([led])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
