"""Super-resolution by all systems that the paper compares, on the same parts of maps."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from statistics import fmean

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.peers import ours, pu_net, rdn
from benchmarks.paper.peers.onnx_weights import read_weights
from benchmarks.paper.superres_maps import Judged, middle
from benchmarks.paper.tables import Number, Table
from rig import Progress
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
        ground = processing.integrate(truth)
        if name in _SHOWN:
            panels.append(lit_panel(f"{name}, low resolution", low.normals))
        for label, system in systems.items():
            made = system(low)
            heights = processing.height_profile(ground, processing.integrate(made)).rms
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
    described = json.loads(pu_net.WEIGHTS.with_suffix(".json").read_text(encoding="utf-8"))
    note = (
        f"The middle {SIDE_PX} x {SIDE_PX} pixels of each map. PU-Net has "
        f"{described['weights']:,} weights (the published one: {described['published_weights']:,}) "
        f"and was trained for {described['training']['steps']:,} steps on points of the simulated "
        "surfaces from which the other networks learned"
        + (". " if described["converged"] else "; its loss has NOT CONVERGED. ")
        + "It enlarges the points of the integrated map in two passes, and the result is "
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
                columns,
                paper.SUPERRES if columns else {},
                note if key == "deg" else "As above.",
            )
        )
    return tables, panels
