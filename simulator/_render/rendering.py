"""The images of a scene without noise, and its ground truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import DataError, MapRows
from rig import short_repr
from simulator._render.truth import Truth
from simulator._scene.scene import Scene

Values = npt.NDArray[np.float32]


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

    planes: Values
    ambient: Values
    truth: Truth
    scene: Scene

    __repr__ = short_repr

    def plane(self, led: int | None) -> Values:
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
        alone: Values = self.planes[led]
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
        part = slice(first, last)
        truth = self.truth
        rows = replace(
            truth,
            normals=truth.normals[part],
            height_mm=truth.height_mm[part],
            albedo=truth.albedo[part],
            mask=truth.mask[part],
            sphere_masks=truth.sphere_masks[:, part],
            shadows=None if truth.shadows is None else truth.shadows[:, part],
            top=truth.top + first,
        )
        return Rendering(self.planes[:, part], self.ambient[part], rows, self.scene)

    @property
    def maps(self) -> dict[str, MapRows]:
        """The maps of the ground truth by the names of their files; see `truth_maps`."""
        return truth_maps(self.truth)

    def truth_of(self, rows: slice) -> Truth:
        """Return the ground truth of some rows."""
        return self.rows(rows.start, rows.stop).truth


def truth_maps(truth: Truth) -> dict[str, MapRows]:
    """Return ``normals``, ``height``, ``albedo``, ``mask``, ``sphere_0``, ``shadows/L00``, etc."""
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
