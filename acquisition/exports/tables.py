"""Files of lights, masks and normals in the formats of other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from acquisition.files.storage import write_durably
from acquisition.value_files.lights_text import DIRECTIONS_FILE, FILENAMES_FILE, INTENSITIES_FILE
from acquisition.value_files.mat5 import write_normals_mat
from acquisition.values.lights import Lights
from rig.arrays import Float32, Float64


def write_diligent_tables(
    folder: Path, names: Sequence[str], lights: Lights, normals: Float32 | None
) -> list[Path]:
    """Write filenames.txt, light_directions.txt, light_intensities.txt, and Normal_gt.mat.

    Normal_gt.mat is written only if ``normals`` is given.
    """
    files = [
        _text(folder / FILENAMES_FILE, [[name] for name in names]),
        _text(folder / DIRECTIONS_FILE, _numbers(lights.unit_directions)),
        _text(folder / INTENSITIES_FILE, _numbers(np.asarray(lights.intensities))),
    ]
    if normals is not None:
        files.append(folder / "Normal_gt.mat")
        write_normals_mat(files[-1], normals)
    return files


def write_lp_table(folder: Path, names: Sequence[str], lights: Lights) -> Path:
    """Write lights.lp: the count, then one line per file with its unit light direction."""
    vectors = _numbers(lights.unit_directions)
    rows = [[name, *vector] for name, vector in zip(names, vectors, strict=True)]
    return _text(folder / "lights.lp", [[str(len(rows))], *rows])


def write_alicevision_lights(folder: Path, views: Sequence[int], lights: Lights) -> Path:
    """Write AliceVision's lights JSON: numbers as text, y down and z away from the camera."""
    directions = _numbers(lights.unit_directions * (1.0, -1.0, -1.0))
    strengths = _numbers(np.asarray(lights.intensities))
    records = [
        {"viewId": str(view), "type": "directional", "direction": toward, "intensity": strength}
        for view, toward, strength in zip(views, directions, strengths, strict=True)
    ]
    path = folder / "alicevision_lights.json"
    write_durably(path, (json.dumps({"lights": records}, indent=1) + "\n").encode())
    return path


def _numbers(table: Float64) -> list[list[str]]:
    """Format numbers without exponents, with enough digits to read back exactly."""
    return [[np.format_float_positional(value, trim="0") for value in row] for row in table]


def _text(path: Path, rows: Sequence[Sequence[str]]) -> Path:
    write_durably(path, "".join(" ".join(row) + "\n" for row in rows).encode())
    return path
