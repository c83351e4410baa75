"""The residual dense network, written once for torch, which trains it, and for ONNX."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar

import numpy as np

from rig.arrays import Float32

if TYPE_CHECKING:
    import torch

T = TypeVar("T")

# The residual of a normal, and the logarithms of two mean-square errors.
OUTPUTS = 5
_NORMAL = 3


@dataclass(frozen=True)
class RdnSize:
    """Sizes of a residual dense network (Zhang et al., CVPR 2018).

    Parameters
    ----------
    scale
        Factor from low to high resolution, 2 or 4.
    blocks, convolutions, growth
        D, C and G of the paper: residual dense blocks, convolutions in each, and the channels that
        each of them adds.
    features
        G0 of the paper: channels between blocks.
    upsampling
        ``convolved`` as in the paper: one convolution and a pixel shuffle for each factor of 2,
        then a convolution at high resolution. ``direct``: one convolution, then one pixel shuffle
        (Shi et al., CVPR 2016), which costs 1/40 for few features.
    """

    scale: Literal[2, 4]
    blocks: int = 16
    convolutions: int = 8
    growth: int = 64
    features: int = 64
    upsampling: Literal["convolved", "direct"] = "convolved"

    @property
    def halo_px(self) -> int:
        """How far a pixel of low resolution has an effect, in pixels of low resolution."""
        tail = 1 if self.upsampling == "direct" else 3
        return self.blocks * self.convolutions + 3 + tail


class Layers(Protocol[T]):
    """The operations of a library on its own kind of images."""

    def convolve(self, name: str, image: T, inputs: int, outputs: int, side: int) -> T:
        """Return a convolution with zeros outside the image."""

    def rectify(self, image: T) -> T:
        """Return the positive part."""

    def join(self, images: Sequence[T]) -> T:
        """Return the channels of all images."""

    def add(self, first: T, second: T) -> T:
        """Return the sum."""

    def shuffle(self, image: T, scale: int) -> T:
        """Return an image with `scale` times as many rows and columns, made of its channels."""


def rdn(size: RdnSize, layers: Layers[T], low: T) -> T:
    """Return the output of the network: ``OUTPUTS`` channels at high resolution."""
    g0, growth, dense = size.features, size.growth, size.convolutions
    first = layers.convolve("shallow1", low, _NORMAL, g0, 3)
    image = layers.convolve("shallow2", first, g0, g0, 3)
    outcomes = []
    for block in range(size.blocks):
        parts = [image]
        for index in range(dense):
            name, inputs = f"block{block}.dense{index}", g0 + index * growth
            joined = layers.join(parts) if index else image
            added = layers.convolve(name, joined, inputs, growth, 3)
            parts.append(layers.rectify(added))
        name, inputs = f"block{block}.fusion", g0 + dense * growth
        image = layers.add(image, layers.convolve(name, layers.join(parts), inputs, g0, 1))
        outcomes.append(image)
    image = layers.convolve("fusion1", layers.join(outcomes), size.blocks * g0, g0, 1)
    image = layers.add(layers.convolve("fusion2", image, g0, g0, 3), first)
    if size.upsampling == "direct":
        image = layers.convolve("last", image, g0, OUTPUTS * size.scale**2, 3)
        return layers.shuffle(image, size.scale)
    for step in range(size.scale // 2):
        image = layers.shuffle(layers.convolve(f"upsample{step}", image, g0, 4 * g0, 3), 2)
    return layers.convolve("last", image, g0, OUTPUTS, 3)


class _Shapes:
    """Layers that only note the shapes of their weights."""

    def __init__(self) -> None:
        self.noted: dict[str, tuple[int, int, int, int]] = {}

    def convolve(self, name: str, image: None, inputs: int, outputs: int, side: int) -> None:
        self.noted[name] = (outputs, inputs, side, side)

    def rectify(self, image: None) -> None:
        return

    def join(self, images: Sequence[None]) -> None:
        return

    def add(self, first: None, second: None) -> None:
        return

    def shuffle(self, image: None, scale: int) -> None:
        return


@functools.cache
def weight_shapes(size: RdnSize) -> dict[str, tuple[int, int, int, int]]:
    """Return the shape of the weights of each convolution, by its name, in order."""
    shapes = _Shapes()
    rdn(size, shapes, None)
    return shapes.noted


# Logarithm of the mean-square errors before training, in radian^2: about 5 degrees.
_FIRST_VARIANCE = -5.0
_VARIANCES = 2


class TorchLayers:
    """The layers of `rdn` in torch, with weights by name."""

    def __init__(self, weights: Mapping[str, torch.Tensor]) -> None:
        self._weights = weights

    def convolve(
        self, name: str, image: torch.Tensor, inputs: int, outputs: int, side: int
    ) -> torch.Tensor:
        """Return the convolution of an image, padded to its size."""
        from torch.nn.functional import conv2d

        weights, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
        return conv2d(image, weights, bias, padding=side // 2)

    def rectify(self, image: torch.Tensor) -> torch.Tensor:
        """Return the values that are not negative, and 0 for the others."""
        return image.relu()

    def join(self, images: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return the channels of all images as one image."""
        import torch

        return torch.cat(list(images), 1)

    def add(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        """Return the sum of two images."""
        return first + second

    def shuffle(self, image: torch.Tensor, scale: int) -> torch.Tensor:
        """Return groups of channels as the pixels of a larger image."""
        from torch.nn.functional import pixel_shuffle

        return pixel_shuffle(image, scale)


def as_images(maps: Float32) -> torch.Tensor:
    """Return ``(B, h, w, 3)`` maps as a tensor ``(B, 3, h, w)``, its channels last in memory."""
    import torch

    return torch.from_numpy(np.ascontiguousarray(maps)).permute(0, 3, 1, 2)


def forward(size: RdnSize, weights: Mapping[str, Any], low: torch.Tensor) -> torch.Tensor:
    """Return the output of the network for ``(B, 3, h, w)`` normals of low resolution."""
    return rdn(size, TorchLayers(weights), low)


def first_weights(size: RdnSize, seed: int) -> dict[str, torch.Tensor]:
    """Return random weights, except of the last convolution, whose output is constant.

    Training starts at bicubic interpolation, because the residual is 0.
    """
    import torch

    random = torch.Generator().manual_seed(seed)
    weights: dict[str, torch.Tensor] = {}
    for name, shape in weight_shapes(size).items():
        reach = 1 / math.sqrt(math.prod(shape[1:]))
        start, bias = torch.zeros(shape), torch.zeros(shape[0])
        if name == "last":
            bias[-_VARIANCES * shape[0] // 5 :] = _FIRST_VARIANCE
        else:
            start.uniform_(-reach, reach, generator=random)
            bias.uniform_(-reach, reach, generator=random)
        weights[f"{name}.weight"] = start.contiguous(memory_format=torch.channels_last)
        weights[f"{name}.bias"] = bias
    return weights


OPSET, _IR_VERSION = 17, 8


class _OnnxLayers:
    """The layers of `rdn` as nodes of a graph; an image is the name of a node's output."""

    def __init__(self, weights: Mapping[str, Float32]) -> None:
        self._weights = weights
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def _node(self, kind: str, images: Sequence[str], **attributes: Any) -> str:
        from onnx import helper

        out = f"{kind.lower()}{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(images), [out], out, **attributes))
        return out

    def convolve(self, name: str, image: str, inputs: int, outputs: int, side: int) -> str:
        from onnx import numpy_helper

        names = [f"{name}.weight", f"{name}.bias"]
        self.constants += [
            numpy_helper.from_array(np.ascontiguousarray(self._weights[one]), one) for one in names
        ]
        pads, sides = [side // 2] * 4, [side, side]
        return self._node("Conv", [image, *names], kernel_shape=sides, pads=pads)

    def rectify(self, image: str) -> str:
        return self._node("Relu", [image])

    def join(self, images: Sequence[str]) -> str:
        return images[0] if len(images) == 1 else self._node("Concat", images, axis=1)

    def add(self, first: str, second: str) -> str:
        return self._node("Add", [first, second])

    def shuffle(self, image: str, scale: int) -> str:
        # CRD is the order of channels of torch's pixel_shuffle.
        return self._node("DepthToSpace", [image], blocksize=scale, mode="CRD")


def onnx_bytes(size: RdnSize, weights: Mapping[str, Float32]) -> bytes:
    """Return the ONNX file of a network: ``low`` (1, 3, h, w) to ``high`` (1, 5, s h, s w).

    It has only operations that OpenCV's dnn executes.
    """
    from onnx import TensorProto, checker, helper

    layers = _OnnxLayers(weights)
    rdn(size, layers, "low")
    layers.nodes[-1].output[0] = "high"
    low = helper.make_tensor_value_info("low", TensorProto.FLOAT, [1, 3, "h", "w"])
    high = helper.make_tensor_value_info("high", TensorProto.FLOAT, [1, OUTPUTS, "sh", "sw"])
    graph = helper.make_graph(layers.nodes, "rdn", [low], [high], layers.constants)
    opset = helper.make_opsetid("", OPSET)
    model = helper.make_model(graph, opset_imports=[opset], ir_version=_IR_VERSION)
    checker.check_model(model)
    return bytes(model.SerializeToString(deterministic=True))
