"""``capture preview``: see, check and record an object from a page."""

from __future__ import annotations

import webbrowser
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

import acquisition
import rig as rigs
from sgp.cli.console import note
from sgp.cli.exit import UsageError
from sgp.cli.options import OptionalInput, Positive, RigOption, Whole
from sgp.commands.capture_plan import chosen_plan
from sgp.results import Result
from sgp.rigs import chosen_rig
from sgp.sessions import Order, StoredOptions

if TYPE_CHECKING:
    from sgp.screen import Screen, Station

# Packages of the extra `screen`.
_EXTRA = ("uvicorn", "starlette")

_STORED = StoredOptions()
Port = Annotated[Whole, Parameter(validator=Number(gte=0, lte=65535))]


def preview(
    *,
    rig: RigOption = None,
    plan: OptionalInput = None,
    out: Path = Path("recordings"),
    stored: StoredOptions = _STORED,
    pixel_mm: Positive | None = None,
    port: Port = 0,
    no_open: Annotated[bool, Parameter(negative=())] = False,
    terminal: Annotated[bool, Parameter(negative=())] = False,
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
    stored
        What the sessions store besides the frames.
    pixel_mm
        Size of a pixel on the object in mm, for the scale bar and the quick look at normals.
    port
        Port of the page; default: a free one.
    no_open
        Print the address, and do not open the page in the browser.
    terminal
        Show focus, clipping and histogram on the terminal instead, and choose LEDs by keys.
    """
    from sgp.screen import Desk, Light, PlanSheet, Screen, Station

    name = chosen_rig(rig)
    config, order = rigs.find_rig_config(name), Order.read(name, rig, stored)
    chosen, _ = chosen_plan(plan, config)
    # A recording states which LEDs of the plan file it leaves out.
    desk = Desk(PlanSheet(chosen if plan is None else acquisition.read_plan(plan), config))
    station = Station(
        lambda: rigs.open_rig(name),
        desk,
        Light("one", chosen.leds[:1], chosen.exposures_of(chosen.leds[0])[0], chosen.gain_db),
        black_dn=0.0 if order.sensor is None else order.sensor.noise_model().black_level_dn,
        always_attended=terminal,
    )
    if terminal:
        view = _terminal(station, chosen)
    else:
        view = _page(station, Screen(station, desk, order, out, pixel_mm), port, no_open)
    with view:
        station.run()
    unsure = "; the rig did not answer: check that all LEDs are off"
    off = ", and all LEDs are off" if station.confirmed_off else unsure
    return Result(summary=[f"the screen is closed{off}"])


def _terminal(station: Station, plan: acquisition.CapturePlan) -> AbstractContextManager[None]:
    from sgp.screen.terminal_view import TerminalView

    return TerminalView(station, plan.leds).shown()


@contextmanager
def _page(station: Station, screen: Screen, port: int, no_open: bool) -> Iterator[None]:
    try:
        from sgp.screen.access import private_link
        from sgp.screen.server import ScreenServer
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in _EXTRA:
            raise
        raise UsageError(
            f"the page needs the extra `screen` ({missing} is missing): install "
            "surface-geometry-processing[screen], or use --terminal"
        ) from error
    with (
        ScreenServer(station, screen.perform, screen.picture, port=port) as server,
        private_link(server.address) as link,
    ):
        note(f"page: {server.address}")
        if not no_open:
            webbrowser.open(link)
        yield
