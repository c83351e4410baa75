"""The network as an ONNX file, with the operations that OpenCV's dnn executes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rig.arrays import Float32
from sgp.training.rdn import OUTPUTS, RdnSize, rdn

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
    """Return the ONNX file of a network: ``low`` (1, 3, h, w) to ``high`` (1, 5, s h, s w)."""
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
