"""Panels of the errors of calibrated lights: error ellipsoids on the dome, and residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

import acquisition
from rig import figure
from rig.arrays import Float64
from sgp.pictures.lights import short_names
from sgp.pictures.sheet import Panel, rounded_down, set_plot_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The dome is seen from this direction: from the front and the right, 30 degrees above the plane.
_AZIMUTH_DEG: Final = -60.0
_ELEVATION_DEG: Final = 30.0
# An ellipsoid of median size is drawn about this long, relative to the median distance.
_SHARE: Final = 0.06

_FEW: Final = 40  # lights; the names of more do not fit


def ellipsoids_panel(lights: acquisition.Lights) -> Panel | None:
    """Show the lights in space with their error ellipsoids, None if their errors are not known.

    The semi-axes are standard deviations, enlarged by the factor in the title. Directions are
    points of the unit sphere.
    """
    covariances = _in_space(lights)
    sigmas = longest_sigmas(lights)
    if covariances is None or sigmas is None:
        return None
    places = lights.unit_directions if lights.positions_mm is None else lights.positions_mm
    distance = float(np.median(np.linalg.norm(places, axis=1)))
    fitting = _SHARE * distance / max(float(np.median(sigmas)), 1e-12 * distance)
    factor = max(1.0, rounded_down(fitting * (1 + 1e-9)))

    def draw(axes: Axes) -> None:
        from matplotlib.patches import Ellipse

        view = _view()
        seen = places @ view.T
        feet = (places * [1, 1, 0]) @ view.T
        turn = np.linspace(0, 2 * np.pi, 121)
        for radius in (0.5 * distance, distance):
            ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) * radius @ view.T
            axes.plot(ring[:, 0], ring[:, 1], color="0.88", lw=0.8)
        for name, axis in zip("XYZ", np.eye(3) * 0.5 * distance, strict=True):
            x, y = view @ axis
            axes.annotate(
                "", (x, y), (0, 0), arrowprops={"arrowstyle": "->", "color": "0.6", "lw": 0.8}
            )
            axes.text(x, y, name, fontsize=7, color="0.4")
        for (x, y), (u, v) in zip(seen, feet, strict=True):
            axes.plot([u, x], [v, y], color="0.85", lw=0.6, zorder=1)
        for (x, y), covariance in zip(seen, covariances, strict=True):
            if not np.isfinite(covariance).all():
                continue
            values, vectors = np.linalg.eigh(view @ covariance @ view.T)
            minor, major = 2 * factor * np.sqrt(values.clip(0))
            angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
            shape = Ellipse(
                (x, y), major, minor, angle=angle, fc="tab:orange", ec="tab:red", alpha=0.5, lw=0.6
            )
            axes.add_patch(shape)
        axes.scatter(seen[:, 0], seen[:, 1], s=5, color="tab:blue", linewidths=0, zorder=3)
        axes.set_aspect("equal")
        axes.margins(0.08)
        axes.axis("off")

    unit, scale = (" mm", 1.0) if lights.near else ("°", 180 / np.pi)
    median, largest = scale * np.median(sigmas), scale * sigmas.max()
    text = f"median {figure(median)}{unit}, largest {figure(largest)}{unit}"
    title = f"error ellipsoids (1 sigma), enlarged {factor:g} times; {text}"
    return Panel(title, draw, 1.2)


def longest_sigmas(lights: acquisition.Lights) -> Float64 | None:
    """Return the standard deviations of lights along the longest axes of their ellipsoids.

    In mm, or in radians for directions; lights without errors are left out. None if there are no
    others.
    """
    covariances = _in_space(lights)
    if covariances is None:
        return None
    known = covariances[np.isfinite(covariances).all(axis=(1, 2))]
    sigmas: Float64 = np.sqrt(np.linalg.eigvalsh(known)[:, -1].clip(0))
    return sigmas if len(sigmas) else None


def residuals_panel(lights: acquisition.Lights) -> Panel | None:
    """Show the rms residual of the highlights of each light, None if it is not known."""
    errors = lights.errors
    if errors is None or errors.residual_px is None:
        return None
    residuals = errors.residual_px

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        where = np.arange(len(residuals))
        axes.bar(where, np.nan_to_num(residuals), color="tab:blue", width=0.8)
        axes.set_xlim(-0.7, len(residuals) - 0.3)
        names = short_names(lights.ids)
        step = 1 if len(names) <= _FEW // 2 else -(-len(names) // (_FEW // 2))
        axes.set_xticks(where[::step], names[::step], fontsize=7, rotation=90)

    # A label at the axis would be outside of the picture in its first column.
    title = "rms distance of the highlights of each light from those predicted, px"
    return Panel(title, draw, None)


def _in_space(lights: acquisition.Lights) -> Float64 | None:
    """Return covariances ``(N, 3, 3)`` of positions in mm^2, or of unit vectors."""
    if lights.errors is None or lights.errors.covariances is None:
        return None
    if lights.directions is None:
        return lights.errors.covariances
    basis = acquisition.values.tangent_basis(lights.directions)
    covariances: Float64 = basis.transpose(0, 2, 1) @ lights.errors.covariances @ basis
    return covariances


def _view() -> Float64:
    """Return the unit vectors of the picture's x and y, ``(2, 3)``."""
    azimuth, elevation = np.radians([_AZIMUTH_DEG, _ELEVATION_DEG])
    right = [-np.sin(azimuth), np.cos(azimuth), 0.0]
    up = [
        -np.sin(elevation) * np.cos(azimuth),
        -np.sin(elevation) * np.sin(azimuth),
        np.cos(elevation),
    ]
    return np.array([right, up])
