"""A complete rig without hardware: the real client and controller on a virtual board and camera."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

from rig import Board, Camera, Rig, RigConfig, RigConfigError
from rig.arrays import Float32
from rig.genicam import open_genicam
from simulator.bench.state import BenchState
from simulator.bench.wiring import Planes, Wiring
from simulator.camera.gentl_camera import GentlCamera, GentlDevice
from simulator.camera.sensor import ImageFormation, pixel_format
from simulator.camera.virtual_camera import VirtualCamera
from simulator.gentl import CompilerError, build
from simulator.led_board.virtual_board import VirtualBoard

CameraKind = Literal["auto", "gentl", "inside"]

FRAME_RATE_HZ = 200.0
_DEPTHS = (8, 10, 12, 16)
IN_PYTHON = "virtual camera in Python"


def simulated_rig(
    planes: Planes,
    config: RigConfig,
    *,
    size: tuple[int, int],
    formation: ImageFormation,
    realtime: bool = True,
    camera: CameraKind = "auto",
    frame_rate_hz: float = FRAME_RATE_HZ,
    wiring: Wiring | None = None,
) -> Rig:
    """Start a virtual board in its own process and open a rig with it and a virtual camera.

    Closing the rig ends all of them.

    Parameters
    ----------
    planes
        Image of each LED and of the ambient light, see `VirtualCamera`; render them beforehand.
    config
        Configuration of the rig; the board has its LED count. ``planes`` are upright; they are
        turned and mirrored as the mounting of the camera requires.
    size, realtime
        See `VirtualCamera`.
    formation
        How the image forms; its ``cfa`` is that of the upright planes.
    camera
        ``gentl``: a GenICam camera behind a GenTL producer, opened by the same code as a real
        camera. ``inside``: a `VirtualCamera` in this process. Only this camera can run without
        waiting for exposures (``realtime`` False); it has no exposure-active output for single
        flashes. ``auto``: ``gentl`` if it supports the options and there is a C compiler,
        otherwise ``inside``.
    frame_rate_hz
        Maximum frame rate of the GenICam camera.
    wiring
        Wiring faults of the LEDs.

    Raises
    ------
    RigConfigError
        If the requested camera does not support the options.
    RigError
        If the board's process or the rig does not start; all processes have ended then.

    Examples
    --------
    >>> import numpy as np
    >>> from rig import RigConfig
    >>> from simulator import bench_sensor, simulated_rig
    >>> from simulator.camera import ImageFormation
    >>> planes = {None: np.zeros((52, 64), np.float32), 0: np.ones((52, 64), np.float32)}
    >>> config = RigConfig(name="desk", driver="simulated", leds=1)
    >>> even = {"formation": ImageFormation(bench_sensor()), "realtime": False, "camera": "inside"}
    >>> with simulated_rig(planes.get, config, size=(52, 64), **even) as rig:
    ...     shot = rig.shoot(0, exposure_us=10_000.0)
    >>> shot.led
    0
    """
    seen = _mounted((wiring or Wiring()).planes(planes), config)
    height, width, *_ = config.mounting.upright_shape(size)
    if formation.cfa is not None:
        formation = replace(formation, cfa=config.mounting.stored_cfa(formation.cfa, size))
    bit_depth = formation.noise.bit_depth
    odd_depth = bit_depth not in _DEPTHS
    inside_only = not realtime or odd_depth
    if camera == "gentl" and inside_only:
        raise RigConfigError(
            f"rig {config.name}: the camera 'gentl' has {', '.join(map(str, _DEPTHS))} bits and "
            "waits for exposures: use the camera 'inside', or keep the default of "
            f"{'bit_depth' if odd_depth else 'realtime'}"
        )
    wanted = "inside" if inside_only else camera
    lacking = None if wanted == "inside" or camera == "gentl" else _why_not_built()
    with contextlib.ExitStack() as opened:
        # What the rig ends when it is closed.
        closing = opened.enter_context(contextlib.ExitStack())
        virtual = closing.enter_context(VirtualBoard(config.leds))
        board = Board(virtual.port)
        opened.callback(board.close)
        open_camera: Callable[[], Camera]
        if wanted != "inside" and lacking is None:
            gentl_camera = GentlCamera(
                lambda led: seen(led)[:],
                size=(height, width),
                leds=config.leds,
                formation=formation,
                device=GentlDevice(frame_rate_hz=frame_rate_hz),
                bench_state_path=virtual.bench_state_path,
            )
            closing.enter_context(gentl_camera)
            format_ = pixel_format(formation.cfa, bit_depth)
            open_camera = partial(open_genicam, gentl_camera.cti, pixel_format=format_)
        else:

            def open_camera() -> Camera:
                inside = VirtualCamera(
                    seen,
                    size=(height, width),
                    bench=BenchState(virtual.bench_state_path),
                    formation=formation,
                    realtime=realtime,
                )
                if lacking is not None:
                    inside.info = replace(inside.info, model=f"{IN_PYTHON} ({lacking})")
                return inside

        rig = Rig(board, open_camera(), config, on_close=closing.close, open_camera=open_camera)
        opened.pop_all()
    return rig


def _why_not_built() -> str | None:
    """Build the GenTL producer; return the reason if it cannot be built, otherwise None."""
    try:
        build()
    except CompilerError as error:
        return str(error)
    return None


def _mounted(planes: Planes, config: RigConfig) -> Planes:
    """Return upright planes as the sensor sees them with the mounting of the camera."""
    mounting = config.mounting
    if mounting == type(mounting)():
        return planes

    def stored(led: int | None) -> Float32:
        return mounting.stored(planes(led)[:])

    return stored
