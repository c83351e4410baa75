"""Triangle meshes of height maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from processing._normal_map import NormalMap
from processing._surface.integration import HeightMap
from rig import check_type, short_repr

Float = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh.

    Parameters
    ----------
    vertices
        ``(V, 3)`` float32.
    faces
        ``(F, 3)`` int32 vertex indices, counter-clockwise as seen from the camera.
    normals
        ``(V, 3)`` float32 unit vectors, or None.
    unit
        Unit of the vertices: ``mm``, or ``px`` if the scale is not known.
    colours
        ``(V, 3)`` uint8 sRGB, or None.
    places
        ``(V, 2)`` float32 positions in a texture of the image, 0..1 to the right and down, or None.
    """

    vertices: Float
    faces: npt.NDArray[np.int32]
    normals: Float | None = None
    unit: Literal["mm", "px"] = "px"
    colours: npt.NDArray[np.uint8] | None = None
    places: Float | None = None

    __repr__ = short_repr


def height_mesh(
    height_map: HeightMap,
    *,
    normals: NormalMap | None = None,
    colours: npt.NDArray[np.uint8] | None = None,
) -> Mesh:
    """Make a mesh from a height map: one vertex per pixel of its mask, in reading order.

    Four neighbouring pixels form two triangles, split along the shorter diagonal in space; three of
    the four form one triangle. No triangle connects two parts of the surface.

    Parameters
    ----------
    height_map
        The surface.
    normals
        Normals of the vertices; the map must cover the height map's mask.
    colours
        ``(H, W)`` or ``(H, W, 3)`` uint8 sRGB colours of the vertices.

    Returns
    -------
    Mesh
        The mesh, in the unit of the height map, with normals toward the camera.

    Raises
    ------
    DataError
        If the normals do not cover the height map, the colours have another size or type, or the
        map contains no triangle.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, height_mesh, integrate
    >>> y, x = np.mgrid[1:-1:5j, -1:1:5j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> mesh = height_mesh(integrate(bowl, pixel_mm=0.5))
    >>> mesh.vertices.shape, mesh.faces.shape, mesh.unit
    ((25, 3), (32, 3), 'mm')
    """
    check_type("height_map", height_map, HeightMap, "integrate(normal_map) returns one")
    mask = height_map.mask
    if normals is not None and (normals.size != mask.shape or np.any(mask & ~normals.mask)):
        raise DataError(
            "the normals do not cover the height map: give the normal map it was integrated from"
        )
    vertices = height_map.points()[mask]
    faces = _faces(height_map.parts, vertices)
    if not len(faces):
        raise DataError(
            "the surface contains no triangle: it is nowhere two pixels wide; check the mask"
        )
    facing = None if normals is None else normals.normals[mask]
    # A texture covers 0 to 1 from the outer edge of its first pixel to that of its last.
    places = ((np.argwhere(mask)[:, ::-1] + 0.5) / mask.shape[::-1]).astype(np.float32)
    painted = None if colours is None else _colours(colours, mask)
    return Mesh(vertices, faces, facing, height_map.unit, painted, places)


def _colours(colours: npt.NDArray[np.uint8], mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    shape = colours.shape
    if colours.dtype != np.uint8 or shape not in (mask.shape, (*mask.shape, 3)):
        raise DataError(
            f"colours of {colours.dtype} and shape {shape} do not fit a height map of shape "
            f"{mask.shape}: give sRGB samples of type uint8"
        )
    picked = colours[mask]
    return np.repeat(picked[:, None], 3, axis=1) if colours.ndim == 2 else picked


def _faces(parts: npt.NDArray[np.int32], vertices: Float) -> npt.NDArray[np.int32]:
    inside = parts >= 0
    number = np.full(parts.shape, -1, np.int32)
    number[inside] = np.arange(len(vertices), dtype=np.int32)
    # Corners of each square of pixels: a and b above d and e.
    a, b, d, e = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]

    part_of = parts[inside]

    def joined(*corners: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
        # A missing corner (-1) indexes the last vertex; corner >= 0 excludes it.
        first = part_of[corners[0]]
        whole = np.ones(first.shape, np.bool_)
        for corner in corners:
            whole &= (corner >= 0) & (part_of[corner] == first)
        return whole

    adb, bde, ade, aeb = joined(a, d, b), joined(b, d, e), joined(a, d, e), joined(a, e, b)
    quads = adb & bde
    shorter_bd = np.zeros_like(quads)
    shorter_bd[quads] = _distance2(vertices, b[quads], d[quads]) <= _distance2(
        vertices, a[quads], e[quads]
    )
    split_ae = quads & ~shorter_bd
    # Squares with three corners contain one triangle; squares with four are split at a diagonal.
    triangles = [
        (adb & ~split_ae, (a, d, b)),
        (bde & ~split_ae, (b, d, e)),
        (ade & (split_ae | ~quads), (a, d, e)),
        (aeb & (split_ae | ~quads), (a, e, b)),
    ]
    return np.concatenate(
        [np.stack([corner[where] for corner in corners], axis=1) for where, corners in triangles]
    )


def _distance2(vertices: Float, a: npt.NDArray[np.int32], b: npt.NDArray[np.int32]) -> Float:
    step = vertices[a] - vertices[b]
    return np.asarray(np.einsum("ij,ij->i", step, step), np.float32)
