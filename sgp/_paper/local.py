"""The paper's local transfers: a face set into another surface, peers beside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from processing import NormalMap, angle_deg, separate, ssim, transfer_local
from sgp._overview import Panel, normals_panel
from sgp._paper import figures as paper
from sgp._paper.measure import measure
from sgp._paper.sources import Sources
from sgp._paper.tables import Number, Table

Advance = Callable[[str], None]
Mask = npt.NDArray[np.bool_]

# What goes where: source and target, the ellipse round the face (column, row, half axes), the place
# it goes to, its scale and its turn in degrees.
_FACES = {
    "Cat onto Bear": ("cat", "bear", (392, 164, 42, 30), (303.0, 192.0), 1.3, 5.0),
    "Buddha onto Bear": ("buddha", "bear", (305, 118, 27, 34), (303.0, 185.0), 1.5, 0.0),
}
# The paper's granularity for faces.
_W = 10


def local_transfers(sources: Sources, advance: Advance) -> tuple[Table, list[Panel]]:
    """Set faces into other surfaces; errors over the region that received them."""
    targets = sources.targets()
    rows: dict[str, list[Number]] = {}
    panels: list[Panel] = []
    for source, target, ellipse, at, scale, turn in _FACES.values():
        advance(f"face of {source} onto {target}")
        done = transfer_local(
            targets[source],
            targets[target],
            source_mask=_ellipse(targets[source].size, ellipse),
            at=at,
            scale=scale,
            rotate_deg=turn,
            w=_W,
            order=1,
        )
        region = done.region
        results: dict[str, NormalMap] = {"normals": done.normal_map}
        # Where the source does not reach, the meshes need a surface too.
        around = np.where(done.placed.mask[..., None], done.placed.normals, targets[target].normals)
        placed = NormalMap(around, done.placed.mask | targets[target].mask)
        peers = measure(("DSPL", "LAPL"), placed, targets[target], region=region, w=_W)
        results |= {method: one.normal_map for method, one in peers.items()}
        put = separate(done.placed, order=1, w=_W).detail
        for method, result in results.items():
            found = separate(result, order=1, w=_W).detail
            error = angle_deg(found.normals[region], put.normals[region]).mean()
            rows.setdefault(f"detail error, deg, {method}", []).append(float(error))
            rows.setdefault(f"detail SSIM, {method}", []).append(ssim(found, put, region))
            panels.append(normals_panel(f"{source} onto {target}, {method}", result))
        seam = done.seam
        rows.setdefault("step across the seam over the interior's, normals", []).append(seam.ratio)
    return Table(
        "local",
        "Local transfer: a face set into another surface, errors over its region",
        tuple(_FACES),
        rows,
        tuple(paper.LOCAL_DEG),
        {
            "detail error, deg, normals": tuple(paper.LOCAL_DEG.values()),
            "detail SSIM, normals": tuple(paper.LOCAL_SSIM.get(name) for name in paper.LOCAL_DEG),
        },
        f"The paper neither says where its faces were put nor how they were blended; Goethe and "
        f"Venus are not to be had. Gaussian of order 1, w={_W}; the errors count what the blending "
        "toward the rim takes away. SSIM over the region with the usual constants, which is "
        "stricter than the paper's.",
    ), panels


def _ellipse(size: tuple[int, int], ellipse: tuple[int, int, int, int]) -> Mask:
    x, y, across, down = ellipse
    rows, columns = np.ogrid[: size[0], : size[1]]
    inside: Mask = ((columns - x) / across) ** 2 + ((rows - y) / down) ** 2 <= 1
    return inside
