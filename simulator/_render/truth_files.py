"""Files with the ground truth of a session, in the formats of measured results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import (
    SOFTWARE,
    make_folder,
    software_version,
    write_camera,
    write_durably,
    write_exr,
    write_lights,
    write_mask,
)
from simulator._render.cramer_rao import Measurement, cramer_rao_deg
from simulator._render.rendering import Rendering
from simulator._render.truth import Truth
from simulator._scene.scene_file import write_scene


def save_truth(
    folder: Path | str,
    rendering: Rendering,
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
    folder, truth = Path(folder), rendering.truth
    make_folder(folder)
    paths = _save_maps(folder, truth) if truth.mask.any() else {}
    if paths:
        paths["cramer_rao"] = folder / "cramer_rao.exr"
        write_exr(paths["cramer_rao"], _bound_deg(rendering, exposures_us))
    for index in np.flatnonzero(truth.sphere_masks.any(axis=(1, 2))):
        paths[f"sphere_{index}"] = folder / f"sphere_{index}.png"
        write_mask(paths[f"sphere_{index}"], truth.sphere_masks[index])
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


def _save_maps(folder: Path, truth: Truth) -> dict[str, Path]:
    maps: dict[str, npt.NDArray[Any] | None] = {
        "normals": truth.normals,
        "height": truth.height_mm,
        "depth": truth.depth_mm,
        "albedo": truth.albedo,
    }
    paths = {}
    for name, values in maps.items():
        if values is not None:
            paths[name] = folder / f"{name}.exr"
            write_exr(paths[name], values.astype(np.float32))
    paths["mask"] = folder / "mask.png"
    write_mask(paths["mask"], truth.mask)
    if truth.shadows is not None:
        paths["shadows"] = folder / "shadows"
        make_folder(paths["shadows"])
        for light, shadow in zip(truth.lights.ids, truth.shadows, strict=True):
            write_mask(paths["shadows"] / f"{light}.png", shadow)
    return paths


def _bound_deg(rendering: Rendering, exposures_us: Sequence[float]) -> npt.NDArray[np.float32]:
    truth, dead = rendering.truth, list(rendering.scene.lamps.dead)
    height, width = truth.size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    shadows = truth.shadows
    if dead:
        # An image of a dead LED is as dark as a shadow.
        whole = (len(truth.lights), height, width)
        shadows = np.zeros(whole, np.bool_) if shadows is None else shadows.copy()
        shadows[dead] = True
    return cramer_rao_deg(
        truth.normals,
        truth.albedo,
        truth.lights,
        Measurement(
            truth.noise,
            truth.electrons_per_us * truth.lens.vignette(x, y),
            exposures_us,
            background_per_us=rendering.ambient,
            channel=truth.lens.channel(x, y),
        ),
        points_mm=truth.points_mm,
        shadows=shadows,
    )


def _values(rendering: Rendering) -> dict[str, Any]:
    truth = rendering.truth
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
