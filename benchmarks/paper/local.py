"""The paper's local transfers: a face transferred to another surface, compared with peers."""

from __future__ import annotations

import numpy as np

import processing
from benchmarks.paper import figures as paper
from benchmarks.paper.faces import FACE_W, FACES
from benchmarks.paper.judge import judge
from benchmarks.paper.measure import measure
from benchmarks.paper.sources import Sources
from benchmarks.paper.tables import Number, Table
from rig import Progress
from rig.arrays import Bool
from sgp.pictures import Panel, normals_panel


def local_transfers(sources: Sources, advance: Progress) -> tuple[Table, list[Panel]]:
    """Transfer faces to other surfaces; return errors over the target regions, and pictures."""
    targets = sources.targets()
    rows: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    for at, face in enumerate(FACES.values()):
        advance(f"face of {face.source} onto {face.target}", at, len(FACES))
        target = targets[face.target]
        done = face.set_in(targets[face.source], target, order=1)
        region = done.region
        results: dict[str, processing.NormalMap] = {"normals": done.normal_map}
        # The meshes also need a surface at pixels that the source does not cover.
        around = np.where(done.placed.mask[..., None], done.placed.normals, target.normals)
        placed = processing.NormalMap(around, done.placed.mask | target.mask)
        peers = measure(("DSPL", "LAPL"), placed, target, region=region, w=FACE_W)
        results |= {method: one.normal_map for method, one in peers.items()}

        def in_normals(
            one: processing.NormalMap,
            other: processing.NormalMap,
            region: Bool = region,
        ) -> processing.NormalMap:
            return processing.transfer_local(
                one,
                other,
                source_mask=region,
                shape_filter=processing.ShapeFilter(order=1, w=FACE_W),
            ).normal_map

        judged = judge(
            results, done.placed, target, {"normals": in_normals}, region=region, w=FACE_W
        )
        for quantity, figures in judged.items():
            if quantity.startswith("detail"):
                for method, figure in figures.items():
                    rows.setdefault(f"{quantity}, {method}", []).append(figure)
        panels += [
            normals_panel(f"{face.source} onto {face.target}, {method}", result)
            for method, result in results.items()
        ]
        seam = done.seam
        rows.setdefault("step across the seam over the interior's, normals", []).append(seam.ratio)
    return Table(
        "local",
        "Local transfer: a face transferred to another surface, errors over its region",
        tuple(FACES),
        rows,
        f"The paper states neither the positions of its faces nor how they were blended; Goethe "
        f"and Venus are not available. Gaussian of order 1, w={FACE_W}; the errors include the "
        "detail that the blending toward the rim removes. SSIM over the region with the usual "
        "constants, which is stricter than the paper's. The round trip and the measures 'from the "
        "same surfaces' and 'as surfaces' are as in the table by resolution.",
        tuple(paper.LOCAL_DEG),
        {
            "detail error, deg, normals": tuple(paper.LOCAL_DEG.values()),
            "detail SSIM, normals": tuple(paper.LOCAL_SSIM.get(name) for name in paper.LOCAL_DEG),
        },
    ), panels
