"""The measured noise of a sensor for a recording that does not state it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition._errors import DataError
from acquisition._source.source import Source
from acquisition._values.measured_sensor import MeasuredSensor
from acquisition._values.setup import Setup
from acquisition._values.transfer_curve import LINEAR
from rig import Notice

# Gains in decibels that differ by less are equal.
_SAME_GAIN_DB = 0.05


def with_sensor(source: Source, sensor: MeasuredSensor) -> Source:
    """Return a recording whose noise, black level and white level are those of a measured sensor.

    Parameters
    ----------
    source
        Recording of raw samples; a noise model that it states itself is replaced.
    sensor
        The sensor of its camera, for example from `read_sensor`. Another gain is taken into
        account; if the gain of the recording is not known, it counts as that of the measurement.

    Returns
    -------
    Source
        With notices ``sensor-of-another-camera`` and ``sensor-of-another-gain`` where they apply.

    Raises
    ------
    DataError
        If the samples are not linear, have another bit depth, or were recorded with several gains.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Measured, MeasuredSensor, read_source, with_sensor, write_png
    >>> write_png("card.png", np.full((40, 50), 4095, np.uint16))
    >>> black, nothing = Measured(64.0, 0.1), Measured(0.0, 0.0)
    >>> sensor = MeasuredSensor(12, 0.0, Measured(2.5, 0.01), nothing, black, *[nothing] * 3)
    >>> source = with_sensor(read_source("card.png"), sensor)
    >>> source.noise
    NoiseModel(2.5 e/DN, read noise 0 e, black level 64 DN, 12 bit)
    """
    if source.transfer != LINEAR:
        raise DataError(
            f"{source.path}: the samples have the transfer curve {source.transfer.name}, but the "
            "noise of a sensor is that of linear samples: leave out the sensor"
        )
    end_dn = 2**sensor.bit_depth - 1
    if not end_dn / 2 < source.white_level <= end_dn:
        raise DataError(
            f"{source.path}: samples up to {source.white_level:g}, but the sensor was measured "
            f"with {sensor.bit_depth} bits: measure it in this pixel format"
        )
    gains_db = {frame.gain_db for frame in source.frames if frame.gain_db is not None}
    if len(gains_db) > 1:
        raise DataError(
            f"{source.path}: frames with several gains have no common noise: leave out the sensor"
        )
    gain_db = gains_db.pop() if gains_db else sensor.gain_db
    noise = sensor.noise_model(gain_db)
    return replace(
        source,
        noise=noise,
        black_level=noise.black_level_dn,
        white_level=min(source.white_level, float(noise.white_level_dn)),
        warnings=(*source.warnings, *sensor_notices(sensor, source.setup, gain_db)),
    )


def sensor_notices(sensor: MeasuredSensor, setup: Setup, gain_db: float) -> tuple[Notice, ...]:
    """Return warnings if a sensor was measured with another camera or gain.

    Parameters
    ----------
    sensor
        The measured sensor.
    setup
        Camera of the recording; what one of them does not state is not compared.
    gain_db
        Analogue gain of the recording, decibels.

    Examples
    --------
    >>> from acquisition import Measured, MeasuredSensor, Setup, sensor_notices
    >>> nothing = Measured(0.0, 0.0)
    >>> sensor = MeasuredSensor(12, 0.0, Measured(2.5, 0.01), *[nothing] * 5)
    >>> [notice.code for notice in sensor_notices(sensor, Setup(), gain_db=6.0)]
    ['sensor-of-another-gain']
    """
    notices = []
    then = sensor.setup
    pairs = (
        (setup.camera_serial, then.camera_serial),
        (setup.camera_model, then.camera_model),
    )
    other = next((pair for pair in pairs if all(pair) and pair[0] != pair[1]), None)
    if other is not None:
        text = f"the sensor was measured with camera {other[1]}, but this is {other[0]}"
        notices.append(Notice("sensor-of-another-camera", text))
    if not np.isclose(gain_db, sensor.gain_db, rtol=0, atol=_SAME_GAIN_DB):
        text = (
            f"the sensor was measured at {sensor.gain_db:g} dB, but the gain is {gain_db:g} dB: "
            "its read noise in electrons may differ"
        )
        notices.append(Notice("sensor-of-another-gain", text))
    return tuple(notices)
