"""The images of a scene without noise, and its ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acquisition import CameraModel, DataError, Lights, MapRows, NoiseModel
from rig import pluralize, short_repr
from rig.arrays import Bool, Float32, Float64, Intp
from simulator.rendering.blur import blur
from simulator.scene.lens import Lens
from simulator.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact geometry, reflectance, lights and sensor of a rendered scene.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit vectors inside the mask, 0 outside.
    height_mm
        ``(H, W)`` z of the surface point at the pixel's centre, NaN outside the mask.
    albedo
        ``(H, W)``, or ``(H, W, 3)`` if it has colour; 0 outside the mask.
    mask
        ``(H, W)`` pixels whose centre shows the object.
    sphere_masks
        ``(S, H, W)`` pixels whose centre shows the sphere.
    sphere_centres_mm, sphere_radii_mm
        ``(S, 3)`` centres and ``(S,)`` radii of the spheres.
    highlights_px
        ``(S, N, 2)`` position (x, y) of LED n mirrored in sphere s, NaN if it is not seen.
    lights, lens, noise
        Lights, lens and sensor of the scene.
    electrons_per_us
        Signal of a white surface under irradiance 1.
    shadows
        ``(N, H, W)`` True where light n does not reach the point at the pixel's centre, because
        the surface faces away from it or the light is blocked; None if shadows were not rendered.
    top
        Row of the image in which the maps begin.
    """

    normals: Float32
    height_mm: Float64
    albedo: Float32
    mask: Bool
    sphere_masks: Bool
    sphere_centres_mm: Float64
    sphere_radii_mm: Float64
    highlights_px: Float64
    lights: Lights
    lens: Lens
    noise: NoiseModel
    electrons_per_us: float
    shadows: Bool | None = None
    top: int = 0

    @classmethod
    def of(cls, scene: Scene, highlights_px: Float64, **maps: Any) -> Truth:
        """Return the truth of a scene; ``maps`` are its maps and the row of the first."""
        return cls(
            sphere_centres_mm=scene.sphere_table[:, :3],
            sphere_radii_mm=scene.sphere_table[:, 3],
            highlights_px=highlights_px,
            lights=scene.lights,
            lens=scene.lens,
            noise=scene.noise,
            electrons_per_us=scene.electrons_per_us,
            **maps,
        )

    def __repr__(self) -> str:
        lights, spheres = len(self.lights), len(self.sphere_radii_mm)
        shape = f"{self.normals.dtype}{list(self.normals.shape)}"
        return f"Truth({shape}, {pluralize(lights, 'light')}, {pluralize(spheres, 'sphere')})"

    @property
    def camera(self) -> CameraModel | None:
        """Camera of the lens; None for an orthographic lens."""
        return self.lens.camera

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of every map."""
        height, width = self.mask.shape
        return height, width

    @property
    def depth_mm(self) -> Float64 | None:
        """``(H, W)`` distance from the camera along the optical axis, NaN outside the mask.

        None for an orthographic lens.
        """
        return None if self.camera is None else self.lens.camera_z_mm - self.height_mm

    @property
    def places_px(self) -> tuple[Intp, Intp]:
        """Columns and rows of the pixels in the image, ``(H, W)`` each."""
        height, width = self.size
        x, y = np.meshgrid(np.arange(width), self.top + np.arange(height))
        return x, y

    @property
    def points_mm(self) -> Float64:
        """``(H, W, 3)`` surface points at the pixels' centres, NaN outside the mask."""
        origins, rays = self.lens.origins_and_rays(*self.places_px)
        return origins + (self.lens.camera_z_mm - self.height_mm)[..., None] * rays


def resolved_normals(truth: Truth) -> Float32:
    r"""Return the normals of the ground truth, blurred as the lens blurs the images.

    A matte surface of albedo a and normal n sends ``a n . l`` under a light l. The lens averages
    this light over its point-spread function. Where l is nearly constant and no shadow begins, this
    is the light of the averaged ``a n``. Photometric stereo of images without noise gives the
    direction of this mean; its angle to the normal at the pixel's centre is the error by resolution
    alone.

    Parameters
    ----------
    truth
        Ground truth of a rendered scene; its lens has the defocus and the Gaussian.

    Returns
    -------
    Values
        ``(H, W, 3)`` float32 unit vectors inside the mask, 0 outside. Only light of the object is
        averaged. The normals themselves for a sharp lens.

    Raises
    ------
    DataError
        If a circle of confusion is larger than 64 pixels.

    Examples
    --------
    >>> from simulator import render, resolved_normals, scene_named
    >>> truth = render(scene_named("coin", width=64, height=52, leds=4)).truth
    >>> resolved = resolved_normals(truth)
    >>> cosine = (resolved * truth.normals).sum(axis=2)[truth.mask]
    >>> bool(0.9 < cosine.mean() < 1)
    True
    """
    mask = truth.mask
    if truth.lens.sharp or not mask.any():
        return truth.normals.copy()
    albedo = truth.albedo if truth.albedo.ndim == 2 else truth.albedo.mean(axis=2)
    planes = np.ascontiguousarray(np.moveaxis(truth.normals * albedo[..., None], 2, 0))
    depth = truth.lens.camera_z_mm - truth.height_mm
    depth[~mask] = depth[mask].max()
    circle = truth.lens.circle_px(depth).astype(np.float32)
    blur(planes, depth, circle, truth.lens.blur_px)
    resolved = np.moveaxis(planes, 0, 2)
    length = np.linalg.norm(resolved, axis=2)
    seen = mask & (length > 0)
    result = truth.normals.copy()
    result[seen] = resolved[seen] / length[seen, None]
    return result


@dataclass(frozen=True, eq=False)
class Rendering:
    """The images of a scene without noise.

    Parameters
    ----------
    planes
        ``(N, H, W)`` photons per microsecond of each light alone. With a Bayer lens, they are
        mosaics: each pixel has the value of its channel.
    ambient
        ``(H, W)`` photons per microsecond from the room, which are in every frame.
    truth
        Ground truth of the scene.
    scene
        The rendered scene.
    """

    planes: Float32
    ambient: Float32
    truth: Truth
    scene: Scene

    __repr__ = short_repr

    def plane(self, led: int | None) -> Float32:
        """Return the image of one LED alone, or of the ambient light for None.

        Parameters
        ----------
        led
            Index of the LED, or None.

        Returns
        -------
        Values
            ``(H, W)`` photons per microsecond, a view and not a copy.

        Raises
        ------
        DataError
            If the scene has no such LED.
        """
        if led is None:
            return self.ambient
        if not 0 <= led < len(self.planes):
            raise DataError(f"LED {led} is not in the scene, which has {len(self.planes)} LEDs")
        alone: Float32 = self.planes[led]
        return alone

    def rows(self, first: int, last: int) -> Rendering:
        """Return the rows from ``first`` to before ``last``, views and not copies.

        Parameters
        ----------
        first, last
            Rows of these images.

        Returns
        -------
        Rendering
            Rendering of these rows; ``truth.top`` is their place in the image.
        """
        part, truth = slice(first, last), self.truth
        names = ("normals", "height_mm", "albedo", "mask")
        rows = replace(
            truth,
            **{name: getattr(truth, name)[part] for name in names},
            sphere_masks=truth.sphere_masks[:, part],
            shadows=None if truth.shadows is None else truth.shadows[:, part],
            top=truth.top + first,
        )
        return Rendering(self.planes[:, part], self.ambient[part], rows, self.scene)

    @property
    def maps(self) -> dict[str, MapRows]:
        """The maps of the ground truth by the names of their files.

        ``normals``, ``height``, ``albedo``, ``mask``, ``sphere_0``, ``shadows/L00``, etc.
        """
        truth = self.truth
        maps: dict[str, MapRows] = {
            "normals": truth.normals,
            "height": truth.height_mm,
            "albedo": truth.albedo,
            "mask": truth.mask,
        }
        maps |= {f"sphere_{index}": mask for index, mask in enumerate(truth.sphere_masks)}
        if truth.shadows is not None:
            pairs = zip(truth.lights.ids, truth.shadows, strict=True)
            maps |= {f"shadows/{light}": dark for light, dark in pairs}
        return maps

    def truth_of(self, rows: slice) -> Truth:
        """Return the ground truth of some rows."""
        return self.rows(rows.start, rows.stop).truth
