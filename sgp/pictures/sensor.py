"""Panels of a calibration of a sensor: photon transfer, linearity, signal-to-noise, dark signal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rig.arrays import Float64
from sgp.pictures.sheet import Panel, set_plot_area

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from calibration.sensor import SensorCalibration

_DOT: Final[dict[str, Any]] = {"ls": "none", "marker": ".", "ms": 3, "color": "tab:blue"}
_MODEL: Final[dict[str, Any]] = {"color": "tab:red", "lw": 1}


def sensor_panels(estimate: SensorCalibration) -> list[Panel]:
    """Return the plots of a calibration."""
    return [_transfer(estimate), _snr(estimate), _line(estimate), _dark(estimate)]


def _transfer(estimate: SensorCalibration) -> Panel:
    sensor = estimate.sensor
    gain = 1 / sensor.electrons_per_dn.value
    signal, variance, steps = _lit(estimate)

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        axes.loglog(signal, variance, **_DOT, label="zones of the frames")
        axes.loglog(steps, estimate.dark_variance_dn2 + gain * steps, **_MODEL, label="dark + K s")
        axes.axhline(estimate.dark_variance_dn2, color="0.6", lw=1, ls=":", label="dark")
        if sensor.saturation_capacity_e is not None:
            full = sensor.saturation_capacity_e.value * gain
            axes.axvline(full, color="tab:green", lw=1, ls="--", label="saturation")
        _axis_names(axes, "signal above dark, DN", "temporal variance, DN²")

    return Panel(f"photon transfer: K = {gain:.4g} DN/e, {1 / gain:.4g} e/DN", draw, 1.2)


def _snr(estimate: SensorCalibration) -> Panel:
    sensor = estimate.sensor
    gain = 1 / sensor.electrons_per_dn.value
    # Saturated samples have no noise.
    full = sensor.saturation_capacity_e
    signal, variance, steps = _lit(estimate, np.inf if full is None else full.value * gain)
    total = (estimate.dark_variance_dn2 + gain * steps) ** 0.5

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        axes.loglog(signal / gain, signal / variance**0.5, **_DOT, label="zones of the frames")
        axes.loglog(steps / gain, steps / total, **_MODEL, label="model")
        with_pattern = np.hypot(total, sensor.prnu.value * steps)
        axes.loglog(steps / gain, steps / with_pattern, **_MODEL, ls=":", label="with PRNU")
        _axis_names(axes, "signal, electrons", "signal-to-noise ratio")

    most = "" if sensor.snr_max is None else f", at most {sensor.snr_max.value:.3g}"
    return Panel(f"signal-to-noise ratio of a sample{most}", draw, 1.2)


def _line(estimate: SensorCalibration) -> Panel:
    error = estimate.sensor.linearity_error

    def draw(axes: Axes) -> None:
        from matplotlib.ticker import MaxNLocator

        set_plot_area(axes)
        percent = 100 * estimate.line_deviation
        axes.axhline(0, color="0.6", lw=1)
        axes.plot(estimate.line_signal_dn, percent, ".-", ms=5, lw=0.8, color="tab:blue")
        most = max(0.1, 1.2 * float(np.abs(percent).max()))
        axes.set_ylim(-most, most)
        axes.set_xlim(left=0)
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.yaxis.set_major_formatter("{x:g}")
        _axis_names(axes, "signal above dark, DN", "deviation, %", key=False)

    title = f"deviation from a straight line: {100 * error.value:.2g} ± {100 * error.sigma:.2g} %"
    return Panel(title, draw, 1.2)


def _dark(estimate: SensorCalibration) -> Panel:
    sensor = estimate.sensor
    current = sensor.dark_current_e_per_s
    time_ms = 1e3 * estimate.dark_time_s

    def draw(axes: Axes) -> None:
        set_plot_area(axes)
        axes.plot(time_ms, estimate.dark_mean_dn, **_DOT, label="dark frames")
        if current is not None:
            ends = np.array([0.0, time_ms.max()])
            slope = current.value / sensor.electrons_per_dn.value / 1e3
            axes.plot(ends, sensor.black_level_dn.value + slope * ends, **_MODEL, label="line")
        axes.ticklabel_format(useOffset=False)
        _axis_names(axes, "exposure time, ms", "mean of the dark frame, DN")

    title = "dark current unknown"
    if current is not None:
        title = f"dark current {current.value:.3g} ± {current.sigma:.2g} e/s"
    return Panel(title, draw, 1.2)


def _lit(estimate: SensorCalibration, most: float = np.inf) -> tuple[Float64, Float64, Float64]:
    """Return signals up to ``most`` and variances for a logarithmic plot, and steps of a line."""
    shown = (estimate.signal_dn > 0) & (estimate.variance_dn2 > 0) & (estimate.signal_dn <= most)
    signal, variance = estimate.signal_dn[shown], estimate.variance_dn2[shown]
    return signal, variance, np.geomspace(signal.min(), signal.max(), 200)


def _axis_names(axes: Axes, x: str, y: str, *, key: bool = True) -> None:
    axes.set_xlabel(x, fontsize=8, labelpad=1)
    axes.set_ylabel(y, fontsize=8, labelpad=1)
    axes.tick_params(which="both", labelsize=8)
    axes.grid(color="0.9", lw=0.5)
    axes.set_axisbelow(True)
    if key:
        axes.legend(loc="best", fontsize=7)
