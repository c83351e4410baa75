"""The screen on a terminal: focus, clipping, histogram, and LEDs by key."""

from __future__ import annotations

import os
import re
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final

from sgp.cli.console import terminal
from sgp.cli.exit import UsageError
from sgp.screen.beside import Beside
from sgp.screen.station import BusyError, Station

if sys.platform != "win32":
    import termios
    import tty

KEYS: Final = "left, right: LED   o: LEDs off   +, -: exposure   q: end"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_LOOK_S: Final = 0.1
# Third stops.
_STEP: Final = 2 ** (1 / 3)
# An arrow, or one character.
_KEY: Final = re.compile(r"\x1b\[[A-D]|.", re.DOTALL)
_ARROWS: Final = {"\x1b[C": 1, "\x1b[D": -1, "n": 1, "p": -1}


class TerminalView:
    """Shows a station on the terminal, and changes its light by keys, in a thread.

    Parameters
    ----------
    station
        The station.
    leds
        LEDs that the keys step through.

    Raises
    ------
    UsageError
        If there is no terminal.
    """

    def __init__(self, station: Station, leds: tuple[int, ...]) -> None:
        if sys.platform == "win32" or not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise UsageError("--terminal needs a terminal for keys and display; leave it out")
        self._station, self._leds = station, leds
        self._best: tuple[object, float] = ("", 0.0)
        self._said = ""
        self._beside = Beside(station, self._show)

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Show the station inside the block, with a terminal that passes on every key."""
        before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        self._beside.start()
        try:
            yield
        finally:
            try:
                self._beside.end()
            finally:
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)

    def _show(self) -> None:
        from rich.live import Live
        from rich.text import Text

        with Live(console=terminal(), auto_refresh=False, transient=True) as live:
            while not self._station.closed:
                if select.select([sys.stdin], [], [], _LOOK_S)[0]:
                    typed = os.read(sys.stdin.fileno(), 64).decode(errors="replace")
                    for key in _KEY.findall(typed) or ["q"]:  # "q" at the end of the input
                        self._press(key)
                live.update(Text("\n".join(self._lines(self._station.state()))), refresh=True)

    def _press(self, key: str) -> None:
        light = self._station.current_light
        if key == "q":
            self._station.close()
            return
        if key in _ARROWS:
            led = light.leds[0] if light.leds else self._leds[-1]
            at = self._leds.index(led) if led in self._leds else -1
            light = replace(light, leds=(self._leds[(at + _ARROWS[key]) % len(self._leds)],))
        elif key == "o":
            light = replace(light, leds=())
        elif key in "+-":
            factor = _STEP if key == "+" else 1 / _STEP
            light = replace(light, exposure_us=float(f"{light.exposure_us * factor:.3g}"))
        else:
            return
        try:
            self._station.light(light)
            self._said = ""
        except (ValueError, BusyError) as error:
            self._said = str(error)

    def _lines(self, state: dict[str, Any]) -> list[str]:
        live, frame = state["live"], state["live"]["frame"]
        if not frame:
            return [state["trouble"] or "waiting for the first frame", KEYS]
        lit = ", ".join(f"LED {led}" for led in frame["leds"]) or "all LEDs off"
        key = frame["leds"], frame["exposure_us"]
        best = (
            max(self._best[1], frame["sharpness"]) if self._best[0] == key else frame["sharpness"]
        )
        self._best = key, best
        share = frame["sharpness"] / best if best else 0.0
        return [
            f"{lit}, {frame['exposure_us'] / 1000:.4g} ms, {live['rate_hz']:.1f} frames/s",
            f"focus      {'#' * round(share * 40):<40} {share:4.0%} of the best",
            f"clipped    {frame['clipped_fraction']:.3%}",
            f"histogram  {_bars(frame['histogram'])}",
            state["trouble"] or self._said,
            KEYS,
        ]


def _bars(histogram: list[int]) -> str:
    """Return a histogram as one line of blocks, with heights by order of magnitude."""
    most = max(histogram).bit_length()
    steps = len(_BLOCKS) - 1
    return "".join(_BLOCKS[-(-steps * count.bit_length() // most)] for count in histogram)
