"""Pictures of super-resolution: a head that is projected twice, and parts of maps."""

from __future__ import annotations

import processing
from benchmarks.paper.comparison import Comparison, Picture
from benchmarks.paper.sources import Sources
from benchmarks.paper.superres_maps import head
from benchmarks.paper.tables import Number, Table
from rig import Progress
from sgp.pictures import Crop, Panel, lit_panel, shaded_panel

# Middles of the parts that are shown, in columns and rows, and their side.
_PARTS = {"relief 160": (500, 500), "owl": (280, 125)}
_PART_PX = 160


def add_head(
    comparison: Comparison,
    sources: Sources,
    model: processing.SuperResolutionModel,
    advance: Progress,
) -> None:
    """Project a head at two resolutions, enlarge the lower one, and compare the results."""
    if sources.data is None:
        return
    advance("head of Max Planck", 0, 1)
    points, high = head(sources, sources.data, model.scale)
    low = processing.superres.low_resolution(high, model.scale)
    maps: dict[str, processing.NormalMap] = {}
    surfaces = {
        "low": processing.integrate(low, discontinuity=False),
        "high": processing.integrate(high, discontinuity=False),
    }
    rows: dict[str, list[Number]] = {}
    tried: dict[str, tuple[processing.NormalMap, processing.superres.PixelSampling, bool]] = {
        "means, bicubic": (low, "area", False),
        f"means, {model.domain}": (low, "area", True),
        "points, bicubic": (points, "points", False),
        f"points, {model.domain}": (points, "points", True),
        f"points taken as means, {model.domain}": (points, "area", True),
    }
    for name, (given, sampling, by_network) in tried.items():
        maps[name] = made = processing.super_resolve(
            given,
            model.scale,
            method=model.domain if by_network else "bicubic",
            model=model if by_network else None,
            sampling=sampling,
            mask=high.mask,
        ).normal_map
        surfaces[name] = processing.integrate(made, discontinuity=False)
        profile = processing.height_profile(surfaces["high"], surfaces[name])
        error = processing.angular_error(made, high)
        rows[name] = [error.mae_deg, processing.ssim(made, high, high.mask), profile.rms]
    comparison.tables.append(
        Table(
            "head",
            "Head of Max Planck, projected at low resolution and enlarged",
            ("error, deg", "SSIM", "error of heights, px"),
            rows,
            f"A mesh in {points.size[1]} x {points.size[0]} pixels, enlarged to {high.size[1]} x "
            f"{high.size[0]}, and its projection at that resolution as the reference. Means: each "
            "pixel is the mean of its area, as a camera records it, and as the networks learned. "
            "Points: the normal at the centre of each pixel, as a projection draws it, which is "
            "sharper than a mean. It is averaged over the pixel first; taken as a mean, it is "
            "sharpened once more. The paper shows such experiments on other models.",
        )
    )
    plain, ours = "means, bicubic", f"means, {model.domain}"
    crops = {1: Crop.around(high.mask), model.scale: Crop.around(low.mask)}
    panels: list[Panel] = [
        lit_panel("low resolution", low, crops[model.scale]),
        lit_panel("bicubic interpolation", maps[plain], crops[1]),
        lit_panel("super-resolution", maps[ours], crops[1]),
        lit_panel("high resolution", high, crops[1]),
    ]
    panels += [
        shaded_panel(f"surface, {name}", surfaces[key].height)
        for name, key in (
            ("low resolution", "low"),
            ("bicubic interpolation", plain),
            ("super-resolution", ours),
            ("high resolution", "high"),
        )
    ]
    comparison.pictures["head"] = Picture("Head of Max Planck, scale 4", panels, 4)


def add_parts(
    comparison: Comparison,
    sources: Sources,
    model: processing.SuperResolutionModel,
    advance: Progress,
) -> None:
    """Show parts of a relief and of a captured map, enlarged and given."""
    if sources.data is None:
        return
    advance("pictures", 0, 1)
    panels: list[Panel] = []
    for name, (column, row) in _PARTS.items():
        given = sources.relief(name[7:]) if name.startswith("relief") else sources.given(name)
        window = tuple(
            slice(first - _PART_PX // 2, first + _PART_PX // 2) for first in (row, column)
        )
        truth = processing.NormalMap(given.normals[window].copy(), given.mask[window].copy())
        low = processing.superres.low_resolution(truth, model.scale)
        plain = processing.super_resolve(low, model.scale, method="bicubic", mask=truth.mask)
        made = processing.super_resolve(low, model.scale, model=model, mask=truth.mask)
        panels += [
            lit_panel(f"{name}, low resolution", low),
            lit_panel("bicubic interpolation", plain.normal_map),
            lit_panel("super-resolution", made.normal_map),
            lit_panel("given", truth),
        ]
    comparison.pictures["parts"] = Picture(f"Scale {model.scale}", panels, 4)
