"""Triangle meshes of height maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from acquisition import DataError, MapRows
from acquisition.files import rows_in_bands
from processing.meshes.face_kernels import faces_of
from processing.meshes.simplification import pixels_of, sampled, simplified
from processing.stages.stage import NormalRows, size_of
from processing.surface.height_map import HeightMap
from rig import check_type, short_repr
from rig.arrays import Bool, Float32, Int32, UInt8

if TYPE_CHECKING:
    import trimesh

_BAND = 64  # rows


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

    vertices: Float32
    faces: Int32
    normals: Float32 | None = None
    unit: Literal["mm", "px"] = "px"
    colours: UInt8 | None = None
    places: Float32 | None = None

    __repr__ = short_repr

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh, unit: Literal["mm", "px"] = "mm") -> Mesh:
        """Make a mesh of the vertices, faces, normals and colours of one of trimesh.

        Parameters
        ----------
        mesh
            The mesh; it has no texture here.
        unit
            Unit of its vertices.
        """
        from trimesh.visual import ColorVisuals

        look, colours = mesh.visual, None
        if isinstance(look, ColorVisuals) and look.kind == "vertex":
            colours = np.array(look.vertex_colors[:, :3], np.uint8)
        return cls(
            np.array(mesh.vertices, np.float32),
            np.array(mesh.faces, np.int32),
            np.array(mesh.vertex_normals, np.float32),
            unit,
            colours,
        )

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return a mesh of trimesh with the same vertices, in the same order.

        Its colours are those of the vertices; without these, `places` are its texture coordinates.
        """
        import trimesh

        visual = None
        if self.colours is None and self.places is not None:
            # There, the second coordinate grows upwards.
            uv = np.column_stack([self.places[:, 0], 1 - self.places[:, 1]])
            visual = trimesh.visual.TextureVisuals(uv=uv)  # type: ignore[no-untyped-call]
        made = trimesh.Trimesh(
            self.vertices.copy(),
            self.faces.copy(),
            vertex_normals=self.normals,
            vertex_colors=self.colours,
            visual=visual,
            process=False,
        )
        made.units = self.unit
        return made


def height_mesh(
    height_map: HeightMap,
    *,
    normals: NormalRows | None = None,
    colours: MapRows | None = None,
    triangles: int | None = None,
) -> Mesh:
    """Make a mesh from a height map: one vertex per pixel of its mask, in reading order.

    Four neighbouring pixels form two triangles, split along the shorter diagonal in space; three of
    the four form one triangle. No triangle connects two parts of the surface, or spans
    a jump that `integrate` found.

    With fewer triangles, edges collapse where the surface is flattest (Garland and Heckbert,
    Surface simplification using quadric error metrics, 1997; library fast-simplification). Normals
    and colours of the vertices that are left are interpolated in their images.

    Parameters
    ----------
    height_map
        The surface.
    normals
        Normals of the vertices; the map must cover the height map's mask.
    colours
        ``(H, W)`` or ``(H, W, 3)`` uint8 sRGB colours of the vertices.
    triangles
        Largest number of triangles to keep; the default is all of them.

    Returns
    -------
    Mesh
        The mesh, in the unit of the height map, with normals toward the camera.

    Raises
    ------
    DataError
        If the normals do not cover the height map, the colours have another size or type, the map
        contains no triangle, or fewer than four triangles are requested.

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
    check_cover(mask, normals, colours)
    vertices = _vertices(height_map)
    jumps = height_map.jumps
    cuts = () if jumps is None else (jumps.right, jumps.down)
    faces = faces_of(height_map.parts, vertices, *cuts)
    if not len(faces):
        raise no_triangle()
    if triangles is not None:
        left, fewer = simplified(vertices, faces, triangles, height_map.pixel_size)
        if len(fewer) < len(faces):
            return _interpolated(left, fewer, height_map, normals, colours)
    facing = None if normals is None else normals.normals[:][mask]
    painted = None if colours is None else _three(colours[:][mask])
    return Mesh(vertices, faces, facing, height_map.unit, painted, _places(mask))


def _interpolated(
    vertices: Float32,
    faces: Int32,
    height_map: HeightMap,
    normals: NormalRows | None,
    colours: MapRows | None,
) -> Mesh:
    """Return a mesh whose vertices are not those of the pixels."""
    mask, pixels = height_map.mask, pixels_of(vertices, height_map)
    facing = painted = None
    if normals is not None:
        blend = sampled(normals.normals[:], mask, pixels)
        blend[:, 2] += 1e-6  # a vertex without a pixel nearby faces the camera
        facing = (blend / np.linalg.norm(blend, axis=1)[:, None]).astype(np.float32)
    if colours is not None:
        channels = colours[:] if len(colours.shape) == 3 else colours[:][..., None]
        painted = _three(np.rint(sampled(channels, mask, pixels)).clip(0, 255).astype(np.uint8))
    places = ((pixels + 0.5) / mask.shape[::-1]).astype(np.float32)
    return Mesh(vertices, faces, facing, height_map.unit, painted, places)


def _vertices(height_map: HeightMap) -> Float32:
    """Return the points of the pixels inside, in bands of rows: all points take much memory."""
    mask = height_map.mask
    vertices = np.zeros((int(np.count_nonzero(mask)), 3), np.float32)
    begin = 0
    for rows in rows_in_bands(len(mask), 1, _BAND):
        inside = height_map.points(rows)[mask[rows]]
        vertices[begin : begin + len(inside)] = inside
        begin += len(inside)
    return vertices


def _places(mask: Bool) -> Float32:
    # A texture covers 0 to 1 from the outer edge of its first pixel to that of its last.
    rows, columns = mask.shape
    places = np.zeros((int(np.count_nonzero(mask)), 2), np.float32)
    across = ((np.arange(columns) + 0.5) / columns).astype(np.float32)
    down = ((np.arange(rows) + 0.5) / rows).astype(np.float32)
    places[:, 0] = np.broadcast_to(across, mask.shape)[mask]
    places[:, 1] = np.repeat(down, np.count_nonzero(mask, axis=1))
    return places


def check_cover(mask: Bool, normals: NormalRows | None, colours: MapRows | None) -> None:
    """Refuse normals or colours that do not fit a surface; errors are those of `height_mesh`."""
    if normals is not None and (size_of(normals) != mask.shape or np.any(mask & ~normals.mask)):
        raise DataError(
            "the normals do not cover the height map: give the normal map it was integrated from"
        )
    if colours is None:
        return
    shape = colours.shape
    if colours.dtype != np.uint8 or shape not in (mask.shape, (*mask.shape, 3)):
        raise DataError(
            f"colours of {colours.dtype} and shape {shape} do not fit a height map of shape "
            f"{mask.shape}: give sRGB samples of type uint8"
        )


def no_triangle() -> DataError:
    """Return the error about a surface without a mesh."""
    return DataError(
        "the surface contains no triangle: it is nowhere two pixels wide; check the mask"
    )


def _three(colours: UInt8) -> UInt8:
    """Return ``(V, 3)`` colours from ``(V,)``, ``(V, 1)`` or ``(V, 3)``."""
    column = colours.reshape(len(colours), -1)
    return np.repeat(column, 3, axis=1) if column.shape[1] == 1 else column
