"""Time and memory of every system on the same target, over those of this program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import processing
from benchmarks.paper.comparison import Comparison
from benchmarks.paper.exemplars import materials
from benchmarks.paper.peers import dgts, dspl, efros_leung, lapl, ours, pu_net, rdn, xie2014
from benchmarks.paper.peers.dgts_training import exemplar_of
from benchmarks.paper.peers.onnx_weights import read_weights
from benchmarks.paper.peers.protocol import Peer, costs
from benchmarks.paper.peers.surfaces import MeshTask, Surfaces
from benchmarks.paper.sources import Sources
from benchmarks.paper.surface import for_xie, object_of
from benchmarks.paper.tables import Number, Table
from benchmarks.paper.transfer import placed_over
from rig import Progress

_BOWL_POINTS = 50_000
_SEED = 7
# Side of the sheet of Efros-Leung, whose time grows with the product of both areas.
_EXEMPLAR_PX, _SHEET_PX = 96, 128

_PREFACE = (
    "# Costs of every system\n\n"
    "All systems on one target, in one run: CPU seconds of all threads, and the peak of memory "
    "above the inputs, each in a process of its own with compiled kernels. Ratios are to this "
    "program at the same task."
)


class Work(NamedTuple):
    """A system with what it is fitted to and what it is run on."""

    system: Peer[Any, Any, Any]
    given: Any
    asked: Any


def run_costs(*, quick: bool, advance: Progress) -> Comparison:
    """Measure all systems.

    Parameters
    ----------
    quick
        Has no effect.
    advance
        Called before each step: what it does, and how much of this table is done.
    """
    del quick
    sources, comparison = Sources.found(), Comparison(_PREFACE)
    name, target = sources.target(_BOWL_POINTS)
    tasks = _tasks(sources, target)
    rows: dict[str, list[Number]] = {}
    for done, (task, make) in enumerate(tasks.items()):
        advance(f"costs of {task}", done, len(tasks))
        works = make()
        base = None
        for label, work in works.items():
            taken = costs(*work)
            total = taken.fit_cpu_s + taken.run_cpu_s
            base = base or (total, taken.peak_mb)
            rows[f"{task}: {label}"] = [
                taken.fit_cpu_s,
                taken.run_cpu_s,
                total / base[0],
                taken.peak_mb,
                taken.peak_mb / base[1],
            ]
    height, width = target.size
    note = (
        f"Target: {name}, {int(target.mask.sum())} points in {width} x {height} pixels. Transfer: "
        "the mesh methods receive integrated surfaces. Super-resolution: the target reduced by 4, "
        f"and enlarged again. Efros-Leung: a sheet of {_SHEET_PX} x {_SHEET_PX} pixels from "
        f"{_EXEMPLAR_PX} x {_EXEMPLAR_PX}, and quilting for as many."
    )
    columns = ("fit, CPU s", "run, CPU s", "time, ratio", "memory, MB", "memory, ratio")
    title = f"Costs of all systems on {name}"
    comparison.tables.append(Table("systems", title, columns, rows, note))
    if sources.data is None:
        comparison.without_data("all data are simulated")
    comparison.files = sorted(sources.files)
    return comparison


def _tasks(
    sources: Sources, target: processing.NormalMap
) -> dict[str, Callable[[], dict[str, Work]]]:
    """Return for each task the systems, that of this program first."""

    def transfer() -> dict[str, Work]:
        given = sources.textures()["cloth (simulated)"]
        placed = placed_over(given, target)
        surfaces = Surfaces.of(placed, target)
        task = MeshTask(surfaces.target, surfaces.mesh)
        return {
            "this program": Work(ours.TRANSFER, target, placed),
            "DSPL": Work(dspl.PEER, task, surfaces.source),
            "LAPL": Work(lapl.PEER, task, surfaces.source),
        }

    def surface() -> dict[str, Work]:
        if sources.data is None:
            model = None
            flat = target.normals.astype(float), target.mask
        else:
            _, model, _ = object_of(sources.data / "normals" / "diligent" / "cat")
            flat = for_xie(target, model)
        return {
            "this program": Work(ours.SURFACE, model, target),
            "Xie 2014": Work(xie2014.PEER, "sight", flat),
        }

    def superres() -> dict[str, Work]:
        on_details, on_normals = rdn.models()
        height, width = (length // 4 * 4 for length in target.size)
        cut = processing.NormalMap(
            target.normals[:height, :width].copy(), target.mask[:height, :width].copy()
        )
        low = rdn.Low(processing.superres.low_resolution(cut, 4), cut.mask)
        return {
            "this program": Work(ours.SUPERRES, on_details, low),
            "RDN on details": Work(rdn.PEER, on_details, low),
            "RDN on normals": Work(rdn.PEER, on_normals, low),
            "PU-Net": Work(pu_net.PEER, read_weights(pu_net.WEIGHTS), low),
        }

    def sheet() -> dict[str, Work]:
        detail = processing.separate(materials(_SEED)["textile"]).detail
        part = slice(_EXEMPLAR_PX)
        exemplar = processing.NormalMap(detail.normals[part, part], detail.mask[part, part])
        size = _SHEET_PX, _SHEET_PX
        return {
            "this program": Work(ours.SHEET, exemplar, size),
            "Efros-Leung": Work(efros_leung.PEER, exemplar, size),
        }

    def synthesis() -> dict[str, Work]:
        name = dgts.EXEMPLARS[0]
        shape = processing.ShapeFilter().shape(target)
        return {
            "this program": Work(ours.SYNTHESIS, exemplar_of(name), shape),
            "DGTS": Work(dgts.PEER, read_weights(dgts.weights_of(name)), shape),
        }

    return {
        "transfer": transfer,
        "surface": surface,
        "super-resolution": superres,
        "synthesis": synthesis,
        "sheet": sheet,
    }
