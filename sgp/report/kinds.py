"""The kinds of maps that a page shows: labels, units, colours and steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from rig.arrays import Float32, UInt8
from sgp.report.planes import Colours, Plane, colour_plane, scalar_plane, vectors_plane


class Kind(NamedTuple):
    """A map of numbers; `unit` of None is that of the record."""

    file: str
    label: str
    unit: str | None
    colours: Colours = "doubt"


VECTORS: Final = {"normals": "Normals", "shape": "Shape component"}
ALBEDO: Final = Kind("albedo.png", "Albedo", "")
HEIGHT: Final = Kind("height.exr", "Height", None, "height")
NUMBERS: Final = {
    "normal_sigma_deg": Kind("normal_sigma_deg.exr", "Standard deviation of the normal", "deg"),
    "height_sigma": Kind("height_sigma.exr", "Standard deviation of the height", None),
    "residual": Kind("residual.exr", "Residual of the images", "of the white level"),
    "specular": Kind("specular.exr", "Specular residual", "of the white level"),
    "curl_deg": Kind("curl_deg.exr", "Contradiction of the normals (curl)", "deg"),
    "normal_residual_deg": Kind("normal_residual_deg.exr", "Angle of normals and surface", "deg"),
    "error": Kind("error.exr", "Angular error", "deg"),
    "shape_error": Kind("shape_error.exr", "Error of the shape component", "deg"),
    "detail_error": Kind("detail_error.exr", "Error of the detail component", "deg"),
    "change_height": Kind("change_height.exr", "Change of height", None, "signed"),
    "change_significance": Kind(
        "change_significance.exr", "Significance of changes of the surface", "sigma", "signed"
    ),
    "normals_deg": Kind("normals_deg.exr", "Angle between normals before and after", "deg"),
    "change_log_albedo": Kind(
        "change_log_albedo.exr", "Change of the albedo", "ln(after / before)", "signed"
    ),
    "albedo_significance": Kind(
        "albedo_significance.exr", "Significance of changes of the albedo", "sigma", "signed"
    ),
    "albedo_factor": Kind("albedo_factor.exr", "Factor of the albedo", "after / before", "height"),
    "separability": Kind("separability.exr", "Shape left in the detail", "deg"),
    "curvature_mean": Kind("curvature_mean.exr", "Mean curvature", None, "signed"),
    "curvature_gaussian": Kind("curvature_gaussian.exr", "Gaussian curvature", None, "signed"),
    "detail_height": Kind("detail_height.exr", "Height of the detail", "px", "height"),
}
MASKS: Final = {
    "invented": Kind("invented.png", "Invented share", "0 to 1", "plain"),
    "significant": Kind("significant.png", "Significant changes", "0 to 1", "plain"),
}
_TAIL: Final = 0.005  # share of the pixels beyond each end of a colour scale


def quantiser(name: str, part: Float32, unit: str) -> Callable[[Float32], Plane] | None:
    """Return what makes planes of parts of a map, all with the same steps; None without values.

    ``part`` is the map in its largest form that is embedded; ``unit`` that of its record.
    """
    if name in VECTORS:
        return lambda values: vectors_plane(name, _unit_vectors(values), VECTORS[name])
    if name == "albedo":
        return lambda values: colour_plane(name, _samples(values), ALBEDO.label)
    if name in MASKS:
        mask = MASKS[name]
        return _scalar(name, mask, str(mask.unit), limits=(0.0, 1.0))
    known = part[np.isfinite(part)]
    kind = HEIGHT if name == "height" else NUMBERS[name]
    if kind.colours == "signed":
        # Most of a map of changes is 0, and its scale that of the rest.
        known = known[known != 0]
    if not known.size:
        return None
    low, high = map(float, np.quantile(known, (_TAIL, 1 - _TAIL)))
    own = kind.unit or unit
    if name == "height":
        limits = float(known.min()), float(known.max())
        return _scalar(name, kind, own, bits=16, shown=(low, high), limits=limits)
    if kind.colours == "signed":
        most = max(abs(low), abs(high))
        return _scalar(name, kind, own, limits=(-most, most))
    return _scalar(name, kind, own, limits=(0.0 if kind.colours == "doubt" else low, high))


def _scalar(name: str, kind: Kind, unit: str, **steps: Any) -> Callable[[Float32], Plane]:
    return lambda values: scalar_plane(name, values, kind.label, unit, kind.colours, **steps)


def _unit_vectors(values: Float32) -> Float32:
    vectors = np.where(np.isfinite(values), values, np.float32(0))
    length = np.linalg.norm(vectors, axis=2, keepdims=True)
    np.divide(vectors, length, out=vectors, where=length > 0)
    return vectors


def _samples(values: Float32) -> UInt8:
    return np.rint(np.nan_to_num(values)).astype(np.uint8)
