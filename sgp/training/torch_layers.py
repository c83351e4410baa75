"""The network in torch: its weights, and how they start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.arrays import Float32
from sgp.training.rdn import RdnSize, rdn, weight_shapes

if TYPE_CHECKING:
    import torch

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
