"""A whole rig without hardware: the real client and controller on a virtual board and camera."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from acquisition import NoiseModel
from rig import Board, Rig, RigConfig
from simulator._bench_state import BenchState
from simulator._lamps import Lamps
from simulator._virtual_board import VirtualBoard
from simulator._virtual_camera import CameraFault, Planes, VirtualCamera


def simulated_rig(
    planes: Planes,
    config: RigConfig,
    *,
    size: tuple[int, int],
    noise: NoiseModel,
    seed: int = 0,
    noisy: bool = True,
    realtime: bool = True,
    camera_name: str = "virtual-camera",
    cfa: str | None = None,
    lamps: Lamps | None = None,
    shake_px: float = 0.0,
    sensor_seed: int = 0,
    camera_faults: Mapping[int, CameraFault] | None = None,
) -> Rig:
    """Start a virtual board in its own process and open a rig on it; closing the rig ends all.

    Parameters
    ----------
    planes
        What each LED, and the ambient light, yields: see `VirtualCamera`. Have them rendered.
    config
        The rig's configuration; the board has its LED count.
    size, noise, seed, noisy, realtime, cfa, lamps, shake_px, sensor_seed, camera_faults
        See `VirtualCamera`.
    camera_name
        The camera's serial number.

    Raises
    ------
    RigError
        If the board's process or the rig does not come up; nothing is left running then.
    """
    with contextlib.ExitStack() as opened:
        virtual = opened.enter_context(VirtualBoard(config.leds))
        board = Board(virtual.port)
        opened.callback(board.close)
        bench = opened.enter_context(BenchState(virtual.bench_state_path))
        camera = VirtualCamera(
            planes,
            size=size,
            bench=bench,
            noise=noise,
            seed=seed,
            noisy=noisy,
            realtime=realtime,
            name=camera_name,
            cfa=cfa,
            lamps=lamps or Lamps(),
            shake_px=shake_px,
            sensor_seed=sensor_seed,
            faults=camera_faults,
        )
        rig = Rig(board, camera, config, on_close=virtual.close)
        opened.pop_all()
    return rig
