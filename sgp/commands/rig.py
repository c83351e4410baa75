"""``sgp rig``: talk to board and camera."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from acquisition import write_tiff
from rig import Rig, open_rig, rig_names
from sgp._exit import UsageError
from sgp._options import Positive, Whole
from sgp._output import check_file
from sgp._result import Result


def list_() -> Result:
    """Name the rigs that are installed.

    For example:

        sgp rig list
    """
    names = list(rig_names())
    return Result(metrics={"rigs": names}, summary=names)


def check(*, rig: str = "simulated") -> Result:
    """Open a rig and tell what board and camera it has.

    For example:

        sgp rig check --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or a rig.toml.
    """
    with open_rig(rig) as opened:
        board, camera, config = opened.board.identity, opened.camera.info, opened.config
        dead = ", ".join(map(str, config.dead_leds)) or "none"
        status = opened.board.status()
        return Result(
            metrics={
                "rig": config.name,
                "board": {
                    "name": board.name,
                    "protocol": board.protocol,
                    "firmware": board.firmware,
                    "leds": board.leds,
                    "port": opened.board.port,
                    "faults": status.faults,
                },
                "camera": {
                    "vendor": camera.vendor,
                    "model": camera.model,
                    "serial": camera.serial,
                    "width": camera.width,
                    "height": camera.height,
                    "pixel_format": camera.pixel_format,
                    "exposure_us": [camera.exposure_min_us, camera.exposure_max_us],
                },
            },
            summary=[
                f"rig     {config.name}, {config.leds} LEDs, dead: {dead}",
                f"board   {board.name} on {opened.board.port}, firmware {board.firmware}, "
                f"protocol {board.protocol}",
                f"camera  {camera.vendor} {camera.model} {camera.serial}, "
                f"{camera.width} x {camera.height} {camera.pixel_format}, "
                f"exposure {camera.exposure_min_us:g} to {camera.exposure_max_us:g} us",
            ],
        )


def light(led: Whole, *, rig: str = "simulated", seconds: Positive = 5.0) -> Result:
    """Light one LED for a while; Ctrl-C turns it off.

    For example:

        sgp rig light 7 --seconds 3

    Parameters
    ----------
    led
        LED number from 0.
    rig
        Name of a rig, or a rig.toml.
    seconds
        How long; the board itself turns the LED off then, whatever happens to this program.
    """
    with open_rig(rig) as opened:
        longest = opened.board.identity.max_hold_ms / 1000
        if seconds > longest:
            raise UsageError(f"--seconds {seconds:g}: this board lights for up to {longest:g} s")
        _check_led(opened, led)
        opened.board.on(led, round(seconds * 1000))
        time.sleep(seconds)
        opened.off()
    return Result(metrics={"led": led, "seconds": seconds}, summary=[f"LED {led} is off again"])


def off(*, rig: str = "simulated") -> Result:
    """Turn every LED off.

    For example:

        sgp rig off --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or a rig.toml.
    """
    with open_rig(rig) as opened:
        opened.off()
    return Result(summary=["all LEDs are off"])


def snap(
    *,
    out: Path,
    led: Whole | None = None,
    exposure_us: Positive = 20_000.0,
    rig: str = "simulated",
    force: bool = False,
) -> Result:
    """Take one frame under one LED, or in the dark.

    For example:

        sgp rig snap --led 3 --exposure-us 10000 --out frame.tif

    Parameters
    ----------
    out
        TIFF to write, 16 bit, grey values as the sensor gave them.
    led
        LED number from 0; default: none.
    exposure_us
        Exposure time.
    rig
        Name of a rig, or a rig.toml.
    force
        Replace a file that exists.
    """
    check_file(out, ".tif", force=force)
    with open_rig(rig) as opened:
        if led is not None:
            _check_led(opened, led)
        shot = opened.shoot(led, exposure_us)
        white = 2**opened.camera.info.bit_depth - 1
    pixels = shot.frame.pixels
    write_tiff(out, pixels)
    clipped = float(np.mean(pixels >= white))
    low, high = (float(value) for value in np.percentile(pixels, [1, 99]))
    return Result(
        outputs={"frame": out},
        metrics={"clipped_fraction": clipped, "p1_dn": low, "p99_dn": high, "white_dn": white},
        summary=[f"{out}: 1 % at {low:g}, 99 % at {high:g} of {white}, {clipped:.3%} clipped"],
    )


def _check_led(opened: Rig, led: int) -> None:
    config = opened.config
    if not 0 <= led < config.leds:
        raise UsageError(f"LED {led} does not exist: {config.name} has 0 to {config.leds - 1}")
    if led in config.dead_leds:
        raise UsageError(f"LED {led} of {config.name} is listed as dead: choose another")
