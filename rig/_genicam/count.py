"""Assignment of frames to triggers by the block ids that the device gives its frames."""

from __future__ import annotations


class BlockCount:
    """Converts block ids to places among the triggers since acquisition was started.

    Devices count from 0 (USB3 Vision) or from 1 (GigE Vision); most restart the count with every
    acquisition, some never do. The behaviour is learned from acquisitions with a single trigger:
    the first frame must then belong to that trigger.
    """

    def __init__(self) -> None:
        self._base: int | None = None
        self._continues = False
        self._first = 0
        self._last: int | None = None
        self._next = 0

    def started(self) -> None:
        """Note that acquisition was started."""
        self._last = None

    def place(self, block: int, triggers: int) -> int | None:
        """Return the place, from 0, of a frame among the triggers since the start.

        Parameters
        ----------
        block
            The frame's block id.
        triggers
            Number of triggers since the start.

        Returns
        -------
        int or None
            None if the id is not greater than that of an earlier frame.
        """
        if self._last is None:
            self._first = self._origin(block, triggers)
        if block < self._first or (self._last is not None and block <= self._last):
            return None
        self._last = block
        self._next = block + 1
        return block - self._first

    def _origin(self, block: int, triggers: int) -> int:
        """Return the id of the first trigger's frame, given the first id that arrived."""
        if triggers == 1 and self._base is None:
            self._base = block
        base = min(block, 1) if self._base is None else self._base
        # The id is beyond the number of triggers: the count did not begin with them.
        beyond = block - base >= triggers
        if block != base and block >= self._next and (self._continues or triggers == 1 or beyond):
            self._continues = True
            return block
        return base
