"""Verdicts on the terminal and in files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import processing
from rig import figure

LABELS: dict[str, str] = {"good": "good", "check": "check", "do-not-use": "do not use"}
# Causes that the last line names.
_NAMED = 2


def verdict_line(verdict: processing.checks.Verdict, good: str) -> str:
    """Return the line that ends a command: the answer, and the worst causes with their effects.

    ``good`` is what a good verdict says.
    """
    if verdict.answer == "good":
        return f"good: {good}"
    named = [cause.described for cause in verdict.harmful]
    named += filter(None, [unexplained_text(verdict)])
    more = len(named) - _NAMED
    others = [f"{more} more above"] if more > 0 else []
    return f"{LABELS[verdict.answer]}: {'; '.join([*named[:_NAMED], *others])}"


def unexplained_text(verdict: processing.checks.Verdict) -> str:
    """Return what is said of a residual that no cause explains; empty if it does not matter."""
    if not verdict.unexplained_deg > verdict.matters_deg:
        return ""
    return (
        f"a residual of {verdict.residual:.1%} of the signal is not explained "
        f"(normals may change by {figure(verdict.unexplained_deg)} deg)"
    )


def good_result(verdict: processing.checks.Verdict) -> str:
    """Return what a good verdict says of a result."""
    if not verdict.tried:
        return "but too little data: neither lights nor normals could be tested"
    if verdict.tried == ("lights-mirrored",):
        return "but too few images or pixels to test room light, curve, lights and shifts"
    least = figure(verdict.matters_deg)
    text = f"nothing was found that changes the normals by more than {least} deg"
    if verdict.sigma_deg > 1:
        text += f"; their standard deviation is {figure(verdict.sigma_deg)} deg"
    return text


def verdict_record(verdict: processing.checks.Verdict) -> dict[str, Any]:
    """Return a verdict as ``--json`` and records have it."""
    tested = {
        field.name: getattr(verdict, field.name)
        for field in fields(verdict)
        if field.name != "causes"
    }
    return {
        "verdict": verdict.answer,
        "causes": [asdict(cause) for cause in verdict.causes],
        "tested": tested,
    }


def recorded_verdict(record: Mapping[str, Any]) -> processing.checks.Verdict:
    """Return the verdict of a `verdict_record` that was read from JSON."""
    causes = (processing.checks.Cause(**_numbers(cause)) for cause in record["causes"])
    return processing.checks.Verdict(tuple(causes), **_numbers(record["tested"]))


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with NaN for null, which JSON has instead, and tuples for lists."""
    return {
        name: math.nan if value is None else tuple(value) if isinstance(value, list) else value
        for name, value in values.items()
    }
