"""The training of DGTS on an exemplar: level by level, as published, with fewer iterations."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import processing
from benchmarks.paper.exemplars import materials
from benchmarks.paper.peers import dgts
from benchmarks.paper.peers.checkpoints import converged, load, save, thinned, write_weights
from benchmarks.paper.peers.layers import OnnxLayers, TorchLayers, Weights, first_weights
from rig import Progress
from rig.arrays import Float32

if TYPE_CHECKING:
    import torch

PEER = "dgts"
# Of each level; the original has 2,000. One iteration of the last level takes as long as 40 of the
# first.
ITERATIONS = (2000, 2000, 2000, 1000, 400)
_SEED = 7  # of the material
_MARGIN_PX = 30
# As published: steps, weights of losses, and Adam, whose rate is halved after every 500 iterations.
# A rate that fell faster in a shorter training would make its loss flat too early.
_CRITIC_STEPS, _GENERATOR_STEPS = 2, 3
_PENALTY, _RECONSTRUCTION = 0.1, 5.0
_RATE, _BETAS, _HALVED_AFTER = 5e-4, (0.5, 0.99), 500
_SAVE_EVERY_S = 60.0

Tensors = dict[str, "torch.Tensor"]


def exemplar_of(name: str) -> processing.NormalMap:
    """Return the detail of the part of a material on which DGTS is trained.

    The material is reduced by 2, so that the part has four scales or six yarns on each side.
    """
    reduced = processing.superres.low_resolution(materials(_SEED)[name], 2)
    detail = processing.separate(reduced).detail
    part = slice(_MARGIN_PX, _MARGIN_PX + dgts.EXEMPLAR_PX)
    return processing.NormalMap(detail.normals[part, part].copy(), detail.mask[part, part].copy())


class Level:
    """One level: its surfaces, its two networks, and their optimisers."""

    def __init__(
        self, number: int, real: Float32, generators: dict[str, Float32], reconstructed: Float32
    ) -> None:
        import torch

        self.number = number
        self.mesh = dgts.Mesh(real.shape[0] - 1, real.shape[1] - 1)
        self.neighbours = torch.from_numpy(self.mesh.neighbours)
        self.real = torch.from_numpy(real.reshape(-1, 3))
        self.real_features = dgts.features_of(self.real, self.mesh, torch.stack)
        self.reconstructed = torch.from_numpy(reconstructed.reshape(-1, 3))
        self.networks: dict[str, Tensors] = {}
        self.optimizers: dict[str, Any] = {}
        for kind, outputs in (("generator", 3), ("critic", 1)):
            shapes = dgts.weight_shapes(kind, number, outputs)
            first = first_weights(shapes, number)
            tensors = {name: torch.from_numpy(one) for name, one in first.items()}
            for name, one in tensors.items():
                before = generators.get(name.replace(str(number), str(number - 1), 1))
                if before is not None and before.shape == tuple(one.shape):
                    one.copy_(torch.from_numpy(before))
            for one in tensors.values():
                one.requires_grad_()
            self.networks[kind] = tensors
            self.optimizers[kind] = torch.optim.Adam(list(tensors.values()), lr=_RATE, betas=_BETAS)

    def made(self, start: torch.Tensor, noise: Float32 | None) -> torch.Tensor:
        """Return the vertices that the generator makes of others."""
        import torch

        noisy = start if noise is None else start + torch.from_numpy(noise.reshape(-1, 3))
        features = dgts.features_of(noisy, self.mesh, torch.stack)
        layers = TorchLayers(self.networks["generator"])
        name = f"generator{self.number}"
        deltas = dgts.face_network(layers, name, self.number, 3, features, self.neighbours)
        return torch.as_tensor(dgts.moved(start, self.mesh, deltas, torch.stack))

    def judged(self, features: torch.Tensor) -> torch.Tensor:
        """Return the critic's values of the faces."""
        layers, name = TorchLayers(self.networks["critic"]), f"critic{self.number}"
        return dgts.face_network(layers, name, self.number, 1, features, self.neighbours)

    def critic_step(self, start: torch.Tensor, noise: Float32, share: float) -> float:
        """Take one step of the critic; return by how much it prefers the real surface."""
        import torch

        with torch.no_grad():
            fake = dgts.features_of(self.made(start, noise), self.mesh, torch.stack)
        mixed = (share * self.real_features + (1 - share) * fake).requires_grad_()
        (slopes,) = torch.autograd.grad(self.judged(mixed).sum(), mixed, create_graph=True)
        steepness = slopes.reshape(len(slopes), -1).norm(2, 1)
        penalty = _PENALTY * ((steepness - 1) ** 2).mean()
        apart = self.judged(self.real_features).mean() - self.judged(fake).mean()
        self._step("critic", penalty - apart)
        return float(apart.detach())

    def generator_step(self, start: torch.Tensor, noise: Float32) -> float:
        """Take one step of the generator; return the mean square error of its reconstruction.

        As published, the first level is to reconstruct the exemplar from any noise.
        """
        import torch

        made = self.made(start, noise)
        lost = -self.judged(dgts.features_of(made, self.mesh, torch.stack)).mean()
        again = self.made(self.reconstructed, None) if self.number else made
        error = ((again - self.real) ** 2).mean()
        self._step("generator", lost + _RECONSTRUCTION * error)
        return float(error.detach())

    def set_rate(self, rate: float) -> None:
        for optimizer in self.optimizers.values():
            optimizer.param_groups[0]["lr"] = rate

    def state(self) -> dict[str, Any]:
        return {
            kind: {
                "weights": {name: one.detach() for name, one in tensors.items()},
                "optimizer": self.optimizers[kind].state_dict(),
            }
            for kind, tensors in self.networks.items()
        }

    def restore(self, state: dict[str, Any]) -> None:
        import torch

        for kind, tensors in self.networks.items():
            with torch.no_grad():
                for name, one in tensors.items():
                    one.copy_(state[kind]["weights"][name])
            self.optimizers[kind].load_state_dict(state[kind]["optimizer"])

    def _step(self, kind: str, lost: torch.Tensor) -> None:
        for tensors in self.networks.values():
            for one in tensors.values():
                one.grad = None
        lost.backward()
        self.optimizers[kind].step()


def train(
    out: Path,
    advance: Progress,
    *,
    exemplar: str = dgts.EXEMPLARS[0],
    steps: int | None = None,
) -> None:
    """Train generators and critics of all levels, and write the generators.

    Parameters
    ----------
    out
        The ONNX file; a checkpoint is kept next to it until the training has ended.
    advance
        Receives a stage for each level.
    exemplar
        Name of the material.
    steps
        Iterations of every level, instead of `ITERATIONS`.

    Raises
    ------
    DataError
        If the checkpoint is one of another peer or version.
    """
    import torch

    torch.set_num_threads(1)
    detail = exemplar_of(exemplar)
    heights = np.asarray(processing.integrate(detail, discontinuity=False).height, np.float64)
    reals = dgts.with_levels(heights - heights.mean(), dgts.CELLS, dgts.CELLS)
    flat = [one * np.array([1, 1, 0], np.float32) for one in reals]
    checkpoint = out.with_suffix(".pt")
    state = load(checkpoint, PEER) or {"weights": {}, "level": 0, "done": 0, "own": None,
                                       "losses": [], "wall_s": 0.0, "cpu_s": 0.0}  # fmt: skip
    weights: dict[str, Float32] = {name: one.numpy() for name, one in state["weights"].items()}
    losses: list[list[float]] = list(state["losses"])
    began = time.monotonic() - state["wall_s"], time.process_time() - state["cpu_s"]
    saved = time.monotonic()
    for number in range(state["level"], dgts.LEVELS):
        count = ITERATIONS[number] if steps is None else steps
        kept = _start(weights, flat, number, list(dgts.kept_noise()))
        level = Level(number, reals[number], weights, kept)
        done = 0
        if number == state["level"] and state["own"] is not None:
            level.restore(state["own"])
            done = state["done"]
        else:
            losses.append([])
        for iteration in range(done, count):
            advance(f"level {number + 1} of {dgts.LEVELS}", iteration, count)
            level.set_rate(_RATE * 0.5 ** (iteration // _HALVED_AFTER))
            random = np.random.default_rng([number, iteration, 2020])
            for _ in range(_CRITIC_STEPS):
                start, noise = _random_start(weights, flat, number, random)
                level.critic_step(start, noise, float(random.random()))
            for _ in range(_GENERATOR_STEPS):
                error = level.generator_step(*_random_start(weights, flat, number, random))
            losses[-1].append(error)
            if time.monotonic() - saved > _SAVE_EVERY_S:
                _save(checkpoint, weights, losses, began, number, iteration + 1, level.state())
                saved = time.monotonic()
        for tensors in level.networks.values():
            weights |= {name: one.detach().numpy() for name, one in tensors.items()}
        _save(checkpoint, weights, losses, began, number + 1, 0, None)
    write_generators(out, weights, losses, {
        "exemplar": exemplar,
        "iterations": list(ITERATIONS if steps is None else [steps] * dgts.LEVELS),
        "published_iterations": 2000,
        "wall_s": round(time.monotonic() - began[0]),
        "cpu_s": round(time.process_time() - began[1]),
    })  # fmt: skip
    checkpoint.unlink()


def _save(
    path: Path,
    weights: dict[str, Float32],
    losses: list[list[float]],
    began: tuple[float, float],
    level: int,
    done: int,
    own: dict[str, Any] | None,
) -> None:
    import torch

    spent = time.monotonic() - began[0], time.process_time() - began[1]
    save(path, PEER, {
        "weights": {name: torch.from_numpy(one) for name, one in weights.items()},
        "level": level, "done": done, "own": own, "losses": losses,
        "wall_s": spent[0], "cpu_s": spent[1],
    })  # fmt: skip


def _start(
    weights: dict[str, Float32],
    flat: list[Float32],
    number: int,
    noises: list[Float32 | None],
) -> Float32:
    """Return the vertices that a level begins with: the levels before it, subdivided."""
    if number == 0:
        return flat[0]
    made = dgts.generate(weights, flat, noises, number)
    return flat[number] + 2 * dgts.doubled(made - flat[number - 1])


def _random_start(
    weights: dict[str, Float32], flat: list[Float32], number: int, random: np.random.Generator
) -> tuple[torch.Tensor, Float32]:
    import torch

    noises = [
        random.normal(scale=dgts.NOISE, size=one.shape).astype(np.float32)
        for one in flat[: number + 1]
    ]
    start = _start(weights, flat, number, [*noises])
    return torch.from_numpy(start.reshape(-1, 3)), noises[number]


def write_generators(
    out: Path,
    weights: dict[str, Float32],
    losses: list[list[float]],
    training: dict[str, Any],
) -> None:
    """Write the generators of all levels and their description."""
    own = {name: one for name, one in weights.items() if name.startswith("generator")}

    def network(layers: OnnxLayers) -> dict[str, tuple[str, int]]:
        results = [
            dgts.face_network(
                layers, f"generator{level}", level, 3, f"features{level}", f"neighbours{level}"
            )
            for level in range(dgts.LEVELS)
        ]
        return {result: (f"faces{level}", 3) for level, result in enumerate(results)}

    inputs: dict[str, tuple[tuple[int | str, ...], bool]] = {}
    for level in range(dgts.LEVELS):
        inputs[f"features{level}"] = ((f"faces{level}", 3, 4), False)
        inputs[f"neighbours{level}"] = ((f"faces{level}", 3), True)
    write_weights(out, own, inputs, network, {
        "format": 1,
        "peer": PEER,
        "weights": sum(one.size for one in weights.values()),
        "published_weights": 192_000,
        "faces": [2 * (dgts.COARSEST << level) ** 2 for level in range(dgts.LEVELS)],
        "published_faces": [320 * 4**level for level in range(dgts.LEVELS)],
        "training": training,
        "losses": [thinned(level) for level in losses],
        "converged": converged(losses[-1]),
    })  # fmt: skip


def reconstructed(weights: Weights) -> processing.NormalMap:
    """Return the map that generators make of the noise that was kept for reconstruction."""
    flat = [
        dgts.plane(dgts.COARSEST << level, dgts.COARSEST << level) for level in range(dgts.LEVELS)
    ]
    made = dgts.generate(weights, flat, dgts.kept_noise())
    return dgts.normals_of(made, np.ones((dgts.EXEMPLAR_PX, dgts.EXEMPLAR_PX), np.bool_))
