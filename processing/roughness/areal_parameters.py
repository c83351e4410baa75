"""Parameters of areas (ISO 25178-2)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

import numpy as np

from acquisition.files import rows_in_bands
from processing.roughness.autocorrelation import texture
from processing.roughness.material_ratio import material_ratio
from rig.arrays import Floating

Kind = Literal["height", "length", "ratio", "angle", "slope"]


class Parameter(NamedTuple):
    """What a parameter is.

    Parameters
    ----------
    kind
        ``height`` in um, ``length`` in mm, ``ratio`` without a unit or in percent, ``angle`` in
        degrees, ``slope`` without a unit.
    unit
        Its unit.
    meaning
        In a few words.
    noisy
        Whether noise adds to its square, as to a root mean square.
    """

    kind: Kind
    unit: str
    meaning: str
    noisy: bool


AREAL: Final[Mapping[str, Parameter]] = {
    "Sa": Parameter("height", "um", "arithmetic mean height", True),
    "Sq": Parameter("height", "um", "root mean square height", True),
    "Sp": Parameter("height", "um", "highest peak", True),
    "Sv": Parameter("height", "um", "deepest pit", True),
    "Sz": Parameter("height", "um", "maximum height", True),
    "Ssk": Parameter("ratio", "", "skewness", False),
    "Sku": Parameter("ratio", "", "kurtosis", False),
    "Sdq": Parameter("slope", "", "root mean square gradient", True),
    "Sdr": Parameter("ratio", "%", "developed interfacial area", False),
    "Sal": Parameter("length", "mm", "autocorrelation length", False),
    "Str": Parameter("ratio", "", "texture aspect ratio", False),
    "Std": Parameter("angle", "deg", "texture direction", False),
    "Sk": Parameter("height", "um", "core height", True),
    "Spk": Parameter("height", "um", "reduced peak height", True),
    "Svk": Parameter("height", "um", "reduced dale depth", True),
    "Smr1": Parameter("ratio", "%", "material ratio of the peaks", False),
    "Smr2": Parameter("ratio", "%", "material ratio of the dales", False),
    "Sxp": Parameter("height", "um", "extreme peak height", True),
    "Smr": Parameter("ratio", "%", "material ratio 1 um above the mean", False),
}
# Derivative of a polynomial of order 6 through seven pixels (ISO 25178-2: 2012, annex).
_SIXTH: Final = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
_BAND = 2_000_000


def areal_parameters(heights_mm: Floating, pixel_mm: float) -> dict[str, float]:
    """Return the parameters of a scale-limited surface, NaN where one is not defined.

    Parameters
    ----------
    heights_mm
        ``(H, W)``, NaN outside the area.
    pixel_mm
        Distance between neighbouring pixels.

    Returns
    -------
    The names of `AREAL`, with its units.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import areal_parameters
    >>> x = np.arange(200) * 0.01
    >>> wave = 0.001 * np.sin(2 * np.pi * x / 0.5) * np.ones((200, 1))
    >>> found = areal_parameters(wave, 0.01)
    >>> {name: round(found[name], 4) for name in ("Sa", "Sq", "Sz", "Sdq")}
    {'Sa': 0.6358, 'Sq': 0.7071, 'Sz': 1.9961, 'Sdq': 0.0089}
    """
    values = heights_mm[np.isfinite(heights_mm)]
    # The mean of equal heights may be rounded.
    level = values.mean(dtype=np.float64) if np.ptp(values) > 0 else values[0]
    values -= values.dtype.type(level)
    values *= 1000
    squares = np.square(values)
    square = float(squares.mean(dtype=np.float64))
    root = math.sqrt(square)
    found = dict.fromkeys(AREAL, math.nan)
    found |= {
        "Sa": float(np.abs(values).mean(dtype=np.float64)),
        "Sq": root,
        "Sp": float(values.max()),
        "Sv": float(-values.min()),
        "Sz": float(np.ptp(values)),
    }
    if root > 0:
        found["Ssk"] = float((squares * values).mean(dtype=np.float64)) / root**3
        np.square(squares, out=squares)
        found["Sku"] = float(squares.mean(dtype=np.float64)) / square**2
    del squares
    values.sort()
    found |= material_ratio(values)
    del values
    found["Sdq"], found["Sdr"] = _gradients(heights_mm, pixel_mm)
    if root > 0:
        of_texture = texture(heights_mm)
        found["Sal"] = of_texture.shortest_px * pixel_mm
        found["Str"] = of_texture.aspect
        found["Std"] = of_texture.direction_deg
    return found


def _gradients(heights_mm: Floating, pixel_mm: float) -> tuple[float, float]:
    """Return Sdq and Sdr, over the pixels that have three known neighbours on every side.

    At the border of the map, point reflections stand for the missing ones.
    """
    squares, areas, count = 0.0, 0.0, 0
    height, width = heights_mm.shape
    if min(height, width) < len(_SIXTH):
        return math.nan, math.nan
    padded = np.pad(heights_mm, 3, mode="reflect", reflect_type="odd")
    for rows in rows_in_bands(height, width, _BAND):
        part = padded[rows.start : rows.stop + 6].astype(np.float64)
        slopes = np.zeros((rows.stop - rows.start, width))
        for axis in (0, 1):
            along = np.zeros_like(slopes)
            for at, factor in enumerate(_SIXTH):
                first = [3, 3]
                first[axis] = at
                along += (
                    factor * part[first[0] : first[0] + len(slopes), first[1] : first[1] + width]
                )
            slopes += np.square(along / pixel_mm)
        slopes = slopes[np.isfinite(slopes)]
        squares += float(slopes.sum())
        areas += float((np.sqrt(1 + slopes) - 1).sum())
        count += slopes.size
    if not count:
        return math.nan, math.nan
    return math.sqrt(squares / count), 100 * areas / count
