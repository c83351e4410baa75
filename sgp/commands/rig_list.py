"""``sgp rig list``: installed rigs, connected boards and cameras."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import rig
from sgp._exit import UsageError
from sgp._result import Result
from sgp._user_config import default_rig, how_to_configure


def list_(*, port: tuple[str, ...] = (), cti: tuple[Path, ...] = ()) -> Result:
    """List the installed rigs, the serial ports with the boards that answer, and the cameras.

    For example:

        sgp rig list
        sgp rig list --port /dev/ttyUSB0 --cti /opt/maker/lib/producer.cti

    Parameters
    ----------
    port
        Serial port on which to look for an LED board; default: all ports of this computer.
    cti
        GenTL producer (.cti file) of a camera vendor whose cameras to list.
    """
    missing = next((path for path in cti if not path.exists()), None)
    if missing is not None:
        raise UsageError(
            f"--cti {missing}: no such file; give the path of the .cti file that was installed "
            "with the camera's driver"
        )
    # Cameras first: a wrong producer fails at once, while silent ports take seconds.
    cameras = rig.find_cameras(cti) if cti else ()
    ports = rig.find_boards(port or None)
    names, default = list(rig.rig_names()), default_rig()
    boards = [found for found in ports if found.identity is not None]
    summary = [
        f"rigs     {', '.join(names)}",
        f"default  none: give --rig; for a default, {how_to_configure()}"
        if default is None
        else f"default  {default.name}, from {default.origin}",
        *map(_answer, ports),
        *(f"camera   {found}" for found in cameras),
    ]
    if not boards:
        summary.append("no LED board was found: plug one in, or give its port with --port")
    if not cti:
        summary.append("to list cameras, give the GenTL producer of their vendor with --cti")
    elif not cameras:
        summary.append("no camera was found: check its cable and power, and close other programs")
    return Result(
        metrics={
            "rigs": names,
            "default_rig": None if default is None else asdict(default),
            "ports": [_port(found) for found in ports],
            "cameras": [_camera(found) for found in cameras],
        },
        summary=summary,
    )


def _answer(found: rig.FoundPort) -> str:
    board = found.identity
    if board is None:
        return f"port     {found.problem.removeprefix('LED board on ')}"
    return f"board    {board.name} on {found.port}, {board.leds} LEDs, firmware {board.firmware}"


def _port(found: rig.FoundPort) -> dict[str, Any]:
    board = None if found.identity is None else asdict(found.identity)
    return {"port": found.port, "board": board, "complaint": found.problem}


def _camera(found: rig.FoundCamera) -> dict[str, Any]:
    return {"vendor": found.vendor, "model": found.model, "serial": found.serial, "cti": found.cti}
