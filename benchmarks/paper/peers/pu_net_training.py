"""The training of PU-Net, on points of the simulated surfaces that our own network learned from.

The normals of a surface and of its reduction, as in `sgp.training`, are both integrated. The points
of the reduction are the input, those of the surface the target. Half of the patches are grids of
points four pixels apart, half are irregular ones two pixels apart, as the first pass makes them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

import processing
import simulator
from benchmarks.paper.peers.checkpoints import converged, load, save, thinned, write_weights
from benchmarks.paper.peers.layers import OnnxLayers, TorchLayers, first_weights
from benchmarks.paper.peers.pu_net import (
    CHILDREN,
    POINTS,
    Patches,
    normalised,
    pu_net,
    weight_shapes,
)
from rig import Progress
from rig.arrays import Float32, Float64, Int64

if TYPE_CHECKING:
    import torch

PEER = "pu_net"
STEPS = 3000
# Random and rugged surfaces, and their first seed: those of the network of the program.
_SURFACES, _RUGGED, _FIRST_SEED, _SIDE_PX = 400, 200, 100_000, 240
_BATCH, _RATE, _WARMING = 8, 1e-3, 100
# Of the joint loss, as published: weight of the assignment, decay of weights; radius and width of
# the repulsion, for half the density of points.
_ASSIGNMENT, _DECAY, _REPULSION_RADIUS, _REPULSION_WIDTH = 100.0, 1e-5, 0.14, 0.06
_NEIGHBOURS = 5
_GROUP = 64  # points that are assigned together
_JITTER = 0.3
# Standard deviation of the Gaussian of what is slow: a patch does not determine it.
DRIFT_PX = 18.0
_SAVE_EVERY_S = 60.0


class Heights(NamedTuple):
    """Heights in pixels: a surface, its reductions by 2 and by 4; and splines of the first."""

    full: Float32
    half: Float32
    quarter: Float32
    splines: Float32


def surface_of(normals: Float32) -> Heights:
    """Return the heights of normals and of their reductions, without slow drift between them."""
    given = processing.NormalMap.from_vectors(normals)
    full, half, quarter = (
        scale * np.asarray(processing.integrate(low, discontinuity=False).height, np.float32)
        for scale in (1, 2, 4)
        for low in (processing.superres.low_resolution(given, scale),)
    )
    full, half = _without_drift(full, quarter), _without_drift(half, quarter)
    return Heights(full, half, quarter, spline_filter(full, output=np.float32))


def _without_drift(heights: Float32, reduced: Float32) -> Float32:
    """Return heights less their slow difference from those of the reduction by 4."""
    height, width = reduced.shape
    apart = cv2.resize(heights, (width, height), interpolation=cv2.INTER_AREA) - reduced
    drift = cv2.GaussianBlur(apart, (0, 0), DRIFT_PX / 4, borderType=cv2.BORDER_REFLECT)
    return heights - np.asarray(cv2.resize(drift, heights.shape[::-1]), np.float32)


def surfaces(count: int, rugged: int, advance: Progress) -> list[Heights]:
    """Return the surfaces to learn from; those with pixels that face away are left out."""
    made: list[Heights] = []
    kinds = [(simulator.random_normals, count), (simulator.reliefs.rugged_normals, rugged)]
    for make, number in kinds:
        for seed in range(number):
            advance("surfaces", len(made), count + rugged)
            made.append(surface_of(make(_FIRST_SEED + seed, _SIDE_PX)))
    return [one for one in made if all(np.isfinite(heights).all() for heights in one)]


class Patch(NamedTuple):
    """Points to learn from.

    Parameters
    ----------
    given, target
        ``(256, 3)`` and ``(1024, 3)`` points in the ball of a patch.
    middle, axes
        Points of the ball are ``ball @ axes + middle`` on the surface, in pixels.
    splines
        Of the heights of the surface.
    """

    given: Float32
    target: Float32
    middle: Float64
    axes: Float64
    splines: Float32

    def feet(self, points: Float32) -> tuple[Float32, Float32]:
        """Return the points of the surface above or below others in the ball, and their normals."""
        places = points @ self.axes + self.middle

        def height(right: float, down: float) -> Float64:
            at = [places[:, 1] + down, places[:, 0] + right]
            return map_coordinates(self.splines, at, np.float64, prefilter=False, mode="mirror")

        normals = np.stack(
            [
                height(-0.5, 0) - height(0.5, 0),
                height(0, -0.5) - height(0, 0.5),
                np.ones(len(places)),
            ],
            axis=-1,
        )
        places[:, 2] = height(0, 0)
        normals = normals @ self.axes.T
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        feet = (places - self.middle) @ np.linalg.inv(self.axes)
        return feet.astype(np.float32), normals.astype(np.float32)


def patch_of(surface: Heights, random: np.random.Generator) -> Patch:
    """Return a patch at a random place, turned at random about the z axis, or mirrored."""
    first = bool(random.integers(2))
    coarse, spacing = (surface.quarter, 4.0) if first else (surface.half, 2.0)
    fine = surface.full
    if first:  # at the centres of pixels twice as large
        rows, columns = (length // 2 for length in fine.shape)
        fine = fine.reshape(rows, 2, columns, 2).mean(axis=(1, 3))
    given, target = grid(coarse, spacing), grid(fine, spacing / 2)
    side = surface.full.shape[0]
    reach = spacing * math.sqrt(POINTS / math.pi)
    middle = random.uniform(reach, side - reach, 2)
    given = _nearest(given, middle, POINTS)
    if not first:
        given[:, :2] += random.uniform(-_JITTER, _JITTER, (len(given), 2)) * spacing
        at = [(given[:, axis] + 0.5) / spacing - 0.5 for axis in (1, 0)]
        given[:, 2] = map_coordinates(coarse, at, mode="nearest")
    target = _nearest(target, middle, CHILDREN * POINTS)
    turn = Rotation.from_euler("z", random.uniform(0, 360), degrees=True).as_matrix()
    turn[0] *= random.choice([-1, 1])
    patch, centre, axes = normalised(given @ turn)
    target = (target @ turn - centre) @ np.linalg.inv(axes)
    return Patch(patch, target.astype(np.float32), centre @ turn.T, axes @ turn.T, surface.splines)


def grid(heights: Float32, spacing: float) -> Float64:
    """Return the points of heights whose pixels are `spacing` wide; x right, y down."""
    rows, columns = np.indices(heights.shape)
    places = [(axis + 0.5) * spacing - 0.5 for axis in (columns, rows)]
    return np.stack([*places, heights], axis=-1).reshape(-1, 3).astype(np.float64)


def _nearest(points: Float64, middle: Float64, count: int) -> Float64:
    apart = ((points[:, :2] - middle) ** 2).sum(axis=1)
    return points[np.argpartition(apart, count - 1)[:count]]


def assigned(made: Float32, target: Float32, random: np.random.Generator) -> Int64:
    """Return the target of each point: both sets are halved until parts are small, then assigned.

    The halves have equal numbers, so every target is used once; the total distance is that of the
    best assignment but for points at the borders of parts, which lie elsewhere in every step.
    """
    out = np.zeros(len(made), np.int64)
    turn = Rotation.random(random_state=random).as_matrix().astype(np.float32)

    def divide(ours: Int64, theirs: Int64, axis: int) -> None:
        if len(ours) <= _GROUP:
            rows, columns = linear_sum_assignment(cdist(made[ours], target[theirs], "sqeuclidean"))
            out[ours[rows]] = theirs[columns]
            return
        half = len(ours) // 2
        ours = ours[np.argpartition(made[ours] @ turn[axis], half)]
        theirs = theirs[np.argpartition(target[theirs] @ turn[axis], half)]
        divide(ours[:half], theirs[:half], (axis + 1) % 3)
        divide(ours[half:], theirs[half:], (axis + 1) % 3)

    every = np.arange(len(made))
    divide(every, every.copy(), 0)
    return out


def joint_loss(
    made: torch.Tensor, patches: Sequence[Patch], random: np.random.Generator
) -> tuple[torch.Tensor, float]:
    """Return the joint loss of ``(B, 1024, 3)`` points, and their mean distance to the surface.

    The distance is not part of the published loss. Without it, most of the loss is where points lie
    within the surface.
    """
    import torch

    plain = made.detach().numpy()
    wanted, near = [], []
    feet: list[Float32] = []
    normals: list[Float32] = []
    for number, (one, patch) in enumerate(zip(plain, patches, strict=True)):
        wanted.append(patch.target[assigned(one, patch.target, random)])
        foot, normal = patch.feet(one)
        feet.append(foot)
        normals.append(normal)
        found = np.asarray(cKDTree(one).query(one, _NEIGHBOURS)[1])
        near.append(found[:, 1:] + number * len(one))
    assignment = ((made - torch.from_numpy(np.stack(wanted))) ** 2).sum(2).mean()
    away = made - torch.from_numpy(np.stack(feet))
    across = (away * torch.from_numpy(np.stack(normals))).sum(2).abs().mean()
    rows = made.reshape(-1, 3)
    index = torch.from_numpy(np.concatenate(near))
    squares = ((rows[index.reshape(-1)].reshape(*index.shape, 3) - rows[:, None]) ** 2).sum(2)
    weight = torch.exp(-squares / _REPULSION_WIDTH**2)
    repulsion = ((_REPULSION_RADIUS - (squares + 1e-12).sqrt()).clamp(min=0) * weight).mean()
    return _ASSIGNMENT * (assignment + across) + repulsion, across.item()


def train(
    out: Path,
    advance: Progress,
    *,
    steps: int = STEPS,
    count: int = _SURFACES,
    rugged: int = _RUGGED,
) -> None:
    """Train the network and write its weights; an interrupted training continues.

    Parameters
    ----------
    out
        The ONNX file; a checkpoint is kept next to it until the training has ended.
    advance
        Receives the stages ``surfaces`` and ``training``.
    steps, count, rugged
        Steps of Adam, and number of surfaces of both kinds.

    Raises
    ------
    DataError
        If the checkpoint is one of another peer or version.
    """
    import torch

    torch.set_num_threads(1)
    checkpoint = out.with_suffix(".pt")
    state = load(checkpoint, PEER)
    weights = {
        name: torch.from_numpy(one) for name, one in first_weights(weight_shapes(), 0).items()
    }
    for name in ("place.1.weight", "place.1.bias"):
        weights[name] *= 0.1  # the children begin near their points
    optimizer = torch.optim.Adam(list(weights.values()), lr=_RATE, weight_decay=_DECAY)
    losses: list[float] = []
    wall_s = cpu_s = 0.0
    if state is not None:
        for name, one in weights.items():
            one.copy_(state["weights"][name])
        optimizer.load_state_dict(state["optimizer"])
        losses, wall_s, cpu_s = list(state["losses"]), state["wall_s"], state["cpu_s"]
    began = time.monotonic() - wall_s, time.process_time() - cpu_s
    given = surfaces(count, rugged, advance)
    for one in weights.values():
        one.requires_grad_()
    saved = time.monotonic()
    for step in range(len(losses), steps):
        advance("training", step, steps)
        rate = 0.5 + 0.5 * math.cos(math.pi * step / steps)
        optimizer.param_groups[0]["lr"] = _RATE * rate * min(1, (step + 1) / _WARMING)
        random = np.random.default_rng([step, 41])
        patches = [patch_of(given[random.integers(len(given))], random) for _ in range(_BATCH)]
        made = _forward(weights, np.stack([patch.given for patch in patches]))
        lost, across = joint_loss(made, patches, random)
        optimizer.zero_grad()
        lost.backward()
        optimizer.step()
        losses.append(across)
        spent = time.monotonic() - began[0], time.process_time() - began[1]
        if time.monotonic() - saved > _SAVE_EVERY_S or step == steps - 1:
            plain = {name: one.detach() for name, one in weights.items()}
            save(
                checkpoint,
                PEER,
                {
                    "weights": plain,
                    "optimizer": optimizer.state_dict(),
                    "losses": losses,
                    "wall_s": spent[0],
                    "cpu_s": spent[1],
                },
            )
            saved = time.monotonic()
    write_network(out, {name: one.detach().numpy() for name, one in weights.items()}, losses, {
        "steps": steps,
        "surfaces": [count, rugged],
        "wall_s": round(time.monotonic() - began[0]),
        "cpu_s": round(time.process_time() - began[1]),
    })  # fmt: skip
    checkpoint.unlink()


def _forward(weights: dict[str, torch.Tensor], patches: Float32) -> torch.Tensor:
    import torch

    cloud = Patches.of(patches)
    arrays = {name: torch.from_numpy(one) for name, one in cloud.arrays.items()}
    children = pu_net(TorchLayers(weights), torch.from_numpy(cloud.points), arrays)
    return torch.stack(children, 1).reshape(len(patches), -1, 3)


def write_network(
    out: Path, weights: dict[str, Float32], losses: list[float], training: dict[str, Any]
) -> None:
    """Write weights and description."""
    random = np.random.default_rng(0)
    cloud = Patches.of(random.uniform(-0.5, 0.5, (1, POINTS, 3)).astype(np.float32))

    def network(layers: OnnxLayers) -> dict[str, tuple[int, int]]:
        children = pu_net(layers, "points", {name: name for name in cloud.arrays})
        return dict.fromkeys(children, (POINTS, 3))

    inputs = {"points": (cloud.points.shape, False)} | {
        name: (one.shape, one.dtype == np.int64) for name, one in cloud.arrays.items()
    }
    write_weights(out, weights, inputs, network, {
        "format": 1,
        "peer": PEER,
        "weights": sum(one.size for one in weights.values()),
        "published_weights": 814_000,
        "points": [POINTS, CHILDREN * POINTS],
        "published_points": [1024, 4096],
        "training": training,
        "losses": thinned(losses),
        "converged": converged(losses),
    })  # fmt: skip
