"""A `Camera` for any GenICam camera with a GenTL producer."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rig._errors import CameraError, FrameLostError, FrameTimeoutError
from rig.camera.interface import CameraFrame, Trigger
from rig.genicam.acquisition import Acquisition
from rig.genicam.automatics import camera_settings, turn_off_automatics
from rig.genicam.buffer_content import ReceivedFrame
from rig.genicam.frame_count import BlockCount
from rig.genicam.nodes import Nodes
from rig.genicam.settings import EXPOSURE, Settings, TriggerControl
from rig.genicam.setup import CameraOptions, check_needs, set_up
from rig.genicam.system import OpenDevice, open_device
from rig.messages.notice import pluralize

_POLL_S = 0.001
_WAITING_EVERY_S = 0.1
_TEMPERATURE_EVERY_S = 2.0


class GenICamCamera:
    """A camera that harvesters found. Created by `open_genicam`.

    Parameters
    ----------
    device
        Open camera; closed together with this one, or if it cannot be set up.
    options
        How to set it up.

    Raises
    ------
    CameraError
        If the camera lacks a needed node, an automatic cannot be turned off, or an option is not
        available. By any method if the camera fails or has been closed.
    """

    def __init__(self, device: OpenDevice, options: CameraOptions) -> None:
        self._device = device
        self._options = options
        self._name = device.found.serial or device.found.model
        self._free = "trigger" not in options.needs
        self._armed: Trigger | None = None
        # Frames that may be pending at once.
        self._frames = 1
        self._closed = False
        # The last fetch failed: pending frames are discarded before the next trigger.
        self._stale = False
        # Ids of the next trigger, of the first since acquisition started, and of the next to fetch.
        self._next_id = 0
        self._first_id = 0
        self._unfetched_id = 0
        self._temperature: tuple[float, float | None] = (-_TEMPERATURE_EVERY_S, None)
        try:
            self._nodes = Nodes(device.acquirer.remote_device.node_map, self._name)
            self._acquisition = Acquisition(device.acquirer, self._name, options.most_bytes)
            self._count = BlockCount()
            self._trigger = TriggerControl(self._nodes, options.trigger_line)
            check_needs(self._nodes, device.found, options.needs)
            self._trigger.free()
            changed = turn_off_automatics(self._nodes)
            self._settings = Settings(self._nodes)
            info, form = set_up(self._nodes, self._settings, device.found, options)
            # The nodes for colour exist only after the pixel format has been chosen.
            changed += turn_off_automatics(self._nodes)
            self.info = replace(
                info,
                turned_off=tuple(dict.fromkeys(changed)),
                settings=camera_settings(self._nodes),
            )
            self._acquisition.expect(form, (self.info.height, self.info.width))
        except BaseException:
            with contextlib.suppress(CameraError):
                device.close()
            raise

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        """Set exposure time and gain, armed or not, and return the exposure time as read back."""
        self._check_open()
        if self._acquisition.running and not self._nodes.can_set(EXPOSURE):
            # Some cameras lock it while they wait for triggers; the next trigger restarts it.
            self._stale = True
            self._acquisition.stop()
        exposure_us = self._settings.set_exposure(exposure_us)
        self._settings.set_gain(gain_db)
        self.info = replace(self.info, frame_period_us=self._settings.frame_period_us())
        return exposure_us

    def arm(self, trigger: Trigger = "software", frames: int = 1) -> None:
        """Prepare for triggers of one kind. Frames of earlier triggers are discarded.

        Each of ``frames`` frames gets its own buffer as far as memory and producer allow;
        otherwise a thread empties the buffers while frames are pending.
        """
        self._check_open()
        self._armed = None
        self._frames = frames
        self._acquisition.stop()
        if not self._free:
            self._trigger.choose(trigger)
        self._start()
        self._armed = trigger

    def trigger(self) -> int:
        """Start one exposure by software and return at once the id that its frame will have."""
        frame_id = self._announce("software")
        if not self._free:
            # A command that failed may still have been carried out.
            self._stale = True
            self._trigger.fire()
            self._stale = False
        return frame_id

    def expect(self) -> int:
        """Announce one pulse on the trigger line and return the id that its frame must have."""
        return self._announce("line")

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        """Wait for the frame with this id; older frames that arrive late are discarded."""
        self._check_open()
        under_way = max(self._first_id, self._unfetched_id) <= frame_id < self._next_id
        if not under_way or not self._acquisition.running:
            raise CameraError(f"camera {self._name}: no frame {frame_id} is under way")
        self._stale = True
        try:
            frame = self._await(frame_id, timeout_s, waiting)
        except BaseException:
            self._acquisition.rest()
            raise
        self._stale = False
        self._unfetched_id = frame_id + 1
        if self._unfetched_id == self._next_id:
            self._acquisition.rest()
        return CameraFrame(
            pixels=frame.pixels,
            frame_id=frame_id,
            timestamp_ns=frame.timestamp_ns,
            exposure_us=self._settings.exposure_us,
            gain_db=self._settings.gain_db,
            temperature_c=self._temperature_c(),
        )

    def disarm(self) -> None:
        """Stop accepting triggers."""
        self._check_open()
        self._armed = None
        self._acquisition.stop()

    def close(self) -> None:
        """Release the camera; closing twice does nothing."""
        if not self._closed:
            self._closed = True
            self._acquisition.rest()
            self._device.close()

    def _check_open(self) -> None:
        if self._closed:
            raise CameraError(f"camera {self._name} is closed")

    def _announce(self, trigger: Trigger) -> int:
        self._check_open()
        if self._armed is None:
            raise CameraError(f"camera {self._name} was triggered before it was armed")
        if self._armed != trigger:
            raise CameraError(
                f"camera {self._name} is armed for triggers by {self._armed}, not {trigger}"
            )
        if self._stale:
            self._acquisition.stop()
            self._start()
        elif self._next_id == self._unfetched_id:
            self._refuse_strangers()
        self._next_id += 1
        if self._next_id - self._unfetched_id > 1:
            self._acquisition.collect()
        return self._next_id - 1

    def _start(self) -> None:
        self._stale = True
        self._acquisition.start(self._frames)
        self._count.started()
        self._first_id = self._unfetched_id = self._next_id
        self._stale = False

    def _refuse_strangers(self) -> None:
        """Raise an error if an unexpected frame arrived: the next one could be unexpected, too."""
        self._stale = True
        while self._acquisition.poll() is not None:
            if not self._free:
                raise FrameLostError(
                    f"camera {self._name} took a frame without a trigger{self._on_line()}: check "
                    "the wire for noise, then shoot again",
                    self._acquisition.counts(),
                )
        self._stale = False

    def _on_line(self) -> str:
        return f" on {self._options.trigger_line}" if self._armed == "line" else ""

    def _await(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None
    ) -> ReceivedFrame:
        began_s = called_s = time.monotonic()
        while True:
            frame = self._acquisition.poll()
            now_s = time.monotonic()
            if frame is not None:
                if self._is_awaited(frame, frame_id):
                    return frame
                continue
            if now_s - began_s >= timeout_s:
                self._settings.check_answers()
                line = f", armed on {self._options.trigger_line}," if self._armed == "line" else ":"
                counts = self._acquisition.counts()
                raise FrameTimeoutError(
                    f"camera {self._name}{line} frame {frame_id} did not come within "
                    f"{timeout_s:g} s of waiting; {_cause(counts, 'check trigger and cable')}",
                    counts,
                )
            time.sleep(_POLL_S)
            if waiting is not None and now_s - called_s >= _WAITING_EVERY_S:
                waiting()
                called_s = now_s

    def _is_awaited(self, frame: ReceivedFrame, frame_id: int) -> bool:
        """Return whether this is the awaited frame; False for an older one.

        Raises
        ------
        FrameLostError
            If it is a newer frame, so that the awaited one is lost, or its block id is repeated.
        """
        if self._free:
            return True
        place = self._count.place(frame.block, self._next_id - self._first_id)
        if place is None:
            raise FrameLostError(
                f"camera {self._name}: while frame {frame_id} was awaited, block {frame.block} "
                "arrived twice or after a later one; it is discarded, shoot again",
                self._acquisition.counts(),
            )
        if self._first_id + place > frame_id:
            counts = self._acquisition.counts()
            cause = _cause(counts, "shoot again, and check cable and network if it happens often")
            raise FrameLostError(
                f"camera {self._name}: frame {frame_id} was lost in transfer, frame "
                f"{self._first_id + place} arrived instead; {cause}",
                counts,
            )
        return self._first_id + place == frame_id

    def _temperature_c(self) -> float | None:
        """Return the temperature, read at intervals because each reading is a command."""
        now_s = time.monotonic()
        if now_s - self._temperature[0] >= _TEMPERATURE_EVERY_S:
            self._temperature = now_s, self._settings.temperature_c()
        return self._temperature[1]


def _cause(counts: Mapping[str, int], otherwise: str) -> str:
    """Return why a frame is missing, from the counters of the stream."""
    if "underrun" not in counts:
        return (
            f"{otherwise}; this GenTL producer does not count frames that find no free buffer, so "
            "a busy computer may also be the cause"
        )
    if (underrun := counts["underrun"]) == 0:
        return otherwise
    return (
        f"{pluralize(underrun, 'frame')} found none of the {counts['buffers']} buffers free, "
        "because this computer is too busy to fetch them in time: end other programs, or set "
        "frame_rate_hz in the rig file for a slower camera"
    )


def open_genicam(
    cti: str | Path | Sequence[str | Path],
    *,
    serial: str | None = None,
    model: str | None = None,
    pixel_format: str | None = None,
    trigger_line: str = "Line0",
    frame_rate_hz: float | None = None,
    black_level: float | None = None,
    readout_us: float | None = None,
    most_bytes: int | None = None,
    needs: Collection[str] = ("exposure", "trigger"),
) -> GenICamCamera:
    """Open the camera that a GenTL producer offers.

    Parameters
    ----------
    cti
        The producer (.cti file), or several to search.
    serial, model
        As the camera reports them; None if there is only one camera.
    pixel_format, trigger_line, frame_rate_hz, black_level, readout_us, most_bytes, needs
        See `CameraOptions`.

    Raises
    ------
    CameraError
        If the producer cannot be used, no camera or several match, or the camera cannot be set up:
        see `GenICamCamera`.
    """
    options = CameraOptions(
        pixel_format, trigger_line, frame_rate_hz, black_level, readout_us, most_bytes, needs
    )
    ctis = [cti] if isinstance(cti, str | Path) else list(cti)
    return GenICamCamera(open_device(ctis, serial=serial, model=model), options)
