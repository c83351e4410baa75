"""Super-resolution of normals and of details, in comparison with bicubic interpolation."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

import acquisition
import processing
from benchmarks.paper import superres_tables as tables
from benchmarks.paper.comparison import Comparison, Picture
from benchmarks.paper.measure import cost
from benchmarks.paper.peers import rdn
from benchmarks.paper.sources import Sources
from benchmarks.paper.superres_judge import DOMAINS, Networks, judge
from benchmarks.paper.superres_maps import judged_maps
from benchmarks.paper.superres_peers import compare_systems, distances
from benchmarks.paper.superres_pictures import add_head, add_parts
from benchmarks.paper.tables import Number, Table
from rig import Progress
from sgp.training import judged, measure
from sgp.training.judgement import Judgement
from sgp.training.presets import REPORTED

_SCALES = (4, 2)
_COST_PX = 1000
_RANDOM_PX, _QUICK_RANDOM = 240, 12

_PREFACE = (
    "# Super-resolution\n\n"
    "Each map is reduced as a sensor with larger pixels records it (the mean of squares, of unit "
    "length), enlarged again, and compared with itself. The networks were trained on random "
    "simulated surfaces, and none of these maps is among them. Cloth, leather and coins are among "
    "the kinds that the random surfaces consist of."
)


def run_superres(*, quick: bool, seed: int, models: Path | None, advance: Progress) -> Comparison:
    """Compute all tables of super-resolution that the available data and networks allow.

    Parameters
    ----------
    quick
        Use the middle of the maps, and only scale 4.
    seed
        Seed of the simulated materials.
    models
        Folder with networks of several seeds of the training, on which the domains are compared.
        Default: one of each domain, those of the peer RDN.
    advance
        Called before each step: what it does, and how much of this table is done.
    """
    sources, comparison = Sources.found(), Comparison(_PREFACE)
    maps = list(judged_maps(sources, seed, quick=quick))
    for scale in _SCALES[:1] if quick else _SCALES:
        own = processing.superres.read_superres_model(None, scale)
        compared = networks(models, scale)
        random = _random(own, REPORTED[:_QUICK_RANDOM] if quick else REPORTED, advance)
        found = []
        for done, (kind, name, truth) in enumerate(maps):
            advance(f"scale {scale}: {name}", done, len(maps))
            found.append((kind, name, judge(truth, own, compared)))
        comparison.tables.append(tables.errors(own, found, random))
        if compared:
            comparison.tables.append(tables.domains(scale, found, compared))
        comparison.tables.append(tables.deviations(scale, found, random))
        comparison.files += [own.path]
        comparison.files += [model.path for each in compared.values() for model in each]
        if scale == _SCALES[0]:
            comparison.tables.append(_cost(own, advance))
            add_head(comparison, sources, own, advance)
            add_parts(comparison, sources, own, advance)
            made, panels = compare_systems(maps, advance)
            comparison.tables += [*made, distances(advance)]
            comparison.pictures["systems"] = Picture("All systems, scale 4", panels, 7)
    if sources.data is None:
        comparison.without_data("reliefs, captured maps and the head are left out")
    if quick:
        comparison.shortened("only the middle of each map, and no scale 2")
    comparison.files = sorted({*comparison.files, *sources.files})
    return comparison


def networks(models: Path | None, scale: int) -> Networks:
    """Return the networks of a scale in a folder by domain; without one, those of the peer RDN.

    Raises
    ------
    DataError
        If a network is damaged.
    MissingPathError
        If a network has no description.
    """
    found: Networks = {}
    if models is None:
        own = rdn.models() if scale == rdn.SCALE else ()
        return {model.domain: [model] for model in own}
    for path in sorted(models.glob("*.onnx")):
        try:
            model = processing.superres.read_superres_model(path, scale)
        except acquisition.DataError as error:
            if "is for scale" in str(error):
                continue
            raise
        found.setdefault(model.domain, []).append(model)
    return {domain: found[domain] for domain in DOMAINS if domain in found}


def _random(
    own: processing.SuperResolutionModel, seeds: range, advance: Progress
) -> tuple[range, Judgement]:
    """Judge the network on random surfaces that neither its weights nor its deviations know."""
    name = f"scale {own.scale}: random surfaces"

    def on_progress(_stage: str, done: int, total: int, /) -> None:
        if done == 0:
            advance(name, 0, total)

    return seeds, judged(measure(own, seeds, _RANDOM_PX, name, on_progress))


def _cost(model: processing.SuperResolutionModel, advance: Progress) -> Table:
    """Measure a result of 1 million pixels."""
    advance("cost of 1 million pixels", 0, 1)
    noise = np.random.default_rng(0).normal(scale=0.2, size=(_COST_PX // 4, _COST_PX // 4, 3))
    rough = processing.NormalMap.from_vectors(noise + np.array([0, 0, 1]))
    rows: dict[str, list[Number]] = {}
    for label, ensemble in (("8 turned copies", True), ("--no-self-ensemble", False)):
        work = partial(processing.super_resolve, rough, 4, model=model, self_ensemble=ensemble)
        rows[label] = cost(work)
    return Table(
        "cost",
        "Cost of 1 million pixels",
        ("CPU time, s", "elapsed time, s", "memory, MB"),
        rows,
        "Memory is the peak above that before. The paper prints no cost of super-resolution.",
    )
