"""A matte surface of known shape under every light: a card or a ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import CameraModel, DataError
from calibration.radiance.stack import check_linear
from rig import short_repr
from rig.arrays import Bool, Float32, Float64

# Toward the limb of a ball, the direction of the normal is uncertain: least cosine to the view.
_FRONT = 0.4
_OUTLINE = 64


@dataclass(frozen=True, eq=False)
class MatteSurface:
    """Linear images of a matte surface, with the point and normal of each pixel.

    Parameters
    ----------
    values
        ``(N, H, W)`` or ``(N, H, W, 3)`` linear radiance, not divided by any intensity; NaN where
        saturated.
    points_mm
        ``(H, W, 3)`` points of the surface in the house frame; NaN where it is not known.
    mask
        ``(H, W)`` pixels that show the surface; objects on it need not be left out.
    normals
        ``(H, W, 3)`` unit normals; default: +Z.
    camera_mm
        ``(3,)`` centre of projection, for the test of a card's height; default: far above.

    Raises
    ------
    DataError
        If shapes differ, or a value is infinite.
    TypeError
        If the values are integers.
    """

    values: Float32
    points_mm: Float64
    mask: Bool
    normals: Float64 | None = None
    camera_mm: Float64 | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_linear("values", self.values)
        values, mask = np.asarray(self.values), np.asarray(self.mask, np.bool_)
        points = np.asarray(self.points_mm, np.float64)
        flat = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
        normals = flat if self.normals is None else np.asarray(self.normals, np.float64)
        if (
            values.ndim not in (3, 4)
            or (values.ndim == 4 and values.shape[3] != 3)
            or values.shape[1:3] != mask.shape
            or points.shape != (*mask.shape, 3)
            or normals.shape != points.shape
        ):
            raise DataError(
                f"the shapes of the stack {values.shape}, the mask {mask.shape}, the points "
                f"{points.shape} and the normals {normals.shape} do not match each other"
            )
        if any(np.isinf(image).any() for image in values):
            raise DataError("the images have infinite values: NaN means not measured")
        object.__setattr__(self, "mask", mask)
        object.__setattr__(self, "points_mm", points)
        object.__setattr__(self, "normals", normals)

    @classmethod
    def card(
        cls, values: Float32, camera: CameraModel, *, z_mm: float = 0.0, mask: Bool | None = None
    ) -> MatteSurface:
        """Return a card in the plane z = ``z_mm``, parallel to the working plane.

        Parameters
        ----------
        values
            As in the class.
        camera
            Camera of the images with a working distance, which must be larger than ``z_mm``.
        z_mm
            Height of the card's upper side over the working plane.
        mask
            Pixels that show the card; default: all.

        Raises
        ------
        DataError
            If the size of the camera's images is another one, or the card is behind the camera.
        """
        check_linear("values", values)
        _check_size(values, camera)
        if not z_mm < camera.centre_mm[2]:
            raise DataError(
                f"a card at {z_mm:g} mm is not in front of the camera at {camera.centre_mm[2]:g} mm"
            )
        whole = np.ones(camera.size, np.bool_)
        return cls(
            values,
            camera.points_on_plane(z_mm),
            whole if mask is None else mask,
            camera_mm=camera.centre_mm,
        )

    @classmethod
    def ball(
        cls,
        values: Float32,
        camera: CameraModel,
        circle_px: tuple[float, float, float],
        radius_mm: float,
    ) -> MatteSurface:
        """Return a matte ball: the part that faces the camera, up to 66 degrees.

        Parameters
        ----------
        values
            As in the class.
        camera
            Camera of the images, with a working distance.
        circle_px
            Column, row and radius of its outline, as well as a circle describes it.
        radius_mm
            Radius of the ball; it determines its distance.

        Raises
        ------
        DataError
            If the size of the camera's images is another one, or there is no such ball.
        """
        check_linear("values", values)
        _check_size(values, camera)
        x, y, radius = circle_px
        if not (np.isfinite(circle_px).all() and radius > 0 and radius_mm > 0):
            raise DataError("a ball needs an outline x, y, radius and a radius in mm above 0")
        turn = np.linspace(0, 2 * np.pi, _OUTLINE, endpoint=False)
        edge = camera.rays(np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], axis=1))
        edge /= np.linalg.norm(edge, axis=1, keepdims=True)
        # Rays r that touch the ball have r . v = 1 for v = centre / (|centre| cos(half angle)).
        v = np.linalg.lstsq(edge, np.ones(_OUTLINE), rcond=None)[0]
        length = float(np.linalg.norm(v))
        centre = radius_mm * v / np.sqrt(length**2 - 1)  # from the camera
        rays = camera.pixel_rays()
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        along = rays @ centre
        under = radius_mm**2 - (centre @ centre - along**2)
        seen = under > 0
        depth = along - np.sqrt(np.where(seen, under, np.nan))
        normals = (depth[..., None] * rays - centre) / radius_mm
        seen &= -np.sum(normals * rays, axis=-1) > _FRONT
        return cls(values, camera.centre_mm + depth[..., None] * rays, seen, normals)


def _check_size(values: Float32, camera: CameraModel) -> None:
    if values.ndim not in (3, 4) or values.shape[1:3] != camera.size:
        raise DataError(
            f"a stack of the shape {values.shape} is not from a camera of "
            f"{camera.width} x {camera.height} pixels"
        )
