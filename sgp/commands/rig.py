"""Check and operate a rig: LED board and camera.

For example:

    sgp rig list
    sgp rig check --rig bench.toml
"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import acquisition
import rig as rigs
from sgp.cli.console import Stages
from sgp.cli.exit import UsageError
from sgp.cli.options import LedNumber, Microseconds, Positive, RigOption
from sgp.results import Result, check_file
from sgp.rigs import chosen_rig, default_rig, how_to_configure

# The board's watchdog turns the LED off after one second without a message from this program.
_SIGN_EVERY_S = 0.25
# The board's own time limit ends this much later than the requested time; its clock may be 1 %
# too fast.
_SPARE_HOLD_MS = 3000
_CLOCK = 0.99
_HOT_C = 70.0
_VIEW_GAMMA = 1 / 2.2


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
    cameras = rigs.genicam.find_cameras(cti) if cti else ()
    ports = rigs.board.find_boards(port or None)
    names, default = list(rigs.config.rig_names()), default_rig()
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


def _answer(found: rigs.board.FoundPort) -> str:
    board = found.identity
    if board is None:
        return f"port     {found.problem.removeprefix('LED board on ')}"
    return f"board    {board.name} on {found.port}, {board.leds} LEDs, firmware {board.firmware}"


def _port(found: rigs.board.FoundPort) -> dict[str, Any]:
    board = None if found.identity is None else asdict(found.identity)
    return {"port": found.port, "board": board, "complaint": found.problem}


def _camera(found: rigs.genicam.FoundCamera) -> dict[str, Any]:
    return {"vendor": found.vendor, "model": found.model, "serial": found.serial, "cti": found.cti}


def check(*, rig: RigOption = None) -> Result:
    """Open a rig, describe its board and camera, and report possible problems.

    For example:

        sgp rig check --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    """
    name = chosen_rig(rig)
    with rigs.open_rig(name) as opened:
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
                *[f"off     {', '.join(camera.turned_off)}: switched off in the camera"]
                * bool(camera.turned_off),
            ],
            warnings=_doubts(status, config),
        )


def light(led: LedNumber, *, rig: RigOption = None, seconds: Positive = 5.0) -> Result:
    """Turn one LED on for a given time; Ctrl-C turns it off. No camera is needed.

    For example:

        sgp rig light 7 --seconds 3 --rig bench.toml

    Parameters
    ----------
    led
        LED number, from 0.
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    seconds
        Time in seconds. As a safeguard the board itself turns the LED off 3 s later, or one second
        after this program died.
    """
    name = chosen_rig(rig)
    with rigs.rigs.open_board(name) as opened:
        board = opened.board
        longest = board.identity.max_hold_ms
        if seconds * 1000 > longest:
            raise UsageError(
                f"--seconds {seconds:g}: this board keeps an LED on for at most "
                f"{longest / 1000:g} s"
            )
        _check_led(opened.config, led)
        # Longer than requested, so that normally this program turns the LED off.
        hold_ms = min(longest, round(seconds * 1000 + _SPARE_HOLD_MS))
        began_s = time.monotonic()
        board.on(led, hold_ms)
        while (left_s := began_s + seconds - time.monotonic()) > 0:
            time.sleep(min(left_s, _SIGN_EVERY_S))
            board.ping()
        was_on = board.off().led
        held = (time.monotonic() - began_s) * 1000 < hold_ms * _CLOCK
        if was_on != led and held:
            state = "no LED was on" if was_on is None else f"LED {was_on} was on"
            raise rigs.BoardError(
                f"LED board on {board.port}: LED {led} was turned on, but {state} at the end: "
                "check the board's supply, and that no other program uses the port"
            )
    return Result(metrics={"led": led, "seconds": seconds}, summary=[f"LED {led} is off"])


def off(*, rig: RigOption = None) -> Result:
    """Turn all LEDs off. No camera is needed.

    For example:

        sgp rig off --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    """
    name = chosen_rig(rig)
    with rigs.rigs.open_board(name):
        pass  # opening turns all LEDs off, and closing turns them off again
    return Result(summary=["all LEDs are off"])


def snap(
    *,
    out: Path,
    led: LedNumber | None = None,
    exposure_us: Microseconds = 20_000.0,
    rig: RigOption = None,
    force: bool = False,
) -> Result:
    """Take one frame with one LED on, or with all LEDs off.

    For example:

        sgp rig snap --led 3 --out frame.tif --rig bench.toml

    Parameters
    ----------
    out
        TIFF file to write, 16 bit, raw values of the sensor. The frame is not rotated upright, even
        if the rig file gives the mounting of the camera. A PNG file of the same name shows it
        upright with 8 bits: white is the white level, and gamma 2.2 brightens dark parts.
    led
        LED number, from 0; default: all LEDs off.
    exposure_us
        Exposure time in µs, within the camera's range.
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    force
        Overwrite existing files.
    """
    name = chosen_rig(rig)
    check_file(out, ".tif", force=force)
    view = out.with_suffix(".png")
    check_file(view, ".png", force=force)

    import numpy as np

    with rigs.open_rig(name) as opened:
        if led is not None:
            _check_led(opened.config, led)
        shot = opened.shoot(led, exposure_us)
        white = opened.camera.info.white_dn
        mounting = opened.config.mounting
    pixels = shot.frame.pixels
    acquisition.pixels.write_tiff(out, pixels)
    shade = 255 * (np.minimum(pixels, white) / white) ** _VIEW_GAMMA
    acquisition.write_png(view, mounting.upright(np.rint(shade).astype(np.uint8)))
    clipped = float((pixels >= white).mean())
    low, high = (float(value) for value in np.percentile(pixels, [1, 99]))
    return Result(
        outputs={"frame": out, "view": view},
        metrics={"clipped_fraction": clipped, "p1_dn": low, "p99_dn": high, "white_dn": white},
        summary=[
            f"{out}: percentiles 1 % {low:g}, 99 % {high:g} of {white}, {clipped:.3%} clipped; "
            f"view: {view.name}"
        ],
    )


def selftest(*, rig: RigOption = None) -> Result:
    """Find dead, dim, swapped, doubled and stuck LEDs with the camera, and missing wires.

    Place a matte object under the camera that fills most of its view. Swapped LEDs can be found
    only if the rig file has led_positions_mm. The exit code is 3 if a fault was found.

    For example:

        sgp rig selftest --rig bench.toml

    Parameters
    ----------
    rig
        Name of a rig, or path of a rig file (.toml); default: the environment variable SGP_RIG, or
        else `rig` in the configuration file (~/.config/sgp/config.toml on Linux).
    """
    name = chosen_rig(rig)
    with rigs.open_rig(name) as opened, Stages() as progress:
        result = acquisition.selftests.selftest(opened, on_progress=progress)
    faults = [finding for finding in result.findings if finding.fault]
    notes = [finding for finding in result.findings if not finding.fault]
    # A rig that was opened by name has no file in which to set an option.
    if name in rigs.config.rig_names():
        notes = [finding for finding in notes if finding.kind != "exposure active"]
    verdict = "no faults" if result.ok else rigs.pluralize(len(faults), "fault")
    if result.ok and any(finding.kind == "ambiguous" for finding in notes):
        verdict = "no faults found, but swapped LEDs could not be excluded"
    return Result(
        metrics={
            "leds": list(result.leds),
            "exposure_us": result.exposure_us,
            "wires": asdict(result.wires),
            "findings": [asdict(finding) for finding in result.findings],
        },
        summary=[
            f"{rigs.pluralize(len(result.leds), 'LED')} tested at {result.exposure_us:g} us: "
            f"{verdict}",
            *(f"- {finding.text}" for finding in faults),
        ],
        warnings=[finding.notice for finding in notes],
        ok=result.ok,
        failing_code=3,
    )


def _mounted(config: rigs.RigConfig) -> str:
    mounting = config.mounting
    words = ["mirrored"] * mounting.mirror
    words += [f"rotated by {mounting.rotation_deg} degrees"] * (mounting.rotation_deg != 0)
    return "frames are " + (" and ".join(words) + " to be upright" if words else "upright")


def _doubts(status: rigs.board.BoardStatus, config: rigs.RigConfig) -> list[rigs.Notice]:
    """Return warnings about states that are not errors yet."""
    doubts = []
    if status.faults:
        text = (
            f"the board received {rigs.pluralize(status.faults, 'damaged line')} since it started: "
            "use a shorter or better cable, away from motors and mains cables"
        )
        doubts.append(rigs.Notice("board-lines-damaged", text))
    if status.trips:
        text = (
            f"the board's watchdog turned LEDs off {rigs.pluralize(status.trips, 'time')} since it "
            "started: a program died, or this computer was too busy, while an LED was on"
        )
        doubts.append(rigs.Notice("board-watchdog", text))
    if status.temperature_c is not None and status.temperature_c > _HOT_C:
        text = (
            f"the temperature of the board is {status.temperature_c:.0f} C: let it cool, and "
            "reduce the current or the on-time of the LEDs"
        )
        doubts.append(rigs.Notice("board-hot", text))
    if not config.led_positions_mm:
        text = "led_positions_mm is not in the rig file: the self-test cannot detect swapped LEDs"
        doubts.append(rigs.Notice("led-positions-missing", text, severity="info"))
    return doubts


def _check_led(config: rigs.RigConfig, led: int) -> None:
    if not 0 <= led < config.leds:
        raise UsageError(f"LED {led} does not exist: {config.name} has 0 to {config.leds - 1}")
    if led in config.dead_leds:
        raise UsageError(f"LED {led} of {config.name} is listed as dead: choose another")
