"""Notices about the normals in a file: pixels without one, and where the others point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from rig import Notice, pluralize

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Normals with a smaller z hardly face the camera. Of 66 maps, at most .7 % do not (an owl,
# which also shows its back); if another component is stored as z, nearly half of them.
_LEAST_Z, _MOST_AWAY = 0.02, 0.1
# The channel in which z is stored: noise and quantisation may make a few of its values negative.
_FEW = 0.02
_CHANNELS = ("red", "green")


class Directions:
    """Where the normals of a map point, collected band by band."""

    def __init__(self) -> None:
        self._sum, self._negative = np.zeros(3), np.zeros(3, np.int64)
        self._away = self._count = 0

    def add(self, normals: Float, known: Mask) -> None:
        """Count more normals: ``(h, W, 3)`` unit vectors, 0 where ``(h, W)`` `known` is false."""
        for k in range(3):
            self._sum[k] += normals[..., k].sum(dtype=np.float64)
            self._negative[k] += np.count_nonzero(normals[..., k] < 0)
        self._away += int(np.count_nonzero((normals[..., 2] < _LEAST_Z) & known))
        self._count += int(np.count_nonzero(known))

    def doubts(self, where: str) -> list[Notice]:
        """Return a notice if normals face away from the camera, or z is in another channel.

        Toward the camera, z is positive, and x and y have both signs. If another channel than blue
        is never negative and larger, and blue often is, that channel holds z. A map of a tilted
        plane may have positive x and z; it shows nothing if its channels are swapped.
        """
        away = self._away / max(self._count, 1)
        stored = [
            channel
            for channel, total, negative in zip(
                _CHANNELS, self._sum[:2], self._negative[:2], strict=True
            )
            if negative <= _FEW * self._count and total > abs(self._sum[2])
        ]
        if away > _MOST_AWAY and len(stored) == 1:
            text = (
                f"{away:.0%} of the normals do not face the camera, but all have a positive "
                f"{stored[0]} channel: {stored[0]} and blue seem to be swapped"
                f"{' (BGR)' if stored[0] == 'red' else ''}: the channels must be x, y and z"
            )
            return [Notice("normals-channels-swapped", text, where)]
        if self._sum[2] < 0:
            text = "most normals face away from the camera: check the sign of z"
            return [Notice("normals-face-away", text, where)]
        return []


def pixel_doubts(where: str, finite: Mask | None, mask: Mask | None, known: Mask) -> list[Notice]:
    """Return notices about pixels without a normal.

    Parameters
    ----------
    where
        The file, for messages.
    finite
        ``(H, W)`` bool, pixels whose components are finite; None for integers. It is overwritten.
    mask
        ``(H, W)`` bool, pixels that should have a normal, or None.
    known
        ``(H, W)`` bool, pixels that have one.
    """
    warnings = []
    not_finite = 0
    if finite is not None:
        lacking = np.logical_not(finite, out=finite)
        if mask is not None:
            lacking &= mask
        not_finite = int(np.count_nonzero(lacking))
    if not_finite:
        words = (
            "pixel has a NaN or infinite vector and is",
            "pixels have a NaN or infinite vector and are",
        )
        text = f"{pluralize(not_finite, *words)} left out of the mask"
        warnings.append(Notice("normals-not-finite", text, where))
    lost = 0 if mask is None else int(np.count_nonzero(mask) - np.count_nonzero(known))
    if lost:
        words = (
            "pixel of the mask has no unit vector and is",
            "pixels of the mask have no unit vector and are",
        )
        text = f"{pluralize(lost, *words)} left out"
        warnings.append(Notice("normals-not-unit", text, where))
    return warnings
