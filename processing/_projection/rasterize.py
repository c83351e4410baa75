"""Rendering of a triangle mesh to a raster of pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calibration import EstimateError
from processing._projection import rasterize_kernels as kernels
from processing._projection.creases import (
    blended_with_given,
    corners_at_creases,
    crease_angle_deg,
)
from processing._projection.view import Raster
from rig import Notice, Progress, in_threads, no_progress

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int32]

# Points closer to the camera than this fraction of the working distance are not drawn.
NEAR_SHARE = 1e-3
# Fraction of pixels that may show the back of a face: a few do on the silhouette of any mesh.
_BACK_SHARE = 0.01
# Fraction of pixels whose blended normal may be far from that of their face: in a scan few are.
_BLUNT_SHARE = 0.05
_STEPS = 5


class Drawn(NamedTuple):
    """Normals ``(H, W, 3)``, 0 outside the object; heights in mm, NaN outside; warnings."""

    normals: Float
    height: Float
    warnings: tuple[Notice, ...]


def draw_mesh(
    vertices_mm: Double,
    faces: Whole,
    raster: Raster,
    *,
    smooth: bool = True,
    given: npt.NDArray[np.floating] | None = None,
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
            "from those of their faces: draw flat faces, or use a finer mesh"
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
    vertices: Double, faces: Whole, blended: Float, given: npt.NDArray[np.floating] | None
) -> tuple[Float, Whole, list[Notice]]:
    """Return unit normals, their numbers at the corners of the faces, and notices."""
    notices = []
    corners = faces
    crease_deg = crease_angle_deg(vertices, faces)
    if crease_deg is not None:
        corners, sharp = corners_at_creases(vertices, faces, crease_deg)
        blended, _ = kernels.vertex_normals(vertices, faces, corners, int(corners.max()) + 1)
        text = (
            f"edges at which faces turn by more than {crease_deg:.0f} degrees stay sharp: {sharp}; "
            "the mesh is a part with hard edges"
        )
        notices.append(Notice("creases-kept", text))
    if given is None:
        return blended, corners, notices
    used, off_deg = blended_with_given(given, blended[corners], vertices, faces)
    if off_deg:
        text = (
            f"the normals in the file differ by {off_deg:.1f} degrees (median) from those of the "
            "faces, which are used instead"
        )
        notices.append(Notice("vertex-normals-doubtful", text))
        return blended, corners, notices
    return used.reshape(-1, 3), np.arange(used.size // 3, dtype=np.int32).reshape(-1, 3), notices
