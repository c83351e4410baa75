"""The residual dense network, written once for the two libraries that execute it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

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
