"""Assignment of frames to triggers by the block ids that the device gives its frames."""

from __future__ import annotations

# Bits of the counts of devices: those of GigE Vision 1 have 16.
_WIDTHS = (16, 32, 64)
# A count has overflowed if it was in the last quarter of its range and is in the first: fewer
# frames than half of a range can be lost or be taken by other programs in between.
_QUARTERS = 4


class BlockCount:
    """Converts block ids to places among the triggers since acquisition was started.

    Devices count from 0 (USB3 Vision) or from 1 (GigE Vision); most restart the count with every
    acquisition, some never do. The behaviour is learned from acquisitions with a single trigger:
    the first frame must then belong to that trigger. After its largest number a count overflows to
    0, or to 1 in GigE Vision, where 0 is no number; the places continue.
    """

    def __init__(self) -> None:
        self._base: int | None = None
        self._continues = False
        self._from_zero = False
        self._first = 0
        # The last id as received, and widened by what its overflows removed.
        self._received = 0
        self._removed = 0
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
        removed = self._removed_before(block)
        if self._last is None:
            self._first = self._origin(block, removed, triggers)
            if self._first != block + removed:
                removed = 0  # the count was restarted
        wide = block + removed
        place = wide - self._first
        if place < 0 or (self._last is not None and wide <= self._last):
            return None
        if removed and place >= triggers:
            return None  # a frame from before the overflow, or no overflow
        self._from_zero = self._from_zero or block == 0
        self._received, self._removed = block, removed
        self._last, self._next = wide, wide + 1
        return place

    def _removed_before(self, block: int) -> int:
        """Return by how much overflows have reduced this id."""
        for size in (1 << bits for bits in _WIDTHS):
            if block < size // _QUARTERS and size > self._received >= size - size // _QUARTERS:
                return self._removed + size - (0 if block == 0 or self._from_zero else 1)
        return self._removed

    def _origin(self, block: int, removed: int, triggers: int) -> int:
        """Return the id of the first trigger's frame, given the first id that arrived."""
        if triggers == 1 and self._base is None:
            self._base = block
        base = min(block, 1) if self._base is None else self._base
        # A count that restarts does so at 0 or 1.
        self._continues = self._continues or base > 1
        if self._continues:
            block += removed
        # The id is beyond the number of triggers: the count did not begin with them.
        beyond = block - base >= triggers
        if block != base and block >= self._next and (self._continues or triggers == 1 or beyond):
            self._continues = True
            return block
        return base
