"""The paper's two transfer tables, peers beside: by resolution, and onto the DiLiGenT targets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean, median

import numpy as np

from processing import NormalMap, transfer
from sgp._overview import Panel, normals_panel
from sgp._paper import figures as paper
from sgp._paper.judge import judge
from sgp._paper.measure import IN_NORMALS, METHODS, measure
from sgp._paper.sources import Sources
from sgp._paper.tables import Number, Table, flattened

Advance = Callable[[str], None]
# Cells by quantity and method.
Rows = dict[str, dict[str, list[Number]]]

_MESHES = (
    "DSPL and LAPL are this program's own: they get surface and correspondence for nothing and are "
    "measured in the same run, so compare with them, not with the paper's. Plain errors charge "
    "them with the way from normals to a surface and back: the rows of the round trip without "
    "transfer say how much. Errors from the same surfaces and as surfaces send every method that "
    "way once, and what it is compared with too. Errors by the paper's filter, SSIM in its "
    "protocol. Memory is the peak of resident memory above the inputs, time the mean CPU seconds "
    "of all threads; of the paper's way of measuring only that it averages ten runs is known."
)
FIRST, AGAIN, MEMORY = "time of a first call, s", "time of a repeated call, s", "peak memory, MB"
_COST = (
    "A first call starts from two maps, or two surfaces. A repeated one has kept what depends on "
    "the target alone: its shape, or its smooth base with normals. CPU seconds of all threads; "
    "memory above the inputs, of up to three runs of their own. The normal domain works on the "
    "whole frame, the mesh methods on the window around the mask."
)


def by_resolution(
    sources: Sources, points: Sequence[int], runs: int, advance: Advance
) -> tuple[list[Table], list[Panel]]:
    """Measure one transfer at growing numbers of points.

    Returns its table, the spread of its costs, the headline, and pictures.
    """
    figures = _Figures()
    columns = []
    for count in points:
        name, source, target = sources.resolution_pair(count)
        placed = laid_over(source, target)
        pixels = np.count_nonzero(target.mask)
        columns.append(f"#{pixels}")
        advance(f"{name}, {pixels} points, {len(METHODS)} methods")
        results = figures.add(placed, target, runs)
    panels = [
        normals_panel(f"{method}, {pixels} points", result) for method, result in results.items()
    ]
    table = Table(
        "resolution",
        f"Transfer by resolution ({name}; mean of {runs} run{'s' * (runs > 1)})",
        tuple(columns),
        flattened(figures.main),
        tuple(f"#{count}" for count in paper.POINTS),
        flattened(paper.RESOLUTION),
        f"The paper puts Circular onto Bunny; its Circular is not to be had. {_MESHES}",
    )
    return [table, figures.spread_of(table), _headline(figures, points)], panels


def laid_over(source: NormalMap, target: NormalMap) -> NormalMap:
    """Return a source as `transfer` lays it over a target: cropped, or repeated."""
    return transfer(source, target, order=1).placement.place(source, target)


def _headline(figures: _Figures, points: Sequence[int]) -> Table:
    """Build the abstract's ratios from the same two cells as the paper does."""
    many, few = paper.HEADLINE_POINTS

    def ratio(ours: str, peers: str, method: str) -> Number:
        if many not in points or few not in points:
            return None
        over = figures.number(ours, method, points.index(many))
        under = figures.number(peers, "LAPL", points.index(few))
        return over / under if over is not None and under else None

    rows = {
        method: [
            ratio("memory, MB", "memory, MB", method),
            ratio("time, s", "time, s", method),
            ratio(f"{FIRST}, least", f"{FIRST}, most", method),
            ratio(f"{FIRST}, most", f"{FIRST}, least", method),
        ]
        for method in ("normals", "normals, order 8")
    }
    return Table(
        "headline",
        f"Headline: normals at {many} points over LAPL at {few}",
        ("memory ratio", "time ratio", "time ratio, least", "time ratio, most"),
        rows,
        ("memory ratio", "time ratio"),
        {"normals": (paper.HEADLINE_MEMORY, paper.HEADLINE_TIME)},
        "The paper claims 30 times the points at 6.5 % of the memory and 14.0 % of the time: "
        "53.50 / 827.52 MB and 2.93 / 20.93 s of its table. The peer here needs far less than "
        "the paper's LAPL, so the claim does not carry over: at equal points see the table above. "
        "Least and most hold the fastest run of one against the slowest of the other.",
    )


def onto_diligent(sources: Sources, runs: int, advance: Advance) -> tuple[list[Table], list[Panel]]:
    """Measure transfers onto the DiLiGenT targets.

    Returns for each of two sources the peers' table and the spread of its costs, then this
    program's variants; and pictures.
    """
    targets = sources.targets()
    tables, panels = [], []
    for key, texture, source in (
        ("diligent", "cracks", sources.cracks()),
        ("diligent_owl", "owl", sources.given("owl")),
    ):
        figures = _Figures()
        for name, target in targets.items():
            placed = laid_over(source, target)
            advance(f"{texture} onto {name}, {len(METHODS)} methods")
            results = figures.add(placed, target, runs)
            if texture == "cracks":
                panels.append(normals_panel(f"cracks onto {name}", results["normals"]))
        table = Table(
            key,
            f"Transfer onto DiLiGenT targets (source {texture}; mean of {runs} "
            f"run{'s' * (runs > 1)})",
            tuple(targets),
            flattened(figures.main),
            paper.DILIGENT_TARGETS,
            flattened(paper.DILIGENT),
            f"The paper's source is Flower, which is not to be had. {_MESHES}",
        )
        tables += [table, figures.spread_of(table)]
    return [*tables, _variants(sources, targets, advance)], panels


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


class _Figures:
    """What is measured of every method, pair by pair: a row's cells in the order of the pairs."""

    def __init__(self) -> None:
        self.main: Rows = {}
        self.spread: Rows = {}

    def add(self, source: NormalMap, target: NormalMap, runs: int) -> dict[str, NormalMap]:
        """Measure every method on one pair; returns the results."""
        measured = measure(METHODS, source, target, runs=runs)
        results = {method: done.normal_map for method, done in measured.items()}
        for quantity, judged in judge(results, source, target, IN_NORMALS).items():
            for method, figure in judged.items():
                _append(self.main, quantity, method, figure)
        for method, done in measured.items():
            megabytes = [size / 1e6 for size in done.peak_bytes]
            _append(self.main, "memory, MB", method, median(megabytes) if megabytes else None)
            _append(self.main, "time, s", method, fmean(done.cpu_s))
            for quantity, values in (
                (FIRST, done.cpu_s),
                (AGAIN, done.again_cpu_s),
                (MEMORY, megabytes),
            ):
                for name, of in (("median", median), ("least", min), ("most", max)):
                    _append(
                        self.spread, f"{quantity}, {name}", method, of(values) if values else None
                    )
        return results

    def number(self, quantity: str, method: str, place: int) -> Number:
        rows = self.main if quantity in self.main else self.spread
        return rows[quantity][method][place]

    def spread_of(self, table: Table) -> Table:
        """Return the table of the spread beside a table made of `main`."""
        return Table(
            f"{table.key}_spread",
            f"Spread of the costs: {table.title[0].lower()}{table.title[1:]}",
            table.columns,
            flattened(self.spread),
            ("all",),
            {"no spread is printed": (None,)},
            _COST,
        )


def _append(rows: Rows, quantity: str, method: str, figure: Number) -> None:
    rows.setdefault(quantity, {}).setdefault(method, []).append(figure)
