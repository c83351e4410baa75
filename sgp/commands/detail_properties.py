"""``sgp detail properties``: separability, transferability and idempotence of a map's detail."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.options import Green, Input, Pixels
from sgp.pictures import Panel, detail_panel, map_panel, normals_panel, shaded_panel, write_overview
from sgp.results import (
    ChainStepMetrics,
    LikenessMetrics,
    PropertiesMetrics,
    Result,
    RotationSimilarityMetrics,
    claim_folder,
    figures_of,
    writes_folder,
)
from sgp.stages import SEPARATION, MapInput, SeparationOptions


@writes_folder("properties.json")
def properties(
    normals: Input,
    *targets: Input,
    out: Path,
    options: SeparationOptions = SEPARATION,
    green: Green = "up",
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Measure the properties that the paper claims for the detail of a map.

    For one map: separability, similarity of neighbouring rotations, idempotence. With targets,
    also a chain of transfers (from one map to the next and back to the first) and an exchange of
    details with the first target.

    For example:

        sgp detail properties leather.png bear cat --out properties

    Parameters
    ----------
    normals
        Image of normals, or folder with normals.* and mask.png, such as a result.
    targets
        Maps to which the detail is transferred, in this order.
    out
        Folder for separability.exr (degrees), height.exr and detail_height.exr (px),
        properties.png, exchange.png and properties.json.
    options
        Low-pass filter.
    green
        Direction of the green channel in image files.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    read = [MapInput(path, green, max_pixels=max_pixels).read() for path in (normals, *targets)]
    normal_map, *others = (one.normal_map for one in read)
    parts = processing.separate(normal_map, shape_filter=options.shape_filter())
    result = Result(
        warnings=[line for one in read for line in one.warnings],
        inputs=[file for one in read for file in one.files],
    )
    metrics, panels = _of_one(normal_map, parts, result.summary)
    surfaces = {
        "height": processing.integrate(normal_map, discontinuity=False).height,
        "detail_height": processing.integrate(parts.detail, discontinuity=False).height,
    }
    panels += [
        shaded_panel("Surface, lit from the upper left", surfaces["height"]),
        shaded_panel("Surface of the detail", surfaces["detail_height"]),
    ]
    exchange: list[Panel] = []
    if others:
        paths = (normals, *targets)
        exchange = _of_several(normal_map, others, paths, parts, metrics, result.summary)
    result.metrics = metrics
    claim_folder(out, "properties.json")
    for name, values in {"separability": parts.separability_map_deg, **surfaces}.items():
        acquisition.write_exr(result.file(name, out / f"{name}.exr"), values)
    write_overview(
        result.file("picture", out / "properties.png"), "Detail of one map", panels, columns=3
    )
    if exchange:
        write_overview(
            result.file("exchange_picture", out / "exchange.png"),
            "Details exchanged",
            exchange,
            columns=2,
        )
    return result


def _of_one(
    normal_map: processing.NormalMap, parts: processing.Separation, summary: list[str]
) -> tuple[PropertiesMetrics, list[Panel]]:
    """Measure a single map; add lines to the summary, return figures and pictures."""
    alike = processing.detail.rotation_similarity(parts.shape, parts.shape_filter.w)
    orders = processing.detail.idempotence(parts)
    metrics: PropertiesMetrics = {
        "separability_deg": parts.separability_deg,
        "detail_to_map_ssim": processing.ssim(parts.detail, normal_map),
        "detail_to_map_ssim_paper": processing.ssim(parts.detail, normal_map, protocol="paper"),
        "rotation_similarity": figures_of(RotationSimilarityMetrics, alike),
        "idempotence": {
            str(order): figures_of(LikenessMetrics, found) for order, found in orders.items()
        },
    }
    again = ", ".join(f"{order}: {like.ssim_paper:.4f}" for order, like in orders.items())
    summary += [
        f"separability   {parts.separability_deg:.2f} deg (shape left in the detail; 0 is best)",
        f"rotations      differ by {alike.angle_deg:.2f} deg; norms 1, 2, inf: "
        f"{alike.norm_1:.4f}, {alike.norm_2:.4f}, {alike.norm_inf:.4f}",
        f"idempotence    SSIM in the paper's protocol by order {again}",
    ]
    title = f"Separability, mean {parts.separability_deg:.2f} deg"
    panels = [
        normals_panel("Map", normal_map),
        detail_panel("Detail", parts.detail),
        map_panel(title, parts.separability_map_deg, "deg", error=True),
    ]
    return metrics, panels


def _of_several(
    normal_map: processing.NormalMap,
    others: list[processing.NormalMap],
    paths: tuple[Path, ...],
    parts: processing.Separation,
    metrics: PropertiesMetrics,
    summary: list[str],
) -> list[Panel]:
    """Measure transfers of a map's detail to other maps; add figures and lines, return pictures."""
    source, *targets = (path.name for path in paths)
    by = parts.shape_filter
    chain = processing.detail.transfer_chain(normal_map, others, shape_filter=by)
    summary.append(
        f"chain          {chain[0].pixels} pixels; detail error against the previous, the first map"
    )
    steps: list[ChainStepMetrics] = []
    for step in chain:
        to_previous, to_original = (
            figures_of(LikenessMetrics, found) for found in (step.to_previous, step.to_original)
        )
        steps.append(
            figures_of(
                ChainStepMetrics,
                step,
                target=str(paths[1 + step.target]),
                to_previous=to_previous,
                to_original=to_original,
            )
        )
        summary.append(
            f"  {targets[step.target]:12} {step.to_previous.mae_deg:.2f} deg, "
            f"{step.to_original.mae_deg:.2f} deg (SSIM {step.to_original.ssim_paper:.4f})"
        )
    both = processing.detail.cross_exchange(normal_map, others[0], shape_filter=by)
    errors = [done.fidelity.detail_mae_deg for done in both]
    summary.append(
        f"exchange       {errors[0]:.2f} deg on the target, {errors[1]:.2f} deg on the source"
    )
    metrics["chain"] = steps
    metrics["exchange_detail_mae_deg"] = errors
    metrics["exchange_shape_mae_deg"] = [done.fidelity.shape_mae_deg for done in both]
    panels = []
    names = ((source, targets[0]), (targets[0], source))
    for (detail, shape), done, error in zip(names, both, errors, strict=True):
        panels.append(normals_panel(f"Detail of {detail} on {shape}", done.normal_map))
        title = f"Detail error, mean {error:.2f} deg"
        values = np.asarray(done.fidelity.detail_error_deg, np.float32)
        panels.append(map_panel(title, values, "deg", error=True))
    return panels
