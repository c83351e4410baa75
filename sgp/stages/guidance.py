"""Maps that guide the synthesis of detail onto a target."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cyclopts import Parameter

import acquisition
from rig.arrays import Float32
from sgp.cli.exit import UsageError
from sgp.cli.options import OptionalInput, Positive

_CURVATURE = "curvature"
_LARGEST = {"uint8": 255, "uint16": 65535}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GuidanceOptions:
    """Options that guide a pattern on a target. Maps have one channel and the size of the target.

    Parameters
    ----------
    direction
        With --onto: map of the direction that the x axis of the exemplar follows, counter-clockwise
        from X: degrees in a file of floats; in 8 or 16 bits, black is 0 and white 180 degrees. Or
        curvature: the direction of the largest curvature of the target.
    scale_map
        With --onto: map of the size of the pattern relative to the exemplar: factors in a file of
        floats; in 8 or 16 bits, black is 0.5, mid-grey 1 and white 2.
    guide
        With --onto and --guide-exemplar: map of any quantity, such as curvature, depth, or a
        painted one. Parts of the exemplar are placed where the target has similar values.
    guide_exemplar
        The same quantity on the exemplar, a map of the size of its image.
    guide_weight
        Weight of the guide against the continuation of the pattern, up to 100.
    """

    direction: str | None = None
    scale_map: OptionalInput = None
    guide: OptionalInput = None
    guide_exemplar: OptionalInput = None
    guide_weight: Positive = 1.0

    def check(self, *, onto: bool) -> None:
        """Raise `UsageError` if options are missing that these require."""
        if not onto and (self.direction is not None or self.files()):
            raise UsageError(
                "--direction, --scale-map, --guide and --guide-exemplar require --onto"
            )
        if (self.guide is None) != (self.guide_exemplar is None):
            raise UsageError("--guide and --guide-exemplar require each other")

    def files(self) -> list[Path]:
        """Return the files that the options name."""
        named = [] if self.direction in (None, _CURVATURE) else [Path(str(self.direction))]
        return named + [p for p in (self.scale_map, self.guide, self.guide_exemplar) if p]

    def read(
        self, crop: tuple[slice, slice], size: tuple[int, int], max_pixels: int
    ) -> dict[str, Any]:
        """Read the maps.

        Parameters
        ----------
        crop
            Part of the exemplar that is used.
        size
            (height, width) of the image of the exemplar.
        max_pixels
            Largest allowed number of pixels.
        """
        maps: dict[str, Any] = {"guide_weight": self.guide_weight}
        if self.direction == _CURVATURE:
            maps["direction_deg"] = _CURVATURE
        elif self.direction is not None:
            values, painted = _read(Path(self.direction), max_pixels)
            maps["direction_deg"] = 180 * values if painted else values
        if self.scale_map is not None:
            values, painted = _read(self.scale_map, max_pixels)
            maps["scale"] = np.exp2(2 * values - 1) if painted else values
        if self.guide is not None and self.guide_exemplar is not None:
            maps["guide"], aim_painted = _read(self.guide, max_pixels)
            own, painted = _read(self.guide_exemplar, max_pixels)
            if own.shape != size:
                raise acquisition.DataError(
                    f"{self.guide_exemplar} has {own.shape[1]} x {own.shape[0]} pixels, the "
                    f"exemplar {size[1]} x {size[0]}: give a map of the size of the exemplar"
                )
            if painted != aim_painted:
                raise acquisition.DataError(
                    f"{self.guide} and {self.guide_exemplar} have different units: one has whole "
                    "numbers, the other floats"
                )
            maps["exemplar_guide"] = own[crop]
        return maps


def _read(path: Path, max_pixels: int) -> tuple[Float32, bool]:
    """Return a map, and whether it was stored as whole numbers; these become 0 to 1."""
    image = acquisition.read_image(path, max_pixels=max_pixels)
    if image.ndim != 2:
        raise acquisition.DataError(f"{path} has {image.shape[2]} channels: give a map with one")
    largest = _LARGEST.get(image.dtype.name, 1)
    return np.asarray(image, np.float32) / np.float32(largest), largest > 1
