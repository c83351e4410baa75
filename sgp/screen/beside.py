"""A thread beside a station, for its page or its terminal."""

from __future__ import annotations

import threading
from collections.abc import Callable

from sgp.screen.station import Station


class Beside:
    """Runs a function beside a station, which is closed when the function ends.

    Parameters
    ----------
    station
        The station.
    function
        What to run; it ends soon after the station was closed.
    """

    def __init__(self, station: Station, function: Callable[[], None]) -> None:
        self._station, self._function = station, function
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """Close the station, and wait for the end of the function.

        Raises
        ------
        BaseException
            What the function raised, with a note about the LEDs.
        """
        self._station.close()
        self._thread.join(5)
        if self._error is not None:
            self._error.add_note("all LEDs are off")
            raise self._error

    def _run(self) -> None:
        try:
            self._function()
        except BaseException as error:  # noqa: BLE001 - raised again by `end`
            self._error = error
        finally:
            self._station.close()
