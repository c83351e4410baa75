"""``sgp rig``: talk to board and camera."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

from acquisition import write_tiff
from rig import (
    BoardError,
    BoardStatus,
    RigConfig,
    open_lights,
    open_rig,
    rig_names,
)
from rig import selftest as examine
from sgp._console import Stages
from sgp._exit import UsageError
from sgp._options import Microseconds, Positive, Whole
from sgp._output import check_file
from sgp._result import Result

# The board's watchdog turns the light off after a second without a sign of life.
_SIGN_EVERY_S = 0.25
# The board's own hold ends so much later than the light is wanted; its clock may be 1 % too fast.
_SPARE_HOLD_MS = 3000
_CLOCK = 0.99
_HOT_C = 70.0


def check(*, rig: str = "simulated") -> Result:
    """Open a rig and tell what board and camera it has, and what looks wrong.

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
        readout = f", rolling shutter of {camera.readout_us:g} us" * (camera.shutter == "rolling")
        rate = f", {1e6 / camera.frame_period_us:.4g} frames/s" if camera.frame_period_us else ""
        heat = "" if status.temperature_c is None else f", {status.temperature_c:.0f} C"
        return Result(
            metrics={
                "rig": config.name,
                "trigger": config.trigger,
                "board": {
                    **asdict(board),
                    "port": opened.board.port,
                    "faults": status.faults,
                    "trips": status.trips,
                    "uptime_ms": status.uptime_ms,
                    "temperature_c": status.temperature_c,
                },
                "camera": {
                    **asdict(camera),
                    "exposure_us": [camera.exposure_min_us, camera.exposure_max_us],
                },
            },
            summary=[
                f"rig     {config.name}, {config.leds} LEDs, dead: {dead}, {_mounted(config)}",
                f"board   {board.name} on {opened.board.port}, firmware {board.firmware}, "
                f"protocol {board.protocol}{heat}",
                f"camera  {camera.vendor} {camera.model} {camera.serial}, "
                f"{camera.width} x {camera.height} {camera.pixel_format}, "
                f"exposure {camera.exposure_min_us:g} to {camera.exposure_max_us:g} us{readout}"
                f"{rate}",
                f"trigger by {config.trigger}",
                *[f"off     {', '.join(camera.turned_off)}: turned off in the camera"]
                * bool(camera.turned_off),
            ],
            warnings=_doubts(status, config),
        )


def light(led: Whole, *, rig: str = "simulated", seconds: Positive = 5.0) -> Result:
    """Light one LED for a while; Ctrl-C turns it off. Of a bench only the board is needed.

    For example:

        sgp rig light 7 --seconds 3 --rig bench.toml

    Parameters
    ----------
    led
        LED number from 0.
    rig
        Name of a rig, or a rig.toml.
    seconds
        How long. The board itself turns the LED off 3 s later, or a second after this program
        died.
    """
    with open_lights(rig) as opened:
        board = opened.board
        longest = board.identity.max_hold_ms
        if seconds * 1000 > longest:
            raise UsageError(
                f"--seconds {seconds:g}: this board lights for up to {longest / 1000:g} s"
            )
        _check_led(opened.config, led)
        # Beyond the end: who is to turn it off then is this program.
        hold_ms = min(longest, round(seconds * 1000 + _SPARE_HOLD_MS))
        began_s = time.monotonic()
        board.on(led, hold_ms)
        while (left_s := began_s + seconds - time.monotonic()) > 0:
            time.sleep(min(left_s, _SIGN_EVERY_S))
            board.ping()
        burned = board.off().led
        held = (time.monotonic() - began_s) * 1000 < hold_ms * _CLOCK
        if burned != led and held:
            raise BoardError(
                f"LED board on {board.port}: LED {led} was lit, but {_burning(burned)} when it was "
                "to be turned off: check the board's supply, and that nothing else uses the port"
            )
    return Result(metrics={"led": led, "seconds": seconds}, summary=[f"LED {led} is off again"])


def off(*, rig: str = "simulated") -> Result:
    """Turn every LED off. Of a bench only the board is needed.

    For example:

        sgp rig off --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or a rig.toml.
    """
    with open_lights(rig):
        # It is dark from the beginning, and made sure of at the end.
        pass
    return Result(summary=["all LEDs are off"])


def snap(
    *,
    out: Path,
    led: Whole | None = None,
    exposure_us: Microseconds = 20_000.0,
    rig: str = "simulated",
    force: bool = False,
) -> Result:
    """Take one frame under one LED, or in the dark.

    For example:

        sgp rig snap --led 3 --exposure-us 10000 --out frame.tif

    Parameters
    ----------
    out
        TIFF to write, 16 bit, grey values as the sensor gave them: not turned upright where the
        camera is mounted otherwise.
    led
        LED number from 0; default: none.
    exposure_us
        Exposure time, within the camera's range.
    rig
        Name of a rig, or a rig.toml.
    force
        Replace a file that exists.
    """
    check_file(out, ".tif", force=force)
    with open_rig(rig) as opened:
        if led is not None:
            _check_led(opened.config, led)
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


def selftest(*, rig: str = "simulated") -> Result:
    """Find dead, dim, swapped, doubled and stuck LEDs by what the camera sees, and missing wires.

    Lay something matte under the camera that fills most of its view. Swapped LEDs are found where
    the rig file has led_positions_mm. Exit code 3 says that something is wrong.

    For example:

        sgp rig selftest --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or a rig.toml.
    """
    with open_rig(rig) as opened, Stages() as progress:
        result = examine(opened, on_progress=progress)
    faults = [finding for finding in result.findings if finding.fault]
    notes = [finding for finding in result.findings if not finding.fault]
    if rig in rig_names():  # opened by its name: there is no file to set anything in
        notes = [finding for finding in notes if finding.kind != "exposure active"]
    verdict = "nothing is wrong" if result.ok else f"{len(faults)} things are wrong"
    if len(faults) == 1:
        verdict = "one thing is wrong"
    return Result(
        metrics={
            "leds": list(result.leds),
            "exposure_us": result.exposure_us,
            "wires": asdict(result.wires),
            "findings": [asdict(finding) for finding in result.findings],
        },
        summary=[
            f"{len(result.leds)} LEDs tried at {result.exposure_us:g} us: {verdict}",
            *(f"- {finding.text}" for finding in faults),
        ],
        warnings=[finding.text for finding in notes],
        ok=result.ok,
        failing_code=3,
    )


def _mounted(config: RigConfig) -> str:
    mounting = config.mounting
    words = ["mirrored"] * mounting.mirror
    words += [f"turned by {mounting.rotation_deg} degrees"] * (mounting.rotation_deg != 0)
    return "frames are " + (" and ".join(words) + " to be upright" if words else "upright")


def _doubts(status: BoardStatus, config: RigConfig) -> list[str]:
    """Say what is not an error yet and may become one."""
    doubts = []
    if status.faults:
        doubts.append(
            f"the board received {status.faults} damaged lines since it started: use a shorter or "
            "better cable, away from motors and mains"
        )
    if status.trips:
        doubts.append(
            f"the board's watchdog turned LEDs off {status.trips} times since it started: a "
            "program died, or this computer was too busy, while an LED was lit"
        )
    if status.temperature_c is not None and status.temperature_c > _HOT_C:
        doubts.append(
            f"the board is {status.temperature_c:.0f} degrees hot: let it cool, and lower the "
            "LEDs' current or their time"
        )
    if not config.led_positions_mm:
        doubts.append("led_positions_mm is not in the rig file: no self-test can tell swapped LEDs")
    return doubts


def _burning(led: int | None) -> str:
    return "none burned any more" if led is None else f"LED {led} burned"


def _check_led(config: RigConfig, led: int) -> None:
    if not 0 <= led < config.leds:
        raise UsageError(f"LED {led} does not exist: {config.name} has 0 to {config.leds - 1}")
    if led in config.dead_leds:
        raise UsageError(f"LED {led} of {config.name} is listed as dead: choose another")
