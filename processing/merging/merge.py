"""Fields in memory, joined into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from processing.maps.normal_map import NormalMap
from processing.merging.field_rows import FieldRows
from processing.merging.fusion import FusionStage
from processing.merging.placements import Placements, place_fields
from processing.registration import Field
from processing.stages.stage import computed
from rig import Progress, no_progress, short_repr
from rig.arrays import Float32, UInt8


@dataclass(frozen=True, eq=False)
class MergedField:
    """One map made of overlapping fields.

    Parameters
    ----------
    normal_map
        Fused normals of the whole.
    albedo
        ``(H, W)``; None if no field has one.
    sigma_deg
        ``(H, W)`` standard deviations of the normals in degrees, NaN where they are not known.
    fields
        ``(H, W)`` number of fields that show a pixel.
    placements
        Where the fields are.
    """

    normal_map: NormalMap
    albedo: Float32 | None
    sigma_deg: Float32
    fields: UInt8
    placements: Placements

    __repr__ = short_repr


def merge_fields(fields: Sequence[Field], *, on_progress: Progress = no_progress) -> MergedField:
    """Join normal maps of overlapping fields of one object into one.

    Parameters
    ----------
    fields
        At least two fields of the same scale, in any order, moved and turned in the plane. The
        whole has the axes of the first.
    on_progress
        Receives the stages of `processing.merging.place_fields`, and ``fusing fields``.

    Returns
    -------
    MergedField
        Normals fused by their standard deviations, and where the fields are. `processing.integrate`
        makes a surface of them.

    Raises
    ------
    DataError, EstimateError
        As `processing.merging.place_fields`. Fields are named by their numbers, from 0.

    Examples
    --------
    >>> from processing.merging import merge_fields
    >>> merge_fields([])
    Traceback (most recent call last):
    ...
    acquisition._errors.DataError: 0 fields: give at least two fields that overlap
    """
    rows = tuple(FieldRows.of(field, f"field {number}") for number, field in enumerate(fields))
    stage = FusionStage(rows, place_fields(rows, on_progress))
    maps = computed(stage, on_progress=on_progress)
    count = maps["fields"][:]
    return MergedField(
        NormalMap.of_unit_vectors(maps["normals"][:], count > 0),
        maps["albedo"][:] if stage.channels else None,
        maps["normal_sigma_deg"][:],
        count,
        stage.placements,
    )
