"""Synthesis by all systems that the paper compares, from the same exemplars."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.peers import dgts, efros_leung, ours
from benchmarks.paper.peers.dgts_training import exemplar_of, reconstructed
from benchmarks.paper.peers.layers import Weights
from benchmarks.paper.peers.onnx_weights import read_weights
from benchmarks.paper.peers.protocol import Peer, costs
from benchmarks.paper.sources import Sources
from benchmarks.paper.tables import Number, Table
from benchmarks.paper.trained import description, loss_panel, training_note
from rig import Progress
from sgp.pictures import Panel, lit_panel

_BOWL_POINTS = 20_000
_SHEET_PX = 128
_SHUFFLED_PX = 13  # side of the patches that are shuffled: a fifth of the exemplar
_SEED = 7
_TARGETS = ("cat", "bear", "buddha")
_COLUMNS = (
    "over the exemplar's mean angle",
    "slope distance",
    "spectrum distance",
    "SSIM with what was meant",
    "shape error, deg",
    "CPU time, s",
    "memory, MB",
)
_NONE: list[Number] = [None, None]


def trained() -> list[str]:
    """Return the exemplars on which DGTS was trained."""
    return [name for name in dgts.EXEMPLARS if dgts.weights_of(name).exists()]


def compare_systems(sources: Sources, advance: Progress) -> tuple[Table, list[Panel]]:
    """Return figures of sheets and of textured targets, and pictures."""
    rows: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    notes: list[str] = []
    for name in trained():
        exemplar, weights = exemplar_of(name), read_weights(dgts.weights_of(name))
        panels.append(lit_panel(f"{name}, exemplar", exemplar))
        advance(f"all systems on sheets of {name}", 0, 1)
        for label, made, figures in _sheets(exemplar, weights):
            rows[f"{name}, {label}"] = [*_figures(made, exemplar), *figures]
            panels.append(lit_panel(f"{name}: {label}", made))
        for where, shape in _shapes(sources).items():
            advance(f"all systems on {where}, {name}", 0, 1)
            for label, result, figures in _onto(shape, exemplar, weights):
                detail = processing.separate(result).detail
                rows[f"{name} on {where}, {label}"] = [*_figures(detail, exemplar), *figures]
                panels.append(lit_panel(f"{name} on {where}: {label}", result))
        notes.append(_training(name))
        panels.append(loss_panel("DGTS: error of the reconstruction", dgts.weights_of(name)))
    note = (
        f"Exemplars: {dgts.EXEMPLAR_PX} x {dgts.EXEMPLAR_PX} pixels. Sheets: {_SHEET_PX} x "
        f"{_SHEET_PX} pixels. SSIM with what was meant, in the usual protocol: of the exemplar's "
        "reconstruction by DGTS and of its shuffled patches with the exemplar; on targets, of the "
        "detail separated again with the detail of the sheet that was put there (quilting), or "
        "that the same noise gives on a plane (DGTS). Distances as for sheets above. Costs are "
        "those of running, without training. " + " ".join(notes)
    )
    table = Table(
        "synthesis_systems",
        "Synthesis by all systems",
        _COLUMNS,
        rows,
        note,
        ("SSIM of the detail", "time, s", "memory, MB"),
        paper.SYNTHESIS_SYSTEMS,
    )
    return table, panels


def _sheets(
    exemplar: processing.NormalMap, weights: Weights
) -> list[tuple[str, processing.NormalMap, list[Number]]]:
    """Return sheets by all systems, with SSIM, shape error and costs."""
    size = _SHEET_PX, _SHEET_PX
    flat = _flat(size)
    found: list[tuple[str, processing.NormalMap, list[Number]]] = []
    systems: tuple[tuple[str, Peer[Any, Any, processing.NormalMap], Any, Any], ...] = (
        ("this program (quilting)", ours.SHEET, exemplar, size),
        ("Efros-Leung", efros_leung.PEER, exemplar, size),
        ("DGTS", dgts.PEER, weights, flat),
    )
    for label, system, given, asked in systems:
        taken = costs(system, given, asked)
        made = system.fit(given)(asked)
        detail = processing.separate(made).detail if label == "DGTS" else made
        cost: list[Number] = [taken.fit_cpu_s + taken.run_cpu_s, taken.peak_mb]
        found.append((label, detail, [None, None, *cost]))
    again = processing.separate(reconstructed(weights)).detail
    found.append(("DGTS, reconstruction", again, [_ssim(again, exemplar), None, *_NONE]))
    mixed = shuffled(exemplar)
    found.append(("shuffled patches", mixed, [_ssim(mixed, exemplar), None, *_NONE]))
    return found


def _onto(
    shape: processing.NormalMap, exemplar: processing.NormalMap, weights: Weights
) -> list[tuple[str, processing.NormalMap, list[Number]]]:
    """Return textured targets, with SSIM, shape error and costs."""
    made: list[tuple[str, processing.NormalMap, list[Number]]] = []
    detail = ours.SYNTHESIS.fit(exemplar)(shape)
    textured = processing.combine(shape, detail)
    by_dgts = dgts.onto(shape, weights, seed=1)
    sheet = processing.separate(dgts.onto(_flat_like(shape), weights, seed=1)).detail
    Textured = tuple[str, processing.NormalMap, processing.NormalMap, Peer[Any, Any, Any], Any]
    systems: tuple[Textured, ...] = (
        ("this program (quilting)", textured, detail, ours.SYNTHESIS, exemplar),
        ("DGTS", by_dgts, sheet, dgts.PEER, weights),
    )
    for label, result, meant, system, given in systems:
        taken = costs(system, given, shape)
        parts = processing.separate(result)
        error = processing.angular_error(parts.shape, shape).mae_deg
        cost: list[Number] = [taken.fit_cpu_s + taken.run_cpu_s, taken.peak_mb]
        made.append((label, result, [_ssim(parts.detail, meant), error, *cost]))
    return made


def shuffled(exemplar: processing.NormalMap) -> processing.NormalMap:
    """Return the patches of an exemplar in a random order."""
    side = _SHUFFLED_PX
    rows, columns = (length // side for length in exemplar.size)
    cut = exemplar.normals[: rows * side, : columns * side]
    patches = cut.reshape(rows, side, columns, side, 3).swapaxes(1, 2).reshape(-1, side, side, 3)
    order = np.random.default_rng(_SEED).permutation(len(patches))
    mixed = patches[order].reshape(rows, columns, side, side, 3).swapaxes(1, 2)
    return processing.NormalMap.from_vectors(mixed.reshape(rows * side, columns * side, 3))


def _shapes(sources: Sources) -> dict[str, processing.NormalMap]:
    """Return the shapes of the targets by name."""
    if sources.data is None:
        name, target = sources.target(_BOWL_POINTS)
        return {name: processing.ShapeFilter().shape(target)}
    return {
        name: processing.ShapeFilter().shape(sources.given(f"diligent/{name}")) for name in _TARGETS
    }


def _figures(made: processing.NormalMap, exemplar: processing.NormalMap) -> list[Number]:
    found = processing.synthesis.texture_figures(made, exemplar, patch=ours.PATCH_PX)
    values = (
        found.detail_angle_deg / found.exemplar_angle_deg,
        found.slope_distance,
        found.spectrum_distance,
    )
    return [None if math.isnan(value) else value for value in values]


def _ssim(made: processing.NormalMap, reference: processing.NormalMap) -> float:
    return processing.ssim(made, reference)


def _flat(size: tuple[int, int]) -> processing.NormalMap:
    normals = np.zeros((*size, 3), np.float32)
    normals[..., 2] = 1
    return processing.NormalMap(normals, np.ones(size, np.bool_))


def _flat_like(shape: processing.NormalMap) -> processing.NormalMap:
    return processing.NormalMap(
        np.where(shape.mask[..., None], np.array([0, 0, 1], np.float32), 0), shape.mask
    )


def _training(name: str) -> str:
    path = dgts.weights_of(name)
    described = description(path)
    iterations = ", ".join(map(str, described["training"]["iterations"]))
    return (
        f"DGTS on {name}: {described['weights']:,} weights (the original: "
        f"{described['published_weights']:,}), {described['faces'][-1]:,} faces at the last level "
        f"(81,920), {iterations} iterations (2,000 each), {training_note(path)}."
    )
