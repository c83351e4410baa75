"""Frames of a calibration of the sensor: repeats of exposures, and dark frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from math import ceil, log2

import numpy as np

from acquisition import LINEAR, DataError, Frame, Setup, Source
from acquisition.source import same_exposure
from calibration._errors import EstimateError
from rig import pluralize

_FEWEST_EXPOSURES = 5
_LEAST_SIDE = 64


@dataclass(frozen=True, eq=False)
class Repeats:
    """Frames of one light at one exposure time."""

    frames: tuple[Frame, ...]
    time_s: float


@dataclass(frozen=True, eq=False)
class Series:
    """Exposures of one light in one recording, shortest first."""

    name: str
    exposures: tuple[Repeats, ...]


@dataclass(frozen=True, eq=False)
class SensorRecording:
    """Frames for the calibration of one sensor at one gain.

    Parameters
    ----------
    series
        One for each light of each recording.
    darks
        Dark frames of all recordings.
    shape
        ``(H, W)`` of the frames.
    bit_depth
        Bits of the converter.
    gain_db
        Analogue gain, decibels; 0 if it is not known.
    cfa
        Colours of the first 2 x 2 pixels; None without a mosaic.
    setup, time_utc
        Camera, and start of the first recording.
    """

    series: tuple[Series, ...]
    darks: tuple[Frame, ...]
    shape: tuple[int, int]
    bit_depth: int
    gain_db: float
    cfa: str | None
    setup: Setup
    time_utc: datetime | None


def sensor_recording(sources: Sequence[Source]) -> SensorRecording:
    """Sort the frames of recordings of an evenly lit field, and check that they fit together.

    Raises
    ------
    DataError
        If the frames are not raw samples of one camera at one gain with known exposure times.
    EstimateError
        If there are too few exposures, repeats or dark frames.
    """
    if not sources:
        raise EstimateError("no recording: give at least one session of an evenly lit field")
    for source in sources:
        _check_raw(source)
        _check_like(source, sources[0])
    frames = [frame for source in sources for frame in source.frames]
    gains = sorted({frame.gain_db for frame in frames if frame.gain_db is not None})
    if len(gains) > 1:
        raise DataError(
            f"{sources[-1].path}: gains of {gains[0]:g} and {gains[-1]:g} dB are mixed: calibrate "
            "each gain by itself"
        )
    series = tuple(one for source in sources for one in _series(source))
    darks = tuple(frame for frame in frames if frame.role == "dark")
    _check_counts(sources[0], series, darks)
    first = sources[0]
    height, width = first.size
    if min(height, width) < _LEAST_SIDE:
        raise EstimateError(
            f"{first.path}: images of {width} x {height} pixels are too small for statistics: use "
            f"at least {_LEAST_SIDE} x {_LEAST_SIDE}"
        )
    return SensorRecording(
        series,
        darks,
        (height, width),
        _bit_depth(first),
        gains[0] if gains else 0.0,
        first.cfa,
        first.setup,
        first.recorded_utc,
    )


def _check_raw(source: Source) -> None:
    if source.transfer != LINEAR:
        raise DataError(
            f"{source.path}: the samples have the transfer curve {source.transfer.name}, not the "
            "linear one of a sensor: record raw frames of 10 bits or more"
        )
    if not np.isfinite(source.white_level) or source.white_level < 2:
        raise DataError(f"{source.path}: float images are no raw samples: record raw frames")
    if len(source.frames[0].shape) != 2:
        raise DataError(
            f"{source.path}: images of three channels were demosaiced, which changes their noise: "
            "record raw frames"
        )
    unknown = next((f for f in source.frames if not f.exposure_us), None)
    if unknown is not None:
        raise DataError(
            f"{unknown.path}: the exposure time is not known: record a session, or import the "
            "images with the plan of the series"
        )


def _check_like(source: Source, first: Source) -> None:
    """Refuse a recording of another camera or image format than the first."""
    now, then = source.setup, first.setup
    compared = (
        ("serial number", now.camera_serial, then.camera_serial),
        ("model", now.camera_model, then.camera_model),
    )
    for name, one, other in compared:
        if one and other and one != other:
            raise DataError(
                f"{source.path}: a camera of {name} {one}, but {first.path} has {other}: calibrate "
                "each camera by itself"
            )
    for what, value, expected in (
        ("size", source.size, first.size),
        ("colour filter", source.cfa, first.cfa),
        ("bit depth", _bit_depth(source), _bit_depth(first)),
    ):
        if value != expected:
            raise DataError(
                f"{source.path}: {what} {value}, but {first.path} has {expected}: use one camera "
                "in one pixel format"
            )


def _bit_depth(source: Source) -> int:
    if source.noise is not None:
        return source.noise.bit_depth
    return max(8, ceil(log2(source.white_level + 1)))


def _series(source: Source) -> list[Series]:
    """Return the exposures of each light; brackets of equal exposure times are repeats."""
    lights: dict[str, list[tuple[float, list[Frame]]]] = {}
    for frame in source.frames:
        if frame.role != "light" or frame.exposure_us is None:
            continue
        groups = lights.setdefault(frame.light_id, [])
        for time_us, frames in groups:
            if same_exposure(time_us, frame.exposure_us):
                frames.append(frame)
                break
        else:
            groups.append((frame.exposure_us, [frame]))
    return [
        Series(
            f"{source.path}: {light}",
            tuple(Repeats(tuple(frames), us / 1e6) for us, frames in sorted(groups, key=_time)),
        )
        for light, groups in lights.items()
    ]


def _time(group: tuple[float, list[Frame]]) -> float:
    return group[0]


def _check_counts(first: Source, series: Sequence[Series], darks: Sequence[Frame]) -> None:
    if not series:
        raise EstimateError(f"{first.path}: no frames with light: record an evenly lit field")
    most = max(series, key=lambda one: len(one.exposures))
    if len(most.exposures) < _FEWEST_EXPOSURES:
        raise EstimateError(
            f"{most.name}: {pluralize(len(most.exposures), 'exposure')}, at least "
            f"{_FEWEST_EXPOSURES} are necessary: record more brackets"
        )
    single = next((one for one in series for group in one.exposures if len(group.frames) < 2), None)
    if single is not None:
        raise EstimateError(
            f"{single.name}: a single frame per exposure does not show the noise: record with "
            "repeats = 2 or more"
        )
    times = {f.exposure_us for f in darks}
    if len(darks) < 2 + (len(times) > 1):
        raise EstimateError(
            f"{first.path}: {pluralize(len(darks), 'dark frame')}, too few for the noise in the "
            "dark: record with dark = true and at least 3 exposure times"
        )
