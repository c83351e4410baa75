"""Rig, camera, lens and sensor of a source, and whether its calibrations belong to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acquisition._errors import DataError
from acquisition.source.source import Source
from acquisition.values.camera_model import CameraModel
from acquisition.values.flat import Flat
from acquisition.values.measured_sensor import MeasuredSensor
from acquisition.values.setup import Setup
from acquisition.values.transfer_curve import LINEAR
from rig import Notice, check_type

# A focal length wrong by 1 % moves lights by about a hundredth of their distance; two calibrations
# of one camera agree better than this.
_SAME = 0.005
# Gains in decibels that differ by less are equal.
_SAME_GAIN_DB = 0.05


def source_setup(source: Source) -> Setup:
    """Return rig, camera and lens of a recording; the lens is that of its complete images.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, crop, read_source, write_png
    >>> from acquisition.source import source_setup
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> camera = CameraModel([[90, 0, 25], [0, 90, 20], [0, 0, 1]], 50, 40)
    >>> part = crop(read_source("card.png", camera=camera), 10, 10, 20, 20)
    >>> source_setup(part).intrinsics
    CameraModel(50 x 40 px, focal length 90.0 px)
    """
    check_type("source", source, Source, "read_source(path) returns one")
    return replace(source.setup, intrinsics=_complete(source))


def setup_notices(source: Source) -> tuple[Notice, ...]:
    """Return warnings if the lights of a source were calibrated with another rig or camera.

    What one of them does not state is not compared. Images of another size are the same camera if
    they show the same field of view; without a camera of the recording, only their size is known,
    which counts under lights with positions.

    Parameters
    ----------
    source
        Recording with lights.

    Returns
    -------
    tuple[Notice, ...]
        ``lights-of-another-rig`` and ``lights-of-another-camera``, each at most once.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, Lights, Setup, read_source, write_png
    >>> from acquisition.values import Calibrated
    >>> from acquisition.source import setup_notices
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> old, new = (CameraModel([[f, 0, 25], [0, f, 20], [0, 0, 1]], 50, 40) for f in (90, 95))
    >>> lights = Lights([[0, 0, 1]], calibrated=Calibrated(setup=Setup(intrinsics=old)))
    >>> source = read_source("card.png", lights=lights, camera=new)
    >>> [notice.code for notice in setup_notices(source)]
    ['lights-of-another-camera']
    """
    check_type("source", source, Source, "read_source(path) returns one")
    if source.lights is None or source.lights.calibrated is None:
        return ()
    then, now, where = source.lights.calibrated.setup, source_setup(source), str(source.path)
    notices = []
    if then.rig and now.rig and then.rig != now.rig:
        text = (
            f"the lights were calibrated on the rig {then.rig}, the images were recorded on "
            f"{now.rig}: give the lights of this rig"
        )
        notices.append(Notice("lights-of-another-rig", text, where))
    differences = setup_differences(replace(then, rig=""), now)
    height, width = source.frames[0].shape[:2]
    seen = then.intrinsics if source.lights.near and source.camera is None else None
    if seen is not None and seen.size != (height, width):
        size = f"images of {seen.width} x {seen.height} pixels, now {width} x {height}"
        differences = (*differences, size)
    if differences:
        text = (
            f"the lights were calibrated with another camera or lens: {', '.join(differences)}; "
            "calibrate with the camera of these images, or state it"
        )
        notices.append(Notice("lights-of-another-camera", text, where))
    return tuple(notices)


def setup_differences(then: Setup, now: Setup, share: float = _SAME) -> tuple[str, ...]:
    """Return what differs between the rigs, cameras and lenses of two setups, each in a few words.

    What one of them does not state is not compared. Images of another size are the same camera if
    they show the same field of view.

    Parameters
    ----------
    then, now
        Setups of a calibration and of a recording, or of two recordings.
    share
        Lenses differ if rays at the same places differ by more than this share of half the field
        of view, or working distances by more than this share.

    Examples
    --------
    >>> from acquisition import Setup
    >>> from acquisition.source import setup_differences
    >>> setup_differences(Setup(rig="dome", camera_model="M2"), Setup(rig="arc"))
    ('rig dome, now arc',)
    """
    names = (
        ("rig", then.rig, now.rig),
        ("model", then.camera_model, now.camera_model),
        ("serial number", then.camera_serial, now.camera_serial),
    )
    differences = [f"{name} {a}, now {b}" for name, a, b in names if a and b and a != b]
    return (*differences, *_lens_differences(then, now, share))


def lens_notices(source: Source, camera: CameraModel) -> tuple[Notice, ...]:
    """Return a warning if a camera was calibrated with another lens or focus than a recording.

    What one of them does not state is not compared.

    Parameters
    ----------
    source
        Recording, with the camera that it states.
    camera
        Camera that is used instead.

    Returns
    -------
    tuple[Notice, ...]
        ``camera-of-another-lens``, at most once.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, read_source, write_png
    >>> from acquisition.source import lens_notices
    >>> write_png("card.png", np.full((40, 50), 700, np.uint16))
    >>> K = [[90, 0, 25], [0, 90, 20], [0, 0, 1]]
    >>> recorded = read_source("card.png", camera=CameraModel(K, 50, 40, lens="16 mm"))
    >>> [notice.code for notice in lens_notices(recorded, CameraModel(K, 50, 40, lens="25 mm"))]
    ['camera-of-another-lens']
    """
    check_type("source", source, Source, "read_source(path) returns one")
    differences = [] if source.camera is None else _named_differences(camera, source.camera)
    if not differences:
        return ()
    text = (
        f"the camera was calibrated with another lens or focus: {', '.join(differences)}; "
        "calibrate with the lens of these images"
    )
    return (Notice("camera-of-another-lens", text, str(source.path)),)


def _named_differences(a: CameraModel, b: CameraModel) -> list[str]:
    """Return what differs between the stated lenses and their focus."""
    differences = []
    if a.lens and b.lens and a.lens != b.lens:
        differences.append(f"lens {a.lens}, now {b.lens}")
    if _differ(a.focus_mm, b.focus_mm, _SAME):
        differences.append(f"focus at {a.focus_mm:g} mm, now {b.focus_mm:g} mm")
    return differences


def _complete(source: Source) -> CameraModel | None:
    """Return the calibrated camera of the complete images, of which the source may be a region."""
    camera, part = source.calibrated_camera, source.reduction
    if camera is None or part is None:
        return camera
    K = camera.K.copy()
    K[:2] *= part.factor
    K[:2, 2] += (part.factor - 1) / 2 + np.array([part.x, part.y])
    height, width = source.frames[0].shape[:2]
    return replace(camera, K=K, width=width, height=height)


def _lens_differences(then: Setup, now: Setup, limit: float) -> list[str]:
    a, b = then.intrinsics, now.intrinsics
    if a is None or b is None:
        return []
    differences = _named_differences(a, b)
    share = _field_difference(a, b)
    if share > limit:
        what = (
            f"focal length {_focal(a)}, now {_focal(b)}"
            if _differ(a.focal_px / a.width, b.focal_px / b.width, limit)
            else f"rays that differ by {share:.1%} of the field of view"
        )
        differences.append(what)
    first, second = a.working_distance_mm, b.working_distance_mm
    if _differ(first, second, limit):
        differences.append(f"working distance {first:g} mm, now {second:g} mm")
    return differences


def _differ(one: float | None, other: float | None, share: float) -> bool:
    return one is not None and other is not None and abs(one / other - 1) > share


def _focal(camera: CameraModel) -> str:
    return f"{camera.focal_px:.0f} px at {camera.width} x {camera.height}"


def _field_difference(a: CameraModel, b: CameraModel) -> float:
    """Return the largest difference of rays at the same places, relative to half the field."""
    share = np.linspace(0, 1, 5)
    places = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    first, second = (
        camera.rays(places * (camera.width, camera.height) - 0.5)[:, :2] for camera in (a, b)
    )
    field = np.linalg.norm(first - first.mean(axis=0), axis=1).max()
    return float(np.linalg.norm(first - second, axis=1).max() / field)


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
    >>> from acquisition import Flat, read_source, write_png
    >>> from acquisition.source import apply_flat
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
    >>> from acquisition import MeasuredSensor, read_source, write_png
    >>> from acquisition.source import with_sensor
    >>> from acquisition.values import Measured
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
    >>> from acquisition import MeasuredSensor, Setup
    >>> from acquisition.source import sensor_notices
    >>> from acquisition.values import Measured
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
