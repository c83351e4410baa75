"""Whether the signals of brackets agree with their exposure times."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from acquisition import Frame
from rig import Notice

FloatImage = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]

# Brackets are compared where the longer one has between a tenth and four fifths of its range, in
# every fourth group of rows.
_COMPARED = (0.1, 0.8)
_GROUP = 32
_EVERY_GROUP = 4
_LEAST_COMPARED_PX = 500
_CONTRADICTION = 0.02


class BracketRatios:
    """Compares each bracket of a light with the next shorter one, also in several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # For each light and pair of exposure times, shorter and longer: per row the sums of the
        # radiance of both, and the number of pixels. Rows may be added again.
        self._sums: dict[tuple[str, float, float], npt.NDArray[np.float64]] = {}

    def add(
        self,
        frames: Sequence[Frame],
        shares: Sequence[float],
        radiance: Sequence[FloatImage],
        usable: Sequence[Bools],
        merged: FloatImage,
        top: int,
    ) -> None:
        """Add some rows of the B brackets of a light.

        Parameters
        ----------
        frames
            A frame of each bracket, the longest exposure first.
        shares
            Their exposure times relative to the longest of the source.
        radiance, usable
            Image of each bracket, and where it counts.
        merged
            The merged image.
        top
            First row in the frames.
        """
        rows = np.arange(len(merged)) + top
        rows = rows[rows // _GROUP % _EVERY_GROUP == 0]
        if not len(rows):
            return
        part = rows - top
        for b, (longer, shorter) in enumerate(pairwise(frames)):
            low, high = (limit / shares[b] for limit in _COMPARED)
            level = merged[part]
            both = usable[b][part] & usable[b + 1][part] & (level > low) & (level < high)
            across = tuple(range(1, both.ndim))
            sums = np.stack(
                [
                    radiance[b + 1][part].sum(axis=across, where=both, dtype=np.float64),
                    radiance[b][part].sum(axis=across, where=both, dtype=np.float64),
                    both.sum(axis=across),
                ],
                axis=1,
            )
            key = (longer.light_id, shorter.exposure_us or 0.0, longer.exposure_us or 0.0)
            with self._lock:
                of_rows = self._sums.setdefault(key, np.zeros((longer.shape[0], 3)))
                of_rows[rows] = sums

    @property
    def notices(self) -> list[Notice]:
        """Return a notice for each pair of exposure times whose images contradict them."""
        pairs: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
        with self._lock:
            compared = [(key, *of_rows.sum(axis=0)) for key, of_rows in sorted(self._sums.items())]
        for (_, shorter_us, longer_us), of_shorter, of_longer, pixels in compared:
            if pixels >= _LEAST_COMPARED_PX:
                found = pairs.setdefault((round(shorter_us), round(longer_us)), [])
                found.append((of_shorter / of_longer, shorter_us, longer_us))
        notices = []
        for found in pairs.values():
            ratio = float(np.median([of_one[0] for of_one in found]))
            if abs(ratio - 1) > _CONTRADICTION:
                _, shorter_us, longer_us = found[0]
                text = (
                    f"images of {shorter_us:g} us are {ratio:.2f} times as bright as those of "
                    f"{longer_us:g} us let expect: check the exposure times, the black level and "
                    "the linearity of the camera"
                )
                notices.append(Notice("brackets-contradict", text))
        return notices
