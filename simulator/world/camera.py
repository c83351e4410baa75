"""The camera of the world, with faults that a producer of a real camera may have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from rig import CameraFrame
from rig.arrays import AnyArray, Float32
from rig.camera import Trigger
from simulator.bench.state import BenchState
from simulator.camera.sensor import ImageFormation
from simulator.camera.virtual_camera import VirtualCamera

CameraFault = Literal["lost", "late", "unplug", "twice", "wrong-size"]
CAMERA_FAULTS: tuple[CameraFault, ...] = get_args(CameraFault)

# Each LED lights one block of columns most, so that a frame shows which LED was on.
_BLOCK = 6
_ROWS = 24
_FULL, _REST = 0.4, 0.04


def size_for(leds: int) -> tuple[int, int]:
    """Return the (H, W) of frames that show which of some LEDs was on."""
    return _ROWS, leds * _BLOCK


def plane(leds: int, led: int | None) -> Float32:
    """Return the photons per microsecond ``(H, W)`` of an LED; None for the room, which is dark."""
    height, width = size_for(leds)
    if led is None:
        return np.zeros((height, width), np.float32)
    rows, columns = np.mgrid[:height, :width]
    texture = 1 + 0.3 * np.sin(0.9 * rows + 0.4 * columns) * np.cos(0.55 * columns - 0.3 * rows)
    own = columns // _BLOCK == led
    return np.asarray(texture * np.where(own, _FULL, _REST), np.float32)


def led_of(pixels: AnyArray, black: float) -> int | None:
    """Return the LED that a frame shows; None if it is dark."""
    blocks = pixels.reshape(pixels.shape[0], -1, _BLOCK).mean(axis=(0, 2)) - black
    led = int(blocks.argmax())
    others = np.delete(blocks, led).mean()
    return led if blocks[led] > 3 * max(others, 0.5) else None


class WorldCamera:
    """A `VirtualCamera` with more faults; as `rig.Camera`.

    Parameters
    ----------
    leds
        Number of LEDs.
    state
        Where light is seen and exposures are stated.
    formation
        How the image forms.
    faults
        Faults by frame id.

    Attributes
    ----------
    fault
        Fault of the next frame that is triggered.
    dark
        Number of the next lights that are missing, as with a loose contact.
    """

    def __init__(
        self,
        leds: int,
        state: BenchState,
        formation: ImageFormation,
        faults: Mapping[int, CameraFault] | None = None,
    ) -> None:
        self._planes = {led: plane(leds, led) for led in (None, *range(leds))}
        self._inner = VirtualCamera(
            self._plane, size=size_for(leds), bench=state, formation=formation
        )
        self.info = self._inner.info
        self.configure = self._inner.configure
        self.disarm = self._inner.disarm
        self.close = self._inner.close
        self.unplug = self._inner.unplug
        self.fault: CameraFault | None = None
        self.dark = 0
        self._next = 0
        self._faults = dict(faults or {})
        self._changed: dict[int, CameraFault] = {}
        self._last: CameraFrame | None = None

    def arm(self, trigger: Trigger = "software", frames: int = 1) -> None:
        """Prepare for triggers."""
        self._inner.arm(trigger, frames)

    def trigger(self) -> int:
        """Start an exposure."""
        self._break()
        return self._counted(self._inner.trigger())

    def expect(self) -> int:
        """Announce a pulse."""
        self._break()
        return self._counted(self._inner.expect())

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait for a frame, and return another one if a fault changes it."""
        frame = self._inner.fetch(frame_id, timeout_s, waiting)
        fault = self._changed.pop(frame_id, None)
        if fault == "wrong-size":
            frame = replace(frame, pixels=frame.pixels[:, : -_BLOCK // 2])
        before, self._last = self._last, frame
        return before if fault == "twice" and before is not None else frame

    def _plane(self, led: int | None) -> Float32:
        if led is not None and self.dark > 0:
            self.dark -= 1
            return 0 * self._planes[led]
        return self._planes[led]

    def _break(self) -> None:
        fault, self.fault = self.fault or self._faults.get(self._next), None
        if fault in ("lost", "late", "unplug"):
            self._inner.faults[self._next] = fault
        elif fault is not None:
            self._changed[self._next] = fault

    def _counted(self, frame_id: int) -> int:
        self._next = frame_id + 1
        return frame_id
