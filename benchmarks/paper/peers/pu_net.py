"""PU-Net, a peer: a network that turns the points of a patch into four times as many.

L. Yu, X. Li, C.-W. Fu, D. Cohen-Or and P.-A. Heng, "PU-Net: Point Cloud Upsampling Network", CVPR
2018, from its description. Features are gathered from neighbourhoods at four scales (set
abstraction, with farthest points as centres), interpolated at all points, expanded by four
branches and turned into coordinates.

Here most widths are half of the published ones: 207,000 instead of 814,000 weights, and a patch has
256 points instead of 1,024, with radii that are twice as large or more, so that a neighbourhood has
as many points, and in a grid more than its centre. Patches are turned so that their mean plane is
level. The coordinates are added to those of the point, as in later networks for this task, while
the original predicts them alone. Patches overlap; the four points of each given point are those of
the patch in which it is nearest to the middle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

import processing
from benchmarks.paper.peers.layers import Layers, NumpyLayers, Shapes, T, Weights
from benchmarks.paper.peers.protocol import Peer
from benchmarks.paper.peers.rdn import Low
from rig.arrays import Float32, Float64, Int64

POINTS, CHILDREN = 256, 4
WEIGHTS = Path(__file__).with_name("weights") / "pu-net.onnx"

# Of each set abstraction: share of the points that are centres, radius in units of the radius of
# the patch, most neighbours, and widths of its three maps.
_LEVELS = (
    (1, 0.25, 16, (32, 32, 32)),
    (2, 0.3, 16, (32, 32, 64)),
    (4, 0.4, 32, (64, 64, 128)),
    (8, 0.6, 32, (128, 128, 256)),
)
_COMMON = 32  # features of each level at all points
_BRANCH = (128, 64)
_LAST = (32, 3)
_XYZ = 3
# Share of the points of a patch that no other patch has, in inference.
_OWN = 0.4
SCALE = 4
# Points to which a normal is fitted; chosen on random surfaces 0 to 3, between 8 and 48.
_FITTED = 48


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches of points with their neighbourhoods, as the network takes them.

    Parameters
    ----------
    points
        ``(N, 3)`` float32 points of all patches, each in a ball of radius 1 around 0.
    arrays
        For each level l, ``neighbours{l}`` ``(n, k)`` rows of the level before, ``offsets{l}``
        ``(n, k, 3)`` their places relative to the centre; for all levels but the first,
        ``nearest{l}`` ``(N, 3)`` centres and ``shares{l}`` ``(N, 3, 1)`` their weights.
    """

    points: Float32
    arrays: Mapping[str, Any]

    @classmethod
    def of(cls, patches: Float32) -> Patches:
        """Find the neighbourhoods of ``(B, N, 3)`` patches."""
        parts: list[dict[str, Any]] = [_neighbourhoods(patch) for patch in patches]
        arrays: dict[str, Any] = {}
        for name in parts[0]:
            kind, level = name[:-1], int(name[-1])
            if kind in ("offsets", "shares"):
                arrays[name] = np.concatenate([part[name] for part in parts])
                continue
            # Rows are counted over all patches: those of the level before, or of the level itself.
            count = patches.shape[1] // _LEVELS[max(level - (kind == "neighbours"), 0)][0]
            moved = [part[name] + number * count for number, part in enumerate(parts)]
            arrays[name] = np.concatenate(moved)
        return cls(patches.reshape(-1, 3), arrays)


def pu_net(layers: Layers[T], points: T, arrays: Mapping[str, Any]) -> list[T]:
    """Return the four children of each point: values of ``(N, 3)``, in the frame of the points."""
    features = []
    rows, columns = points, 0
    for level, (_, _, _, widths) in enumerate(_LEVELS):
        near, inputs = arrays[f"offsets{level}"], _XYZ
        if level:
            near = layers.join([near, layers.gather(rows, arrays[f"neighbours{level}"])])
            inputs += columns
        for step, width in enumerate(widths):
            near = layers.rectify(layers.dense(f"level{level}.{step}", near, inputs, width))
            inputs = width
        rows, columns = layers.largest(near), inputs
        if level == 0:
            features.append(rows)
            continue
        found = layers.gather(rows, arrays[f"nearest{level}"])
        found = layers.weigh(found, arrays[f"shares{level}"])
        features.append(layers.rectify(layers.dense(f"common{level}", found, columns, _COMMON)))
    joined = layers.join([points, *features])
    children = []
    for branch in range(CHILDREN):
        rows, inputs = joined, _XYZ + len(_LEVELS) * _COMMON
        for step, width in enumerate(_BRANCH):
            rows = layers.rectify(layers.dense(f"branch{branch}.{step}", rows, inputs, width))
            inputs = width
        rows = layers.rectify(layers.dense("place.0", rows, inputs, _LAST[0]))
        children.append(layers.add(points, layers.dense("place.1", rows, *_LAST)))
    return children


def weight_shapes() -> dict[str, tuple[int, int]]:
    """Return outputs and inputs of each linear map by name."""
    noted = Shapes()
    names = ("offsets", "neighbours", "nearest", "shares")
    pu_net(noted, None, {f"{name}{level}": None for name in names for level in range(4)})
    return noted.noted


def normalised(points: Float64) -> tuple[Float32, Float64, Float64]:
    """Return points in a ball of radius 1 around 0, their mean plane level, and their frame.

    Parameters
    ----------
    points
        ``(N, 3)`` points of a surface that faces the positive z axis.

    Returns
    -------
    patch, middle, axes
        ``(N, 3)`` points in the ball, the place of 0, and ``(3, 3)`` the axes of the ball, so that
        ``patch @ axes + middle`` are the points.
    """
    middle = points.mean(axis=0)
    away = points - middle
    up = np.linalg.eigh(away.T @ away)[1][:, 0]
    up *= 1 if up[2] > 0 else -1
    # The shortest turn from the z axis to the normal of the plane.
    between = up + np.array([0, 0, 1])
    turn = 2 * np.outer(between, between) / (between @ between) - np.eye(3)
    turn *= np.array([-1, -1, 1])[:, None]
    axes = turn * np.linalg.norm(away, axis=1).max()
    return (away @ np.linalg.inv(axes)).astype(np.float32), middle, axes


def enlarged(points: Float64, weights: Weights) -> Float64:
    """Return four points for each point, ``(4 N, 3)``.

    Parameters
    ----------
    points
        ``(N, 3)`` points of a surface.
    weights
        Weights of the network.
    """
    layers: Layers[Float32] = NumpyLayers(weights)
    tree = cKDTree(points)
    count = min(POINTS, len(points))
    made = np.zeros((len(points), CHILDREN, 3))
    rank = np.full(len(points), np.iinfo(np.int64).max)
    # Patches are added around the first point that is not yet well inside another one.
    for seed in range(len(points)):
        if rank[seed] < _OWN * count:
            continue
        members = np.asarray(tree.query(points[seed], count)[1])
        patch, middle, axes = normalised(points[members])
        given = Patches.of(patch[None])
        made_here: list[Float32] = pu_net(layers, given.points, given.arrays)
        children = np.stack(made_here, axis=1)
        better = np.arange(count) < rank[members]
        made[members[better]] = children[better].astype(np.float64) @ axes + middle
        rank[members[better]] = np.arange(count)[better]
    return made.reshape(-1, 3)


def map_of(low: Low, scale: int, weights: Weights) -> processing.NormalMap:
    """Return a map of 2 or 4 times the resolution, by one or two passes over the points.

    The map is integrated, its points are enlarged and projected. A pixel of the mask at which the
    projection has no normal has that of the nearest one.
    """
    surface = processing.integrate(low.normals, discontinuity=False)
    points = scale * surface.points()[surface.mask].astype(np.float64)
    for _ in range(scale // 2):
        points = enlarged(points, weights)
    cloud = processing.Geometry(points, None)
    drawn = processing.project(
        cloud, size=low.mask.shape, pixel_mm=1.0, centred=False, neighbours=_FITTED
    ).normal_map
    _, (rows, columns) = distance_transform_edt(~drawn.mask, return_indices=True)
    return processing.NormalMap.from_vectors(drawn.normals[rows, columns], low.mask)


def _fit(weights: Weights) -> Callable[[Low], processing.NormalMap]:
    return lambda low: map_of(low, SCALE, weights)


PEER = Peer("PU-Net", "Yu et al., CVPR 2018", _fit)


def _neighbourhoods(patch: Float32) -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    before = patch
    for level, (share, radius, most, _) in enumerate(_LEVELS):
        centres = before
        if level:
            chosen = farthest(before, len(patch) // share)
            centres = before[chosen]
        tree = cKDTree(before)
        # The first neighbour is the centre; it stands in for those outside the ball.
        most = min(most, len(before))
        found = np.asarray(tree.query(centres, most, distance_upper_bound=radius)[1])
        found = np.where(found == len(before), found[:, :1], found)
        arrays[f"offsets{level}"] = (before[found] - centres[:, None]) / np.float32(radius)
        if level:
            arrays[f"neighbours{level}"] = found
            distance, nearest = map(np.asarray, cKDTree(centres).query(patch, _XYZ))
            inverse = 1 / np.maximum(distance, 1e-8) ** 2
            shares = inverse / inverse.sum(axis=1, keepdims=True)
            arrays[f"nearest{level}"] = nearest
            arrays[f"shares{level}"] = shares[..., None].astype(np.float32)
        before = centres
    return arrays


@numba.njit(cache=True)
def farthest(points: Float32, count: int) -> Int64:
    """Return the numbers of points, each of which is farthest from those before it."""
    chosen = np.zeros(count, np.int64)
    least = np.full(len(points), np.float32(np.inf))
    for step in range(1, count):
        last = points[chosen[step - 1]]
        best = 0
        for at in range(len(points)):
            apart = np.float32(0)
            for axis in range(3):
                apart += (points[at, axis] - last[axis]) ** 2
            least[at] = min(least[at], apart)
            if least[at] > least[best]:
                best = at
        chosen[step] = best
    return chosen
