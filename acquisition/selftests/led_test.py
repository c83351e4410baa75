"""Self-test of a rig: finds dead, swapped, double or stuck LEDs and missing wires."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from acquisition.pixels.quality import measure_quality
from acquisition.selftests.finding import Finding
from acquisition.selftests.led_findings import Evidence, findings
from rig import Progress, Rig, RigConfig, RigError, no_progress
from rig.arrays import Float64
from rig.shooting import Wires

_COARSE = 20  # places along the longer side
_FIRST_US = 20_000.0
_LONGEST_US = 500_000.0
# Target of the 99th percentile under the brightest LED as a share of the range, and the accepted
# limits.
_FILL, _LEAST_FILL, _MOST_FILL = 0.6, 0.15, 0.95
_PASSES = 8
# Exposure time of the second dark frame relative to the first.
_SHORT = 0.25
# A place with a larger share of saturated pixels does not count.
_CLIPPED = 0.05


@dataclass(frozen=True)
class SelfTest:
    """Result of the self-test.

    Parameters
    ----------
    findings
        Faults, and remarks on what cannot be judged.
    leds
        The tested LEDs.
    exposure_us
        The exposure time that suited the scene.
    wires
        Which signals arrive between board and camera.
    """

    findings: tuple[Finding, ...]
    leds: tuple[int, ...]
    exposure_us: float
    wires: Wires

    @property
    def ok(self) -> bool:
        """Whether there is no fault; remarks do not count."""
        return not any(finding.fault for finding in self.findings)


def selftest(rig: Rig, *, on_progress: Progress = no_progress) -> SelfTest:
    """Shoot every LED that is not listed as dead twice, and judge the images.

    Something matte should fill most of the camera's view: a card, or any object that is not mostly
    black or mirror-like. Swaps are found only if the rig file has ``led_positions_mm``.

    Parameters
    ----------
    rig
        Open rig; it stays open.
    on_progress
        Receives the stage ``self-test``, one step per shot; the total grows while the test
        looks for a suitable exposure time.

    Raises
    ------
    RigError
        If board or camera fail, which is not a finding.

    Examples
    --------
    >>> from acquisition.selftests import selftest
    >>> from simulator import open_rig_seeing, render, scene_named
    >>> view = render(scene_named("white-plane", width=160, height=128, leds=4))
    >>> with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    ...     result = selftest(rig)
    >>> result.ok
    True
    """
    config = rig.config
    leds = tuple(led for led in range(config.leds) if led not in config.dead_leds)
    if not leds:
        raise RigError(
            f"rig {config.name}: every LED is listed in dead_leds, so no LED is left to test"
        )
    camera = _Camera(rig, len(leds), on_progress)
    exposure_us, first = camera.metered(leds)
    second = camera.all(leds, exposure_us)
    low_us = max(rig.camera.info.exposure_min_us, exposure_us * _SHORT)
    dark, short = camera.coarse(None, exposure_us), camera.coarse(None, low_us)
    # Only light grows with the exposure time; black level and offsets do not.
    glow = (dark - short) * exposure_us / max(exposure_us - low_us, 1e-9)
    positions = np.array(config.led_positions_mm)[list(leds)] if config.led_positions_mm else None
    evidence = Evidence(
        leds,
        np.stack([first, second]) - dark,
        np.nan_to_num(glow),
        camera.places(),
        positions,
    )
    wires = rig.wires(leds[0], exposure_us)
    found = (*findings(evidence), *_of_wires(wires, config))
    return SelfTest(found, leds, exposure_us, wires)


def _of_wires(wires: Wires, config: RigConfig) -> Iterator[Finding]:
    """Compare the wires with the rig file."""
    if not wires.trigger:
        text = (
            "the board's trigger pulse does not make the camera expose: check the wire to its line "
            "input, and trigger_line in the rig file; until then only software triggers work, and "
            "no sequences"
        )
        yield Finding("trigger", (), text, fault=config.trigger == "board")
    if wires.exposure_active and not config.exposure_active:
        text = (
            "the camera's exposure-active output is wired to the board: set exposure_active = true "
            "in the rig file to check it with every flash"
        )
        yield Finding("exposure active", (), text, fault=False)
    if config.exposure_active and not wires.exposure_active:
        text = (
            "the board does not see the camera's exposure-active output: check that wire and the "
            "camera's line output, or set exposure_active = false in the rig file"
        )
        yield Finding("exposure active", (), text)


class _Camera:
    """Takes frames and reduces each to coarse means."""

    def __init__(self, rig: Rig, leds: int, on_progress: Progress) -> None:
        self._rig = rig
        self._on_progress = on_progress
        self._count = 0
        # Two passes over the LEDs, and two dark frames.
        self._total = 2 * leds + 2
        self._white = rig.camera.info.white_dn
        self.brightest = 0.0
        self._shape = (1, 1)

    def metered(self, leds: tuple[int, ...]) -> tuple[float, Float64]:
        """Return an exposure time that suits the brightest LED, and images of all LEDs with it."""
        info = self._rig.camera.info
        low_us, high_us = info.exposure_min_us, min(info.exposure_max_us, _LONGEST_US)
        exposure_us = min(max(_FIRST_US, low_us), high_us)
        for _ in range(_PASSES):
            self.brightest = 0.0
            taken_us = exposure_us
            taken = self.all(leds, exposure_us)
            if self.brightest > _MOST_FILL:
                wanted_us = exposure_us / 4
            elif self.brightest < _LEAST_FILL:
                wanted_us = exposure_us * min(_FILL / max(self.brightest, 1e-3), 10.0)
            else:
                break
            wanted_us = min(max(wanted_us, low_us), high_us)
            if wanted_us == exposure_us:
                break
            exposure_us = wanted_us
        return taken_us, taken

    def all(self, leds: tuple[int, ...], exposure_us: float) -> Float64:
        """Return ``(K, B)`` coarse images of the LEDs."""
        return np.stack([self.coarse(led, exposure_us) for led in leds])

    def coarse(self, led: int | None, exposure_us: float) -> Float64:
        """Return ``(B,)`` means over the places of a grid, NaN where saturated."""
        # A software trigger, so that a missing wire does not prevent the test of the LEDs.
        pixels = self._rig.shoot(led, exposure_us, trigger="software").frame.pixels
        self._count += 1
        self._on_progress("self-test", self._count, max(self._count, self._total))
        quality = measure_quality(pixels, white_level_dn=self._white)
        self.brightest = max(self.brightest, quality.percentiles_dn["99"] / self._white)
        upright = self._rig.config.mounting.upright(pixels)
        side = max(1, -(-max(upright.shape) // _COARSE))
        rows, columns = (max(1, length // side) for length in upright.shape)
        high, wide = (min(side, length) for length in upright.shape)
        top, left = (upright.shape[0] - rows * high) // 2, (upright.shape[1] - columns * wide) // 2
        cut = upright[top : top + rows * high, left : left + columns * wide]
        blocks = cut.reshape(rows, high, columns, wide)
        means: Float64 = blocks.mean(axis=(1, 3), dtype=np.float64)
        clipped = (blocks >= self._white).mean(axis=(1, 3))
        self._shape = (rows, columns)
        self._width = upright.shape[1] / wide
        return np.where(clipped > _CLIPPED, np.nan, means).ravel()

    def places(self) -> Float64:
        """Return ``(B, 2)`` positions of the grid's places, in widths of the image."""
        rows, columns = self._shape
        y, x = np.mgrid[0:rows, 0:columns].astype(float)
        across = (x - (columns - 1) / 2) / self._width
        up = ((rows - 1) / 2 - y) / self._width
        return np.stack([across.ravel(), up.ravel()], axis=1)
