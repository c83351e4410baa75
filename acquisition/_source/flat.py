"""A source whose signal is divided by a flat field."""

from __future__ import annotations

from dataclasses import replace

from acquisition._errors import DataError
from acquisition._source.source import Source
from acquisition._source.source_setup import setup_differences, source_setup
from acquisition._values.flat import Flat
from rig import check_type


def apply_flat(source: Source, flat: Flat) -> Source:
    """Return a recording whose linear signal will be divided by a flat field.

    Parameters
    ----------
    source
        The recording, also a region of it.
    flat
        Flat of its camera and lens, for complete upright frames.

    Returns
    -------
    Source
        With `Source.flat`, which `calibration.linear_stack` applies.

    Raises
    ------
    DataError
        If the recording has a flat already, or its frames have another size or filter pattern, or
        were recorded with another camera or lens, as far as recording and flat state it.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Flat, apply_flat, read_source, write_png
    >>> write_png("card.png", np.full((40, 60), 700, np.uint16))
    >>> ones = np.ones((40, 60), np.float32)
    >>> apply_flat(read_source("card.png"), Flat(0.8 * ones, ones)).flat
    Flat(60 x 40 px, corners 80.0%)
    """
    check_type("source", source, Source, "read_source(path) returns one")
    check_type("flat", flat, Flat, "read_flat(path) returns one")
    if source.flat is not None:
        raise DataError(f"{source.path}: the recording has a flat already: apply one only")
    shape = source.frames[0].shape
    if flat.smooth.shape != shape:
        raise DataError(
            f"{source.path}: the flat has {_size(flat.smooth.shape)}, the frames have "
            f"{_size(shape)}: calibrate a flat with the settings of this camera"
        )
    if flat.cfa != source.cfa:
        raise DataError(
            f"{source.path}: the flat has the filter pattern {flat.cfa or 'of a gray sensor'}, the "
            f"frames have {source.cfa or 'none'}: calibrate a flat with this camera"
        )
    now = source_setup(source)
    differences = setup_differences(replace(flat.calibrated.setup, rig=""), now)
    if differences:
        raise DataError(
            f"{source.path}: the flat was calibrated with another camera or lens: "
            f"{', '.join(differences)}; calibrate a flat with the camera of these images"
        )
    return replace(source, flat=flat)


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]} pixels{' in colour' if len(shape) == 3 else ''}"
