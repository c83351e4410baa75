"""``capture preview``: see, check and record an object from a page."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

import rig as rigs
from sgp.cli.console import note
from sgp.cli.exit import UsageError
from sgp.cli.options import OptionalInput, RigOption
from sgp.commands.capture_plan import chosen_plan
from sgp.results import Result
from sgp.rigs import chosen_rig

# Packages of the extra `screen`.
_EXTRA = ("uvicorn", "starlette")

Port = Annotated[int, Parameter(validator=Number(gte=0, lte=65535))]


def preview(
    *,
    rig: RigOption = None,
    plan: OptionalInput = None,
    out: Path = Path("recordings"),
    port: Port = 0,
    no_open: Annotated[bool, Parameter(negative=())] = False,
) -> Result:
    """Show a live picture of the rig on a page, with metering, checks and recording.

    The page is served to this computer only. It shows clipped pixels, a histogram, a focus measure
    and any LED; it meters the plan, checks the rig, and records as `capture run` does. If it is
    closed for 10 s, nothing is lit. Ctrl-C ends the program.

    For example:

        capture preview --rig bench.toml --plan plan.toml

    Parameters
    ----------
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    plan
        Plan file; default: each working LED once at 20 ms, and a dark frame.
    out
        Folder for recordings: each gets a folder in it, named after the object.
    port
        Port of the page; default: a free one.
    no_open
        Print the address, and do not open the page in the browser.
    """
    try:
        from sgp.screen.server import ScreenServer
    except ModuleNotFoundError as error:
        if error.name not in _EXTRA:
            raise
        raise UsageError(
            f"capture preview needs the extra `screen` ({error.name} is missing): install "
            "surface-geometry-processing[screen], or use --terminal"
        ) from error
    from sgp.screen import Desk, Light, PlanSheet, Screen, Station

    name = chosen_rig(rig)
    config = rigs.find_rig_config(name)
    chosen, _ = chosen_plan(plan, config)
    desk = Desk(PlanSheet(chosen, config))
    first = Light("one", chosen.leds[:1], chosen.exposures_of(chosen.leds[0])[0], chosen.gain_db)
    station = Station(lambda: rigs.open_rig(name), desk, first)
    screen = Screen(station, desk, out)
    server = ScreenServer(station, screen.perform, screen.picture, port=port)
    server.start()
    try:
        note(f"page: {server.address}")
        if not no_open:
            webbrowser.open(server.address)
        station.run()
    finally:
        server.close()
    return Result(summary=["the page is closed, and all LEDs are off"])
