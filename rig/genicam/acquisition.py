"""Acquisition of frames through harvesters, without blocking other threads."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from harvesters.core import Callback

from rig._errors import CameraError, FrameLostError
from rig.genicam.buffer_content import Content, ReceivedFrame
from rig.genicam.buffers import LEAST, Buffering, announceable, memory_limit
from rig.genicam.errors import GENICAM_ERRORS, camera_errors
from rig.genicam.pixels import PixelFormat

_ABSENT: tuple[type[Exception], ...] = (*GENICAM_ERRORS, AttributeError)
# Name of each counter as a query of the stream, and as a node of GenTL's standard features.
_COUNTS: Final = {
    "started": ("num_started", "StreamStartedFrameCount"),
    "delivered": ("num_delivered", "StreamDeliveredFrameCount"),
    "underrun": ("num_underrun", "StreamLostFrameCount"),
}
# harvesters holds the interpreter's lock while it waits, so it is polled often and never waits.
_POLL_S = 2e-5
# Interval between attempts of the collecting thread.
_COLLECT_S = 0.001
# How soon the collecting thread notices that it must end, while another thread decodes a frame.
_PATIENCE_S = 0.05


class StreamCounts:
    """The counters of a stream since acquisition was started.

    Parameters
    ----------
    stream
        harvesters' ``DataStream``.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._before: dict[str, int] = {}

    def begin(self) -> None:
        """Start counting here: some producers reset their counters with each start, some never."""
        self._before = self._read()

    def read(self) -> dict[str, int]:
        """Return the available counters by name."""
        return {
            name: max(0, count - self._before.get(name, 0)) for name, count in self._read().items()
        }

    def _read(self) -> dict[str, int]:
        read = {name: self._one(*names) for name, names in _COUNTS.items()}
        return {name: count for name, count in read.items() if count is not None}

    def _one(self, info: str, node: str) -> int | None:
        try:
            return int(getattr(self._stream, info))
        except _ABSENT:
            pass
        nodes = getattr(self._stream, "node_map", None)
        try:
            if nodes is None or not nodes.has_node(node):
                return None
            return int(nodes.get_node(node).value)
        except _ABSENT:
            return None


class Collector:
    """A thread that collects frames from `begin` to `end`.

    Parameters
    ----------
    collect
        Takes one frame and returns True; returns False if there is no frame or no room.
    """

    def __init__(self, collect: Callable[[], bool]) -> None:
        self._collect = collect
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def begin(self) -> None:
        """Start collecting, if not yet started."""
        if self._thread is None:
            self._ended = threading.Event()
            # A producer that never returns must not keep the program alive.
            self._thread = threading.Thread(
                target=self._run, args=(self._ended,), name="collector", daemon=True
            )
            self._thread.start()

    def end(self) -> None:
        """Stop collecting, and wait until the thread has ended; ending twice does nothing."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self, ended: threading.Event) -> None:
        while not ended.is_set():
            try:
                found = self._collect()
            except CameraError:
                # The next request for a frame raises the same error.
                return
            if not found:
                ended.wait(_COLLECT_S)


class _Heard(Callback):  # type: ignore[misc] # harvesters has no types
    """Records that harvesters discarded a buffer, which it reports only to a callback."""

    def __init__(self) -> None:
        self.incomplete = False

    def emit(self, context: object | None = None) -> None:
        self.incomplete = True


class Acquisition:
    """The stream of frames of a camera.

    Frames stay in buffers until they are requested. If there are fewer buffers than frames that may
    be pending, a thread copies frames out of the buffers between `collect` and `rest`.

    Parameters
    ----------
    acquirer
        harvesters' ``ImageAcquirer``.
    camera
        Name of the camera in messages.
    most_bytes
        Memory that frames may take; None for the `memory_limit`.

    Raises
    ------
    CameraError
        If the camera has not exactly one stream.
    """

    def __init__(self, acquirer: Any, camera: str, most_bytes: int | None = None) -> None:
        self._acquirer = acquirer
        self._camera = camera
        self._most_bytes = memory_limit() if most_bytes is None else most_bytes
        self._heard = _Heard()
        self._running = False
        self._form: PixelFormat | None = None
        self._size = (0, 0)
        if (streams := len(acquirer.data_streams)) != 1:
            raise CameraError(f"camera {camera} has {streams} data streams, but one is required")
        acquirer.add_callback(acquirer.Events.INCOMPLETE_BUFFER, self._heard)
        acquirer.timeout_period_on_update_event_data_call = 0
        self._counts = StreamCounts(acquirer.data_streams[0])
        self._room = Buffering(LEAST)
        # Buffers that the producer accepts: payload, requested number, accepted number.
        self._taken = (0, 0, 0)
        # Guards the stream's queue and the frames collected from it. Reentrant: a signal handler
        # may close the camera while this thread decodes a frame.
        self._lock = threading.RLock()
        # None stands for an incomplete frame.
        self._collected: deque[Content | None] = deque()
        self._collector = Collector(self._collect_one)

    @property
    def running(self) -> bool:
        """Whether frames can arrive."""
        return self._running

    def expect(self, form: PixelFormat, size: tuple[int, int]) -> None:
        """Set the format and (H, W) that frames must have."""
        self._form = form
        self._size = size

    def start(self, frames: int = 1) -> None:
        """Start with all buffers empty, and with room for this number of frames at once."""
        with camera_errors(f"camera {self._camera}, start of acquisition"):
            self._room = self._room_for(frames)
            least = self._acquirer.min_num_buffers
            self._acquirer.num_buffers = max(least, self._room.buffers)
            self._acquirer.start()
        self._counts.begin()
        self._running = True

    def stop(self) -> None:
        """Stop, and discard the frames that have not been fetched."""
        self.rest()
        self._collected.clear()
        self._running = False
        with camera_errors(f"camera {self._camera}, end of acquisition"):
            self._acquirer.stop()

    def collect(self) -> None:
        """Copy arriving frames out of their buffers if there are too few buffers to keep them."""
        if self._room.copies:
            self._collector.begin()

    def rest(self) -> None:
        """Leave further frames in their buffers; keep the collected ones."""
        self._collector.end()

    def counts(self) -> dict[str, int]:
        """Return the producer's counters since the start: see `FrameLostError`."""
        return {**self._counts.read(), "buffers": self._room.buffers}

    def poll(self) -> ReceivedFrame | None:
        """Return the next frame, None if no frame is ready.

        Raises
        ------
        FrameLostError
            If a frame is incomplete; its buffer is queued again.
        CameraError
            If the camera does not answer, or a frame has an unexpected format.
        """
        with self._lock:
            if not self._collected:
                return self._from_buffer()
            content = self._collected.popleft()
        if content is None:
            raise self._incomplete()
        return self._frame(content)

    def _from_buffer(self) -> ReceivedFrame | None:
        with self._next_buffer() as buffer:
            if buffer is not None:
                return self._frame(Content.of(buffer))
            if self._heard.incomplete:
                raise self._incomplete()
            return None

    def _collect_one(self) -> bool:
        """Copy a frame out of its buffer; return whether there was a frame and room for it."""
        if not self._lock.acquire(timeout=_PATIENCE_S):
            return False
        try:
            if len(self._collected) >= self._room.copies:
                return False
            with self._next_buffer() as buffer:
                found = buffer is not None or self._heard.incomplete
                if found:
                    self._collected.append(None if buffer is None else Content.of(buffer).copied())
                return found
        finally:
            self._lock.release()

    @contextmanager
    def _next_buffer(self) -> Iterator[Any | None]:
        """Yield the next buffer, None if none is ready, and queue it again after the block."""
        with camera_errors(f"camera {self._camera}, awaiting a frame"):
            self._heard.incomplete = False
            buffer = self._acquirer.try_fetch(timeout=_POLL_S, is_raw=True)
            try:
                yield buffer
            finally:
                if buffer is not None:
                    buffer.parent.queue_buffer(buffer)

    def _frame(self, content: Content) -> ReceivedFrame:
        return content.frame(self._form, self._size, self._camera)

    def _incomplete(self) -> FrameLostError:
        return FrameLostError(f"camera {self._camera}: a frame is incomplete", self.counts())

    def _room_for(self, frames: int) -> Buffering:
        """Return the room for this number of frames, within memory and the producer's limits."""
        payload = self._payload()
        room = Buffering.within(self._most_bytes, frames, payload)
        tried, wanted, taken = self._taken
        if payload != tried or room.buffers > wanted == taken:
            wanted, taken = room.buffers, announceable(self._stream, payload, room.buffers)
            self._taken = payload, wanted, taken
        if taken >= room.buffers:
            return room
        return Buffering.with_copies(taken or LEAST, frames, self._most_bytes // max(1, payload))

    def _payload(self) -> int:
        """Return the size of a buffer in bytes, as harvesters will request it."""
        try:
            if self._stream.defines_payload_size():
                return int(self._stream.payload_size)
            return int(self._acquirer.remote_device.node_map.PayloadSize.value)
        except _ABSENT:
            # The start of acquisition will report the error.
            return 2 * self._size[0] * self._size[1]

    @property
    def _stream(self) -> Any:
        return self._acquirer.data_streams[0]
