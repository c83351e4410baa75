"""Counters of a camera's stream: frames started, delivered, and those that found no buffer."""

from __future__ import annotations

from typing import Any, Final

from rig._genicam.errors import GENICAM_ERRORS

_ABSENT: tuple[type[Exception], ...] = (*GENICAM_ERRORS, AttributeError)
# Name of each counter as a query of the stream, and as a node of GenTL's standard features.
_COUNTS: Final = {
    "started": ("num_started", "StreamStartedFrameCount"),
    "delivered": ("num_delivered", "StreamDeliveredFrameCount"),
    "underrun": ("num_underrun", "StreamLostFrameCount"),
}


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
