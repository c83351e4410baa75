"""Causes compete to explain what normals and albedo leave of the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from acquisition import Lights
from processing.checks.arrangement import Arrangement, better_arrangement, swapped
from processing.checks.block_model import (
    BlockModel,
    block_samples,
    fit_blocks,
    light_vectors,
)
from processing.checks.causes import KINDS, Hypothesis, hypotheses_of, nuisances_of
from processing.checks.derivatives import Columns, columns_of, slopes_of
from processing.checks.evidence import Fitted, NormalEquations
from processing.checks.verdict import Cause
from processing.images.block_means import Cells
from processing.images.viewing_rays import View
from processing.maps.normal_map import NormalMap
from processing.surface.integration import integrate
from rig import pluralize
from rig.arrays import Float64, Intp

# Blocks whose samples are explained.
_BLOCKS = 1500
_FEWEST_BLOCKS, _FEWEST_LIGHTS = 100, 5
# A cause is found if its logarithmic evidence is larger, and the share of the squared residual that
# it foresees. Of 52 correct simulated recordings, gloss imitates causes that foresee up to 0.05.
_EVIDENCE, _FORESEEN = 30.0, 0.06
# Causes with this share of the evidence of the best one cannot be distinguished from it. A special
# case with this share is named instead of the general one.
_TIED, _SPECIAL = 0.9, 0.8
_MOST_CAUSES = 3
_CURVE = "transfer-curve-doubtful"
# An effect on normals that matters, in degrees.
_MATTERS_DEG = 1.0
# Parameters of single images are named if they exceed the typical one so many times.
_OUTSTANDING = 4.0
_LISTED = 6
# Blocks with less albedo, relative to the bright parts, show nothing.
_DARK = 1e-4


def _possible(row: tuple[Hypothesis, Fitted]) -> bool:
    """Return whether a size can exist: no room light is darker than none."""
    hypothesis, fitted = row
    return hypothesis.name != "ambient-light" or fitted.size[0] > 0


@dataclass(frozen=True, eq=False)
class Explanation:
    """What explains the images.

    Parameters
    ----------
    causes
        What is probably wrong, by evidence.
    residual
        Share of the signal that normals and albedo leave.
    unexplained
        Share of the squared residual that neither causes nor reflectance explain, 0..1.
    tried
        Names of the causes.
    not_excluded
        Those that would turn normals by more than 1 degree before these images show them.
    least
        Smallest sizes that would be found.
    """

    causes: tuple[Cause, ...] = ()
    residual: float = float("nan")
    unexplained: float = 1.0
    tried: tuple[str, ...] = ()
    not_excluded: tuple[str, ...] = ()
    least: dict[str, str] = field(default_factory=dict)


def explain(
    cells: Cells, lights: Lights, strengths: Float64, view: View | None, pixel_mm: float | None
) -> Explanation:
    """Find what is probably wrong with a recording.

    Normals and albedo of each block are eliminated from linear least squares in the parameters of
    all causes; height and reflectance are nuisances of each. The cause with the largest evidence is
    taken, then the next one together with it.

    Parameters
    ----------
    cells
        Means of the N images, divided by the strengths of the lights.
    lights
        The N lights.
    strengths
        ``(N,)`` recorded signal of each image relative to these means.
    view
        How pixels see the surface under near lights, else None.
    pixel_mm
        Size of a pixel on the object; None if it is not known.
    """
    samples, places = block_samples(cells)
    shape = cells.mask.shape
    untested = Explanation(not_excluded=tuple(KINDS))
    if len(places) < _FEWEST_BLOCKS or len(lights) < _FEWEST_LIGHTS:
        return untested
    points = _points(cells, places, pixel_mm)
    model = fit_blocks(samples, light_vectors(lights, points), points, places, shape)
    if np.count_nonzero(model.valid) < _FEWEST_BLOCKS:
        return untested
    better = better_arrangement(model, samples, lights)
    if better is not None:
        vectors = light_vectors(better.lights, points)
        changed = fit_blocks(samples, vectors, points, places, shape)
        cause = _arranged(better, _angle_deg(model, changed))
        return Explanation((cause,), model.relative_residual, 1.0, (cause.name,))
    causes: list[Cause] = []
    if pairs := swapped(model):
        order = np.arange(len(lights))
        for image, light in pairs:
            order[image] = light
        ids, lights = lights.ids, lights.take([int(i) for i in order])
        changed = fit_blocks(samples, light_vectors(lights, points), points, places, shape)
        causes.append(_exchanged(pairs, ids, _angle_deg(model, changed)))
        model = changed
    rays = None if view is None else view.rise(points)
    slopes = slopes_of(model)
    blocks = _usable(model, slopes)
    if len(blocks) < _FEWEST_BLOCKS:
        return replace(untested, causes=tuple(causes))
    columns = columns_of(model, lights, strengths, rays, slopes)
    found = _Contest(model, columns, blocks, lights, cells.size, pixel_mm).explanation()
    hidden = (*found.not_excluded, *(() if lights.near else ("images-turned",)))
    return replace(found, causes=(*causes, *found.causes), not_excluded=hidden)


def _usable(model: BlockModel, slopes: tuple[Float64, Float64]) -> Intp:
    """Return the blocks that are used; those at the border of the object have no slopes."""
    inside = np.isfinite(slopes[0] + slopes[1]).all(axis=1)
    usable = np.flatnonzero(model.valid & (model.albedo > _DARK) & inside)
    if len(usable) <= _BLOCKS:
        return usable
    return np.sort(np.random.default_rng(0).choice(usable, _BLOCKS, replace=False))


def _points(cells: Cells, places: Intp, pixel_mm: float | None) -> Float64:
    if cells.points_mm is not None:
        return cells.points_mm.reshape(-1, 3)[places]
    rows, across = np.divmod(places, cells.mask.shape[1])
    size = cells.size * (pixel_mm or 1.0)
    flat = [across - across.mean(), rows.mean() - rows, np.zeros(len(rows))]
    return np.stack(flat, axis=1) * size


def _arranged(better: Arrangement, effect_deg: float) -> Cause:
    lists = "the images are" if better.turned else "the lists of lights and images are"
    return Cause(
        better.name,
        f"{lists} {better.text}",
        np.nan,
        "",
        np.nan,
        effect_deg,
        np.nan,
        "turn the images, or the lights" if better.turned else "check the order of the files",
        inverts=better.inverts,
    )


def _exchanged(pairs: list[tuple[int, int]], ids: tuple[str, ...], effect_deg: float) -> Cause:
    texts = [f"{ids[image]} shows the light of {ids[light]}" for image, light in pairs]
    more = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return Cause(
        "images-swapped",
        f"{', '.join(texts[:_LISTED])}{more}",
        float(len(pairs)),
        "images",
        0.0,
        effect_deg,
        np.nan,
        "check the order of the files",
        where=", ".join(ids[image] for image, _ in pairs),
    )


def _angle_deg(one: BlockModel, other: BlockModel) -> float:
    both = one.valid & other.valid
    sine = np.linalg.norm(np.cross(one.normals[both], other.normals[both]), axis=1)
    cosine = (one.normals[both] * other.normals[both]).sum(axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.arctan2(sine, cosine) ** 2))))


class _Contest:
    """The competition of the causes of one recording."""

    def __init__(
        self,
        model: BlockModel,
        columns: Columns,
        blocks: Intp,
        lights: Lights,
        size: int,
        pixel_mm: float | None,
    ) -> None:
        self._model, self._columns, self._lights = model, columns, lights
        self._size, self._pixel_mm = size, pixel_mm
        nuisances, widths = nuisances_of(self._columns)
        self._equations = NormalEquations(model, columns, blocks, nuisances, widths)
        self._hypotheses = hypotheses_of(self._columns, lights.unit_directions)
        flexible = [one for one in self._hypotheses if not one.general]
        self._design = self._equations.design_effect(
            np.hstack([nuisances, *(one.basis for one in flexible)]),
            self._columns.select("ambient", "offset", "curve", "rough"),
            np.concatenate([widths, *(one.widths for one in flexible)]),
        )

    def explanation(self) -> Explanation:
        """Return the causes that are found, and what could not be."""
        equations = self._equations
        causes: list[Cause] = []
        while len(causes) < _MOST_CAUSES:
            best, others = self._best(equations, {cause.name for cause in causes})
            if best is None:
                break
            causes.append(self._cause(*best, others))
            if best[0].name == _CURVE:
                break  # sizes of others are those of a wrong curve
            equations = equations.with_nuisances(best[0].basis, best[0].widths)
        tried = tuple(dict.fromkeys(one.name for one in self._hypotheses))
        hidden, least = self._limits(equations, {cause.name for cause in causes})
        return Explanation(
            tuple(causes),
            self._model.relative_residual,
            equations.base / self._equations.squares,
            tried,
            hidden,
            least,
        )

    def _best(
        self, equations: NormalEquations, known: set[str]
    ) -> tuple[tuple[Hypothesis, Fitted] | None, tuple[str, ...]]:
        """Return the best cause besides those that are known, and those that are as good."""
        rows: dict[str, tuple[Hypothesis, Fitted]] = {}
        for name, group in groupby(self._hypotheses, key=lambda one: one.name):
            if name not in known:
                fits = [(one, equations.fit(one.basis, one.widths, self._design)) for one in group]
                rows[name] = max(fits, key=lambda pair: pair[1].evidence)
        enough = {
            name: row
            for name, row in rows.items()
            if row[1].evidence > _EVIDENCE and row[1].foreseen > _FORESEEN and _possible(row)
        }
        if not enough:
            return None, ()
        best = max(enough.values(), key=lambda row: row[1].evidence)
        special = [
            row
            for row in enough.values()
            if row[0].general == best[0].name and row[1].evidence > _SPECIAL * best[1].evidence
        ]
        if special:
            best = max(special, key=lambda row: row[1].evidence)
        tied = tuple(
            name
            for name, row in enough.items()
            if row[1].evidence > _TIED * best[1].evidence
            and name not in (best[0].name, best[0].general)
        )
        return best, tied

    def _cause(self, hypothesis: Hypothesis, fitted: Fitted, tied: Sequence[str]) -> Cause:
        kind = KINDS[hypothesis.name]
        size, sigma, where = self._size_of(hypothesis, fitted)
        scale, unit = kind.scale or self._size, kind.unit
        if unit == "mm" and self._pixel_mm is None:
            unit = "px"
        size, sigma = size * scale, sigma * scale
        if hypothesis.name == _CURVE:
            size += 1
        text = kind.text.format(size=f"{size:.2g} +- {sigma:.1g} {unit}".rstrip())
        if where:
            text += f": {where}"
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
            alternatives=tuple(tied),
            where=where,
        )

    def _size_of(self, hypothesis: Hypothesis, fitted: Fitted) -> tuple[float, float, str]:
        """Return size and standard deviation in units of the columns, and images that stand out."""
        if hypothesis.general or hypothesis.name not in ("light-brightness", "image-shifted"):
            if hypothesis.name == "lights-not-distant":
                # The distance follows from its reciprocal.
                size = float(np.ptp(self._model.points[:, :2], axis=0).max())
                share = fitted.sigma[0] / max(abs(float(fitted.size[0])), 1e-9)
                away = size / max(abs(float(fitted.size[0])), 1e-9)
                return away, float(away * share), ""
            if hypothesis.name == "ambient-light":
                return float(fitted.size[0]), float(fitted.sigma[0]), ""
            size = float(np.linalg.norm(fitted.size)) if len(fitted.size) > 1 else fitted.size[0]
            return float(size), float(np.median(fitted.sigma)), ""
        each = fitted.size.reshape(-1, len(self._lights))
        each = each - np.median(each, axis=1, keepdims=True)
        size = np.linalg.norm(each, axis=0)
        limit = _OUTSTANDING * float(np.median(size))
        out = [int(i) for i in np.argsort(-size) if size[i] > limit]
        sigma = float(np.median(fitted.sigma))
        if not out or len(out) > len(size) // 4:
            return float(np.sqrt(np.mean(size**2))), sigma, ""
        names = ", ".join(self._lights.ids[i] for i in out[:_LISTED])
        more = f" and {pluralize(len(out) - _LISTED, 'other')}" if len(out) > _LISTED else ""
        return float(size[out].max()), sigma, names + more

    def _height_mm(self, fitted: Fitted) -> float:
        """Return the root mean square change of the heights, NaN without a scale."""
        if self._pixel_mm is None:
            return float("nan")
        model, step = self._model, 2
        rows, across = np.divmod(model.places, model.shape[1])
        some = np.flatnonzero(model.valid & (rows % step == 0) & (across % step == 0))
        moved = np.zeros((len(some), 3))
        for part in np.array_split(np.arange(len(some)), 1 + len(some) // 500):
            change = self._columns.of(some[part]) @ fitted.alone
            moved[part] = model.scaled_normals[some[part]] - model.answer(some[part], change)
        maps = []
        for scaled in (model.scaled_normals[some], moved):
            grid = np.zeros((*(-(-length // step) for length in model.shape), 3), np.float32)
            grid[rows[some] // step, across[some] // step] = scaled
            maps.append(integrate(NormalMap.from_vectors(grid)))
        both = maps[0].mask & maps[1].mask
        pixel = self._pixel_mm * self._size * step
        lower, upper = (each.height[both].astype(np.float64) for each in maps)
        rise = 0.0
        if "height" in self._columns.names:
            rise = float(fitted.change[self._columns.names.index("height")])
        return float(np.hypot(np.std(upper - lower) * pixel, rise))

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
                size = equations.least_size(column, width, self._design, _EVIDENCE, _FORESEEN)
                capped = min(size, 2 * float(width[0]))
                degrees = equations.effect_deg(column[:, 0] * capped)
                worst = max(worst, float(np.sqrt(np.mean(degrees**2))))
                if i == 0:
                    kind = KINDS[name]
                    number = size * (kind.scale or self._size)
                    least[name] = f"{number:.2g} {kind.unit}".rstrip()
            if worst > _MATTERS_DEG:
                hidden.append(name)
        return tuple(hidden), least
