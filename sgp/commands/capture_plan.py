"""``capture``: describe a plan, and check whether a rig is ready for it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

import acquisition
import rig as rigs
from sgp.cli.console import Stages
from sgp.cli.exit import UsageError
from sgp.cli.options import Count, Leds, OptionalInput, Real, RigOption, image_size, led_list
from sgp.results import Result, check_folder
from sgp.rigs import chosen_rig, default_rig
from sgp.sessions import Accepted

_DEFAULT_EXPOSURE_US = 20_000.0
_ROOM = 1.25
_MOST_ROWS = 12
# Earlier spellings, which still work.
_HIDDEN = Parameter(show=False)

Milliseconds = Annotated[Real, Parameter(validator=Number(gte=0, lte=60_000))]


def plan(
    plan: OptionalInput = None,
    *,
    rig: RigOption = None,
    leds: str | None = None,
    led_count: Leds | None = None,
    size: str | None = None,
    width: Annotated[Count | None, _HIDDEN] = None,
    height: Annotated[Count | None, _HIDDEN] = None,
    frame_ms: Milliseconds = 70.0,
) -> Result:
    """Show the shots, time and disk space of a plan, without using hardware.

    For example:

        capture plan plan.toml --rig bench.toml --size 2448x2048
        capture plan --leds 0-11,24-35

    Parameters
    ----------
    plan
        Plan file; default: each LED once at 20 ms, and a dark frame.
    rig
        Name of a rig, or path of a rig file (.toml), from which the number of LEDs, the dead LEDs
        and the settling time are read; default: the configured rig, if there is one (see `sgp rig
        list`). The rig is not opened.
    leds
        LEDs to plan for without a plan file, as a list with ranges: 0-11,24-35; default: all.
    led_count
        Number of LEDs of the board, instead of a rig; default: 36.
    size
        Size of a frame in pixels; default: 2448x2048.
    width
        Earlier spelling of --size, together with --height.
    height
        See --width.
    frame_ms
        Time in ms that a frame takes in addition to exposure and settling of the light: readout,
        transfer, commands.
    """
    if plan is not None and leds is not None:
        raise UsageError("the plan file lists its LEDs: leave out --leds, or the plan file")
    if rig is not None and led_count is not None:
        raise UsageError("the rig has a number of LEDs: leave out --led-count, or --rig")
    if size is not None and (width, height) != (None, None):
        raise UsageError("--size gives width and height: leave out --width and --height")
    numbers = None if leds is None else led_list("--leds", leds)
    columns, rows = (width or 2448, height or 2048) if size is None else image_size("--size", size)
    if rig is None and (led_count is not None or default_rig() is None):
        config = rigs.RigConfig(name="-", driver="-", leds=led_count or 36)
    else:
        config = rigs.find_rig_config(chosen_rig(rig))
    chosen, left_out = chosen_plan(plan, config, numbers)
    frame_s = (frame_ms + config.settle_ms) / 1000
    cost = acquisition.plan.estimate_plan(chosen, width=columns, height=rows, frame_s=frame_s)
    metered = {
        meter: acquisition.metering.estimate_metered(
            chosen, each=meter == "each", width=columns, height=rows, frame_s=frame_s
        )
        for meter in ("each", "one")
    }
    most, trials = metered["each"]
    shots = chosen.shots()
    counts = {role: sum(shot.role == role for shot in shots) for role in _ROLES}
    frames = ", ".join(f"{count} {role}" for role, count in counts.items() if count)
    table = _table(chosen)
    return Result(
        metrics={
            "shots": [shot.file for shot in shots],
            "counts": counts,
            "bytes": cost.bytes,
            "exposure_seconds": cost.exposure_s,
            "seconds": cost.seconds,
            "metering": {
                meter: {
                    "most_shots": cost.shots,
                    "most_trials": trials,
                    "most_bytes": cost.bytes,
                    "seconds": cost.seconds,
                }
                for meter, (cost, trials) in metered.items()
            },
            "exposures_us": {
                str(led): [chosen.exposure_us(led, b) for b in range(len(chosen.exposures_us))]
                for led in chosen.leds
            },
            "left_out": list(left_out),
        },
        warnings=_left_out(left_out),
        summary=[
            f"{'exposures in us, by bracket':<27}  LEDs",
            *(f"{exposures:<27}  {leds_of}" for exposures, leds_of in table),
            f"{rigs.pluralize(len(shots), 'shot')}: {frames}",
            f"about {_duration(cost.seconds)}: {cost.exposure_s:.2f} s of exposure and "
            f"{frame_s * 1000:g} ms per frame (see --frame-ms)",
            f"{cost.bytes / 1e6:.0f} MB at {columns} x {rows} and 16 bits; "
            f"{_ROOM * cost.bytes / 1e6:.0f} MB should be free",
            f"with --meter each: at most {rigs.pluralize(most.shots, 'shot')}, with unlit frames "
            f"for the exposures of each LED, {most.bytes / 1e6:.0f} MB, about "
            f"{_duration(most.seconds)} or more; at most {trials} trial shots are not recorded",
        ],
    )


def check(
    out: Path,
    *,
    rig: RigOption = None,
    plan: OptionalInput = None,
    quick: bool = False,
    accept: Accepted = (),
) -> Result:
    """Check disk, board, camera, picture and every LED before a recording.

    Place the object under the camera as for the recording. Nothing is recorded. The exit code is 3
    if a check failed, or found what makes a recording useless; other warnings do not count.

    For example:

        capture check recordings/owl --rig bench.toml --plan plan.toml

    Parameters
    ----------
    out
        Folder planned for the session; it need not exist.
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    plan
        Plan file; default: each working LED once at 20 ms, and a dark frame.
    quick
        Skip the test of every LED.
    accept
        Code of a finding that makes a recording useless, to count as ready; can be repeated.
    """
    name = chosen_rig(rig)
    check_folder(out)
    with rigs.open_rig(name) as opened, Stages() as progress:
        chosen, left_out = chosen_plan(plan, opened.config)
        flight = acquisition.preflights.preflight(
            opened, chosen, out, self_test=not quick, on_progress=progress
        )
        notices = [*_left_out(left_out), *_metered_disk(opened, chosen, flight)]
    failed = [check.name for check in flight.failed]
    summary = [
        f"{'' if number else check.state:<9} {'' if number else check.name:<11} {line}"
        for check in flight.checks
        for number, line in enumerate(check.lines)
    ]
    doubts = [check.doubt for check in flight.doubtful if check.doubt not in accept]
    if failed:
        summary.append(f"NOT READY: {', '.join(failed)}")
    elif doubts:
        options = " ".join(f"--accept {code}" for code in doubts)
        summary.append(f"NOT READY: {', '.join(doubts)}; {options} records anyway")
    else:
        summary.append("ready to record")
    ready = not failed and not doubts
    return Result(
        metrics={"ready": ready, "doubts": doubts, **flight.details()},
        warnings=notices,
        summary=summary,
        ok=ready,
        failing_code=3,
    )


def _metered_disk(
    rig: rigs.Rig, plan: acquisition.CapturePlan, flight: acquisition.preflights.Preflight
) -> list[rigs.Notice]:
    """Return a notice if the disk has room for the plan, but maybe not after metering."""
    free, needed = (flight.checks[0].values.get(name) for name in ("free_bytes", "needed_bytes"))
    info = rig.camera.info
    most, _ = acquisition.metering.estimate_metered(
        plan, each=True, width=info.width, height=info.height
    )
    if not isinstance(free, int) or not isinstance(needed, int):
        return []
    if not needed <= free < _ROOM * most.bytes:
        return []
    text = (
        f"with --meter each, up to {rigs.pluralize(most.shots, 'shot')} are recorded, for which "
        f"{_ROOM * most.bytes / 1e6:.0f} MB should be free, {free / 1e6:.0f} MB are"
    )
    return [rigs.Notice("check-disk", text, "disk")]


def chosen_plan(
    path: Path | None, config: rigs.RigConfig, leds: tuple[int, ...] | None = None
) -> tuple[acquisition.CapturePlan, tuple[int, ...]]:
    """Return the plan of a file, or the default plan, for a rig, and the dead LEDs it skips.

    The default plan has the given LEDs, each once, or else all LEDs of the rig.
    """
    if path is None:
        every = tuple(range(config.leds)) if leds is None else leds
        planned = acquisition.CapturePlan(leds=every, exposures_us=(_DEFAULT_EXPOSURE_US,))
    else:
        planned = acquisition.read_plan(path)
    chosen, left_out = planned.without(config.dead_leds)
    try:
        chosen.check(config.leds)
    except acquisition.DataError as error:
        if path is None:
            raise UsageError(f"--leds: {error}") from error
        raise acquisition.DataError(f"{path}: {error}") from error
    return chosen, left_out


_ROLES = ("light", "dark", "ambient", "repeat", "flat")


def _left_out(leds: tuple[int, ...]) -> list[rigs.Notice]:
    if not leds:
        return []
    text = f"LEDs {_ranges(leds)} skipped: listed in dead_leds"
    return [rigs.Notice("leds-skipped", text, severity="info")]


def _table(plan: acquisition.CapturePlan) -> list[tuple[str, str]]:
    """Return exposure times with their LEDs; if there are many, similar ones share a row."""
    brackets = range(len(plan.exposures_us))
    groups: dict[tuple[float, ...], list[int]] = {}
    for led in plan.leds:
        own = tuple(plan.exposure_us(led, bracket) for bracket in brackets)
        groups.setdefault(own, []).append(led)
    if len(groups) <= _MOST_ROWS:
        return [(_exposures(own, own), _ranges(leds)) for own, leds in groups.items()]
    ordered = sorted(groups.items())
    ends = [len(ordered) * row // _MOST_ROWS for row in range(_MOST_ROWS + 1)]
    rows = []
    for begin, end in pairwise(ends):
        part = ordered[begin:end]
        least, most = (
            tuple(limit(own[bracket] for own, _ in part) for bracket in brackets)
            for limit in (min, max)
        )
        rows.append((_exposures(least, most), _ranges(led for _, leds in part for led in leds)))
    return rows


def _exposures(least: tuple[float, ...], most: tuple[float, ...]) -> str:
    return ", ".join(
        f"{low:g}" if low == high else f"{low:g} to {high:g}"
        for low, high in zip(least, most, strict=True)
    )


def _ranges(leds: Iterable[int]) -> str:
    """Format LED numbers as ranges: 0-3, 7."""
    runs: list[list[int]] = []
    for led in sorted(leds):
        if runs and led == runs[-1][-1] + 1:
            runs[-1].append(led)
        else:
            runs.append([led])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s"
