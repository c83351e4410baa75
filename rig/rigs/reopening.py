"""Opening a device again that was gone, without waiting for drivers that never return."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from typing import Any, Generic, Protocol, TypeVar

from rig._errors import RigError
from rig.camera.interface import CameraInfo
from rig.host import clock, threads

_LOOK_S = 0.1


class _Device(Protocol):
    def close(self) -> None: ...


Device = TypeVar("Device", bound=_Device)


class Opening(Generic[Device]):
    """Opens a device in another thread, for which the caller need not wait.

    Parameters
    ----------
    open_device
        Opens the device; may take long, or never return.
    """

    def __init__(self, open_device: Callable[[], Device]) -> None:
        self._open = open_device
        self._lock = threads.Lock()
        self._outcome: Device | RigError | None = None
        self._wanted = True
        threads.Thread(target=self._run, name="opening", daemon=True).start()

    def outcome(self, ends_s: float, waiting: Callable[[], None]) -> Device | RigError:
        """Return the open device, or the error why it is not open.

        Parameters
        ----------
        ends_s
            When to stop waiting, on the monotonic clock.
        waiting
            Called at least every 200 ms; an exception from it ends the wait.

        Notes
        -----
        A device that opens later is closed at once.
        """
        try:
            wait(ends_s, waiting, lambda: self._outcome is not None)
        except BaseException:
            self._give_up()
            raise
        outcome = self._outcome
        if outcome is None:
            self._give_up()
            return RigError("it takes too long to open")
        return outcome

    def _give_up(self) -> None:
        with self._lock:
            self._wanted = False
        self._close_unwanted()

    def _run(self) -> None:
        try:
            outcome: Device | RigError = self._open()
        except RigError as error:
            outcome = error
        except Exception as error:  # noqa: BLE001 - libraries fail in any way while a camera starts
            outcome = RigError(f"{type(error).__name__}: {error}")
        with self._lock:
            self._outcome = outcome
        self._close_unwanted()

    def _close_unwanted(self) -> None:
        if not self._wanted and not isinstance(self._outcome, RigError | None):
            with suppress(RigError):
                self._outcome.close()


def wait(
    ends_s: float, waiting: Callable[[], None], done: Callable[[], bool] = lambda: False
) -> None:
    """Call ``waiting`` every 100 ms until a time of the monotonic clock, or until it is done."""
    while not done() and clock.monotonic() < ends_s:
        waiting()
        clock.sleep(_LOOK_S)


def camera_facts(info: CameraInfo) -> dict[str, Any]:
    """Return what must be the same in a camera that was opened again.

    The frame period depends on the exposure time, and a camera that kept its power still has its
    processing turned off.
    """
    facts = asdict(info)
    del facts["turned_off"], facts["frame_period_us"]
    return {**facts.pop("settings"), **facts}
