"""``sgp calibrate sensor``: gain, noise, saturation and linearity of a sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import acquisition
import calibration
import rig
from sgp.cli.console import with_progress
from sgp.cli.options import Inputs, Pixels
from sgp.results import Result, claim_folder, provenance, writes_folder
from sgp.stages import open_sources

_RECORD = "calibrate-sensor.json"


@writes_folder(_RECORD)
def sensor(
    source: Inputs, *, out: Path, max_pixels: Pixels = rig.MAX_PIXELS, force: bool = False
) -> Result:
    """Measure gain, noise, saturation and linearity of a sensor from frames of an evenly lit card.

    Record a white card or a diffuser, out of focus, under one LED or a few: 10 to 40 exposure times
    up to saturation and beyond, two or more repeats of each, and a dark frame for each. The field
    need not be even; card and light must not change. docs/sensor-format.md has a plan for it.

    The method is photon transfer after EMVA 1288, release 4.0 linear. Figures have standard
    deviations. `capture run --sensor` and `sgp run --sensor` use the result.

    For example:

        sgp calibrate sensor card/ --out sensor
        sgp calibrate sensor first/ second/ --out sensor

    Parameters
    ----------
    source
        Session of the card; several of the same camera, gain and pixel format are used together.
    out
        Folder for sensor.json and sensor.png.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite an existing result.
    """
    opened, files = open_sources(source, max_pixels=max_pixels)
    estimate = with_progress(calibration.calibrate_sensor)(opened)
    result = Result(
        outputs={"sensor": out / "sensor.json", "picture": out / "sensor.png"},
        metrics=_metrics(estimate),
        warnings=list(estimate.warnings),
        summary=_lines(estimate),
        inputs=files,
    )
    made_by = provenance("sgp calibrate sensor", {"source": source}, result.inputs)
    made_by |= {"warnings": [*map(str, result.warnings)]}
    claim_folder(out, _RECORD)
    _draw(result.outputs["picture"], opened[0], estimate)
    acquisition.value_files.write_sensor(result.outputs["sensor"], estimate.sensor, made_by)
    return result


def _metrics(estimate: calibration.sensor.SensorCalibration) -> dict[str, Any]:
    """Return the figures of `SensorMetrics`."""
    measured = estimate.sensor
    figures: dict[str, Any] = {}
    for name, figure in measured.figures.items():
        figures |= {name: figure.value, f"{name}_sigma": figure.sigma}
    if measured.full_well_limit is not None:
        figures["full_well_limit"] = measured.full_well_limit
    return figures | {
        "hot_pixel_fraction": measured.hot_pixel_fraction,
        "hot_pixel_e_per_s": measured.hot_pixel_e_per_s,
        "gain_db": measured.gain_db,
        "exposures": estimate.exposures,
        "frames": estimate.frames,
    }


def _lines(estimate: calibration.sensor.SensorCalibration) -> list[str]:
    """Return the table for the terminal."""
    measured = estimate.sensor
    limit = f", limited by the {measured.full_well_limit}" if measured.full_well_limit else ""
    rows = (
        ("gain", measured.electrons_per_dn, "e/DN", 1.0, f" at {measured.gain_db:g} dB"),
        ("read noise", measured.read_noise_e, "e", 1.0, ""),
        ("full well", measured.full_well_e, "e", 1.0, limit),
        ("saturation", measured.saturation_capacity_e, "e", 1.0, ", where the variance is largest"),
        ("SNR at most", measured.snr_max, "", 1.0, ""),
        ("dynamic range", measured.dynamic_range, "", 1.0, ""),
        ("dark current", measured.dark_current_e_per_s, "e/s", 1.0, ""),
        ("black level", measured.black_level_dn, "DN", 1.0, ""),
        ("PRNU", measured.prnu, "%", 100.0, ""),
        ("DSNU", measured.dsnu_e, "e", 1.0, ""),
        ("linearity error", measured.linearity_error, "%", 100.0, ""),
    )
    lines = [
        f"{rig.pluralize(estimate.frames, 'frame')}, "
        f"{rig.pluralize(estimate.exposures, 'exposure time')}"
    ]
    for name, figure, unit, factor, more in rows:
        if figure is None:
            lines.append(f"  {name:<16}unknown")
            continue
        text = f"{factor * figure.value:.4g} +- {factor * figure.sigma:.2g} {unit}".rstrip()
        lines.append(f"  {name:<16}{text}{more}")
    if measured.hot_pixel_fraction:
        lines.append(
            f"  {'hot pixels':<16}{measured.hot_pixel_fraction:.2%}, "
            f"{measured.hot_pixel_e_per_s:.4g} e/s on average"
        )
    return lines


def _draw(
    path: Path, source: acquisition.Source, estimate: calibration.sensor.SensorCalibration
) -> None:
    from sgp.pictures import sensor_panels, source_title, write_overview

    title = source_title(source, f"sensor: {source.path}")
    write_overview(path, title, sensor_panels(estimate), columns=2)
