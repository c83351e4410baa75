"""Super-resolution of normals and of details, in comparison with bicubic interpolation."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

import numpy as np

import processing
import rig
from rig import Progress
from sgp._overview import Panel
from sgp._panels.crop import Crop
from sgp._panels.maps import lit_panel, shaded_panel
from sgp._paper import superres_tables as tables
from sgp._paper.comparison import Comparison, Picture
from sgp._paper.measure import peaks
from sgp._paper.sources import Sources
from sgp._paper.superres_judge import DOMAINS, Networks, judge
from sgp._paper.superres_maps import head, judged_maps
from sgp._paper.tables import Number, Table

_SCALES = (4, 2)
_COST_PX = 1000

_PREFACE = (
    "# Super-resolution\n\n"
    "Each map is reduced as a sensor with larger pixels records it (the mean of squares, of unit "
    "length), enlarged again, and compared with itself. The networks were trained on random "
    "simulated surfaces, and none of these maps is among them."
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
        Folder with further networks, for example of other seeds of the training.
    advance
        Called before each step: what it does, and how much of this table is done.
    """
    sources, comparison = Sources.found(), Comparison(_PREFACE)
    maps = list(judged_maps(sources, seed, quick=quick))
    for scale in _SCALES[:1] if quick else _SCALES:
        networks = available(scale, models)
        found = []
        for done, (kind, name, truth) in enumerate(maps):
            advance(f"scale {scale}: {name}", done, len(maps))
            found.append((kind, name, judge(truth, scale, networks)))
        comparison.tables += [
            tables.errors(scale, found, networks),
            tables.heights(scale, found, networks),
            tables.deviations(scale, found),
        ]
        used = [model for each in networks.values() for model in each]
        comparison.files += [model.path for model in used]
        if scale == _SCALES[0]:
            comparison.tables.append(_cost(used[0], advance))
            _add_head(comparison, sources, used[0], advance)
    if sources.data is None:
        text = "SGP_DATA is not set: reliefs, captured maps and the head are left out"
        comparison.left_out.append(rig.Notice("bench-without-data", text))
    if quick:
        text = "--quick: only the middle of each map, and no scale 2"
        comparison.left_out.append(rig.Notice("bench-quick", text, severity="info"))
    comparison.files = sorted({*comparison.files, *sources.files})
    return comparison


def available(scale: int, models: Path | None) -> Networks:
    """Return the networks of a scale by domain, that of the program first.

    Raises
    ------
    DataError
        If a network is damaged, or has no description.
    """
    found = [processing.read_superres_model(None, scale)]
    for path in sorted(models.glob("*.onnx")) if models is not None else ():
        try:
            model = processing.read_superres_model(path, scale)
        except processing.DataError as error:
            if "is for scale" in str(error):
                continue
            raise
        if all(model.sha256 != other.sha256 for other in found):
            found.append(model)
    by_domain: Networks = {
        domain: [model for model in found if model.domain == domain] for domain in DOMAINS
    }
    return {domain: each for domain, each in by_domain.items() if each}


def _cost(model: processing.SuperResolutionModel, advance: Progress) -> Table:
    """Measure a result of 1 million pixels."""
    advance("cost of 1 million pixels", 0, 1)
    noise = np.random.default_rng(0).normal(scale=0.2, size=(_COST_PX // 4, _COST_PX // 4, 3))
    rough = processing.NormalMap.from_vectors(noise + np.array([0, 0, 1]))
    rows: dict[str, list[Number]] = {}
    for label, ensemble in (("one copy", False), ("--self-ensemble", True)):
        work = partial(processing.super_resolve, rough, 4, model=model, self_ensemble=ensemble)
        cpu, wall = time.process_time(), time.perf_counter()
        work()
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        measured = peaks(work, 1)
        rows[label] = [cpu, wall, measured[0] / 1e6 if measured else None]
    return Table(
        "cost",
        "Cost of 1 million pixels",
        ("CPU time, s", "elapsed time, s", "memory, MB"),
        rows,
        (),
        {},
        "Memory is the peak above that before. The paper prints no cost of super-resolution.",
    )


def _add_head(
    comparison: Comparison,
    sources: Sources,
    model: processing.SuperResolutionModel,
    advance: Progress,
) -> None:
    """Project a head at two resolutions, enlarge the lower one, and compare the results."""
    advance("head of Max Planck", 0, 1)
    pair = head(sources, model.scale)
    if pair is None:
        return
    points, high = pair
    low = processing.low_resolution(high, model.scale)
    maps: dict[str, processing.NormalMap] = {}
    surfaces = {"low": processing.integrate(low), "high": processing.integrate(high)}
    rows: dict[str, list[Number]] = {}
    for kind, given in {"means": low, "points": points}.items():
        for method in ("bicubic", model.domain):
            used = None if method == "bicubic" else model
            name = f"{kind}, {method}"
            maps[name] = one = processing.super_resolve(
                given, model.scale, method=method, model=used, mask=high.mask
            ).normal_map
            surfaces[name] = processing.integrate(one)
            profile = processing.height_profile(surfaces["high"], surfaces[name])
            error = processing.angular_error(one, high)
            rows[name] = [error.mae_deg, processing.ssim(one, high, high.mask), profile.rms]
    comparison.tables.append(
        Table(
            "head",
            "Head of Max Planck, projected at low resolution and enlarged",
            ("error, deg", "SSIM", "error of heights, px"),
            rows,
            (),
            {},
            f"A mesh in {points.size[1]} x {points.size[0]} pixels, enlarged to {high.size[1]} x "
            f"{high.size[0]}, and its projection at that resolution as the reference. Means: each "
            "pixel is the mean of its area, as a camera records it, and as the networks learned. "
            "Points: the normal at the centre of each pixel, as a projection draws it, which is "
            "sharper than a mean; a network sharpens it once more. The paper shows such "
            "experiments on other models.",
        )
    )
    plain, made = "means, bicubic", f"means, {model.domain}"
    crops = {1: Crop.around(high.mask), model.scale: Crop.around(low.mask)}
    panels: list[Panel] = [
        lit_panel("low resolution", low, crops[model.scale]),
        lit_panel("bicubic interpolation", maps[plain], crops[1]),
        lit_panel("super-resolution", maps[made], crops[1]),
        lit_panel("high resolution", high, crops[1]),
    ]
    panels += [
        shaded_panel(f"surface, {name}", surfaces[key].height)
        for name, key in (
            ("low resolution", "low"),
            ("bicubic interpolation", plain),
            ("super-resolution", made),
            ("high resolution", "high"),
        )
    ]
    comparison.pictures["head"] = Picture("Head of Max Planck, scale 4", panels, 4)
