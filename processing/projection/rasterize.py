"""Rendering of a triangle mesh to a raster of pixels."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from calibration import EstimateError
from processing.projection import rasterize_kernels as kernels
from processing.projection.geometry_files import neighbours
from processing.projection.mesh_kernels import half_edges
from processing.projection.view import Raster
from rig import Notice, Progress, in_threads, no_progress
from rig.arrays import Bool, Float32, Float64, Floating, Int32, Int64

# The usual crease angle. Another one is chosen if the edges of a part leave no gap around it.
_USUAL_DEG: Final = 40
_LEAST_DEG, _MOST_DEG = 32, 60
# Half the width of a gap: the edges of a cylinder of 24 segments turn by 15 degrees.
_GAP_DEG: Final = 8
# Edges in the gap, relative to the sharper ones: the edges of scanned and of decimated meshes
# have all angles, ever fewer of the larger ones; there it is 0.5 and more.
_MOST_BETWEEN: Final = 0.05
# Share of all edges, by length: a few folded faces do not make a part.
_LEAST_SHARP: Final = 1e-3
# The normal of a face that is longer than this many times its width is uncertain.
_LONGEST: Final = 1e3
# Half-edges that are enough to judge a mesh.
_ENOUGH: Final = 300_000
# Angles to normals of the file that rounding and the coarseness of a mesh explain.
_ROUNDING_DEG: Final = 0.5
# Points closer to the camera than this fraction of the working distance are not drawn.
NEAR_SHARE = 1e-3
# Fraction of pixels that may show the back of a face: a few do on the silhouette of any mesh.
_BACK_SHARE = 0.01
# Fraction of pixels whose blended normal may be far from that of their face: in a scan few are.
_BLUNT_SHARE = 0.05
_STEPS = 5


class Drawn(NamedTuple):
    """Normals ``(H, W, 3)``, 0 outside the object; heights in mm, NaN outside; warnings."""

    normals: Float32
    height: Float32
    warnings: tuple[Notice, ...]


def draw_mesh(
    vertices_mm: Float64,
    faces: Int32,
    raster: Raster,
    *,
    smooth: bool = True,
    given: Floating | None = None,
    on_progress: Progress = no_progress,
) -> Drawn:
    """Draw the nearest face at each pixel's centre.

    Coverage follows the top-left rule on corners rounded to 1 / 2^14 pixel: two faces that share
    an edge leave no hole and cover no pixel twice. Normal and height are evaluated at the
    intersection of the face with the pixel's line of sight, as in ray casting. With a distorted
    camera the edges of faces remain straight in the image, which matters only for faces of many
    pixels.

    Parameters
    ----------
    vertices_mm
        ``(V, 3)`` in the house frame.
    faces
        ``(F, 3)``. Both sides of a face are visible; the normal of a back side is inverted.
    raster
        The pixels.
    smooth
        Blend the area-weighted normals of the corners over a face; otherwise faces are flat.
        Normals are not blended across the sharp edges of a part.
    given
        ``(F, 3, 3)`` normals of the corners in the file, NaN where unknown, which replace
        blended ones if they fit the faces; or None.
    on_progress
        Receives the stage ``projecting``, in steps of about the same duration.

    Returns
    -------
    Drawn
        The image, with warnings about faces without area and faces that extend behind the camera,
        which are left out, about sharp edges, normals of the file that do not fit, normals far
        from those of their faces, and visible back sides.

    Raises
    ------
    EstimateError
        If no face can be drawn.
    """
    warnings = []
    on_progress("projecting", 0, _STEPS)
    vertex_normal, thin = kernels.vertex_normals(vertices_mm, faces, faces, len(vertices_mm))
    if thin:
        text = f"faces left out because they have no area: {thin} of {len(faces)}"
        warnings.append(Notice("faces-without-area", text))
        sound = kernels.sound_faces(vertices_mm, faces)
        faces, given = faces[sound], None if given is None else given[sound]
    corners = faces
    if smooth and len(faces):
        vertex_normal, corners, more = _normals_of_corners(vertices_mm, faces, vertex_normal, given)
        warnings += more
    if raster.camera is not None:
        behind = vertices_mm[:, 2] > (1 - NEAR_SHARE) * raster.eye_mm
        if behind.any():
            before = ~behind[faces].any(axis=1)
            text = f"faces left out because they are behind the camera: {int((~before).sum())}"
            warnings.append(Notice("faces-behind-camera", text))
            faces, corners = faces[before], corners[before]
            vertices_mm = np.where(behind[:, None], 0.0, vertices_mm)
    if not len(faces):
        raise EstimateError(f"no face can be drawn: {'; '.join(map(str, warnings))}")
    on_progress("projecting", 1, _STEPS)
    rows, columns = raster.size
    screen = kernels.snap(*raster.pixels(vertices_mm))
    bands = kernels.face_bands(screen, faces, rows, columns)
    on_progress("projecting", 2, _STEPS)
    members, begin = kernels.sort_into_bands(*bands, -(-rows // kernels.BAND_ROWS))
    on_progress("projecting", 3, _STEPS)
    nearest = np.full((rows, columns), -np.inf, np.float32)
    seen = np.full((rows, columns), -1, np.int32)
    in_threads(kernels.draw, len(begin) - 1, screen, faces, members, begin, nearest, seen)
    on_progress("projecting", 4, _STEPS)
    normals = np.zeros((rows, columns, 3), np.float32)
    height = np.full((rows, columns), np.nan, np.float32)
    back, blunt = np.zeros(rows, np.int32), np.zeros(rows, np.int32)
    in_threads(
        kernels.shade, rows, seen, vertices_mm, faces, vertex_normal, corners, smooth,
        *raster.sights(), raster.eye_mm, normals, height, back, blunt,
    )  # fmt: skip
    on_progress("projecting", _STEPS, _STEPS)
    share = blunt.sum() / max(np.count_nonzero(seen >= 0), 1)
    if share > _BLUNT_SHARE:
        text = (
            f"{share:.0%} of the pixels have blended normals that differ by more than 30 degrees "
            "from those of their faces: the mesh is coarse or noisy; if its edges are sharp, draw "
            "flat faces"
        )
        warnings.append(Notice("normals-blended", text))
    share = back.sum() / max(np.count_nonzero(seen >= 0), 1)
    if share > _BACK_SHARE:
        text = (
            f"{share:.0%} of the pixels show the back of a face: their normals are inverted to "
            "point toward the viewer; if the mesh should be closed, correct the winding of its "
            "faces"
        )
        warnings.append(Notice("faces-seen-from-behind", text))
    return Drawn(normals, height, tuple(warnings))


def _normals_of_corners(
    vertices: Float64, faces: Int32, blended: Float32, given: Floating | None
) -> tuple[Float32, Int32, list[Notice]]:
    """Return unit normals, their numbers at the corners of the faces, and notices."""
    notices = []
    corners = faces
    crease_deg = crease_angle_deg(vertices, faces)
    if crease_deg is not None:
        corners, sharp = _corners_at_creases(vertices, faces, crease_deg)
        blended, _ = kernels.vertex_normals(vertices, faces, corners, int(corners.max()) + 1)
        blended, corners = _faces_at_tips(vertices, faces, blended, corners, crease_deg)
        text = (
            f"edges at which faces turn by more than {crease_deg:.0f} degrees stay sharp: {sharp}; "
            "the mesh is a part with hard edges"
        )
        notices.append(Notice("creases-kept", text))
    if given is None:
        return blended, corners, notices
    used, off_deg = _blended_with_given(given, blended[corners], vertices, faces)
    if off_deg:
        text = (
            f"the normals in the file differ by {off_deg:.1f} degrees (median) from those of the "
            "faces, which are used instead"
        )
        notices.append(Notice("vertex-normals-doubtful", text))
        return blended, corners, notices
    return used.reshape(-1, 3), np.arange(used.size // 3, dtype=np.int32).reshape(-1, 3), notices


def crease_angle_deg(vertices: Float64, faces: Int32) -> float | None:
    """Return the angle that separates sharp edges from others; None if there is no such angle.

    The edges of a part with hard edges turn either by little, within its smooth faces, or by much.
    Those of a scan turn by all angles, so that no edge can be called sharp.

    Parameters
    ----------
    vertices
        ``(V, 3)``.
    faces
        ``(F, 3)`` faces that have an area.
    """
    first, second = _pairs(faces, max(3 * len(faces) // _ENOUGH, 1))
    angle, _, sound = _angles(vertices, faces, first, second)
    begin, end = (faces[first % len(faces), (first // len(faces) + k) % 3] for k in (0, 1))
    length = np.linalg.norm(vertices[begin] - vertices[end], axis=1) * sound
    for centre in sorted(range(_LEAST_DEG, _MOST_DEG + 1), key=lambda deg: abs(deg - _USUAL_DEG)):
        above = length[angle >= centre + _GAP_DEG].sum()
        between = length[np.abs(angle - centre) < _GAP_DEG].sum()
        if above > _LEAST_SHARP * length.sum() and between <= _MOST_BETWEEN * above:
            return float(centre)
    return None


def _corners_at_creases(vertices: Float64, faces: Int32, crease_deg: float) -> tuple[Int32, int]:
    """Return numbers of normals for the corners of faces; equal ones share a normal.

    Returns
    -------
    tuple
        ``(F, 3)`` numbers from 0, and the number of sharp edges. Faces on both sides of an edge
        share the normals at its ends if they turn by less than the crease angle.
    """
    first, second = _pairs(faces)
    angle, alike, _ = _angles(vertices, faces, first, second)
    smooth = angle < crease_deg
    count = len(faces)
    one, two, alike = first[smooth], second[smooth], alike[smooth]
    # The half-edge h of a face begins at the corner h and ends at the next one.
    one_end, two_end = (one + count) % (3 * count), (two + count) % (3 * count)
    begin = np.concatenate([one, one_end])
    end = np.concatenate([np.where(alike, two, two_end), np.where(alike, two_end, two)])
    links = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(3 * count, 3 * count))
    _, part = connected_components(links, directed=False)
    return (
        np.ascontiguousarray(part.reshape(3, count).T, np.int32),
        int(np.count_nonzero(~smooth)),
    )


def _faces_at_tips(
    vertices: Float64, faces: Int32, blended: Float32, corners: Int32, crease_deg: float
) -> tuple[Float32, Int32]:
    """Replace normals far from those of their faces, as at the tip of a cone, by these.

    Parameters
    ----------
    vertices, faces
        ``(V, 3)`` and ``(F, 3)``.
    blended
        ``(N, 3)`` normals.
    corners
        ``(F, 3)`` their numbers at the corners of the faces.
    crease_deg
        The crease angle.
    """
    normal, _ = _face_normals(vertices, faces)
    far = np.degrees(_angle(blended[corners], normal[:, None])) > crease_deg
    face, _ = np.nonzero(far)
    corners = corners.copy()
    corners[far] = len(blended) + np.arange(len(face))
    return np.concatenate([blended, normal[face].astype(np.float32)]), corners


def _pairs(faces: Int32, every: int = 1) -> tuple[Int64, Int64]:
    """Return the half-edges of edges with two faces."""
    codes, places = half_edges(faces, every)
    first, second = neighbours(codes)
    return places[first], places[second]


def _angles(
    vertices: Float64, faces: Int32, first: Int64, second: Int64
) -> tuple[Float64, Bool, Bool]:
    """Return by how many degrees neighbours turn, which run alike, and which normals are sound."""
    count = len(faces)
    (one, wide), (two, also) = (_face_normals(vertices, faces[h % count]) for h in (first, second))
    alike = faces[first % count, first // count] == faces[second % count, second // count]
    angle = np.degrees(_angle(one, np.where(alike[:, None], -two, two)))
    return angle, alike, wide & also


def _face_normals(vertices: Float64, faces: Int32) -> tuple[Float64, Bool]:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    area = np.linalg.norm(cross, axis=1)
    return cross / np.maximum(area, 1e-300)[:, None], area * _LONGEST > longest


def _angle(a: Floating, b: Floating) -> Float64:
    crossed = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(crossed, (a * b).sum(axis=-1)), np.float64)


def _blended_with_given(
    given: Floating, blended: Float32, vertices: Float64, faces: Int32
) -> tuple[Float32, float]:
    """Return the normals of the file where they fit the faces, else blended ones.

    Parameters
    ----------
    given
        ``(F, 3, 3)`` normals of corners in the file, unit vectors of either sign or NaN.
    blended
        ``(F, 3, 3)`` normals that are blended over the faces.
    vertices, faces
        ``(V, 3)`` and ``(F, 3)``.

    Returns
    -------
    tuple
        ``(F, 3, 3)`` normals; the median angle in degrees by which those of the file differ from
        the blended ones if it is too large for them to be used, else 0.
    """
    normal, _ = _face_normals(vertices, faces)
    face = np.repeat(normal[:, None], 3, axis=1)
    given = np.where((given * face).sum(axis=-1, keepdims=True) < 0, -given, given)
    known = np.asarray(np.isfinite(given).all(axis=-1))
    if not known.any():
        return blended, 0.0
    off = math.degrees(float(np.median(_angle(given[known], blended[known]))))
    coarse = math.degrees(float(np.median(_angle(blended[known], face[known]))))
    # Normals of the true surface are far nearer to the blended ones than those of the faces are.
    if off > 0.5 * coarse + _ROUNDING_DEG:
        return blended, off
    close = np.asarray((np.where(known[..., None], given, 0) * face).sum(axis=-1) > 0.5)
    near = known & close
    return np.where(near[..., None], given, blended).astype(np.float32), 0.0
