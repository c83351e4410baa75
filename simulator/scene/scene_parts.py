"""Parts of a scene file: recipes, files or lists for lights and lenses, and all kinds of parts."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from acquisition import CameraModel, DataError, Lights, read_camera, read_lights
from acquisition.values import led_id
from rig.messages import validation_message
from simulator.scene.clutter import Ball, Box
from simulator.scene.lens import Lens, Optics
from simulator.scene.reflectance import Ggx, Lambert, OrenNayar
from simulator.scene.rig_scenes import dome_lights, ring_directions
from simulator.shapes.carved_surfaces import (
    CrackedLeather,
    LizardScales,
    StepGauge,
    Textile,
    WoodCarving,
)
from simulator.shapes.coin import Coin
from simulator.shapes.grounds import Cork, Print, Weave, Wood
from simulator.shapes.mesh import MeshBody
from simulator.shapes.patterns import ChArUco, Checker, ColourWheel, Even, Gradient, Paint
from simulator.shapes.surface import BandNoise, Plane, Ripples, SphericalCap

_Vector = tuple[float, float, float]
_OPTICS = Optics()
_FIELD_MM, _DISTANCE_MM = 293.76, 600.0
# Maximum in a rig file.
_MOST_LEDS = 4096
Kinds = Mapping[str, Callable[..., Any]]
_LARGEST = 1e12
_CONFIG = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def build(maker: Callable[..., Any], values: Mapping[str, Any], where: str, **defaults: Any) -> Any:
    """Call a class or function with the keys of a table, checked against its signature.

    The keys of a table are the parameters of the object, so there is no second list of parameters
    that could become outdated. A new surface or pattern needs only an entry in a mapping of kinds.

    Parameters
    ----------
    maker
        A dataclass or an annotated function.
    values
        Keys and values of the table.
    where
        Name of the table, for messages.
    **defaults
        Values of parameters that are not in the table; ignored if ``maker`` has no parameter of
        that name.

    Raises
    ------
    DataError
        If a key is unknown or missing, a value has the wrong type, or ``maker`` raises it. The
        message names table and key.
    """
    model = _model(maker)
    keys = model.model_fields
    values = {name: value for name, value in defaults.items() if name in keys} | dict(values)
    try:
        read = model.model_validate(values)
    except ValidationError as error:
        message = validation_message(error, noun="key", known=keys)
        raise DataError(f"[{where}]: {message}") from error
    check_range(read, where)
    try:
        return maker(**{name: getattr(read, name) for name in keys})
    except DataError as error:
        raise DataError(f"[{where}]: {error}") from error


def check_range(read: BaseModel, where: str) -> None:
    """Check that no number is so large that its square could overflow.

    Raises
    ------
    DataError
        If a number is too large; the message names table and key.
    """
    for key, value in read:
        numbers = [value]
        while numbers:
            number = numbers.pop()
            if isinstance(number, (tuple, list)):
                numbers += number
            elif isinstance(number, float) and abs(number) > _LARGEST:
                raise DataError(f"[{where}]: key {key!r}: {number:g} is larger than {_LARGEST:g}")


def build_kind(kinds: Kinds, values: Mapping[str, Any], where: str, **defaults: Any) -> Any:
    """Build an object of the kind that the key ``kind`` of a table names.

    Raises
    ------
    DataError
        If the kind is missing or unknown, or `build` raises it.
    """
    rest = dict(values)
    kind = rest.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        fault = "kind is missing" if kind is None else f"unknown kind {kind!r}"
        raise DataError(f"[{where}]: {fault}: use one of {', '.join(kinds)}")
    return build(kinds[kind], rest, where, **defaults)


def table(value: Any) -> dict[str, Any]:
    """Return a dataclass as a table, without None and without default values.

    Seeds are always included; otherwise a reader would use the seed of its own scene.
    """
    entries: dict[str, Any] = {}
    for item in dataclasses.fields(value):
        content, default = getattr(value, item.name), item.default
        same = type(content) is type(default) and bool(content == default)
        if content is not None and (item.name == "seed" or not same):
            entries[item.name] = content
    return entries


def kind_table(kinds: Kinds, value: Any) -> dict[str, Any]:
    """Return an object as a table with its kind.

    Raises
    ------
    DataError
        If scene files have no kind for the object.
    """
    for kind, maker in kinds.items():
        if type(value) is maker:
            return {"kind": kind} | table(value)
    raise DataError(f"a scene file has no kind for a {type(value).__name__}")


@functools.cache
def _model(maker: Callable[..., Any]) -> type[BaseModel]:
    hints = get_type_hints(maker)
    parts: dict[str, Any] = {}
    for name, parameter in inspect.signature(maker).parameters.items():
        required = parameter.default is inspect.Parameter.empty
        parts[name] = (hints[name], ... if required else parameter.default)
    return create_model(maker.__name__, __config__=_CONFIG, **parts)


def dome(
    count: int = 36,
    radius_mm: float = 450.0,
    spread: float = 0.03,
    jitter_mm: float = 4.0,
    mu: float | None = None,
    seed: int = 0,
) -> Lights:
    """Return LEDs on rings of a dome, see `dome_lights`; ``mu`` applies to all of them."""
    _check_count(count)
    lights = dome_lights(count, radius_mm, seed=seed, spread=spread, jitter_mm=jitter_mm)
    return lights if mu is None else replace(lights, mu=np.full(count, mu))


def _check_count(count: int) -> None:
    if count > _MOST_LEDS:
        raise DataError(f"count is {count}, but a board has at most {_MOST_LEDS} LEDs")


def ring(
    count: int = 36,
    radius_mm: float = 450.0,
    elevation_deg: float = 45.0,
    spread: float = 0.03,
    mu: float = 1.0,
    seed: int = 0,
) -> Lights:
    """Return LEDs at equal angles on one ring, ``radius_mm`` from the origin.

    The first LED is on the right. The intensities have the relative standard deviation ``spread``.
    """
    _check_count(count)
    if count < 1 or not radius_mm > 0 or not 0 < elevation_deg < 90 or not 0 <= spread < 0.3:
        raise DataError(
            f"a ring of {count} LEDs, radius {radius_mm:g} mm, elevation {elevation_deg:g} deg, "
            f"spread {spread:g} cannot be built: count >= 1, radius > 0, elevation within 0..90, "
            "spread < 0.3"
        )
    directions = ring_directions(
        2 * math.pi * np.arange(count) / count, math.radians(elevation_deg)
    )
    drawn = np.random.default_rng(seed).normal(1, spread, count)
    return Lights(
        positions_mm=radius_mm * directions,
        intensities=np.clip(drawn, 1 - 3 * spread, 1 + 3 * spread),
        mu=np.full(count, mu),
    )


def lights_file(file: Path) -> Lights:
    """Return the lights of a file that `read_lights` reads; LED n is the n-th light.

    The lights of a scene are exact and were not calibrated, whatever the file says about them.
    """
    lights = read_lights(file)
    ids = tuple(led_id(led) for led in range(len(lights)))
    return replace(lights, ids=ids, errors=None, calibrated=None)


def listed(
    positions_mm: tuple[_Vector, ...] | None = None,
    directions: tuple[_Vector, ...] | None = None,
    intensities: tuple[_Vector, ...] | tuple[float, ...] | None = None,
    axes: tuple[_Vector, ...] | None = None,
    mu: tuple[float, ...] | None = None,
) -> Lights:
    """Return lights from lists with one row per light, see `Lights`."""
    lists = (directions, positions_mm, intensities, axes, mu)
    arrays: list[Any] = [None if rows is None else np.array(rows, np.float64) for rows in lists]
    return Lights(*arrays)


def perspective(
    width: int = 640,
    height: int = 512,
    field_mm: float = _FIELD_MM,
    working_distance_mm: float = _DISTANCE_MM,
    K: tuple[_Vector, _Vector, _Vector] | None = None,
    distortion: tuple[float, ...] = (),
    vignetting: float = 0.0,
    psf_sigma_px: float = 0.7,
    f_number: float = _OPTICS.f_number,
    focal_length_mm: float = _OPTICS.focal_length_mm,
    focus_mm: float | None = None,
    wavelength_um: float = _OPTICS.wavelength_um,
    sharp: bool = True,
    cfa: str | None = None,
) -> Lens:
    """Return a perspective lens with a field ``field_mm`` wide, or with the matrix ``K``."""
    if K is None:
        if not (field_mm > 0 and working_distance_mm > 0):
            raise DataError("field_mm and working_distance_mm of a camera must be positive")
        focal = max(width, 1) * working_distance_mm / field_mm
        K = ((focal, 0.0, (width - 1) / 2), (0.0, focal, (height - 1) / 2), (0.0, 0.0, 1.0))
    camera = CameraModel(np.array(K), width, height, working_distance_mm, np.array(distortion))
    optics = Optics(f_number, focal_length_mm, focus_mm, wavelength_um)
    return Lens(
        camera, vignetting=vignetting, psf_sigma_px=psf_sigma_px,
        optics=optics, sharp=sharp, cfa=cfa,
    )  # fmt: skip


def camera_file(
    file: Path,
    vignetting: float = 0.0,
    psf_sigma_px: float = 0.7,
    f_number: float = _OPTICS.f_number,
    focal_length_mm: float = _OPTICS.focal_length_mm,
    focus_mm: float | None = None,
    wavelength_um: float = _OPTICS.wavelength_um,
    sharp: bool = True,
    cfa: str | None = None,
) -> Lens:
    """Return the lens of a camera file, which has an image size and a working distance."""
    optics = Optics(f_number, focal_length_mm, focus_mm, wavelength_um)
    return Lens(
        read_camera(file), vignetting=vignetting, psf_sigma_px=psf_sigma_px,
        optics=optics, sharp=sharp, cfa=cfa,
    )  # fmt: skip


def orthographic(
    width: int = 640,
    height: int = 512,
    pixel_mm: float = _FIELD_MM / 640,
    height_mm: float = _DISTANCE_MM,
    vignetting: float = 0.0,
    psf_sigma_px: float = 0.7,
    sharp: bool = True,
    cfa: str | None = None,
) -> Lens:
    """Return a lens with parallel rays, ``pixel_mm`` apart."""
    return Lens.orthographic(
        width, height, pixel_mm, height_mm,
        vignetting=vignetting, psf_sigma_px=psf_sigma_px, sharp=sharp, cfa=cfa,
    )  # fmt: skip


def mesh(
    file: Path, radius_mm: float, turn_deg: _Vector = (0.0, 0.0, 0.0), smooth: bool = True
) -> MeshBody:
    """Read a mesh and place it on the board, see `MeshBody.read`."""
    return MeshBody.read(file, radius_mm=radius_mm, turn_deg=turn_deg, smooth=smooth)


def resized(lens: Lens, width: int, height: int) -> Lens:
    """Return a lens with another number of pixels and the same width of field."""
    rows, columns = lens.size
    gain = width / columns
    if lens.camera is None:
        pixel_mm = float(lens.pixel_mm or 0.0) / gain
        return replace(lens, width=width, height=height, pixel_mm=pixel_mm)
    # The principal point keeps its position relative to the middle of the image.
    old, new = np.array([columns - 1, rows - 1]) / 2, np.array([width - 1, height - 1]) / 2
    K = lens.camera.K.copy()
    K[:2, :2] *= gain
    K[:2, 2] = new + gain * (K[:2, 2] - old)
    return replace(lens, camera=replace(lens.camera, K=K, width=width, height=height))


def lens_table(lens: Lens) -> dict[str, Any]:
    """Return the table of a lens, for `perspective` or `orthographic`."""
    height, width = lens.size
    entries: dict[str, Any] = {"width": width, "height": height}
    if lens.camera is None:
        entries |= {"kind": "orthographic", "pixel_mm": lens.pixel_mm, "height_mm": lens.height_mm}
    else:
        entries |= {
            "kind": "perspective",
            "working_distance_mm": lens.camera.working_distance_mm,
            "K": lens.camera.K.tolist(),
            "distortion": lens.camera.distortion.tolist(),
            **asdict(lens.optics),
        }
    entries |= {"vignetting": lens.vignetting, "psf_sigma_px": lens.psf_sigma_px}
    entries |= {"sharp": lens.sharp, "cfa": lens.cfa}
    return {name: value for name, value in entries.items() if value is not None}


LIGHTS: Kinds = {"dome": dome, "ring": ring, "file": lights_file, "listed": listed}
LENSES: Kinds = {"perspective": perspective, "orthographic": orthographic, "file": camera_file}
BODIES: Kinds = {
    "plane": Plane,
    "cap": SphericalCap,
    "coin": Coin,
    "ripples": Ripples,
    "scales": LizardScales,
    "textile": Textile,
    "woodcarving": WoodCarving,
    "leather": CrackedLeather,
    "noise": BandNoise,
    "step-gauge": StepGauge,
    "mesh": mesh,
}
# Objects that can be the relief of the board.
RELIEFS: Kinds = {kind: BODIES[kind] for kind in ("noise", "textile", "leather", "ripples")}
CLUTTER: Kinds = {"ball": Ball, "box": Box}
PATTERNS: Kinds = {
    "even": Even,
    "checker": Checker,
    "gradient": Gradient,
    "paint": Paint,
    "colour-wheel": ColourWheel,
    "charuco": ChArUco,
    "cork": Cork,
    "wood": Wood,
    "print": Print,
    "weave": Weave,
}
MATERIALS: Kinds = {"lambert": Lambert, "oren-nayar": OrenNayar, "ggx": Ggx}
