"""Checkpoints of the trainings of peers, and the files of their weights."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import acquisition
from benchmarks.paper.peers.layers import OnnxLayers, Weights
from rig.arrays import Float64
from sgp.cli.exit import UsageError
from sgp.results import dumps

VERSION = 1
_OPSET, _IR_VERSION = 17, 8


def require_learned() -> None:
    """Refuse to train without torch and onnx.

    Raises
    ------
    UsageError
        The message names the extra.
    """
    missing = [name for name in ("torch", "onnx") if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"{' and '.join(missing)} not found, which training requires: "
            'pip install "surface-geometry-processing[learned]"'
        )


def save(path: Path, peer: str, state: Mapping[str, Any]) -> None:
    """Write the state of a training; an interruption leaves the one before."""
    import torch

    content = io.BytesIO()
    torch.save({"peer": peer, "version": VERSION, **state}, content)
    acquisition.write_durably(path, content.getvalue())


def load(path: Path, peer: str) -> dict[str, Any] | None:
    """Return the state of a training, or None before its first checkpoint.

    Raises
    ------
    DataError
        If the file is no checkpoint, or one of another peer or version.
    """
    import torch

    if not path.exists():
        return None
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
        found = state["peer"], state["version"]
    except (RuntimeError, LookupError, EOFError, ValueError, TypeError, pickle.UnpicklingError):
        found = None
    if found is None:
        raise acquisition.DataError(
            f"{path}: the checkpoint cannot be read: remove it to train from the start"
        )
    if found != (peer, VERSION):
        raise acquisition.DataError(
            f"{path}: a checkpoint of {found[0]}, version {found[1]}; {peer}, version {VERSION} is "
            "required: remove it to train from the start, or give another --out"
        )
    return state


def write_weights(
    path: Path,
    weights: Weights,
    inputs: Mapping[str, tuple[Sequence[int | str], bool]],
    network: Callable[[OnnxLayers], Mapping[str, Sequence[int | str]]],
    description: Mapping[str, Any],
) -> None:
    """Write a network as an ONNX file, and what is known of its training as JSON next to it.

    Parameters
    ----------
    path
        The ONNX file.
    weights
        Weights by name.
    inputs
        Shape of each input by name, and whether it has whole numbers.
    network
        Writes the nodes, and returns the shapes of the outputs by the names of their values.
    description
        Sizes, steps, losses, cost.
    """
    from onnx import TensorProto, checker, helper

    layers = OnnxLayers(weights)
    outputs = network(layers)
    values = [
        helper.make_tensor_value_info(
            name, TensorProto.INT64 if whole else TensorProto.FLOAT, list(shape)
        )
        for name, (shape, whole) in inputs.items()
    ]
    results = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape))
        for name, shape in outputs.items()
    ]
    graph = helper.make_graph(
        layers.nodes, path.stem, values, results, list(layers.constants.values())
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR_VERSION
    )
    checker.check_model(model)
    acquisition.write_durably(path, bytes(model.SerializeToString(deterministic=True)))
    text = f"{dumps(dict(description))}\n"
    acquisition.write_durably(path.with_suffix(".json"), text.encode())


# The change of a loss over the last fifth of its steps, relative to the fifth before, at which it
# counts as flat.
_FLAT = 0.02


def converged(losses: Sequence[float]) -> bool:
    """Return whether a loss neither falls nor rises: its last two fifths differ by at most 2 %."""
    values: Float64 = np.asarray(losses, np.float64)
    fifth = len(values) // 5
    if not fifth:
        return False
    before, last = values[-2 * fifth : -fifth].mean(), values[-fifth:].mean()
    return bool(abs(before - last) <= _FLAT * abs(before))


def thinned(losses: Sequence[float], parts: int = 100) -> list[float]:
    """Return the means of at most 100 parts of losses, in order."""
    split = np.array_split(np.asarray(losses, np.float64), parts)
    return [float(f"{part.mean():.5g}") for part in split if len(part)]
