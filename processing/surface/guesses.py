"""Pieces of a surface whose height relative to the rest is a guess."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rig.arrays import Bool, Float32, Float64, Int32


class Guesses(NamedTuple):
    """Pieces that hang together with the rest of their part across jumps only.

    In each part, the pieces with a known height are no guesses, or else the largest one.

    Parameters
    ----------
    pieces
        ``(H, W)`` int32 number of the guessed piece of each pixel, from 0; -1 elsewhere.
    number
        Number of guessed pieces.
    share
        Their share of the pixels of all pieces.
    """

    pieces: Int32
    number: int
    share: float

    @classmethod
    def of(cls, pieces: Int32, parts: Int32, known: Bool | None) -> Guesses:
        """Return the guesses among pieces.

        Parameters
        ----------
        pieces
            ``(H, W)`` int32 pieces between jumps, -1 outside and at crumbs.
        parts
            ``(H, W)`` int32 number of the connected part of each pixel.
        known
            ``(H, W)`` bool, pixels whose heights are known from elsewhere.
        """
        inside = pieces >= 0
        numbers, first, sizes = np.unique(pieces[inside], return_index=True, return_counts=True)
        part_of = parts[inside][first]
        sure = np.zeros(len(numbers), bool)
        if known is not None:
            sure[np.isin(numbers, pieces[known & inside])] = True
        bare = ~np.isin(part_of, part_of[sure])
        _, largest = np.unique(part_of[bare], return_index=True)
        sure[np.flatnonzero(bare)[largest]] = True
        # The last one is that of pixels without a piece.
        guessed = np.full(int(pieces.max(initial=-1)) + 2, -1, np.int32)
        guessed[numbers[~sure]] = np.arange(np.count_nonzero(~sure))
        share = float(sizes[~sure].sum() / max(sizes.sum(), 1))
        return cls(guessed[pieces], int(np.count_nonzero(~sure)), share)

    def sigma(
        self, u: Float64, edges: tuple[Float32, Float32], steps: tuple[Float64, Float64]
    ) -> Float64:
        """Return a standard deviation for the height of each guess.

        No normal knows it: the piece may be off by what the edges around it contradict, and by
        about as much as its own heights vary.

        Parameters
        ----------
        u
            ``(H+2, W+2)`` the surface.
        edges, steps
            ``(H+2, W+2)`` weights and steps of all edges, without regard to jumps.
        """
        pieces = np.pad(self.pieces, 1, constant_values=-1).ravel()
        squares, counts = np.zeros(self.number), np.zeros(self.number)
        for beside, edge, step in zip((1, u.shape[1]), edges, steps, strict=True):
            here = np.flatnonzero(edge)
            here = here[pieces[here] != pieces[here + beside]]
            there = here + beside
            off = np.square(u.ravel()[there] - u.ravel()[here] - step.ravel()[here])
            for ends in (pieces[here], pieces[there]):
                own = ends >= 0
                squares += np.bincount(ends[own], off[own], self.number)
                counts += np.bincount(ends[own], minlength=self.number)
        own = pieces >= 0
        sizes = np.bincount(pieces[own], minlength=self.number)
        means, means2 = (
            np.bincount(pieces[own], u.ravel()[own] ** power, self.number) / sizes
            for power in (1, 2)
        )
        variances = squares / np.maximum(counts, 1) + np.maximum(means2 - means**2, 0)
        return np.asarray(np.sqrt(variances))
