"""Calibrations of near lights from elsewhere: positions, axes, strengths, in the camera's axes.

The variables and their meaning are those of near_ps (Queau et al., LED-based photometric stereo,
2018): S positions in mm, Dir axes, mu exponents of the radiation pattern, Phi strengths.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from acquisition._errors import DataError
from acquisition.files.text_files import numbered_lines, read_text
from acquisition.value_files.mat5 import read_variables, variable_names
from acquisition.values.camera_model import CameraModel
from acquisition.values.lights import Lights
from rig import Notice, figure
from rig.arrays import Float64

LightAxes = Literal["opencv", "opengl", "house"]

# Names of variables, of files without suffix, and the columns of a table, in any case.
_NAMES: Final = {
    "positions": ("S", "positions", "light_positions", "led_positions"),
    "axes": ("Dir", "axes", "light_axes", "orientations", "directions"),
    "mu": ("mu",),
    "strengths": ("Phi", "strengths", "light_strengths", "intensities"),
}
_COLUMNS: Final = {
    "positions": ("x", "y", "z"),
    "axes": ("dx", "dy", "dz"),
    "mu": ("mu",),
    "strengths": ("phi",),
    "rgb": ("r", "g", "b"),
}
_KNOWN: Final = {name for names in _COLUMNS.values() for name in names}
# Columns of each variable.
_WIDTHS: Final = {"positions": (3,), "axes": (3,), "mu": (1,), "strengths": (1, 3)}
# Lights closer to the camera, relative to its distance, give no shading: they are in metres.
_NEAREST: Final = 0.02
_LISTED: Final = 6
_TEXT_SUFFIXES: Final = {".txt", ".csv", ".dat"}
_AXES: Final = {
    "opencv": "the camera's axes (X right, Y down, Z away from the camera, origin in the camera)",
    "opengl": "the camera's axes (X right, Y up, Z toward the camera, origin in the camera)",
    "house": "our axes (X right, Y up, Z toward the camera, origin in the working plane)",
}


@dataclass(frozen=True, eq=False)
class NearLights:
    """Near lights in the house frame, and the notice that states how they were converted."""

    lights: Lights
    notice: Notice


def is_near_lights(path: Path) -> bool:
    r"""Return whether a file is a calibration of near lights, by its name and its first line.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.value_files import is_near_lights
    >>> _ = Path("lamps.csv").write_text("x y z mu\n100 0 300 1\n0 100 300 1\n")
    >>> is_near_lights(Path("lamps.csv"))
    True
    """
    suffix = path.suffix.casefold()
    if suffix == ".mat":
        return True
    if suffix not in _TEXT_SUFFIXES or not path.is_file():
        return False
    return _is_named(path, "positions") or _header(path) is not None


def read_near_lights(
    path: str | Path, camera: CameraModel | None, *, axes: LightAxes | None = None
) -> NearLights:
    r"""Read a calibration of near lights and convert it to the house frame.

    Parameters
    ----------
    path
        A ``.mat`` (version 5 to 7) with ``S``, N x 3 positions in mm, and optionally ``Dir``, N x 3
        axes along which the lights shine, ``mu``, N exponents of their radiation patterns, and
        ``Phi``, N x 1 or N x 3 strengths. Or a text file ``S.txt`` or ``light_positions.txt`` with
        the other variables in text files of the same folder (``Dir.txt``, ``mu.txt``,
        ``Phi.txt``). Or a text table with a line of column names: ``x y z``, and optionally
        ``dx dy dz``, ``mu``, and ``phi`` or ``r g b``.
    camera
        Camera with a working distance; not needed for axes of the house frame.
    axes
        Axes of positions and directions: ``opencv`` or ``opengl``, with the origin in the centre of
        projection, or ``house``. Default: ``opencv``, as in near_ps; the notice says so.

    Returns
    -------
    NearLights
        Lights with the irradiance at the origin as intensity, relative to its mean: strength times
        ``cos(angle) ** mu / distance ** 2``. Missing variables: axes toward the origin, mu 0, equal
        strengths.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If a value is missing or invalid, lights do not shine toward the origin in these axes, or a
        camera with a working distance is needed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition.value_files import read_near_lights
    >>> _ = Path("lamps.csv").write_text("x y z mu\n100 0 300 1\n0 100 300 1\n")
    >>> read_near_lights("lamps.csv", None, axes="house").lights.positions_mm
    array([[100.,   0., 300.],
           [  0., 100., 300.]])
    """
    path = Path(path)
    values, unused = _variables(path)
    if "positions" not in values:
        others = f"; it has {', '.join(unused[:_LISTED])}" if unused else ""
        raise DataError(
            f"{path}: no positions of lights: S is missing{others}: save the variables themselves, "
            "not in a struct, under the names S, Dir, mu and Phi"
        )
    values = _checked(path, values)
    count = len(values["positions"])
    chosen: LightAxes = axes or "opencv"
    positions, directions = _in_house(path, values, camera, chosen)
    mu = values["mu"][:, 0] if "mu" in values else None
    lights = Lights(positions_mm=positions, axes=directions, mu=mu)
    strengths = values.get("strengths")
    lights = _with_intensities(path, lights, strengths, chosen, given=axes is not None)
    how = "given" if axes is not None else "assumed"
    ignored = f"; not used: {', '.join(unused[:_LISTED])}" if unused else ""
    there = [name for name in ("axes", "mu", "strengths") if name in values]
    text = (
        f"{count} positions in mm{''.join(f', {name}' for name in there)} in {_AXES[chosen]}, as "
        f"{how}; converted to ours{ignored}"
    )
    return NearLights(lights, Notice("light-axes", text, str(path), "info" if axes else "warning"))


def _in_house(
    path: Path, values: dict[str, Float64], camera: CameraModel | None, axes: LightAxes
) -> tuple[Float64, Float64 | None]:
    positions, directions = values["positions"], values.get("axes")
    if axes == "house":
        return positions, directions
    if camera is None or camera.working_distance_mm is None:
        raise DataError(
            f"{path}: positions in the camera's axes need a camera with its working distance, from "
            "the centre of projection to the object"
        )
    flip = np.array([1.0, 1.0, 1.0] if axes == "opencv" else [1.0, -1.0, -1.0])
    centre = camera.from_opencv(np.zeros(3))
    house = camera.from_opencv(positions * flip)
    farthest = float(np.linalg.norm(positions, axis=1).max())
    if farthest < _NEAREST * camera.working_distance_mm:
        raise DataError(
            f"{path}: all lights are within {figure(farthest, 3)} mm of the camera, which is "
            f"{camera.working_distance_mm:g} mm from the object: S must be in millimetres"
        )
    return house, None if directions is None else camera.from_opencv(directions * flip) - centre


def _with_intensities(
    path: Path, lights: Lights, strengths: Float64 | None, axes: LightAxes, *, given: bool
) -> Lights:
    """Convert strengths of sources to irradiance at the origin."""
    positions, along, mu = map(np.asarray, (lights.positions_mm, lights.axes, lights.mu))
    distance = np.linalg.norm(positions, axis=1)
    cosine = -np.sum(positions * along, axis=1) / distance
    # A light in front of the object that shines toward the camera shows that Z is reversed.
    dark = (cosine <= 0) | ((positions[:, 2] > 0) & (along[:, 2] > 0))
    if dark.any():
        away = int(dark.sum())
        hint = "" if given else "; state the axes of the file if they are others"
        raise DataError(
            f"{path}: {away} of {len(lights)} lights shine away from the object in {_AXES[axes]}"
            f"{hint}"
        )
    if strengths is not None and not np.all(strengths > 0):
        raise DataError(f"{path}: a strength of a light is not a positive number")
    irradiance = (cosine**mu / distance**2)[:, None] * (1.0 if strengths is None else strengths)
    irradiance = np.broadcast_to(irradiance, (len(lights), 3))
    return replace(lights, intensities=irradiance / irradiance.mean())


def _variables(path: Path) -> tuple[dict[str, Float64], list[str]]:
    """Return the variables of a file by our names, and the names of its other variables."""
    if path.suffix.casefold() == ".mat":
        there = variable_names(path)
        by_name = {name.casefold(): name for name in reversed(there)}
        chosen = {
            ours: by_name[name.casefold()]
            for ours, names in _NAMES.items()
            for name in reversed(names)
            if name.casefold() in by_name
        }
        found = read_variables(path, chosen.values())
        values = {ours: found[name] for ours, name in chosen.items()}
        return values, [name for name in there if name not in chosen.values()]
    if (header := _header(path)) is not None:
        return _columns(path, header), []
    siblings = {ours: _sibling(path, ours) for ours in _NAMES}
    return {ours: array for ours, array in siblings.items() if array is not None}, []


def _checked(path: Path, values: dict[str, Float64]) -> dict[str, Float64]:
    """Return variables with one row per light, or say what is wrong with one of them.

    MATLAB's vectors have one row or one column, and a single number counts for all lights.
    """
    shape = values["positions"].shape
    count = shape[0]
    checked = {}
    for ours, widths in _WIDTHS.items():
        if (array := values.get(ours)) is None:
            continue
        name = _NAMES[ours][0]
        if 1 in widths and array.shape in ((1, count), (1, 1)):
            array = np.broadcast_to(array.reshape(-1, 1), (count, 1))
        size = " x ".join(map(str, array.shape))
        across = array.shape[0] in widths and (ours == "positions" or array.shape[0] != count)
        if array.shape[1] not in widths and across:
            raise DataError(
                f"{path}: {name} is {size}, but must have a row for each light: transpose it"
            )
        if array.shape[1] not in widths or array.shape[0] != count:
            must = " or ".join(f"{count} x {width}" for width in widths)
            raise DataError(f"{path}: {name} is {size}, but must be {must} for {count} lights")
        if not np.isfinite(array).all():
            light = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
            raise DataError(f"{path}: {name} of light {light} is not finite")
        checked[ours] = array
    if "axes" in checked and (zero := np.flatnonzero(~checked["axes"].any(axis=1))).size:
        raise DataError(f"{path}: Dir of light {zero[0]} has the length 0")
    return checked


def _is_named(path: Path, ours: str) -> bool:
    return path.stem.casefold() in {name.casefold() for name in _NAMES[ours]}


def _sibling(path: Path, ours: str) -> Float64 | None:
    """Return the numbers of a variable from the file itself or from a file next to it."""
    if not _is_named(path, ours):
        others = (one for one in sorted(path.parent.iterdir()) if _is_named(one, ours))
        found = next((one for one in others if one.suffix.casefold() in _TEXT_SUFFIXES), None)
        if found is None:
            return None
        path = found
    return _numbers(path, numbered_lines(read_text(path)))


def _words(line: str) -> list[str]:
    return [word for word in re.split(r"[\s,;]+", line.lstrip("#% ")) if word]


def _header(path: Path) -> list[str] | None:
    """Return the column names of a table, or None if its first line has none."""
    lines = numbered_lines(read_text(path))
    names = [word.casefold() for word in _words(lines[0][1])] if lines else []
    # Three columns alone may be directions.
    return names if {"x", "y", "z"} < _KNOWN & set(names) else None


def _columns(path: Path, header: list[str]) -> dict[str, Float64]:
    table = _numbers(path, numbered_lines(read_text(path))[1:], header)
    values = {
        ours: table[:, [header.index(name) for name in names]]
        for ours, names in _COLUMNS.items()
        if set(names) <= set(header)
    }
    if "rgb" in values:
        values["strengths"] = values.pop("rgb")
    return values


def _numbers(path: Path, lines: list[tuple[int, str]], header: list[str] | None = None) -> Float64:
    """Return the numbers of a table; columns whose names we do not know may hold text."""
    rows: list[list[float]] = []
    for number, line in lines:
        words = _words(line)
        names = header or ["x"] * len(words)
        try:
            if len(words) != len(names) or (rows and len(rows[0]) != len(words)):
                raise ValueError
            row = [float(w) if n in _KNOWN else 0.0 for n, w in zip(names, words, strict=True)]
        except ValueError:
            raise DataError(f"{path} line {number}: '{line[:40]}' does not fit its table") from None
        if not np.isfinite(row).all():
            raise DataError(f"{path} line {number}: a number is not finite")
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: no numbers")
    return np.array(rows)
