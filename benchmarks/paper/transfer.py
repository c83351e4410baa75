"""The paper's two transfer tables with peers: by resolution, and on the DiLiGenT targets."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, median

import numpy as np

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.judge import judge
from benchmarks.paper.measure import IN_NORMALS, METHODS, measure
from benchmarks.paper.sources import Sources
from benchmarks.paper.tables import Number, Table, flattened
from rig import Progress
from sgp.pictures import Panel, normals_panel

# Cells by quantity and method.
Rows = dict[str, dict[str, list[Number]]]

_MESHES = (
    "DSPL and LAPL are implementations of this program. They receive surface and correspondence "
    "at no cost and are measured in the same run, so compare with them, not with the paper's "
    "figures. Their plain errors include the way from normals to a surface and back; the rows of "
    "the round trip without transfer show how much this is. For the errors from the same surfaces "
    "and as surfaces, every method and its reference include this way once. Errors are measured "
    "with the paper's filter, SSIM in its protocol. Memory is the peak of resident memory above "
    "the inputs, time is the mean CPU time of all threads. About the paper's measurements it is "
    "only known that they average ten runs."
)
FIRST, AGAIN, MEMORY = "time of a first call, s", "time of a repeated call, s", "peak memory, MB"
_COST = (
    "A first call starts from two maps, or two surfaces. A repeated call reuses the data that "
    "depend on the target only: its shape, or its smooth base with normals. Times are CPU seconds "
    "of all threads; memory is above the inputs, in up to three separate runs. The normal domain "
    "works on the complete frame, the mesh methods on the window around the mask."
)


def by_resolution(
    sources: Sources, points: Sequence[int], runs: int, advance: Progress
) -> tuple[list[Table], list[Panel]]:
    """Measure one transfer at increasing numbers of points.

    Return its table, the spread of its costs, the headline, and pictures.
    """
    figures = _Figures()
    columns = []
    for at, count in enumerate(points):
        name, source, target = sources.resolution_pair(count)
        placed = placed_over(source, target)
        pixels = np.count_nonzero(target.mask)
        columns.append(f"#{pixels}")
        # Most of the time is roughly proportional to the number of points.
        work = f"{name}, {pixels} points, {len(METHODS)} methods"
        advance(work, sum(points[:at]), sum(points))
        results = figures.add(placed, target, runs)
    panels = [
        normals_panel(f"{method}, {pixels} points", result) for method, result in results.items()
    ]
    table = Table(
        "resolution",
        f"Transfer by resolution ({name}; mean of {runs} run{'s' * (runs > 1)})",
        tuple(columns),
        flattened(figures.main),
        f"The paper transfers Circular to Bunny; its Circular is not available. {_MESHES}",
        tuple(f"#{count}" for count in paper.POINTS),
        flattened(paper.RESOLUTION),
    )
    return [table, figures.spread_of(table), _headline(figures, points)], panels


def placed_over(source: processing.NormalMap, target: processing.NormalMap) -> processing.NormalMap:
    """Return a source as `transfer` places it over a target: cropped, or repeated."""
    return processing.transfer(
        source, target, shape_filter=processing.ShapeFilter(order=1), tile="plain"
    ).placement.place(source, target)


def _headline(figures: _Figures, points: Sequence[int]) -> Table:
    """Return the abstract's ratios, computed from the same two cells as in the paper."""
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
        "The paper claims 30 times the points at 6.5 % of the memory and 14.0 % of the time: "
        "53.50 / 827.52 MB and 2.93 / 20.93 s of its table. The peer here needs far less than "
        "the paper's LAPL, so the claim does not apply to it: for equal numbers of points see the "
        "table above. Least and most compare the fastest run of one with the slowest of the other.",
        ("memory ratio", "time ratio"),
        {"normals": (paper.HEADLINE_MEMORY, paper.HEADLINE_TIME)},
    )


def onto_diligent(
    sources: Sources, runs: int, advance: Progress
) -> tuple[list[Table], list[Panel]]:
    """Measure transfers to the DiLiGenT targets.

    Return, for each of two sources, the table with peers and the spread of its costs, then the
    variants of this program; and pictures.
    """
    targets = sources.targets()
    tables, panels = [], []
    for key, texture, source in (
        ("diligent", "cracks", sources.cracks()),
        ("diligent_owl", "owl", sources.given("owl")),
    ):
        figures = _Figures()
        for at, (name, target) in enumerate(targets.items()):
            placed = placed_over(source, target)
            advance(f"{texture} onto {name}, {len(METHODS)} methods", at, len(targets))
            results = figures.add(placed, target, runs)
            if texture == "cracks":
                panels.append(normals_panel(f"cracks onto {name}", results["normals"]))
        table = Table(
            key,
            f"Transfer onto DiLiGenT targets (source {texture}; mean of {runs} "
            f"run{'s' * (runs > 1)})",
            tuple(targets),
            flattened(figures.main),
            f"The paper's source is Flower, which is not available. {_MESHES}",
            paper.DILIGENT_TARGETS,
            flattened(paper.DILIGENT),
        )
        tables += [table, figures.spread_of(table)]
    return [*tables, _variants(sources, targets, advance)], panels


def _variants(
    sources: Sources, targets: dict[str, processing.NormalMap], advance: Progress
) -> Table:
    """Return the errors of this program's variants of transfer, each with its own filter."""
    # Order, refinement steps, raw target.
    ways = {
        "order 8 (default)": (8, 0, False),
        "order 8, one refinement": (8, 1, False),
        "order 1": (1, 0, False),
        "order 1, raw target (the paper's table)": (1, 0, True),
    }
    rows: dict[str, list[Number]] = {}
    for half, texture in enumerate(("owl", "plant")):
        source = sources.given(texture)
        for at, (way, (order, refine, raw)) in enumerate(ways.items(), half * len(ways)):
            advance(f"{texture} onto the targets, {way}", at, 2 * len(ways))
            done = [
                processing.transfer(
                    source,
                    target,
                    shape_filter=processing.ShapeFilter(order=order),
                    refine=refine,
                    keep_target_detail=raw,
                    tile="plain",
                ).fidelity
                for target in targets.values()
            ]
            for part in ("shape", "detail"):
                errors = [getattr(one, f"{part}_mae_deg") for one in done]
                rows[f"{texture}, {way}: {part} error, deg"] = [*errors, fmean(errors)]
    return Table(
        "diligent_variants",
        "Transfer onto DiLiGenT targets, variants of this program",
        (*targets, "mean"),
        rows,
        "The paper's detail row is the error of detail added to the raw target, that is, the "
        "detail of the target: compare it with the raw-target rows. Errors are measured with the "
        "filter of each variant.",
        (*paper.DILIGENT_TARGETS, "mean"),
        {
            f"Flower: {part}": [
                *paper.DILIGENT[part]["normals"],
                _mean(paper.DILIGENT[part]["normals"]),
            ]
            for part in ("shape error, deg", "detail error, deg")
        },
    )


def _mean(row: Sequence[Number]) -> float:
    return fmean(value for value in row if value is not None)


class _Figures:
    """Figures of every method; the cells of a row are in the order of the pairs of maps."""

    def __init__(self) -> None:
        self.main: Rows = {}
        self.spread: Rows = {}

    def add(
        self, source: processing.NormalMap, target: processing.NormalMap, runs: int
    ) -> dict[str, processing.NormalMap]:
        """Measure every method on one pair of maps; return the results."""
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
        """Return the table of the spread for a table made from `main`."""
        return Table(
            f"{table.key}_spread",
            f"Spread of the costs: {table.title[0].lower()}{table.title[1:]}",
            table.columns,
            flattened(self.spread),
            _COST,
            ("all",),
            {"no spread is printed": (None,)},
        )


def _append(rows: Rows, quantity: str, method: str, figure: Number) -> None:
    rows.setdefault(quantity, {}).setdefault(method, []).append(figure)
