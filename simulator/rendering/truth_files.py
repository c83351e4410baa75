"""Files with the ground truth of a session, in the formats of measured results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import (
    MapRows,
    make_folder,
    write_camera,
    write_durably,
    write_exr,
    write_lights,
    write_mask,
)
from acquisition.files import SOFTWARE, ComputedRows, rows_in_bands, software_version
from rig.arrays import AnyArray, Float32
from simulator.rendering.cramer_rao import Measurement, cramer_rao_deg
from simulator.rendering.renderer import StoredRendering
from simulator.rendering.rendering import Rendering
from simulator.scene.scene_file import write_scene

_BAND_BYTES = 2**26


def save_truth(
    folder: Path | str,
    rendering: Rendering | StoredRendering,
    *,
    exposures_us: Sequence[float],
    facts: Mapping[str, Any] | None = None,
) -> dict[str, Path]:
    """Write the ground truth of a recorded scene to a folder.

    The files are ``lights.json``, and ``camera.json`` for a perspective camera. If an object is in
    view: ``normals.exr``, ``height.exr`` and ``depth.exr`` (mm), ``albedo.exr``, ``mask.png``,
    ``shadows/L00.png`` and so on (white: no light from this LED), and ``cramer_rao.exr``, the
    smallest rms angular error in degrees of an unbiased estimate of the normal. ``sphere_0.png``
    and so on are the masks of the spheres in view. ``scene.toml`` recreates the scene, with
    ``scene.lights.json`` and, for a mesh, ``scene.ply``. ``truth.json`` contains spheres, mirrored
    LEDs, dead LEDs, sensor and exposure scale; it is written last.

    Parameters
    ----------
    folder
        Folder for the files; created if it does not exist. Files of these names are replaced.
    rendering
        Rendering that was recorded.
    exposures_us
        Exposure times of the images of each light, for the Cramer-Rao bound.
    facts
        Additional entries of ``truth.json``, for example seeds; values must be valid in JSON.

    Returns
    -------
    dict
        Paths by name; ``shadows`` is a folder.

    Raises
    ------
    StorageError
        If a file cannot be written.
    DataError
        If an exposure time is not positive, or scene files have no kind for a part of the scene.

    Examples
    --------
    >>> from simulator import render, save_truth, scene_named
    >>> rendering = render(scene_named("coin", width=64, height=52, leds=4))
    >>> files = save_truth("truth", rendering, exposures_us=[10_000.0])
    >>> files["normals"].name, files["mask"].name
    ('normals.exr', 'mask.png')
    """
    folder, maps, truth = Path(folder), rendering.maps, rendering.truth_of(slice(0, 1))
    make_folder(folder)
    paths = _save_maps(folder, rendering, exposures_us) if _any(maps["mask"]) else {}
    for name, mask in maps.items():
        if name.startswith("sphere_") and _any(mask):
            paths[name] = folder / f"{name}.png"
            write_mask(paths[name], mask)
    paths["lights"] = folder / "lights.json"
    write_lights(paths["lights"], truth.lights, {"method": "simulated"})
    if truth.camera is not None:
        paths["camera"] = folder / "camera.json"
        write_camera(paths["camera"], truth.camera)
    paths["scene"] = folder / "scene.toml"
    write_scene(paths["scene"], rendering.scene)
    paths["truth"] = folder / "truth.json"
    values = _values(rendering) | dict(facts or {})
    text = json.dumps(values, indent=1, allow_nan=False)
    write_durably(paths["truth"], f"{text}\n".encode())
    return paths


def _any(mask: MapRows) -> bool:
    height, width = mask.shape
    return any(mask[rows].any() for rows in rows_in_bands(height, width, _BAND_BYTES))


def _save_maps(
    folder: Path, rendering: Rendering | StoredRendering, exposures_us: Sequence[float]
) -> dict[str, Path]:
    maps, lens = rendering.maps, rendering.truth_of(slice(0, 1)).lens
    size = maps["mask"].shape

    def depth(rows: slice) -> AnyArray:
        return lens.camera_z_mm - maps["height"][rows]

    def bound(rows: slice) -> Float32:
        return _bound_deg(rendering, rows, exposures_us)

    written: dict[str, MapRows] = {"normals": maps["normals"], "height": _single(maps["height"])}
    if lens.camera is not None:
        written["depth"] = _single(ComputedRows(size, np.dtype(np.float64), depth))
    written["albedo"] = maps["albedo"]
    written["cramer_rao"] = ComputedRows(size, np.dtype(np.float32), bound)
    paths = {}
    for name, values in written.items():
        paths[name] = folder / f"{name}.exr"
        write_exr(paths[name], values)
    paths["mask"] = folder / "mask.png"
    write_mask(paths["mask"], maps["mask"])
    shadows = {name: dark for name, dark in maps.items() if name.startswith("shadows/")}
    if shadows:
        paths["shadows"] = folder / "shadows"
        make_folder(paths["shadows"])
    for name, dark in shadows.items():
        write_mask(folder / f"{name}.png", dark)
    return paths


def _single(values: MapRows) -> ComputedRows:
    single = np.dtype(np.float32)
    return ComputedRows(values.shape, single, lambda rows: values[rows].astype(single))


def _bound_deg(
    rendering: Rendering | StoredRendering, rows: slice, exposures_us: Sequence[float]
) -> Float32:
    truth, dead = rendering.truth_of(rows), list(rendering.scene.lamps.dead)
    shadows, places = truth.shadows, truth.places_px
    if dead:
        # An image of a dead LED is as dark as a shadow.
        whole = (len(truth.lights), *truth.size)
        shadows = np.zeros(whole, np.bool_) if shadows is None else shadows.copy()
        shadows[dead] = True
    measurement = Measurement(
        truth.noise,
        truth.electrons_per_us * truth.lens.vignette(*places),
        exposures_us,
        background_per_us=rendering.plane(None)[rows],
        channel=truth.lens.channel(*places),
    )
    surface = truth.normals, truth.albedo, truth.lights, measurement
    return cramer_rao_deg(*surface, points_mm=truth.points_mm, shadows=shadows)


def _values(rendering: Rendering | StoredRendering) -> dict[str, Any]:
    truth = rendering.truth_of(slice(0, 1))
    spheres = zip(truth.sphere_centres_mm, truth.sphere_radii_mm, truth.highlights_px, strict=True)
    return {
        "format": "sgp-truth",
        "version": 1,
        "software": {"name": SOFTWARE, "version": software_version()},
        "spheres": [
            {
                "centre_mm": centre.tolist(),
                "radius_mm": float(radius),
                # An LED that is not mirrored into the camera has no position: null.
                "highlights_px": [
                    place.tolist() if np.isfinite(place).all() else None for place in places
                ],
            }
            for centre, radius, places in spheres
        ],
        "dead_leds": list(rendering.scene.lamps.dead),
        "sensor": asdict(truth.noise),
        "electrons_per_us": truth.electrons_per_us,
    }
