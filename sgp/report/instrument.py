"""With what a result was measured: devices and calibrations, with dates, checks and deviations."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

import acquisition
import rig
from sgp.pictures.light_errors import longest_sigmas
from sgp.report.folder import Inputs, ResultFolder, changed_notice, noted
from sgp.report.recording import Recording
from sgp.results import read_record, records_of, verify_results

Row = tuple[str, str]
_STATED: Final = "as the recording states"


def instrument_rows(
    folder: ResultFolder, recording: Recording, notices: list[rig.Notice], check: Path | None = None
) -> list[Row]:
    """Return terms and texts about the instrument, as far as records and files state it.

    ``check`` is the folder of a comparison of calibrations.

    Raises
    ------
    DataError
        If it is not, has changed, or does not contain the lights of the result.
    """
    files, changed = _files(folder, notices)
    rows: list[Row] = []
    with noted(notices, "recording"):
        rows += _devices(recording)
    rows.append(("Lights", _lights(recording.lights)))
    for term, name, text_of in (
        ("Camera calibration", "camera", _camera),
        ("Sensor", "sensor", _sensor),
        ("Flat field", "flat", _flat),
    ):
        text = "not known"
        with noted(notices, "recording"):
            if name not in changed:
                text = text_of(files.get(name), recording.source)
        rows.append((term, text))
    rows += _agreement(folder)
    return rows if check is None else [*rows, _drift(folder, check)]


def _files(folder: ResultFolder, notices: list[rig.Notice]) -> tuple[dict[str, Path], set[str]]:
    """Return the files of calibrations that the records name, and which of them have changed."""
    inputs, found, changed = Inputs(folder), dict[str, Path](), set[str]()
    for name in ("camera", "sensor", "flat"):
        stated = folder.parameter(name)
        if not isinstance(stated, str):
            continue
        path = folder.located(stated)
        path = path / "flat.json" if path.is_dir() else path
        if inputs.state(path) == "changed":
            notices.append(changed_notice([path], "what it states is not shown"))
            changed.add(name)
        else:
            found[name] = path
    return found, changed


def _devices(recording: Recording) -> Iterator[Row]:
    source = recording.source
    if source is None:
        return
    setup = source.setup
    camera = " ".join(filter(None, (setup.camera_vendor, setup.camera_model)))
    serial = setup.camera_serial and f", serial number {setup.camera_serial}"
    if camera or serial:
        yield "Camera", f"{camera}{serial}"
    if source.kind != "session":
        return
    bench = acquisition.Session.open(source.path, damaged_frames=True).manifest.rig
    if bench is not None:
        yield "Rig", f"{bench.name}: board {bench.board}, firmware {bench.firmware}"


def _lights(lights: acquisition.Lights | None) -> str:
    if lights is None:
        return "not known"
    when = lights.calibrated
    parts = [
        rig.pluralize(len(lights), "near light" if lights.near else "distant light"),
        _date(None if when is None else when.time_utc),
    ]
    if when is not None and when.spheres:
        parts.append(f"by {rig.pluralize(len(when.spheres), 'sphere')}")
    sigmas = longest_sigmas(lights)
    if sigmas is None:
        parts.append("standard deviations not known")
    elif lights.near:
        parts.append(f"standard deviation of positions {rig.figure(np.median(sigmas))} mm (median)")
    else:
        sigma = np.degrees(np.median(sigmas))
        parts.append(f"standard deviation of directions {rig.figure(sigma)} deg (median)")
    errors = lights.errors
    if errors is not None and errors.intensity_std is not None:
        share = np.nanmedian(errors.intensity_std / np.asarray(lights.intensities))
        parts.append(f"of intensities {rig.figure(100 * share)} %")
    return ", ".join(parts)


def _camera(path: Path | None, source: acquisition.Source | None) -> str:
    if path is None:
        camera = None if source is None else source.calibrated_camera
        return "none" if camera is None else f"{_of_camera(camera)}, {_STATED}"
    parts = [_of_camera(acquisition.read_camera(path))]
    for _, record in records_of(path):
        dates = [one.started_utc for one in record.recordings if one.started_utc]
        parts += [f"calibrated {dates[0][:10]}"] if dates else []
        figures: Any = record.metrics
        sigma, corner = figures.get("std"), figures.get("corner_std_px")
        if sigma:
            parts.append(f"standard deviation of the focal length {rig.figure(sigma[0])} px")
        if corner:
            parts.append(f"of a corner {rig.figure(corner)} px")
    return ", ".join([*parts, path.name])


def _of_camera(camera: acquisition.CameraModel) -> str:
    far = camera.working_distance_mm
    distance = "" if far is None else f", working distance {far:g} mm"
    lens = camera.lens and f"{camera.lens}, "
    return f"{lens}focal length {camera.focal_px:.1f} px{distance}"


def _sensor(path: Path | None, source: acquisition.Source | None) -> str:
    if path is not None:
        sensor = acquisition.value_files.read_sensor(path)
        gain, noise = sensor.electrons_per_dn, sensor.read_noise_e
        parts = [
            _date(sensor.time_utc),
            f"{gain.value:.4g} electrons/DN (standard deviation {gain.sigma:.2g})",
            f"read noise {noise.value:.3g} e (standard deviation {noise.sigma:.2g})",
            path.name,
        ]
        return ", ".join(parts)
    known = None if source is None else source.noise
    if known is None:
        return "not calibrated: noise was estimated from the images"
    return (
        f"{known.electrons_per_dn:.4g} electrons/DN, read noise {known.read_noise_e:.3g} e, "
        f"{_STATED}"
    )


def _flat(path: Path | None, source: acquisition.Source | None) -> str:
    del source  # it states no flat field
    if path is None:
        return "none: lens and sensor count as even"
    flat = acquisition.value_files.read_flat(path)
    parts = [_date(None if flat.calibrated is None else flat.calibrated.time_utc)]
    for what, sigma in (("pixels", flat.pixel_std), ("the gradient", flat.gradient_std)):
        if sigma is not None:
            parts.append(f"standard deviation of {what} {rig.figure(100 * sigma)} %")
    return ", ".join([*parts, path.name])


def _agreement(folder: ResultFolder) -> Iterator[Row]:
    """Yield how well the lights explain the images."""
    for record in folder.records.values():
        figures: Any = record.metrics
        errors, gains = figures.get("light_errors_deg"), figures.get("light_gains")
        if errors and gains:
            text = (
                f"lights differ from the images by at most {max(errors):.1f} deg; brightness of "
                f"the images {min(gains):.2f} to {max(gains):.2f} of the expected one"
            )
            yield "Check of the lights", text
            return


def _drift(folder: ResultFolder, check: Path) -> Row:
    path = check / "check.json" if check.is_dir() else check
    record = read_record(path)
    figures: Any = record.metrics
    if "drifts" not in figures:
        raise acquisition.DataError(
            f"{path}: is the record of {record.command}: give the folder that `sgp calibrate "
            "check --out` writes for three calibrations or more"
        )
    notices = verify_results([path]).notices
    if fault := next((one for one in notices if one.severity == "error"), None):
        raise acquisition.DataError(str(fault))
    used = {digest for one in folder.records.values() for digest in one.inputs.values()}
    if used.isdisjoint(record.inputs.values()):
        raise acquisition.DataError(
            f"{path}: does not contain the lights of {folder.path}: compare a series of "
            "calibrations that contains their file"
        )
    series = figures["calibrations"]
    dates = " to ".join(str(series[n]["time_utc"])[:10] for n in (0, -1))
    parts = [f"{len(series)} calibrations{f', {dates}' if series[0]['time_utc'] else ''}"]
    beyond = [one["id"] for one in figures["drifts"] if one["beyond"]]
    if figures["moved"]:
        parts.append("all lights turned together, beyond the control limit")
    if beyond:
        parts.append(f"beyond control limits: {rig.listed(beyond, 6)}")
    if not (beyond or figures["moved"]):
        parts.append("all lights within control limits")
    return "Drift of the lights", ", ".join(parts)


def _date(time: datetime | None) -> str:
    return "date not known" if time is None else f"calibrated {time:%Y-%m-%d %H:%M} UTC"
