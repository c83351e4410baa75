"""Super-resolution by all systems that the paper compares, on the same parts of maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import fmean

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

import processing
import simulator
from benchmarks.paper import figures as paper
from benchmarks.paper.peers import ours, pu_net, rdn
from benchmarks.paper.peers.onnx_weights import read_weights
from benchmarks.paper.peers.pu_net_training import DRIFT_PX
from benchmarks.paper.superres_maps import Judged, middle
from benchmarks.paper.tables import Number, Table
from benchmarks.paper.trained import description, loss_panel, training_note
from rig import Progress
from rig.arrays import Float64
from sgp.pictures import Panel, lit_panel

SIDE_PX = 256
_SHOWN = ("relief 160", "owl", "lizard scales", "coin")

Method = Callable[[rdn.Low], processing.NormalMap]


def methods() -> dict[str, Method]:
    """Return the systems by name."""
    on_details, on_normals = rdn.models()
    return {
        "bicubic": lambda low: (
            processing.super_resolve(
                low.normals, rdn.SCALE, method="bicubic", mask=low.mask
            ).normal_map
        ),
        "PU-Net": pu_net.PEER.fit(read_weights(pu_net.WEIGHTS)),
        "RDN on normals": rdn.PEER.fit(on_normals),
        "RDN on details": rdn.PEER.fit(on_details),
        "this program": ours.SUPERRES.fit(on_details),
    }


def compare_systems(maps: Sequence[Judged], advance: Progress) -> tuple[list[Table], list[Panel]]:
    """Return errors of normals, SSIM, errors of heights, and pictures of some maps."""
    systems = methods()
    figures: dict[str, dict[str, list[float]]] = {name: {} for name in ("deg", "ssim", "px")}
    panels: list[Panel] = []
    for done, (_, name, whole) in enumerate(maps):
        advance(f"all systems on {name}", done, len(maps))
        truth = middle(whole, SIDE_PX)
        low = rdn.Low(processing.superres.low_resolution(truth, rdn.SCALE), truth.mask)
        ground = processing.integrate(truth, discontinuity=False)
        if name in _SHOWN:
            panels.append(lit_panel(f"{name}, low resolution", low.normals))
        for label, system in systems.items():
            made = system(low)
            heights = processing.height_profile(
                ground, processing.integrate(made, discontinuity=False)
            ).rms
            for key, value in (
                ("deg", processing.angular_error(made, truth).mae_deg),
                ("ssim", processing.ssim(made, truth, protocol="paper")),
                ("px", heights),
            ):
                figures[key].setdefault(name, []).append(value)
            if name in _SHOWN:
                panels.append(lit_panel(label, made))
        if name in _SHOWN:
            panels.append(lit_panel("given", truth))
    described = description(pu_net.WEIGHTS)
    panels.append(loss_panel("PU-Net: offset along the normal", pu_net.WEIGHTS))
    note = (
        f"The middle {SIDE_PX} x {SIDE_PX} pixels of each map. PU-Net has "
        f"{described['weights']:,} weights (the published one: {described['published_weights']:,}) "
        f"and took {described['training']['steps']:,} steps on points of the simulated surfaces "
        f"from which the other networks learned ({training_note(pu_net.WEIGHTS)}). "
        "It enlarges the points of the integrated map in two passes, and the result is "
        "projected. RDN: one copy, both trained alike; this program: RDN on details, 8 turned "
        "copies. "
    )
    titles = {
        "deg": "mean error of normals, in degrees",
        "ssim": "SSIM in the paper's protocol",
        "px": "root mean square error of heights, in pixels",
    }
    tables = []
    for key, title in titles.items():
        rows: dict[str, list[Number]] = {name: [*row] for name, row in figures[key].items()}
        for kind in dict.fromkeys(each.kind for each in maps):
            of_kind = [figures[key][each.name] for each in maps if each.kind == kind]
            rows[f"**{kind}**, mean"] = [fmean(column) for column in zip(*of_kind, strict=True)]
        columns = paper.SUPERRES_COLUMNS if key == "deg" else ()
        tables.append(
            Table(
                f"systems_{key}",
                f"All systems at scale 4: {title}",
                tuple(systems),
                rows,
                note if key == "deg" else "As above.",
                columns,
                paper.SUPERRES if columns else {},
            )
        )
    return tables, panels


# Held-out surfaces, for the distances of points.
_SEEDS, _HELD_OUT_PX = range(1000, 1012), 160
_RIM_PX = 8


def distances(advance: Progress) -> Table:
    """Return how far points are from the true surface before and after PU-Net."""
    weights = read_weights(pu_net.WEIGHTS)
    found: dict[str, list[list[float]]] = {}
    for done, seed in enumerate(_SEEDS):
        advance("distances of points", done, len(_SEEDS))
        truth = processing.NormalMap.from_vectors(simulator.random_normals(seed, _HELD_OUT_PX))
        low = processing.integrate(
            processing.superres.low_resolution(truth, pu_net.SCALE), discontinuity=False
        )
        ground = np.asarray(processing.integrate(truth, discontinuity=False).height, np.float64)
        points = pu_net.SCALE * low.points()[low.mask].astype(np.float64)
        clouds = {"given points": points}
        for name in ("one pass", "two passes"):
            points = pu_net.enlarged(points, weights)
            clouds[f"after {name}"] = points
            clouds[f"given surface at the points after {name}"] = _between(low, points)
        for name, points in clouds.items():
            found.setdefault(name, []).append(_apart(points, ground, truth))
    first = np.mean(found["given points"], axis=0)
    rows: dict[str, list[Number]] = {}
    for name, each in found.items():
        mean = np.mean(each, axis=0)
        rows[name] = [
            mean[0],
            100 * (mean[0] / first[0] - 1),
            mean[1],
            100 * (mean[1] / first[1] - 1),
        ]
    return Table(
        "distances",
        "PU-Net: distance of its points to the true surface",
        ("px", "change, %", "without slow drift, px", "change, %"),
        rows,
        f"Mean over random surfaces {_SEEDS[0]} to {_SEEDS[-1]}, which no network was trained on, "
        "along the normals. The given points are those of the integrated map at a quarter of the "
        "resolution, the given surface is linear between them. Without slow drift: less the mean "
        "of the neighbourhood, which a patch does not determine.",
    )


def _between(low: processing.HeightMap, points: Float64) -> Float64:
    """Return points of a given surface at the places of others."""
    scale, heights = pu_net.SCALE, np.asarray(low.height, np.float64)
    middle = [(length - 1) / 2 for length in heights.shape]
    at = [middle[0] - points[:, 1] / scale, points[:, 0] / scale + middle[1]]
    z = scale * map_coordinates(heights, at, order=1, mode="nearest")
    return np.column_stack([points[:, :2], z])


def _apart(points: Float64, ground: Float64, truth: processing.NormalMap) -> list[float]:
    """Return the mean distance of points, as they are and without slow drift."""
    side = ground.shape[0]
    at = [(side - 1) / 2 - points[:, 1], points[:, 0] + (side - 1) / 2]
    inside = np.all([(axis > _RIM_PX) & (axis < side - 1 - _RIM_PX) for axis in at], axis=0)
    at = [axis[inside] for axis in at]
    height, facing = (map_coordinates(values, at) for values in (ground, truth.normals[..., 2]))
    error = points[inside, 2] - height
    error -= np.median(error)
    total, count = np.zeros((2, side, side))
    cell = tuple(np.round(axis).astype(int) for axis in at)
    np.add.at(total, cell, error)
    np.add.at(count, cell, 1)
    total, count = (gaussian_filter(values, DRIFT_PX) for values in (total, count))
    drift = map_coordinates(total / np.maximum(count, 1e-9), at, order=1)
    return [float(np.abs(each * facing).mean()) for each in (error, error - drift)]
