"""The host's sign of life to the board, sent while the host waits."""

from __future__ import annotations

from collections.abc import Callable

from rig.host import clock

# The board's watchdog acts after 0.9 s of silence, and a sign of life may have to be repeated.
_EVERY_S = 0.2
_LONGEST_SLEEP_S = 0.05


class SignOfLife:
    """Calls ``ping`` every 200 ms if it is called itself at least as often.

    Parameters
    ----------
    ping
        Sends a query to the board; an exception from it ends the wait.
    since_s
        When the last command was sent to the board, on the monotonic clock; now by default.
    """

    def __init__(self, ping: Callable[[], None], since_s: float | None = None) -> None:
        self._ping = ping
        self._answered_s = clock.monotonic()
        self._sent_s = self._answered_s if since_s is None else since_s
        self._longest_s = 0.0

    @property
    def silence_s(self) -> float:
        """Longest time for which the board may have received nothing, up to now."""
        return max(self._longest_s, clock.monotonic() - self._sent_s)

    def __call__(self) -> None:
        """Send the sign of life if it is due."""
        begun_s = clock.monotonic()
        if begun_s - self._answered_s >= _EVERY_S:
            self._ping()
            self._longest_s = self.silence_s
            self._sent_s, self._answered_s = begun_s, clock.monotonic()

    def sleep_until(self, when_s: float) -> None:
        """Wait until a time of the monotonic clock."""
        while (left_s := when_s - clock.monotonic()) > 0:
            clock.sleep(min(left_s, _LONGEST_SLEEP_S))
            self()
