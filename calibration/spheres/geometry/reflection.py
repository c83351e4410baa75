"""Mirror geometry of a sphere: rays from highlights, and highlights from lights."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calibration.spheres.geometry.ellipse import Ellipse
from rig.arrays import Float64


def orthographic_directions(outline: Ellipse, pixels: npt.ArrayLike) -> Float64:
    """Return the light directions for highlights in an orthographic view.

    With the sphere's normal n at the highlight and the view direction z, the law of reflection
    gives ``2 (n . z) n - z``. The outline may be an ellipse if the pixels are not square.

    Parameters
    ----------
    outline
        The sphere's outline.
    pixels
        ``(..., 2)`` highlights. The result is NaN for NaN and for points outside the outline.

    Returns
    -------
    Array
        ``(..., 3)`` unit vectors in the house frame.

    Examples
    --------
    >>> from calibration.spheres import Ellipse, orthographic_directions
    >>> towards = orthographic_directions(Ellipse((50, 50), (20, 20)), [50, 50])
    >>> towards.round(3) + 0.0  # a highlight in the centre: the light is at the camera
    array([0., 0., 1.])
    """
    unit = outline.unit(pixels)
    x, y = unit[..., 0], -unit[..., 1]
    inside = 1 - x**2 - y**2
    z = np.sqrt(np.where(inside >= 0, inside, np.nan))
    return np.stack([2 * z * x, 2 * z * y, 2 * z * z - 1], axis=-1)


def reflected_rays(
    rays: Float64, centre: Float64, radius: npt.ArrayLike
) -> tuple[Float64, Float64]:
    """Reflect camera rays on spheres.

    Parameters
    ----------
    rays
        ``(..., 3)`` rays from the centre of projection, of any length. NaN gives NaN.
    centre
        ``(..., 3)`` centres of the spheres relative to the centre of projection, broadcast against
        the rays.
    radius
        ``(...)`` radii of the spheres, in the unit of ``centre``.

    Returns
    -------
    points
        ``(..., 3)`` points where the rays meet the spheres, relative to the centre of projection;
        NaN if a ray misses.
    directions
        ``(..., 3)`` unit vectors of the reflected rays.
    """
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    radius = np.asarray(radius, np.float64)
    along = np.sum(unit * centre, axis=-1)
    inside = along**2 - (np.sum(centre**2, axis=-1) - radius**2)
    root = np.sqrt(np.where(inside >= 0, inside, np.nan))
    points: Float64 = unit * (along - root)[..., None]
    normals = (points - centre) / radius[..., None]
    directions: Float64 = unit - 2 * np.sum(unit * normals, axis=-1, keepdims=True) * normals
    return points, directions


def mirror_points(eye: Float64, light: Float64, centre: Float64, radius: Float64) -> Float64:
    """Return the point of a sphere at which an eye sees a light (Alhazen's problem).

    The normal is in the plane of eye, centre and light, at an angle between 0 (toward the eye) and
    psi (toward the light). The difference between the two angles of incidence increases with this
    angle and crosses zero once. A bracketed Newton iteration finds the zero to rounding precision.

    Parameters
    ----------
    eye, light, centre
        ``(..., 3)``, broadcast against each other; eye and light are outside the sphere.
    radius
        ``(...)`` radii.

    Returns
    -------
    Array
        ``(..., 3)`` points.
    """
    eye, light, centre = np.broadcast_arrays(eye, light, centre)
    to_eye, to_light = eye - centre, light - centre
    a = np.linalg.norm(to_eye, axis=-1)
    b = np.linalg.norm(to_light, axis=-1)
    first = to_eye / a[..., None]
    across = to_light - np.sum(to_light * first, axis=-1, keepdims=True) * first
    height = np.linalg.norm(across, axis=-1)
    psi = np.arctan2(height, np.sum(to_light * first, axis=-1))
    second = across / np.maximum(height, 1e-300)[..., None]
    low, high = np.zeros_like(psi), psi.copy()
    phi = psi * b / (a + b)
    for _ in range(60):
        f = _incidence(a, phi, radius) - _incidence(b, psi - phi, radius)
        low, high = np.where(f < 0, phi, low), np.where(f < 0, high, phi)
        slope = _incidence_slope(a, phi, radius) + _incidence_slope(b, psi - phi, radius)
        newton = phi - f / slope
        # The converged value is one end of its bracket.
        step = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        if np.all(np.abs(step - phi) < 1e-15):
            break
        phi = step
    normal = np.cos(phi)[..., None] * first + np.sin(phi)[..., None] * second
    return np.asarray(centre + np.asarray(radius)[..., None] * normal)


def _incidence(distance: Float64, angle: Float64, radius: Float64) -> Float64:
    """Return the angle between the normal and the direction to a point.

    The point is at ``distance`` from the centre, at ``angle`` from the normal.
    """
    return np.arctan2(distance * np.sin(angle), distance * np.cos(angle) - radius)


def _incidence_slope(distance: Float64, angle: Float64, radius: Float64) -> Float64:
    cosine = np.cos(angle)
    square = distance**2 + radius**2 - 2 * distance * radius * cosine
    return (distance**2 - distance * radius * cosine) / square
