"""The paper's tables and figures about the properties of detail.

These are separability, idempotence and transferability.
"""

from __future__ import annotations

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.sources import DILIGENT, Sources
from benchmarks.paper.tables import Number, Table
from rig import Progress
from sgp.pictures import Panel, detail_panel, map_panel, normals_panel

_SOURCES = (
    "None of the paper's five models is available: other surfaces are used, so the paper's "
    "figures are context, not a standard. "
)
_ORDERS = "Order 1 is the paper's filter, order 8 the default of this program; w=5."


def of_textures(
    textures: dict[str, processing.NormalMap], advance: Progress
) -> tuple[Table, Table, Table, list[Panel]]:
    """Return shape similarity, separability and idempotence, and pictures of the errors."""
    alike: dict[str, list[Number]] = {}
    apart: dict[str, list[Number]] = {}
    again: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    for half, order in enumerate((1, 8)):
        for at, (name, normal_map) in enumerate(textures.items(), half * len(textures)):
            advance(f"properties of {name}, order {order}", at, 2 * len(textures))
            by = processing.ShapeFilter(order=order)
            parts = processing.separate(normal_map, shape_filter=by)
            turn = processing.detail.rotation_similarity(parts.shape)
            for label, value in zip(
                paper.SHAPE_SIMILARITY,
                (turn.angle_deg, turn.norm_1, turn.norm_2, turn.norm_inf),
                strict=True,
            ):
                alike.setdefault(f"{label}, order {order}", []).append(value)
            for label, value in zip(
                (*paper.SEPARABILITY, "SSIM of detail and map, mask only"),
                (
                    parts.separability_deg,
                    processing.ssim(parts.detail, normal_map, protocol="paper"),
                    processing.ssim(parts.detail, normal_map),
                ),
                strict=True,
            ):
                apart.setdefault(f"{label}, order {order}", []).append(value)
            for higher, comparison in processing.detail.idempotence(parts).items():
                again.setdefault(f"order {higher}, filter of order {order}", []).append(
                    comparison.ssim_paper
                )
            if order == 8:
                panels.append(detail_panel(f"{name}: detail", parts.detail))
                panels.append(
                    map_panel(
                        f"shape left, mean {parts.separability_deg:.2f} deg",
                        parts.separability_map_deg,
                        "deg",
                        error=True,
                    )
                )
    tables = (
        Table(
            "shape_similarity",
            "Shape component: rotations within a window",
            tuple(textures),
            alike,
            _SOURCES
            + _ORDERS
            + " The figures increase with the curvature per pixel; the paper does not state "
            "the resolution of its maps here.",
            paper.MODELS,
            paper.SHAPE_SIMILARITY,
        ),
        Table(
            "separability",
            "Separability: shape left in the detail",
            tuple(textures),
            apart,
            _SOURCES + _ORDERS + " The SSIM measures how flat the surface was, not how well it "
            "was separated: detail and map are equal only for a surface without shape.",
            paper.MODELS,
            paper.SEPARABILITY,
        ),
        Table(
            "idempotence",
            "Idempotence: SSIM of a higher order with the first (paper's protocol)",
            tuple(textures),
            again,
            _SOURCES + _ORDERS,
            paper.MODELS,
            paper.IDEMPOTENCE,
        ),
    )
    return *tables, panels


def chain(sources: Sources, advance: Progress) -> Table:
    """Transfer the owl's detail along the DiLiGenT targets and back to the first."""
    targets = sources.targets()
    rows: dict[str, list[Number]] = {}
    for done, order in enumerate((1, 8)):
        advance(f"owl over a chain of targets, order {order}", done, 2)
        steps = processing.detail.transfer_chain(
            sources.given("owl"),
            list(targets.values()),
            shape_filter=processing.ShapeFilter(order=order),
        )
        rows |= {
            f"shape error, deg, order {order}": [step.shape_mae_deg for step in steps],
            f"detail to previous, deg, order {order}": [step.to_previous.mae_deg for step in steps],
            f"detail to original, deg, order {order}": [step.to_original.mae_deg for step in steps],
            f"detail to original, SSIM, order {order}": [
                step.to_original.ssim_paper for step in steps
            ],
        }
    return Table(
        "chain",
        "Chain: detail transferred from target to target and back to the first",
        (*targets, f"{DILIGENT[0]} again"),
        rows,
        f"{len(targets)} of the ten DiLiGenT targets are available, and the owl instead of "
        "Circular. All maps are cropped to one rectangle inside all masks, so that every pixel "
        "takes part in all steps. The paper prints bounds only, and does not state whether errors "
        f"are against the previous or the original detail: both are listed here. {_ORDERS}",
        ("worst of 11 steps",),
        {
            "shape error, deg, at most": (paper.CHAIN_SHAPE_DEG_MAX,),
            "detail error, deg, below": (paper.CHAIN_DETAIL_DEG_MAX,),
            "detail SSIM, above": (paper.CHAIN_DETAIL_SSIM_MIN,),
        },
    )


def exchange(
    textures: dict[str, processing.NormalMap], advance: Progress
) -> tuple[Table, list[Panel]]:
    """Exchange the details of two surfaces."""
    (name_a, a), (name_b, b) = list(textures.items())[:2]
    rows: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    for at, order in enumerate((1, 8)):
        advance(f"details of {name_a} and {name_b} exchanged, order {order}", at, 2)
        done = processing.detail.cross_exchange(
            a, b, shape_filter=processing.ShapeFilter(order=order)
        )
        rows[f"detail error, deg, order {order}"] = [one.fidelity.detail_mae_deg for one in done]
        rows[f"shape error, deg, order {order}"] = [one.fidelity.shape_mae_deg for one in done]
        if order == 8:
            for detail, shape, one in zip((name_a, name_b), (name_b, name_a), done, strict=True):
                panels.append(normals_panel(f"detail of {detail} on {shape}", one.normal_map))
                panels.append(
                    map_panel("detail error", one.fidelity.detail_error_deg, "deg", error=True)
                )
    return Table(
        "cross_exchange",
        "Cross-exchange of two details",
        (f"{name_a} on {name_b}", f"{name_b} on {name_a}"),
        rows,
        f"The surfaces are not the paper's Circular and Walnut. {_ORDERS}",
        ("Circular, Walnut: upper map", "lower map"),
        {"detail error, deg": paper.CROSS_EXCHANGE_DEG},
    ), panels
