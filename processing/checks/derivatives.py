"""How the samples of a block model change with what may be wrong: one column for each parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from acquisition import Lights
from processing.checks.block_model import BlockModel, light_vectors
from rig.arrays import Float64, Intp

# Exponents of the specular lobes about the half vector (Blinn, 1977).
LOBES = (2, 8, 32, 128, 512)
# Names of the columns that say that the surface is not matte.
REFLECTANCE = (*(f"lobe {n}" for n in LOBES), "rough", "slope", "grazing", "retro")
# Columns of each image.
OF_IMAGES = ("gain", "room", "right", "down")
_STEP = 1e-3
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Columns:
    """Derivatives of the samples of blocks.

    Parameters
    ----------
    names
        Names of the Q columns: first c of all images, and then those of each image. The latter are
        ``gain k`` of image k, and likewise the other ones of `OF_IMAGES`.
    of
        Returns the derivatives of some blocks, given by their indices: ``(B, N, c)`` by the
        parameters of all images, and ``(B, N, 4)`` of each image by its own.
    """

    names: tuple[str, ...]
    of: Callable[[Intp], tuple[Float64, Float64]]

    def change(self, blocks: Intp, parameters: Float64) -> Float64:
        """Return how samples ``(B, N)`` of blocks change with the parameters ``(Q,)``."""
        shared, own = self.of(blocks)
        common = shared.shape[2]
        each = parameters[common:].reshape(own.shape[2], -1)
        return np.asarray(shared @ parameters[:common] + np.einsum("bnj,jn->bn", own, each))

    def select(self, *names: str) -> Float64:
        """Return ``(Q, q)``, the unit vectors of columns."""
        chosen = [self.names.index(name) for name in names]
        return np.eye(len(self.names))[:, chosen]

    def images(self, kind: str) -> Float64:
        """Return ``(Q, N)``, the unit vectors of the columns of one kind of all images."""
        return self.select(*(name for name in self.names if name.startswith(f"{kind} ")))


def slopes_of(model: BlockModel) -> tuple[Float64, Float64]:
    """Return the changes ``(P, 3)`` of the scaled normals per block to the right and down.

    They are NaN at the border of the object.
    """
    grid = np.full((*model.shape, 3), np.nan)
    grid.reshape(-1, 3)[model.places] = np.where(model.valid[:, None], model.scaled_normals, np.nan)
    right, down = np.full_like(grid, np.nan), np.full_like(grid, np.nan)
    right[:, 1:-1] = (grid[:, 2:] - grid[:, :-2]) / 2
    down[1:-1] = (grid[2:] - grid[:-2]) / 2
    return right.reshape(-1, 3)[model.places], down.reshape(-1, 3)[model.places]


def columns_of(
    model: BlockModel,
    lights: Lights,
    strengths: Float64,
    rays: Float64 | None,
    slopes: tuple[Float64, Float64],
    toned: Callable[[Float64], Float64] | None,
) -> Columns:
    """Return the columns of a model.

    Parameters
    ----------
    model
        P blocks of N images.
    lights
        The lights.
    strengths
        ``(N,)`` recorded signal of each image relative to its samples.
    rays
        ``(P, 3)`` change of the surface points per mm of height; None under distant lights.
    slopes
        Changes of the scaled normals, see `slopes_of`.
    toned
        Returns the derivative of samples ``(B, N)`` by the depth of a tone curve; None if the
        transfer curve is known.
    """
    moved = _moved_lights(model, lights, rays)
    names = ("ambient", "ambient right", "ambient up", "offset", "curve", *moved, *REFLECTANCE)
    if toned is not None:
        names += ("tone",)
    count = model.samples.shape[1]
    column = {name: i for i, name in enumerate(names)}

    def of(blocks: Intp) -> tuple[Float64, Float64]:
        scaled, predicted = model.scaled_normals[blocks], model.predicted[blocks]
        albedo, normals = model.albedo[blocks], model.normals[blocks]
        vectors, attached = model.vectors[blocks], model.attached[blocks]
        lit = (predicted > 0) & ~attached
        found = np.zeros((len(blocks), count, len(names)))

        def put(name: str, values: Float64) -> None:
            found[:, :, column[name]] = values

        # Images are divided by strengths; room light is not brighter when a lamp is.
        room = (albedo * (1 + normals[:, 2]) / 2)[:, None] / strengths
        put("ambient", room)
        put("ambient right", scaled[:, :1] / strengths)
        put("ambient up", scaled[:, 1:2] / strengths)
        put("offset", (1 / strengths)[None])
        positive = np.where(lit, np.maximum(predicted, 1e-3), 1.0)
        put("curve", positive * np.log(positive * strengths) * lit)
        if toned is not None:
            put("tone", toned(predicted) * lit)
        for name, change in moved.items():
            put(name, _times(change(blocks) - vectors, scaled) * ~attached / _STEP)
        for name, values in reflectance_of(model, blocks).items():
            put(name, values)
        shifts = [-_times(vectors, slope[blocks]) * lit for slope in slopes]
        return found, np.stack([predicted * lit, room, *shifts], axis=2)

    each = (f"{kind} {k}" for kind in OF_IMAGES for k in range(count))
    return Columns((*names, *each), of)


def _times(vectors: Float64, scaled: Float64) -> Float64:
    return np.asarray((vectors @ scaled[..., None])[..., 0])


def _moved_lights(
    model: BlockModel, lights: Lights, rays: Float64 | None
) -> dict[str, Callable[[Intp], Float64]]:
    """Return functions that give the light vectors of blocks after a small change of geometry."""
    points = model.points

    def at(changed: Lights, offset: Float64 | None = None) -> Callable[[Intp], Float64]:
        def vectors(blocks: Intp) -> Float64:
            places = points[blocks] if offset is None else points[blocks] + offset[blocks]
            return light_vectors(changed, places)

        return vectors

    def turned(axis: int) -> Lights:
        about = np.eye(3)[axis] * _STEP
        near = lights.positions_mm is not None
        places = np.asarray(lights.positions_mm if near else lights.directions)
        moved = places + np.cross(about, places)
        axes = np.asarray(lights.axes)
        axes = axes + np.cross(about, axes)
        if near:
            return replace(lights, positions_mm=moved, axes=axes)
        return replace(lights, directions=moved, axes=None)

    found = {f"turn {name}": at(turned(axis)) for axis, name in enumerate("xyz")}
    if lights.positions_mm is not None and rays is not None:
        away = float(np.mean(np.linalg.norm(lights.positions_mm, axis=1)))
        size = np.ptp(points[:, :2], axis=0).max()
        across, up = ((points[:, i : i + 1] - points[:, i].mean()) / size for i in (0, 1))
        for name, shape in {
            "height": 1.0,
            "tilt right": across,
            "tilt up": up,
            "dome": across**2 + up**2,
        }.items():
            found[name] = at(lights, rays * shape * _STEP)
        for axis, name in enumerate("xyz"):
            moved = replace(
                lights, positions_mm=lights.positions_mm + np.eye(3)[axis] * _STEP * away
            )
            found[f"shift {name}"] = at(moved)
        return found
    unit = lights.unit_directions
    size = float(np.ptp(points[:, :2], axis=0).max())

    def nearer(blocks: Intp) -> Float64:
        # Of light vectors by the reciprocal distance, in units of the size of the object.
        place = points[blocks][:, None] / size
        along = (place * unit).sum(axis=2, keepdims=True)
        return np.asarray(unit + _STEP * (3 * along * unit - place))

    def higher(blocks: Intp) -> Float64:
        up = np.broadcast_to(_UP, (len(blocks), 1, 3))
        along = (up * unit).sum(axis=2, keepdims=True)
        return np.asarray(unit + _STEP * (3 * along * unit - up))

    return found | {"near": nearer, "near height": higher}


def reflectance_of(model: BlockModel, blocks: Intp) -> dict[str, Float64]:
    """Return the light ``(B, N)`` of surfaces that are not matte, for a camera above."""
    vectors, normals, predicted = (
        each[blocks] for each in (model.vectors, model.normals, model.predicted)
    )
    lit = (predicted > 0) & ~model.attached[blocks]
    size = np.maximum(np.linalg.norm(vectors, axis=2), 1e-9)
    unit = vectors / size[..., None]
    half = unit + _UP
    half /= np.linalg.norm(half, axis=2, keepdims=True)
    facing = np.clip((half * normals[:, None]).sum(axis=2), 0, 1)
    cosine = np.clip((unit * normals[:, None]).sum(axis=2), 1e-3, 1)
    view = np.clip(normals[:, 2:], 1e-3, 1)
    azimuth = unit[..., 2] - cosine * view
    found = {f"lobe {n}": size * facing**n * lit for n in LOBES}
    matte = predicted * lit
    return found | {
        # Oren and Nayar (1994), first order.
        "rough": matte * np.maximum(azimuth, 0) / np.maximum(cosine, view),
        "slope": matte * cosine,
        "grazing": matte * (1 - cosine) ** 5,
        "retro": matte * (1 - np.clip(half[..., 2], 0, 1)),
    }
