"""``sgp calibrate check``: calibrations of the same lights, or one and the rig file, compared."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import acquisition
import calibration
import rig as rigs
from rig.arrays import Bool
from sgp.cli.exit import UsageError
from sgp.cli.options import Input, OptionalInput, Positive, RigOption
from sgp.results import CheckMetrics, LightDifferenceMetrics, Result, writes_folder
from sgp.rigs import rig_with_positions

_SHOWN = 12
_LONGEST_ID = 14
_NO_FACTOR = 5e-5
# Lights that contradict a rig file; the code is that of `calibration.comparison.compare_with_rig`.
_CONTRADICTION = "lights-changed"


@writes_folder("check.json")
def check(
    a: Input,
    b: OptionalInput = None,
    *more: Input,
    rig: RigOption = None,
    limit_deg: Positive | None = None,
    limit_mm: Positive | None = None,
    limit_percent: Positive | None = None,
    out: Path | None = None,
    force: bool = False,
) -> Result:
    """Compare a calibration of the lights with other ones, or with a rig file.

    Reports the differences of each light, the worst first; a rotation or a shift that all lights
    have in common, as after a move of the camera; and lights at the places of others, as after
    swapping wires. The exit code is 4 if a difference is beyond a limit, if the order or the sides
    of the lights differ, or if a light contradicts the rig file.

    Three or more calibrations are a series, in the order of their dates. Their scatter gives
    control limits for the direction and the strength of each light, and for what all lights have in
    common; the exit code is 4 if a value is beyond them.

    For example:

        sgp calibrate check before.json after.json
        sgp calibrate check old.json new.json --limit-mm 3 --limit-percent 2
        sgp calibrate check lights.json --rig bench.toml
        sgp calibrate check march.json april.json may.json june.json --out drift

    Parameters
    ----------
    a
        Lights file: the reference, or with --rig the lights to check.
    b
        Lights file to compare with it.
    more
        More lights files of a series.
    rig
        Rig file (.toml) whose led_positions_mm the lights must match, instead of a second file.
        These positions are assumed to be accurate to 10 mm, as with a tape measure.
    limit_deg
        Largest allowed angle between the directions from the origin, in degrees. In a series,
        deviations up to it are allowed, also beyond control limits.
    limit_mm
        Largest allowed distance between positions, in mm.
    limit_percent
        Largest allowed difference of intensities, in percent. Intensities are relative: a common
        factor of all lights is removed first. In a series as --limit-deg.
    out
        Folder for drift.png (charts), drift.csv (values and limits) and check.json of a series.
    force
        Write into an output folder that already contains files.
    """
    if b is not None and more:
        if rig is not None:
            raise UsageError("--rig is for one calibration: give it without the other files")
        if limit_mm is not None:
            raise UsageError("--limit-mm is for two calibrations: give --limit-deg for a series")
        # Late, because a comparison of two draws nothing.
        from sgp.calibrate import check_series

        return check_series([a, b, *more], limit_deg, limit_percent, out)
    if out is not None:
        raise UsageError("--out is for a series: give three lights files or more")
    if (b is None) == (rig is None):
        raise UsageError("compare with one thing: give a second lights file, or --rig")
    if rig is not None and limit_percent is not None:
        raise UsageError("--limit-percent: a rig file has no intensities: give a lights file")
    if b is not None and os.path.samefile(a, b):
        raise UsageError(f"{a} and {b} are the same file: give two calibrations")
    if b is None:
        config = rig_with_positions(rig)
        first = acquisition.read_lights(a)
        stated = first.warnings
        compared = calibration.comparison.compare_with_rig(first, config)
        inputs, title = [a], f"against the rig {config.name}"
        equal = []
    else:
        first, second = acquisition.read_lights(a), acquisition.read_lights(b)
        stated = (*first.warnings, *second.warnings)
        compared = calibration.compare_lights(first, second)
        # Calibrations in different folders mostly have the same file name.
        labels = [str(a), str(b)] if a.name == b.name else [a.name, b.name]
        inputs, title = [a, b], f"of {labels[1]} against {labels[0]}"
        both = zip(labels, (first, second), strict=True)
        equal = [label for label, lights in both if _all_equal(lights)]
    if limit_mm is not None and compared.distance_mm is None:
        raise UsageError("--limit-mm needs lights with positions: give --limit-deg for directions")
    intensities = b is not None and not np.isnan(compared.intensity_factor)
    if limit_percent is not None and not intensities:
        raise UsageError(
            f"--limit-percent: the intensities of {' and '.join(equal)} are all equal, as before "
            "`sgp calibrate intensities`: compare two files with measured ones"
        )
    beyond = _beyond(compared, limit_deg, limit_mm, limit_percent)
    # Lights beyond a limit come first.
    order = sorted(compared.worst_first.tolist(), key=lambda n: not beyond[n])
    contradicted = b is None and any(one.code == _CONTRADICTION for one in compared.warnings)
    limits = any(limit is not None for limit in (limit_deg, limit_mm, limit_percent))
    return Result(
        metrics=_metrics(compared, beyond, order),
        warnings=[*stated, *compared.warnings],
        summary=[
            f"{rigs.pluralize(len(compared.ids), 'light')} {title}, the worst first",
            *_rows(compared, beyond, order, intensities=intensities),
            *_verdict(compared, beyond, limits=limits, equal=equal),
        ],
        inputs=inputs,
        ok=compared.same_order and not beyond.any() and not contradicted,
    )


def _all_equal(lights: acquisition.Lights) -> bool:
    """Return whether the intensities are those of lights whose intensities were not measured."""
    return not np.ptp(np.asarray(lights.intensities))


def _beyond(
    compared: calibration.LightComparison,
    limit_deg: float | None,
    limit_mm: float | None,
    limit_percent: float | None,
) -> Bool:
    """Return which lights are beyond a limit, ``(N,)``."""
    beyond = np.zeros(len(compared.ids), np.bool_)
    if limit_deg is not None:
        beyond |= compared.angle_deg > limit_deg
    if limit_mm is not None and compared.distance_mm is not None:
        beyond |= compared.distance_mm > limit_mm
    if limit_percent is not None:
        beyond |= np.abs(compared.intensity_percent) > limit_percent
    return beyond


def _metrics(compared: calibration.LightComparison, beyond: Bool, order: list[int]) -> CheckMetrics:
    far, rest = compared.distance_mm, compared.rest_mm
    differences: list[LightDifferenceMetrics] = [
        {
            "id": compared.ids[n],
            "angle_deg": float(compared.angle_deg[n]),
            "distance_mm": None if far is None else float(far[n]),
            "intensity_percent": float(compared.intensity_percent[n]),
            "deviations": float(compared.deviations[n]),
            "intensity_deviations": float(compared.intensity_deviations[n]),
            "rest_deg": float(compared.rest_deg[n]),
            "rest_mm": None if rest is None else float(rest[n]),
            "beyond": bool(beyond[n]),
        }
        for n in order
    ]
    metrics: CheckMetrics = {
        "lights": len(compared.ids),
        "near": far is not None,
        "beyond": int(beyond.sum()),
        "intensity_factor": compared.intensity_factor,
        "mirrored": compared.mirror,
        "reversed": compared.is_reversed,
        "exchanged": [list(cycle) for cycle in compared.exchanged],
        "differences": differences,
    }
    if compared.motion is not None:
        x, y, z = compared.motion.axis.tolist()
        dx, dy, dz = compared.motion.shift_mm.tolist()
        metrics["motion"] = {
            "angle_deg": compared.motion.angle_deg,
            "axis": (x, y, z),
            "shift_mm": (dx, dy, dz),
        }
    return metrics


def _rows(
    compared: calibration.LightComparison, beyond: Bool, order: list[int], *, intensities: bool
) -> Iterator[str]:
    """Yield a table of at most 78 characters; lights beyond a limit have an asterisk."""
    columns = [("angle", [f"{value:.3f} deg" for value in compared.angle_deg])]
    if compared.distance_mm is not None:
        columns.append(("distance", [f"{value:.2f} mm" for value in compared.distance_mm]))
    if intensities:
        columns.append(("intensity", [f"{value:+.1f} %" for value in compared.intensity_percent]))
    if not np.isnan(compared.deviations).all():
        columns.append(("std. dev.", [_short(value) for value in compared.deviations]))
    if compared.motion is not None or not compared.same_order:
        rest, unit = compared.rest_mm, "mm"
        if rest is None:
            rest, unit = compared.rest_deg, "deg"
        columns.append(("remains", [f"{value:.2f} {unit}" for value in rest]))
    names = [name if len(name) <= _LONGEST_ID else f"{name[:11]}..." for name in compared.ids]
    width = max(map(len, names))
    yield f"    {'':{width}}" + "".join(f"{title:>13}" for title, _ in columns)
    for n in order[:_SHOWN]:
        mark = "*" if beyond[n] else " "
        yield f"  {mark} {names[n]:{width}}" + "".join(f"{cells[n]:>13}" for _, cells in columns)
    hidden = order[_SHOWN:]
    if hidden:
        most = [f"{compared.angle_deg[hidden].max():.3f} deg"]
        if compared.distance_mm is not None:
            most.append(f"{compared.distance_mm[hidden].max():.2f} mm")
        if intensities:
            most.append(f"{np.abs(compared.intensity_percent[hidden]).max():.1f} %")
        marked = int(beyond[hidden].sum())
        also = f", {marked} of them beyond a limit" if marked else ""
        yield f"    and {len(hidden)} more, at most {', '.join(most)}{also}"


def _short(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.1f}"


def _verdict(
    compared: calibration.LightComparison, beyond: Bool, *, limits: bool, equal: list[str]
) -> Iterator[str]:
    if equal:
        yield f"intensities are not compared: those of {' and '.join(equal)} are all equal"
    elif not np.isnan(compared.intensity_factor):
        factor = compared.intensity_factor
        yield (
            "the intensities have no common factor"
            if abs(factor - 1) < _NO_FACTOR
            else f"intensities are relative: their common factor of {factor:.4g} was removed"
        )
    if limits:
        count = int(beyond.sum())
        of = rigs.pluralize(len(compared.ids), "light")
        yield (
            f"{count} of {of} {'is' if count == 1 else 'are'} beyond a limit (*)"
            if count
            else f"all {of} that were compared are within the limits"
        )
