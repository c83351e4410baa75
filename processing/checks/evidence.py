"""How much better images are explained if something is wrong, beyond chance."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from processing.checks.block_model import BlockModel
from processing.checks.derivatives import Columns
from rig.arrays import Float64, Intp

# Parts of the object whose residuals count as independent, along each side.
_PARTS = 8
_FOLDS = 4
_RIDGE = 1e-12
# Squared residual of images without noise.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Fitted:
    """Parameters of one hypothesis, with those of the nuisances.

    Parameters
    ----------
    size
        ``(q,)`` parameters of the cause.
    sigma
        ``(q,)`` their standard deviations.
    change
        ``(Q,)`` of all columns, with the nuisances.
    alone
        ``(Q,)`` of the columns of the cause.
    evidence
        Logarithm of how much more probable the images are than without the cause.
    foreseen
        Share of the squared residual of normals and albedo that it explains in parts of the object
        to which it was not fitted.
    """

    size: Float64
    sigma: Float64
    change: Float64
    alone: Float64
    evidence: float
    foreseen: float


class NormalEquations:
    """Least squares of all columns, from which normals and albedo of each block are eliminated.

    Parameters
    ----------
    model
        The blocks.
    columns
        Their derivatives.
    blocks
        Indices of the blocks that are used.
    nuisances
        ``(Q, m)`` columns that belong to every hypothesis.
    widths
        ``(m,)`` their expected sizes.
    """

    def __init__(
        self,
        model: BlockModel,
        columns: Columns,
        blocks: Intp,
        nuisances: Float64,
        widths: Float64,
    ) -> None:
        self.model, self.columns, self.blocks = model, columns, blocks
        self.nuisances, self.widths = nuisances, widths
        count = len(columns.names)
        rows, across = np.divmod(model.places[blocks], model.shape[1])
        part = _part(rows) * _PARTS + _part(across)
        self._products = np.zeros((_PARTS**2, count, count))
        self._scores = np.zeros((_PARTS**2, count))
        self._squares = np.zeros(_PARTS**2)
        self._count = np.zeros(_PARTS**2)
        # Change (B, 3, Q) of the scaled normals with the columns.
        self.answers = np.zeros((len(blocks), 3, count), np.float32)
        for i in np.unique(part):
            inside = np.flatnonzero(part == i)
            self._add(i, inside, *columns.of(blocks[inside]))
        self._used = np.flatnonzero(self._count > 0)
        rows, across = np.divmod(self._used, _PARTS)
        fold = (rows // 2 * 7 + across // 2 * 3) % _FOLDS
        folds = [self._used[fold == i] for i in range(_FOLDS)]
        self._sums = self._summed(self._used)
        self._folds = [self._summed(one) for one in folds if 0 < len(one) < len(self._used)]
        self.samples = float(self._count.sum())

    def _add(self, part: int, inside: Intp, shared: Float64, own: Float64) -> None:
        """Add the blocks of a part, with columns of all images, and those of each image."""
        model, blocks = self.model, self.blocks[inside]
        weights, left = model.weights[blocks], model.samples[blocks] - model.predicted[blocks]
        weighted, products = model.products(blocks)
        across = weighted.transpose(0, 2, 1)
        each = across[:, :, None] * own.transpose(0, 2, 1)[:, None]
        mixed = np.concatenate([across @ shared, each.reshape(len(blocks), 3, -1)], axis=2)
        target = (weighted * left[..., None]).sum(axis=1)
        answer = np.linalg.solve(products, mixed)
        fitted = np.linalg.solve(products, target[..., None])[..., 0]
        root = np.sqrt(weights)
        residual = left * root
        flat, answers = (each.reshape(-1, mixed.shape[2]) for each in (mixed, answer))
        squares, scores = _products(shared * root[..., None], own * root[..., None], residual)
        self._products[part] = squares - flat.T @ answers
        self._scores[part] = scores - answers.T @ target.reshape(-1)
        self._squares[part] = float((residual**2).sum()) - float((target * fitted).sum())
        self._count[part] = np.count_nonzero(weights) - 3 * len(blocks)
        self.answers[inside] = -answer

    def _summed(self, parts: Intp) -> tuple[Float64, Float64]:
        return self._products[parts].sum(axis=0), self._scores[parts].sum(axis=0)

    def _solved(
        self,
        basis: Float64,
        widths: Float64,
        variance: float,
        sums: tuple[Float64, Float64] | None = None,
    ) -> tuple[Float64, Float64, Float64]:
        products, scores = sums or self._sums
        matrix = basis.T @ products @ basis
        ridge = np.diag(variance / widths**2) + _RIDGE * np.trace(matrix) * np.eye(len(matrix))
        return np.linalg.solve(matrix + ridge, basis.T @ scores), matrix, ridge

    def _gain(self, change: Float64, sums: tuple[Float64, Float64] | None = None) -> float:
        products, scores = sums or self._sums
        return float(2 * change @ scores - change @ products @ change)

    @property
    def squares(self) -> float:
        """Squared residual of normals and albedo alone."""
        return float(self._squares.sum())

    @cached_property
    def base(self) -> float:
        """Squared residual with the nuisances alone."""
        squares = self.squares
        if not self.nuisances.shape[1]:
            return max(squares, _ROUNDING)
        found, _, _ = self._solved(self.nuisances, self.widths, squares / self.samples)
        return max(squares - self._gain(self.nuisances @ found), _ROUNDING)

    def design_effect(self, flexible: Float64, judged: Float64, widths: Float64) -> float:
        """Return how many samples count as one, because neighbours deviate alike.

        Parameters
        ----------
        flexible
            ``(Q, q)`` columns that are fitted before, with their expected sizes ``widths``.
        judged
            ``(Q, j)`` columns whose scores are compared with those of independent samples.
        """
        squares = self.squares
        found, _, _ = self._solved(flexible, widths, squares / self.samples)
        change = flexible @ found
        left = max(squares - self._gain(change), 1e-12) / self.samples
        scores = (self._scores[self._used] - self._products[self._used] @ change) @ judged
        expected = np.einsum("pij,ik,jk->k", self._products[self._used], judged, judged) * left
        return max(1.0, float(np.median((scores**2).sum(axis=0) / np.maximum(expected, 1e-12))))

    def fit(self, cause: Float64, widths: Float64, design_effect: float) -> Fitted:
        """Fit a cause together with the nuisances.

        Parameters
        ----------
        cause
            ``(Q, q)`` its columns, or contrasts of them.
        widths
            ``(q,)`` expected sizes.
        design_effect
            Samples that count as one.
        """
        basis = np.hstack([self.nuisances, cause])
        expected = np.concatenate([self.widths, widths])
        known = self.nuisances.shape[1]
        left = self.base
        for _ in range(2):
            variance = left / self.samples * design_effect
            found, matrix, ridge = self._solved(basis, expected, variance)
            left = max(self.squares - self._gain(basis @ found), _ROUNDING)
        information = np.linalg.slogdet(matrix + ridge)[1] - np.linalg.slogdet(ridge)[1]
        before = 0.0
        if known:
            inner = matrix[:known, :known] + ridge[:known, :known]
            before = np.linalg.slogdet(inner)[1] - np.linalg.slogdet(ridge[:known, :known])[1]
        evidence = self.samples / design_effect / 2 * np.log(self.base / left)
        evidence -= (information - before) / 2
        inverse = np.linalg.inv(matrix + ridge)
        scores = self._scores[self._used] - self._products[self._used] @ (basis @ found)
        scores = scores @ basis
        covariance = inverse @ (scores.T @ scores) @ inverse
        alone = cause @ found[known:]
        return Fitted(
            found[known:],
            np.sqrt(np.maximum(np.diag(covariance), 0))[known:],
            basis @ found,
            alone,
            float(evidence),
            self._foreseen(basis, expected, variance),
        )

    def _foreseen(self, basis: Float64, widths: Float64, variance: float) -> float:
        """Return the share that is explained in parts of the object that were left out."""
        known = self.nuisances.shape[1]
        gain = 0.0
        for own in self._folds:
            others = self._sums[0] - own[0], self._sums[1] - own[1]
            found, _, _ = self._solved(basis, widths, variance, others)
            gain += self._gain(basis @ found, own)
            if known:
                found, _, _ = self._solved(self.nuisances, self.widths, variance, others)
                gain -= self._gain(self.nuisances @ found, own)
        return gain / self.squares

    def with_nuisances(self, basis: Float64, widths: Float64) -> NormalEquations:
        """Return the same equations with more nuisances."""
        other = copy(self)
        other.nuisances = np.hstack([self.nuisances, basis])
        other.widths = np.concatenate([self.widths, widths])
        other.__dict__.pop("base", None)  # it depends on them
        return other

    def least_size(
        self, cause: Float64, widths: Float64, design_effect: float, evidence: float, share: float
    ) -> float:
        """Return the smallest size of a single parameter that would be found.

        Parameters
        ----------
        cause
            ``(Q, 1)`` its column.
        widths, design_effect
            As for `fit`.
        evidence, share
            What a cause must reach.
        """
        basis = np.hstack([self.nuisances, cause])
        variance = self.base / self.samples
        _, matrix, ridge = self._solved(
            basis, np.concatenate([self.widths, widths]), variance * design_effect
        )
        known = self.nuisances.shape[1]
        left = matrix[known, known]
        if known:
            inner = matrix[:known, :known] + ridge[:known, :known]
            left -= matrix[known, :known] @ np.linalg.solve(inner, matrix[:known, known])
        needed = max(2 * evidence * variance * design_effect, share * self.squares)
        return float(np.sqrt(needed / max(float(left), 1e-300)))

    def effect_deg(self, change: Float64) -> Float64:
        """Return how much a change of the columns turns the normals of the blocks, in degrees."""
        moved = self.answers @ change
        normals = self.model.normals[self.blocks]
        across = moved - (moved * normals).sum(axis=1, keepdims=True) * normals
        size = np.linalg.norm(across, axis=1) / self.model.albedo[self.blocks]
        return np.asarray(np.degrees(np.arctan(size)))


def _products(shared: Float64, own: Float64, residual: Float64) -> tuple[Float64, Float64]:
    """Return the products of all columns with each other, and with the residual.

    Columns of different images have no sample in common.
    """
    count, kinds = own.shape[1:]
    common = shared.shape[2]
    found = np.zeros((common + kinds * count,) * 2)
    rows = shared.reshape(-1, common)
    found[:common, :common] = rows.T @ rows
    images = own.transpose(1, 2, 0)  # (N, kinds, B)
    mixed = (images @ shared.transpose(1, 0, 2)).transpose(1, 0, 2).reshape(-1, common)
    found[common:, :common], found[:common, common:] = mixed, mixed.T
    alike = found[common:, common:].reshape(kinds, count, kinds, count)
    k = np.arange(count)
    alike[:, k, :, k] = images @ images.transpose(0, 2, 1)
    found[common:, common:] = alike.reshape(kinds * count, -1)
    each = np.einsum("bnj,bn->jn", own, residual).reshape(-1)
    return found, np.concatenate([rows.T @ residual.reshape(-1), each])


def _part(at: Intp) -> Intp:
    return np.asarray(
        np.minimum((at - at.min()) * _PARTS // max(int(np.ptp(at)) + 1, 1), _PARTS - 1)
    )
