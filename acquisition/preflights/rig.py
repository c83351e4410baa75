"""Pre-flight of disk, board, camera and LEDs: their reports, and the light that the camera sees."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from acquisition._errors import DataError, StorageError
from acquisition.files.part_files import temporary
from acquisition.files.storage import disk, read_back, sync_folder, write_whole
from acquisition.plan.plan import CapturePlan
from acquisition.preflights.check import Check, State
from acquisition.selftests.led_test import selftest
from rig import Rig, pluralize
from rig.host import clock, filesystem

FULL_LEVEL = 4095
_HOT_C = 70.0
# Relative difference by which cameras may round exposure times.
_STEP = 0.02
NAME = "disk"
# Required space relative to the estimate: retakes and other programs need some, too.
MARGIN = 1.25
_PROBE_BYTES = 4_000_000


def check_board(rig: Rig, plan: CapturePlan) -> Check:
    """Check that the board responds, agrees with the rig file, and can run the plan."""
    board, config = rig.board, rig.config
    identity, status = board.identity, board.status()
    values: dict[str, float | int | str | None] = {
        "board": identity.name,
        "firmware": identity.firmware,
        "leds": identity.leds,
        "uptime_ms": status.uptime_ms,
        "damaged_lines": status.faults,
        "temperature_c": status.temperature_c,
    }

    def failed(text: str) -> Check:
        return Check("board", "failed", f"board on {board.port}: {text}", values)

    if identity.leds != config.leds:
        return failed(
            f"has {identity.leds} LEDs, the rig file has {config.leds}: correct the rig file"
        )
    try:
        plan.check(config.leds, config.dead_leds)
    except DataError as error:
        return failed(str(error))
    if status.led is not None:
        return failed(
            f"LED {status.led} is on although all should be off: turn the board off and on"
        )
    longest_ms = max(plan.distinct_exposures_us) / 1000 + config.settle_ms
    if longest_ms > identity.max_hold_ms:
        return failed(
            f"keeps an LED on for at most {identity.max_hold_ms} ms, the plan requires "
            f"{longest_ms:g} ms: shorten the exposure"
        )
    text = f"{identity.name} {identity.firmware} on {board.port}, {identity.leds} LEDs, all off"
    if status.temperature_c is not None and status.temperature_c > _HOT_C:
        text += f"; it is at {status.temperature_c:g} C: let it cool down"
        return Check("board", "warning", text, values)
    return Check("board", "ok", text, values)


def check_camera(rig: Rig, plan: CapturePlan) -> Check:
    """Check that the camera applies the plan's exposures and gain and reports them in its frames.

    Automatic image processing was turned off and read back when the camera was opened. The text
    names the functions that had been on, because another program had then configured the camera.
    """
    info = rig.camera.info
    who = f"{info.vendor} {info.model} {info.serial}".strip()
    values: dict[str, float | int | str | None] = {
        "camera": who,
        "width": info.width,
        "height": info.height,
        "pixel_format": info.pixel_format,
        "turned_off": ", ".join(info.turned_off),
    }
    exposures = plan.distinct_exposures_us
    for exposure_us in exposures:
        if not info.exposure_min_us <= exposure_us <= info.exposure_max_us:
            text = (
                f"{who}: exposes for {info.exposure_min_us:g} to {info.exposure_max_us:g} us, not "
                f"for {exposure_us:g}: correct the plan"
            )
            return Check("camera", "failed", text, values)
    off: list[str] = []
    for exposure_us in {min(exposures), max(exposures)}:
        frame = rig.shoot(None, exposure_us, plan.gain_db).frame
        values["temperature_c"] = frame.temperature_c
        if abs(frame.exposure_us / exposure_us - 1) > _STEP:
            off.append(f"{frame.exposure_us:g} us instead of {exposure_us:g} us")
        if abs(frame.gain_db - plan.gain_db) > 0.1:
            off.append(f"a gain of {frame.gain_db:g} dB instead of {plan.gain_db:g} dB")
    turned_off = f" (on when it was opened: {values['turned_off']})" if info.turned_off else ""
    text = f"{who}, {info.width} x {info.height}, {info.pixel_format}, automatics off{turned_off}"
    if off:
        text += f": used {', '.join(sorted(set(off)))}: plan values that the camera supports"
        return Check("camera", "warning", text, values)
    return Check("camera", "ok", text, values)


def check_brightness(rig: Rig, plan: CapturePlan) -> Check:
    """Set the plan's LEDs to full brightness, so that PWM does not affect the exposure.

    Below full scale an LED is dimmed by PWM, and an exposure that is not a multiple of the PWM
    period receives more or less light than its share.
    """
    for led in plan.leds:
        rig.board.level(led, FULL_LEVEL)
    leds = pluralize(len(plan.leds), "LED")
    text = f"{leds} at full brightness: exposures of any length get steady light"
    return Check("brightness", "ok", text, {"level": FULL_LEVEL})


def check_leds(rig: Rig, plan: CapturePlan, *, metered: bool = True) -> Check:
    """Test every LED by the light that the camera sees.

    Before metering, dead and dim LEDs give a warning: metering skips dead LEDs.

    Parameters
    ----------
    rig
        Open rig. It stays open, with all LEDs off.
    plan
        Plan of the recording; a fault of LEDs that it does not use gives a warning.
    metered
        Whether the exposure times of the plan are final.

    Examples
    --------
    >>> from acquisition import CapturePlan
    >>> from acquisition.preflights import check_leds
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("white-plane", width=160, height=128, leds=4))
    >>> plan = CapturePlan(leds="0-3", exposures_us=(20_000.0,))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     check = check_leds(rig, plan)
    >>> check.state
    'ok'
    """
    tested = selftest(rig)
    values = {"tried": len(tested.leds), "exposure_us": tested.exposure_us}
    wrong = [finding for finding in tested.findings if finding.fault]
    lines = [finding.text for finding in wrong or tested.findings]
    if not wrong:
        lines.insert(0, f"{pluralize(len(tested.leds), 'LED')} tested, no fault")
        return Check("LEDs", "ok", "; ".join(lines), values, tuple(lines))
    concerned = any(
        (not finding.leds or set(finding.leds) & set(plan.leds))
        and (metered or finding.kind not in ("dead", "dim"))
        for finding in wrong
    )
    state: State = "failed" if concerned else "warning"
    return Check("LEDs", state, "; ".join(lines), values, tuple(lines))


def check_disk(folder: Path, estimate_bytes: int) -> Check:
    """Check the disk of a planned session.

    A probe file is written into the nearest existing folder, flushed, read back and removed.

    Parameters
    ----------
    folder
        Folder of the session; it need not exist.
    estimate_bytes
        Estimated size of the recording; 1.25 times as much must be free.
    """
    place = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    try:
        rate_mb_s = _probe(place)
        with disk(place, "read the free space"):
            free_bytes = shutil.disk_usage(place).free
    except StorageError as error:
        return Check(NAME, "failed", str(error))
    needed_bytes = int(estimate_bytes * MARGIN)
    values = {
        "free_bytes": free_bytes,
        "needed_bytes": needed_bytes,
        "write_mb_per_s": round(rate_mb_s, 1),
    }
    finding = (
        f"{place}: {free_bytes / 1e6:.0f} MB free, {needed_bytes / 1e6:.0f} MB required "
        f"({MARGIN:g} x the estimate)"
    )
    if free_bytes < needed_bytes:
        text = f"{finding}: free space, choose another disk, or plan fewer shots"
        return Check(NAME, "failed", text, values)
    return Check(NAME, "ok", f"{finding}; writes durably at {rate_mb_s:.0f} MB/s", values)


def _probe(place: Path) -> float:
    """Write, flush, read back and remove a file; return megabytes per second."""
    data = os.urandom(_PROBE_BYTES)
    with disk(place, "write a file here"), temporary(place / "sgp-probe") as part:
        began_s = clock.monotonic()
        write_whole(part.descriptor, data)
        filesystem.fsync(part.descriptor)
        sync_folder(place)
        seconds = clock.monotonic() - began_s
        same = read_back(part.path) == data
    if not same:
        raise StorageError(
            f"{place}: a file read back differs from the data written: do not use this disk"
        )
    return len(data) / 1e6 / max(seconds, 1e-6)
