"""Networks on points and faces, each written once for numpy, torch and ONNX.

Numpy runs them, torch trains them, and ONNX stores their graph and weights. Values are rows: the
features of points, of neighbours of points, or of faces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from rig.arrays import Float32

if TYPE_CHECKING:
    import torch

T = TypeVar("T")
# Weights by name: ``(outputs, inputs)`` named ``*.weight``, and ``(outputs,)`` named ``*.bias``.
Weights = Mapping[str, Float32]
_SLOPE = 0.2  # of leaky rectifiers
_LEAST_VARIANCE = 1e-5


class Layers(Protocol[T]):
    """The operations of a library on its own kind of values."""

    def dense(self, name: str, rows: T, inputs: int, outputs: int) -> T:
        """Return a linear map of the last axis, with a bias."""

    def rectify(self, rows: T) -> T:
        """Return the positive part."""

    def leak(self, rows: T) -> T:
        """Return the positive part and a fifth of the negative one."""

    def standardise(self, rows: T) -> T:
        """Return rows whose columns have mean 0 and variance 1 (instance normalisation)."""

    def gather(self, rows: T, index: T) -> T:
        """Return rows by number: the shape of the index, and the columns."""

    def join(self, parts: Sequence[T]) -> T:
        """Return the columns of all parts."""

    def largest(self, rows: T) -> T:
        """Return the largest values over the second of three axes."""

    def weigh(self, rows: T, weights: T) -> T:
        """Return sums over the second of three axes with weights ``(n, k, 1)``."""

    def add(self, first: T, second: T) -> T:
        """Return the sum."""


class NumpyLayers:
    """The layers in numpy, with weights by name."""

    def __init__(self, weights: Weights) -> None:
        self._weights = weights

    def dense(self, name: str, rows: Float32, inputs: int, outputs: int) -> Float32:
        weights, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
        out: Float32 = rows.reshape(-1, inputs) @ weights.T + bias
        return np.asarray(np.reshape(out, (*rows.shape[:-1], outputs)), np.float32)

    def rectify(self, rows: Float32) -> Float32:
        return np.asarray(np.maximum(rows, 0), np.float32)

    def leak(self, rows: Float32) -> Float32:
        return np.asarray(np.maximum(rows, np.float32(_SLOPE) * rows), np.float32)

    def standardise(self, rows: Float32) -> Float32:
        spread = np.sqrt(rows.var(axis=0) + np.float32(_LEAST_VARIANCE))
        return np.asarray((rows - rows.mean(axis=0)) / spread, np.float32)

    def gather(self, rows: Float32, index: Any) -> Float32:
        return np.asarray(rows[index], np.float32)

    def join(self, parts: Sequence[Float32]) -> Float32:
        return np.concatenate(parts, axis=-1)

    def largest(self, rows: Float32) -> Float32:
        return np.asarray(rows.max(axis=1), np.float32)

    def weigh(self, rows: Float32, weights: Float32) -> Float32:
        return np.asarray((rows * weights).sum(axis=1), np.float32)

    def add(self, first: Float32, second: Float32) -> Float32:
        return first + second


class TorchLayers:
    """The layers in torch, with weights by name."""

    def __init__(self, weights: Mapping[str, torch.Tensor]) -> None:
        self._weights = weights

    def dense(self, name: str, rows: torch.Tensor, inputs: int, outputs: int) -> torch.Tensor:
        from torch.nn.functional import linear

        return linear(rows, self._weights[f"{name}.weight"], self._weights[f"{name}.bias"])

    def rectify(self, rows: torch.Tensor) -> torch.Tensor:
        return rows.relu()

    def leak(self, rows: torch.Tensor) -> torch.Tensor:
        from torch.nn.functional import leaky_relu

        return leaky_relu(rows, _SLOPE)

    def standardise(self, rows: torch.Tensor) -> torch.Tensor:
        # Twice as fast as Tensor.var.
        centred = rows - rows.mean(0)
        return centred / ((centred**2).mean(0) + _LEAST_VARIANCE).sqrt()

    def gather(self, rows: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        return rows.index_select(0, index.reshape(-1)).reshape(*index.shape, rows.shape[-1])

    def join(self, parts: Sequence[torch.Tensor]) -> torch.Tensor:
        import torch

        return torch.cat(list(parts), -1)

    def largest(self, rows: torch.Tensor) -> torch.Tensor:
        return rows.amax(1)

    def weigh(self, rows: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        return (rows * weights).sum(1)

    def add(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        return first + second


class OnnxLayers:
    """The layers as nodes of an ONNX graph; a value is the name of a node's output."""

    def __init__(self, weights: Weights) -> None:
        self._weights = weights
        self.nodes: list[Any] = []
        self.constants: dict[str, Any] = {}

    def _node(self, kind: str, inputs: Sequence[str], **attributes: Any) -> str:
        from onnx import helper

        out = f"{kind.lower()}{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [out], out, **attributes))
        return out

    def _constant(self, name: str, values: Any) -> str:
        from onnx import numpy_helper

        self.constants[name] = numpy_helper.from_array(np.ascontiguousarray(values), name)
        return name

    def dense(self, name: str, rows: str, inputs: int, outputs: int) -> str:
        weights = self._constant(f"{name}.weight", self._weights[f"{name}.weight"])
        bias = self._constant(f"{name}.bias", self._weights[f"{name}.bias"])
        turned = self._node("Transpose", [weights], perm=[1, 0])
        return self.add(self._node("MatMul", [rows, turned]), bias)

    def rectify(self, rows: str) -> str:
        return self._node("Relu", [rows])

    def leak(self, rows: str) -> str:
        return self._node("LeakyRelu", [rows], alpha=_SLOPE)

    def standardise(self, rows: str) -> str:
        least = self._constant("least_variance", np.float32(_LEAST_VARIANCE))
        mean = self._node("ReduceMean", [rows], axes=[0], keepdims=1)
        centred = self._node("Sub", [rows, mean])
        square = self._node("Mul", [centred, centred])
        variance = self._node("ReduceMean", [square], axes=[0], keepdims=1)
        return self._node("Div", [centred, self._node("Sqrt", [self.add(variance, least)])])

    def gather(self, rows: str, index: str) -> str:
        return self._node("Gather", [rows, index], axis=0)

    def join(self, parts: Sequence[str]) -> str:
        return self._node("Concat", parts, axis=-1)

    def largest(self, rows: str) -> str:
        return self._node("ReduceMax", [rows], axes=[1], keepdims=0)

    def weigh(self, rows: str, weights: str) -> str:
        product = self._node("Mul", [rows, weights])
        axis = self._constant("second_axis", np.array([1]))
        return self._node("ReduceSum", [product, axis], keepdims=0)

    def add(self, first: str, second: str) -> str:
        return self._node("Add", [first, second])


def first_weights(shapes: Mapping[str, tuple[int, int]], seed: int) -> dict[str, Float32]:
    """Return random weights, uniform up to ``1 / sqrt(inputs)``.

    Parameters
    ----------
    shapes
        Outputs and inputs of each linear map by name.
    seed
        Fixes the weights.
    """
    random = np.random.default_rng(seed)
    weights: dict[str, Float32] = {}
    for name, (outputs, inputs) in shapes.items():
        reach = 1 / math.sqrt(inputs)
        for part, shape in (("weight", (outputs, inputs)), ("bias", (outputs,))):
            weights[f"{name}.{part}"] = random.uniform(-reach, reach, shape).astype(np.float32)
    return weights


class Shapes:
    """Layers that only note the shapes of their weights; every value is None."""

    def __init__(self) -> None:
        self.noted: dict[str, tuple[int, int]] = {}

    def dense(self, name: str, rows: None, inputs: int, outputs: int) -> None:
        self.noted[name] = outputs, inputs

    def rectify(self, rows: None) -> None:
        return

    leak = standardise = rectify

    def gather(self, rows: None, index: None) -> None:
        return

    def join(self, parts: Sequence[None]) -> None:
        return

    largest = rectify
    weigh = add = gather
