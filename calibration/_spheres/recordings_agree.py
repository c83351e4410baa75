"""Whether recordings show the same lights through the same camera, so that they count as one."""

from __future__ import annotations

from collections.abc import Sequence

from acquisition import DataError, Source, setup_differences, source_setup
from rig import check_type, pluralize

# A focal length wrong by .1 % moves lights by .6 mm, as much as the errors of good spheres.
_SAME = 0.001
_LISTED = 4


def check_recordings(sources: Sequence[Source]) -> None:
    """Refuse recordings of moved spheres under different rigs, cameras, lenses or lights.

    What one of them does not state is not compared. Lenses are the same if their rays agree to .1 %
    of half the field of view.

    Parameters
    ----------
    sources
        Recordings of the same lights; each is compared with the first.

    Raises
    ------
    DataError
        One line that names both recordings and what differs.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, read_source, write_png
    >>> from calibration import check_recordings
    >>> write_png("L00.png", np.full((40, 50), 700, np.uint16))
    >>> cameras = [CameraModel([[f, 0, 25], [0, f, 20], [0, 0, 1]], 50, 40) for f in (90, 95)]
    >>> try:
    ...     check_recordings([read_source("L00.png", camera=camera) for camera in cameras])
    ... except ValueError as error:
    ...     print(str(error)[:59])
    L00.png differs from L00.png: focal length 90 px at 50 x 40
    """
    for source in sources:
        check_type("source", source, Source, "acquisition.read_source(path) returns one")
    first = sources[0]
    setup = source_setup(first)
    for other in sources[1:]:
        if other.size != first.size:
            (h, w), (height, width) = first.size, other.size
            raise DataError(
                f"{other.path} has images of {width} x {height} pixels, {first.path} of {w} x {h}: "
                "the recordings must be of one camera, with images of one size"
            )
        differences = setup_differences(setup, source_setup(other), _SAME)
        if differences:
            raise DataError(
                f"{other.path} differs from {first.path}: {', '.join(differences)}; recordings "
                "with moved spheres need one rig and one camera"
            )
        different = light_difference(
            str(first.path), first.light_ids, str(other.path), other.light_ids
        )
        if different:
            raise DataError(different)


def light_difference(
    first: str, first_ids: Sequence[str], other: str, other_ids: Sequence[str]
) -> str:
    """Return one line if two recordings do not show the same lights, in any order; else ""."""
    if sorted(first_ids) == sorted(other_ids):
        return ""
    if len(first_ids) != len(other_ids):
        return (
            f"{other} shows {pluralize(len(other_ids), 'light')}, {first} "
            f"{len(first_ids)}: the recordings must show the same lights"
        )
    rest = [name for name in other_ids if name not in first_ids]
    shown = ", ".join(rest[:_LISTED]) + (", ..." if len(rest) > _LISTED else "")
    return (
        f"{first} has no light {shown}, which {other} shows: the same light must have the same "
        "name in all recordings"
    )
