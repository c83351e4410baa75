"""The steps of a training, which continues where it was interrupted."""

from __future__ import annotations

import io
import math
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import acquisition
import rig
from sgp.training.pairs import PairFiles, batch
from sgp.training.presets import Task
from sgp.training.rdn import as_images, first_weights, forward

if TYPE_CHECKING:
    import torch

# Weight of the likelihood: it is small so that it hardly changes the normals.
_LIKELIHOOD = 0.02
# Added to square errors (radian^2): the rounding of normals, 0.02 degree.
_ROUNDING = 1e-7
# Added to squared chords, so that the derivative of the chord exists at 0.
_SMOOTHING = 1e-12


def results(low: torch.Tensor, output: torch.Tensor, scale: int) -> tuple[torch.Tensor, ...]:
    """Return the unit normals of bicubic interpolation and of the network.

    Parameters
    ----------
    low
        ``(B, 3, h, w)`` input of the network.
    output
        ``(B, 5, s h, s w)`` output of the network.
    scale
        s.
    """
    from torch.nn.functional import interpolate, normalize

    bicubic = interpolate(low, scale_factor=scale, mode="bicubic", align_corners=False)
    return normalize(bicubic, dim=1), normalize(bicubic + output[:, :3], dim=1)


def squared_chord(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the squared distance of the ends of ``(B, 3, h, w)`` unit vectors."""
    return ((first - second) ** 2).sum(1)


def squared_angle(chord2: torch.Tensor) -> torch.Tensor:
    """Return the squared angle in radian of squared chords."""
    return (2 * (0.5 * chord2.sqrt()).clamp(max=1).asin()) ** 2


def loss(low: torch.Tensor, high: torch.Tensor, output: torch.Tensor, scale: int) -> torch.Tensor:
    """Return the mean chord between normals and target, plus a little of the likelihood.

    The likelihood is that of two normally distributed tangent components, ln v + e^2 / v, whose
    expectation is smallest if v is the mean square of the angle e. It does not change the normals
    through e, only through what the layers have in common.
    """
    import torch

    bicubic, normals = results(low, output, scale)
    chord2 = squared_chord(normals, high)
    with torch.no_grad():
        chords2 = torch.stack([chord2, squared_chord(bicubic, high)], 1)
        squares = squared_angle(chords2) + _ROUNDING
    logs = output[:, 3:]
    likelihood = (logs + squares * torch.exp(-logs)).mean()
    return (chord2 + _SMOOTHING).sqrt().mean() + _LIKELIHOOD * likelihood


_SAVE_EVERY_S = 30.0
_WARMING = 50  # steps with a rising rate
_LEAST_SHARE = 1e-3  # of the rate, at the last step
_SECOND_RATE = 0.5  # of the rate, in the second part

Clock = Callable[[], float]


def train(
    task: Task,
    pairs: PairFiles,
    rugged: PairFiles,
    checkpoint: Path,
    on_progress: rig.Progress,
    clock: Clock = time.monotonic,
) -> dict[str, torch.Tensor]:
    """Return the weights of a network after all steps.

    The result depends on task and pairs, and on the processor and its threads through rounding.
    With one thread it does not depend on how often the training was interrupted; with several,
    the last digits may.

    Parameters
    ----------
    task
        What to train.
    pairs, rugged
        What to train on; the rugged surfaces in the second part only.
    checkpoint
        File of weights and optimiser, written every 30 seconds; a training with such a file
        continues from it.
    on_progress
        Receives the stage ``training``, one step per step.
    clock
        Seconds, for the intervals between checkpoints.

    Raises
    ------
    DataError
        If the checkpoint cannot be read.
    StorageError
        If it cannot be written.
    """
    import torch

    torch.use_deterministic_algorithms(not torch.cuda.is_available())
    device = "cuda" if torch.cuda.is_available() else "cpu"
    preset, size = task.preset, task.size
    weights = {name: one.to(device) for name, one in first_weights(size, task.seed).items()}
    optimizer = torch.optim.Adam(list(weights.values()), lr=preset.rate)
    every = pairs.joined(rugged)
    done = _load(checkpoint, weights, optimizer) if checkpoint.is_file() else 0
    for one in weights.values():
        one.requires_grad_()
    side, saved_s = preset.low_crop(task.scale), clock()
    on_progress("training", done, task.steps)
    for step in range(done, task.steps):
        if step == task.first_steps:
            optimizer = torch.optim.Adam(list(weights.values()), lr=preset.rate)
        optimizer.param_groups[0]["lr"] = preset.rate * _share(task, step)
        chosen = pairs if step < task.first_steps else every
        crops = batch(chosen, preset.batch, side, (task.seed, step))
        low, high = (as_images(one).to(device) for one in crops)
        lost = loss(low, high, forward(size, weights, low), task.scale)
        optimizer.zero_grad()
        lost.backward()
        optimizer.step()
        on_progress("training", step + 1, task.steps)
        if clock() - saved_s > _SAVE_EVERY_S:
            _save(checkpoint, weights, optimizer, step + 1)
            saved_s = clock()
    return {name: one.detach().cpu() for name, one in weights.items()}


def _share(task: Task, step: int) -> float:
    """Return the rate of a step as a share of the preset's."""
    if not task.preset.falling:
        return 1.0
    most, steps = 1.0, task.first_steps
    if step >= steps:
        most, step, steps = _SECOND_RATE, step - steps, task.steps - steps
    warm = min(1.0, (step + 1) / _WARMING)
    return most * max(_LEAST_SHARE, warm * (0.5 + 0.5 * math.cos(math.pi * step / steps)))


def _save(path: Path, weights: dict[str, torch.Tensor], optimizer: Any, done: int) -> None:
    import torch

    content = io.BytesIO()
    plain = {name: one.detach() for name, one in weights.items()}
    state = {"weights": plain, "optimizer": optimizer.state_dict(), "done": done}
    torch.save(state, content)
    acquisition.write_durably(path, content.getvalue())


def _load(path: Path, weights: dict[str, torch.Tensor], optimizer: Any) -> int:
    """Read a checkpoint into weights and optimiser; return the number of steps done."""
    import torch

    try:
        state = torch.load(path, weights_only=True, map_location=weights["last.bias"].device)
        with torch.no_grad():
            for name, one in weights.items():
                one.copy_(state["weights"][name])
        optimizer.load_state_dict(state["optimizer"])
        return int(state["done"])
    except (RuntimeError, LookupError, EOFError, ValueError, pickle.UnpicklingError) as error:
        raise acquisition.DataError(
            f"{path}: the checkpoint cannot be read ({type(error).__name__}): remove the file to "
            "train from the start"
        ) from error
