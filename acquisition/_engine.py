"""The capture engine: carry a plan out on a rig and leave a session, whatever happens."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from acquisition._camera_model import CameraModel
from acquisition._errors import DataError, StorageError
from acquisition._journal import Echo, FrameLine
from acquisition._lights import Lights, led_id
from acquisition._manifest import Manifest
from acquisition._noise_model import NoiseModel
from acquisition._plan import CapturePlan, PlannedShot
from acquisition._session import Session
from acquisition._session_writer import SessionWriter
from rig import CameraError, CameraInfo, Rig, RigError, Shot

OnFrame = Callable[[FrameLine, int, int], None]


def record(
    rig: Rig,
    plan: CapturePlan,
    folder: str | Path,
    *,
    operator: str,
    object_name: str,
    notes: str = "",
    camera_model: CameraModel | None = None,
    sensor: NoiseModel | None = None,
    lights: Lights | None = None,
    on_frame: OnFrame | None = None,
) -> Session:
    """Record one object: every shot of the plan, each safe on disk before the next is taken.

    Stop-and-go in one thread; writing beside shooting is not done yet.

    Parameters
    ----------
    rig
        Open rig. It stays open.
    plan
        What to capture.
    folder
        New or empty folder for the session.
    operator, object_name, notes
        Who records what, for people.
    camera_model, sensor, lights
        Calibrations to store with the recording, where known. The sensor gives black and white
        level; without it black is 0 and white the greatest value of the camera's bit depth. The
        lights are those of the LEDs by their ids, ``L07`` for LED 7; there may be more of them.
    on_frame
        Called after each frame with its journal line, how many are done, and how many there are.

    Returns
    -------
    Session
        Complete.

    Raises
    ------
    DataError
        If the plan does not fit the rig, a calibration does not fit the camera, lights are missing
        for an LED of the plan, or a frame is not what the camera announced.
    StorageError
        If the folder is not empty or is being recorded into, or the disk refuses.
    RigError
        If board or camera fail.

    Notes
    -----
    On any error, KeyboardInterrupt too, the LEDs are turned off first. The session stays behind
    whole and incomplete, with an ``interrupted`` or ``failed`` event where the disk still takes
    one, and the error goes on to the caller.
    """
    plan.check(rig.config.leds, rig.config.dead_leds)
    _check_exposures(rig.camera.info, plan)
    _check_calibrations(rig.camera.info, camera_model, sensor)
    if lights is not None:
        _check_lights(lights, plan)
    manifest = Manifest.begin(
        folder,
        operator=operator,
        object=object_name,
        notes=notes,
        plan=plan,
        rig=_rig_record(rig),
        camera=_camera_record(rig.camera.info, sensor),
        camera_model=camera_model,
        sensor=sensor,
        lights=lights,
    )
    with SessionWriter.create(folder, manifest) as writer:
        try:
            shots = writer.missing
            for done, shot in enumerate(shots, 1):
                line = _write(writer, shot, rig.shoot(shot.led, _exposure(shot), plan.gain_db))
                if on_frame is not None:
                    on_frame(line, done, len(shots))
        except BaseException as error:
            _stop(rig, writer, error)
            raise
        writer.complete()
    return Session.open(folder)


def _exposure(shot: PlannedShot) -> float:
    if shot.exposure_us is None:
        raise DataError(f"{shot.file}: the plan gives no exposure")
    return shot.exposure_us


def _write(writer: SessionWriter, planned: PlannedShot, shot: Shot) -> FrameLine:
    frame, echo = shot.frame, shot.echo
    return writer.write_frame(
        planned,
        frame.pixels,
        exposure_us=frame.exposure_us,
        gain_db=frame.gain_db,
        frame_id=frame.frame_id,
        timestamp_ns=frame.timestamp_ns,
        temperature_c=frame.temperature_c,
        echo=None if echo is None else Echo(seq=echo.seq, led=echo.led),
    )


def _stop(rig: Rig, writer: SessionWriter, error: BaseException) -> None:
    """Go dark, then note in the journal why; neither may hide the error itself."""
    dark = True
    try:
        rig.off()
    except RigError as failure:
        dark = False
        note = f"LEDs not confirmed off: {failure}"
        if note not in getattr(error, "__notes__", ()):  # the rig may have tried in vain already
            error.add_note(note)
    event = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
    reason = str(error) or type(error).__name__
    with suppress(StorageError, DataError):
        writer.write_event(event, reason=reason, leds_confirmed_off=dark)


def _check_exposures(info: CameraInfo, plan: CapturePlan) -> None:
    """Refuse what the camera cannot do before a folder is made for it."""
    low, high = info.exposure_min_us, info.exposure_max_us
    for exposure_us in plan.exposures_us:
        if not low <= exposure_us <= high:
            raise CameraError(
                f"the plan asks for {exposure_us:g} us, camera {info.model} {info.serial} exposes "
                f"for {low:g} to {high:g} us: correct exposures_us in the plan"
            )


def _check_calibrations(
    info: CameraInfo, camera_model: CameraModel | None, sensor: NoiseModel | None
) -> None:
    if camera_model is not None and camera_model.size != (info.height, info.width):
        raise DataError(
            f"the camera model is for {camera_model.width} x {camera_model.height} pixels, the "
            f"camera delivers {info.width} x {info.height}; calibrate it at this size"
        )
    if sensor is not None and sensor.bit_depth != info.bit_depth:
        raise DataError(
            f"the sensor model is for {sensor.bit_depth} bits, the camera delivers "
            f"{info.bit_depth}; measure it in this pixel format"
        )


def _check_lights(lights: Lights, plan: CapturePlan) -> None:
    """Refuse lights that would be found missing, or be matched by order, when it is too late."""
    wanted = [led_id(led) for led in plan.leds]
    try:
        _, by_name = lights.match(wanted)
    except DataError as error:
        raise DataError(f"the lights do not fit the plan: {error}") from error
    if not by_name:
        raise DataError(
            f"the lights are called {lights.ids[0]} and so on, the plan lights {wanted[0]} and so "
            "on: give the lights of this rig, called after its LEDs"
        )


def _rig_record(rig: Rig) -> dict[str, Any]:
    config, board = rig.config, rig.board.identity
    return {
        "name": config.name,
        "driver": config.driver,
        "board": board.name,
        "protocol": str(board.protocol),
        "firmware": board.firmware,
        "leds": board.leds,
    }


def _camera_record(info: CameraInfo, sensor: NoiseModel | None) -> dict[str, Any]:
    return {
        "vendor": info.vendor,
        "model": info.model,
        "serial": info.serial,
        "width": info.width,
        "height": info.height,
        "pixel_format": info.pixel_format,
        "bit_depth": info.bit_depth,
        "cfa": info.cfa,
        "black_level_dn": 0.0 if sensor is None else sensor.black_level_dn,
        "white_level_dn": None if sensor is None else sensor.white_level_dn,
    }
