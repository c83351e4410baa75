"""Pieces of a surface whose height relative to the rest is a guess."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acquisition.files import MapRows, rows_in_bands
from rig.arrays import Bool, Float32, Float64, Int32

# Pixels of a band.
_BAND = 1 << 20


class Guesses(NamedTuple):
    """Pieces that hang together with the rest of their part across jumps only.

    In each part, the pieces with a known height are no guesses, or else the largest one.

    Parameters
    ----------
    of_piece
        ``(N + 1,)`` int32 number of the guess, from 0, that each piece is; -1 for other pieces, and
        at the end, for pixels without a piece.
    number
        Number of guessed pieces.
    share
        Their share of the pixels of all pieces.
    """

    of_piece: Int32
    number: int
    share: float

    @classmethod
    def of(cls, pieces: Int32, parts: MapRows, known: Bool | None) -> Guesses:
        """Return the guesses among pieces.

        Parameters
        ----------
        pieces
            ``(H, W)`` int32 pieces between jumps, the largest first, -1 outside and at crumbs.
        parts
            ``(H, W)`` int32 number of the connected part of each pixel.
        known
            ``(H, W)`` bool, pixels whose heights are known from elsewhere.
        """
        count = int(pieces.max(initial=-1)) + 1
        sizes, part_of = np.zeros(count, np.int64), np.zeros(count, np.int32)
        sure = np.zeros(count, bool)
        for rows in rows_in_bands(len(pieces), pieces.shape[1], _BAND):
            inside = pieces[rows] >= 0
            own = pieces[rows][inside]
            sizes += np.bincount(own, minlength=count)
            part_of[own] = parts[rows][inside]
            if known is not None:
                sure[own[known[rows][inside]]] = True
        numbers = np.flatnonzero(sizes)
        bare = numbers[~np.isin(part_of[numbers], part_of[sure])]
        sure[bare[np.unique(part_of[bare], return_index=True)[1]]] = True
        guessed = np.flatnonzero((sizes > 0) & ~sure)
        of_piece = np.full(count + 1, -1, np.int32)
        of_piece[guessed] = np.arange(len(guessed))
        return cls(of_piece, len(guessed), float(sizes[guessed].sum() / max(sizes.sum(), 1)))

    def sigma(
        self,
        guesses: Int32,
        u: Float64,
        edges: tuple[Float32, Float32],
        steps: tuple[Float64, Float64],
    ) -> Float64:
        """Return a standard deviation for the height of each guess.

        No normal knows it: the piece may be off by what the edges around it contradict, and by
        about as much as its own heights vary.

        Parameters
        ----------
        guesses
            ``(H, W)`` int32 number of the guess of each pixel, -1 elsewhere.
        u
            ``(H+2, W+2)`` the surface.
        edges, steps
            ``(H+2, W+2)`` weights and steps of all edges, without regard to jumps.
        """
        pieces = np.pad(guesses, 1, constant_values=-1).ravel()
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
