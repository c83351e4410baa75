"""Write the meshes of a surface: complete or with fewer triangles, and closed to a solid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import acquisition
import processing
import rig
from sgp.cli.console import shown
from sgp.results import MeshMetrics
from sgp.stages.options import SurfaceOptions

SOLID = "solid.stl"


def write_meshes(
    folder: Path,
    height_map: processing.HeightMap,
    normal_map: processing.stages.NormalRows,
    options: SurfaceOptions,
    colours: acquisition.MapRows | None,
) -> tuple[dict[str, Path], MeshMetrics, list[rig.Notice]]:
    """Write a mesh in each requested format; return the files, the figures and notices."""
    outputs: dict[str, Path] = {}
    metrics, notices, mesh = MeshMetrics(), list[rig.Notice](), None
    if any(options.whole_mesh().values()):
        mesh = processing.height_mesh(
            height_map, normals=normal_map, colours=colours, triangles=options.triangles
        )
        metrics, notices = _simplified(mesh, height_map, normal_map, options.triangles)
    for suffix in shown("writing meshes", options.formats()):
        path, *others = processing.write_mesh(
            folder / f"surface.{suffix}",
            height_map,
            normals=normal_map,
            colours=colours,
            normal_texture=options.normal_texture,
            mesh=mesh,
        )
        outputs[suffix] = path
        outputs |= {f"{suffix}_{other.suffix[1:]}": other for other in others}
    if mesh is not None and (options.close or options.base is not None):
        solid = processing.solid_mesh(mesh, options.base)
        (outputs["solid"],) = processing.write_mesh(folder / SOLID, height_map, mesh=solid)
    return outputs, metrics, notices


def _simplified(
    mesh: processing.meshes.Mesh,
    height_map: processing.HeightMap,
    normal_map: processing.stages.NormalRows,
    triangles: int | None,
) -> tuple[MeshMetrics, list[rig.Notice]]:
    """Return how far a mesh with fewer triangles is from the surface, where both are seen."""
    if triangles is None:
        return {}, []
    if len(mesh.vertices) == np.count_nonzero(height_map.mask):
        text = (
            f"the surface has {len(mesh.faces)} triangles, not more than the {triangles} to keep: "
            "its meshes are complete"
        )
        return {"triangles": len(mesh.faces)}, [rig.Notice("mesh-complete", text, "", "info")]
    # The unit of a surface without a scale is the pixel: for the drawing it is a millimetre.
    camera, pixel_mm = height_map.camera, height_map.pixel_size
    if camera is not None:
        camera = replace(camera, working_distance_mm=pixel_mm * camera.focal_px)
    drawn = processing.project(
        processing.Geometry(mesh.vertices.astype(np.float64), mesh.faces),
        size=None if camera is not None else height_map.mask.shape,
        pixel_mm=None if camera is not None else pixel_mm,
        camera=camera,
        centred=False,
        smooth=False,
    )
    both = height_map.mask & np.isfinite(drawn.height)
    # On a slope, a height differs by more than the distance between the surfaces.
    apart = np.abs(drawn.height[both] - height_map.height[both]) * normal_map.normals[:][both, 2]
    return {
        "triangles": len(mesh.faces),
        "deviation_rms": float(np.sqrt(np.mean(np.square(apart, dtype=np.float64)))),
        "deviation_largest": float(apart.max()),
    }, []
