"""The paper's two transfer tables, peers beside: by resolution, and onto the DiLiGenT targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean

import numpy as np

from processing import NormalMap, ShapeFilter, angular_error, separate, ssim, transfer
from sgp._overview import Panel, normals_panel
from sgp._paper import figures as paper
from sgp._paper.measure import METHODS, Method, measure
from sgp._paper.sources import Sources
from sgp._paper.tables import Number, Table, flattened

Advance = Callable[[str], None]
Figures = dict[str, dict[str, list[Number]]]

_QUANTITIES = (
    "shape error, deg", "shape SSIM", "detail error, deg", "detail SSIM", "memory, MB", "time, s",
)  # fmt: skip
_MESHES = (
    "DSPL and LAPL are this program's own, written on scipy: they get surface and correspondence "
    "for nothing and are measured in the same run, so compare with them, not with the paper's. "
    "Memory is the peak of resident memory above the inputs, time the mean CPU seconds of all "
    "threads; of the paper's way of measuring only that it averages ten runs is known. Errors by "
    "the paper's filter, SSIM in its protocol."
)


def by_resolution(
    sources: Sources, points: Sequence[int], runs: int, advance: Advance
) -> tuple[Table, Table, list[Panel]]:
    """Measure one transfer at growing numbers of points; returns table, headline and pictures."""
    figures: Figures = {name: {method: [] for method in METHODS} for name in _QUANTITIES}
    columns = []
    for count in points:
        name, source, target = sources.resolution_pair(count)
        placed = laid_over(source, target)
        pixels = np.count_nonzero(target.mask)
        columns.append(f"#{pixels}")
        advance(f"{name}, {pixels} points, {len(METHODS)} methods")
        results = _add(figures, placed, target, runs)
    panels = [
        normals_panel(f"{method}, {pixels} points", result) for method, result in results.items()
    ]
    table = Table(
        "resolution",
        f"Transfer by resolution ({name}; mean of {runs} run{'s' * (runs > 1)})",
        tuple(columns),
        flattened(figures),
        tuple(f"#{count}" for count in paper.POINTS),
        flattened(paper.RESOLUTION),
        f"The paper puts Circular onto Bunny; its Circular is not to be had. {_MESHES}",
    )
    return table, _headline(figures, points), panels


def laid_over(source: NormalMap, target: NormalMap) -> NormalMap:
    """Return a source as `transfer` lays it over a target: cropped, or repeated."""
    return transfer(source, target, order=1).placement.place(source, target)


def _headline(figures: Figures, points: Sequence[int]) -> Table:
    """Build the abstract's ratios from the same two cells as the paper does."""
    many, few = paper.HEADLINE_POINTS
    rows: dict[str, list[Number]] = {}
    for method in ("normals", "normals, order 8"):
        cells: list[Number] = []
        for quantity in ("memory, MB", "time, s"):
            pair = [
                figures[quantity][name][points.index(count)] if count in points else None
                for name, count in ((method, many), ("LAPL", few))
            ]
            cells.append(pair[0] / pair[1] if pair[0] is not None and pair[1] else None)
        rows[method] = cells
    columns = ("memory ratio", "time ratio")
    return Table(
        "headline",
        f"Headline: normals at {many} points over LAPL at {few}",
        columns,
        rows,
        columns,
        {"normals": (paper.HEADLINE_MEMORY, paper.HEADLINE_TIME)},
        "The paper claims 30 times the points at 6.5 % of the memory and 14.0 % of the time: "
        "53.50 / 827.52 MB and 2.93 / 20.93 s of its table. The peer here needs far less than "
        "the paper's LAPL, so the claim does not carry over: at equal points see the table above.",
    )


def onto_diligent(
    sources: Sources, runs: int, advance: Advance
) -> tuple[Table, Table, list[Panel]]:
    """Measure transfers onto the DiLiGenT targets; returns peers' table, variants and pictures."""
    targets = sources.targets()
    source = sources.cracks()
    figures: Figures = {name: {method: [] for method in METHODS} for name in _QUANTITIES}
    panels = []
    for name, target in targets.items():
        placed = laid_over(source, target)
        advance(f"cracks onto {name}, {len(METHODS)} methods")
        results = _add(figures, placed, target, runs)
        panels.append(normals_panel(f"cracks onto {name}", results["normals"]))
    table = Table(
        "diligent",
        f"Transfer onto DiLiGenT targets (source cracks; mean of {runs} run{'s' * (runs > 1)})",
        tuple(targets),
        flattened(figures),
        paper.DILIGENT_TARGETS,
        flattened(paper.DILIGENT),
        f"The paper's source is Flower, which is not to be had. {_MESHES}",
    )
    return table, _variants(sources, targets, advance), panels


def _variants(sources: Sources, targets: dict[str, NormalMap], advance: Advance) -> Table:
    """Return the errors of this program's ways of transferring, by the filter of each."""
    # Order, refinement steps, raw target.
    ways = {
        "order 8 (default)": (8, 0, False),
        "order 8, one refinement": (8, 1, False),
        "order 1": (1, 0, False),
        "order 1, raw target (the paper's table)": (1, 0, True),
    }
    rows: dict[str, list[Number]] = {}
    for texture in ("owl", "plant"):
        source = sources.given(texture)
        for way, (order, refine, raw) in ways.items():
            advance(f"{texture} onto the targets, {way}")
            done = [
                transfer(
                    source, target, order=order, refine=refine, keep_target_detail=raw
                ).fidelity
                for target in targets.values()
            ]
            for part in ("shape", "detail"):
                errors = [getattr(one, f"{part}_mae_deg") for one in done]
                rows[f"{texture}, {way}: {part} error, deg"] = [*errors, fmean(errors)]
    return Table(
        "diligent_variants",
        "Transfer onto DiLiGenT targets, ways of this program",
        (*targets, "mean"),
        rows,
        (*paper.DILIGENT_TARGETS, "mean"),
        {
            f"Flower: {part}": [
                *paper.DILIGENT[part]["normals"],
                _mean(paper.DILIGENT[part]["normals"]),
            ]
            for part in ("shape error, deg", "detail error, deg")
        },
        "The paper's detail row is the error of detail laid on the raw target, that is the "
        "target's own detail: compare it with the raw-target rows. Errors by the filter of "
        "each way.",
    )


def _mean(row: Sequence[Number]) -> float:
    return fmean(value for value in row if value is not None)


def _add(
    figures: Figures, source: NormalMap, target: NormalMap, runs: int
) -> dict[Method, NormalMap]:
    """Measure every method on one pair and append to the figures; returns the results."""
    measured = measure(METHODS, source, target, runs=runs)
    meant = ShapeFilter("gaussian", 1, 5).shape(target)
    put = separate(source, order=1).detail
    for method, done in measured.items():
        found = separate(done.normal_map, order=1)
        size = done.peak_bytes
        for name, value in {
            "shape error, deg": angular_error(found.shape, meant).mae_deg,
            "shape SSIM": ssim(found.shape, meant, protocol="paper"),
            "detail error, deg": angular_error(found.detail, put).mae_deg,
            "detail SSIM": ssim(found.detail, put, protocol="paper"),
            "memory, MB": None if size is None else size / 1e6,
            "time, s": fmean(done.cpu_s),
        }.items():
            figures[name][method].append(value)
    return {method: done.normal_map for method, done in measured.items()}
