"""Causes that act on all images compete to explain what normals and albedo leave of them."""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import numpy as np

from acquisition import Lights
from processing.checks import limits
from processing.checks.block_model import BlockModel
from processing.checks.causes import KINDS, Hypothesis, hypotheses_of, nuisances_of
from processing.checks.derivatives import Columns
from processing.checks.evidence import Fitted, NormalEquations
from processing.checks.height_effect import height_effect_mm, sparse_blocks
from processing.checks.verdict import Cause
from rig import figure, listed
from rig.arrays import Float64, Intp

_MOST_CAUSES = 3
_CURVE = "transfer-curve-doubtful"
_CURVES = (_CURVE, "tone-curve")


_Row = tuple[Hypothesis, Fitted]


def _possible(row: _Row) -> bool:
    """Return whether a size can exist: no room light is darker than none."""
    hypothesis, fitted = row
    if hypothesis.name == _CURVE:
        return bool(0 < 1 + fitted.size[0] < limits.LARGEST_POWER)
    if hypothesis.name == "ambient-light-changes":
        return bool(fitted.size.mean() > 0)
    return hypothesis.name != "ambient-light" or bool(fitted.size[0] > 0)


class Decision(NamedTuple):
    """What explains the images.

    Parameters
    ----------
    causes
        What is probably wrong, by evidence.
    unexplained
        Share of the squared residual that neither causes nor reflectance explain, 0..1.
    tried
        Names of the causes.
    not_excluded
        Those that would turn normals by more than 1 degree before these images show them.
    least
        Smallest sizes that would be found.
    outstanding
        Images whose brightness or position differs from that of the others, with the factor of the
        brightness; None of the position.
    """

    causes: tuple[Cause, ...]
    unexplained: float
    tried: tuple[str, ...]
    not_excluded: tuple[str, ...]
    least: dict[str, str]
    outstanding: dict[str, float | None]


class Contest:
    """The competition of the causes of one recording.

    Normals and albedo of each block are eliminated from linear least squares in the parameters of
    all causes; height and reflectance are nuisances of each. The cause with the largest evidence is
    taken, then the next one together with it.

    Parameters
    ----------
    model
        The blocks.
    columns
        Their derivatives.
    blocks
        Indices of the blocks that are used.
    lights
        The N lights.
    size
        Pixels along the side of a block.
    pixel_mm
        Size of a pixel on the object; None if it is not known.
    rays
        ``(P, 3)`` change of the surface points per mm of height; None under distant lights.
    """

    def __init__(
        self,
        model: BlockModel,
        columns: Columns,
        blocks: Intp,
        lights: Lights,
        size: int,
        pixel_mm: float | None,
        rays: Float64 | None,
    ) -> None:
        self._model, self._columns, self._lights = model, columns, lights
        self._size, self._pixel_mm, self._rays = size, pixel_mm, rays
        self._outstanding: dict[str, float | None] = {}
        nuisances, widths = nuisances_of(self._columns)
        self._equations = NormalEquations(model, columns, blocks, nuisances, widths)
        self._hypotheses = hypotheses_of(self._columns, lights.unit_directions)
        self._design = self._equations.design_effect(
            np.hstack([nuisances, *(one.basis for one in self._hypotheses)]),
            self._columns.select("ambient", "offset", "curve", "rough"),
            np.concatenate([widths, *(one.widths for one in self._hypotheses)]),
        )

    def decide(self, *, with_limits: bool = True) -> Decision:
        """Return the causes that are found, and what could not be if ``with_limits``."""
        equations = self._equations
        causes: list[Cause] = []
        while len(causes) < _MOST_CAUSES:
            found = self._best(equations, {cause.name for cause in causes})
            if not found:
                break
            causes.append(self._cause(*found))
            best, _ = found[0]
            if best.name in _CURVES:
                break  # sizes of others are those of a wrong curve
            equations = equations.with_nuisances(best.basis, best.widths)
        tried = tuple(dict.fromkeys(one.name for one in self._hypotheses))
        known = {cause.name for cause in causes}
        hidden, least = self._limits(equations, known) if with_limits else ((), {})
        unexplained = equations.base / self._equations.squares
        return Decision(tuple(causes), unexplained, tried, hidden, least, self._outstanding)

    def _best(self, equations: NormalEquations, known: set[str]) -> list[_Row]:
        """Return the best cause besides those that are known, and then those that are as good."""
        rows: dict[str, _Row] = {}
        for name, group in groupby(self._hypotheses, key=lambda one: one.name):
            if name not in known:
                fits = [(one, equations.fit(one.basis, one.widths, self._design)) for one in group]
                rows[name] = max(fits, key=lambda pair: pair[1].evidence)
        enough = {
            name: row
            for name, row in rows.items()
            if row[1].evidence > limits.EVIDENCE
            and row[1].foreseen > limits.FORESEEN
            and _possible(row)
            and self._is_known(row)
        }
        if not enough:
            return []
        best = max(enough.values(), key=lambda row: row[1].evidence)
        special = [
            row
            for row in enough.values()
            if best[0].name in row[0].general
            and row[1].evidence > limits.SPECIAL * best[1].evidence
        ]
        if special:
            best = max(special, key=lambda row: row[1].evidence)
        tied = [
            row
            for name, row in enough.items()
            if row[1].evidence > limits.TIED * best[1].evidence
            and name not in (best[0].name, *best[0].general)
        ]
        return [best, *tied]

    def _is_known(self, row: _Row) -> bool:
        """Return whether the size that a text would state is significant."""
        size, sigma, _ = self._size_of(*row)
        return abs(size) > limits.SIGMAS * sigma

    def _cause(self, best: _Row, *tied: _Row) -> Cause:
        hypothesis, fitted = best
        kind = KINDS[hypothesis.name]
        size, sigma, out = self._size_of(hypothesis, fitted)
        self._outstanding |= out
        scale, unit = kind.scale or self._size, kind.unit
        if unit == "mm" and self._pixel_mm is None:
            unit = "px"
        size, sigma = size * scale, sigma * scale
        if hypothesis.name == _CURVE:
            size += 1
        text = kind.text.format(size=f"{figure(size)} +- {figure(sigma, 1)} {unit}".rstrip())
        if out:
            text += ": " + listed(
                name if gain is None else f"{name} ({gain:.2f} times as bright)"
                for name, gain in out.items()
            )
        degrees = self._equations.effect_deg(fitted.alone)
        return Cause(
            hypothesis.name,
            text,
            float(size),
            unit,
            float(sigma),
            float(np.sqrt(np.mean(degrees**2))),
            self._height_mm(fitted),
            kind.remedy,
            alternatives=tuple(one.name for one, _ in tied),
            where=", ".join(out),
            share=float(np.clip(fitted.foreseen, 0, 1)),
        )

    def _size_of(
        self, hypothesis: Hypothesis, fitted: Fitted
    ) -> tuple[float, float, dict[str, float | None]]:
        """Return size and standard deviation in units of the columns, and images that stand out."""
        if hypothesis.name not in ("light-brightness", "image-shifted"):
            if hypothesis.name == "lights-not-distant":
                # The distance follows from its reciprocal. A height alone is a factor that depends
                # on the elevations of the lights.
                size = float(np.ptp(self._model.points[:, :2], axis=0).max())
                share = fitted.sigma[0] / max(abs(float(fitted.size[0])), 1e-9)
                away = size / max(abs(float(fitted.size[0])), 1e-9)
                return away, float(away * share), {}
            if hypothesis.name == "ambient-light-changes":
                return float(np.std(fitted.size)), float(np.median(fitted.sigma)), {}
            if hypothesis.name == "ambient-light":
                return float(fitted.size[0]), float(fitted.sigma[0]), {}
            size = float(np.linalg.norm(fitted.size)) if len(fitted.size) > 1 else fitted.size[0]
            return float(size), float(np.median(fitted.sigma)), {}
        each = fitted.size.reshape(-1, len(self._lights))
        each = each - np.median(each, axis=1, keepdims=True)
        size = np.linalg.norm(each, axis=0)
        limit = limits.OUTSTANDING * float(np.median(size))
        out = [int(i) for i in np.argsort(-size) if size[i] > limit]
        sigma = float(np.median(fitted.sigma))
        if not out or len(out) > len(size) // 4:
            return float(np.sqrt(np.mean(size**2))), sigma, {}
        kept = {}
        for i in out:
            gain = float(1 + each[0, i]) if hypothesis.name == "light-brightness" else None
            kept[self._lights.ids[i]] = gain
        return float(size[out].max()), sigma, kept

    def _height_mm(self, fitted: Fitted) -> float:
        """Return the root mean square change of the heights, NaN without a scale."""
        if self._pixel_mm is None:
            return float("nan")
        model = self._model
        some = sparse_blocks(model)
        block_mm = self._pixel_mm * self._size
        samples = model.samples[some] - self._columns.change(some, fitted.alone)
        return height_effect_mm(model, samples, self._lights, self._rays, block_mm)

    def _limits(
        self, equations: NormalEquations, found: set[str]
    ) -> tuple[tuple[str, ...], dict[str, str]]:
        """Return the causes that could be hidden, and the least sizes that would be found."""
        hidden, least = [], {}
        for name, group in groupby(self._hypotheses, key=lambda one: one.name):
            hypothesis = next(iter(group))
            if name in found:
                continue
            worst = 0.0
            for i in range(hypothesis.basis.shape[1]):
                column, width = hypothesis.basis[:, i : i + 1], hypothesis.widths[i : i + 1]
                size = equations.least_size(
                    column, width, self._design, limits.EVIDENCE, limits.FORESEEN
                )
                capped = min(size, 2 * float(width[0]))
                degrees = equations.effect_deg(column[:, 0] * capped)
                worst = max(worst, float(np.sqrt(np.mean(degrees**2))))
                if i == 0:
                    kind = KINDS[name]
                    number = size * (kind.scale or self._size)
                    least[name] = f"{figure(number)} {kind.unit}".rstrip()
            if worst > limits.MATTERS_DEG:
                hidden.append(name)
        return tuple(hidden), least
