"""RDN, a peer: super-resolution by a residual dense network, on normals or on details.

Y. Zhang, Y. Tian, Y. Kong, B. Zhong and Y. Fu, "Residual Dense Network for Image Super-Resolution",
CVPR 2018. Both networks have 5 blocks of 3 convolutions (the original: 16 of 8) and were trained
alike, on the same simulated surfaces: ``sgp detail train --scale 4 --domain normals`` or
``--domain detail``. The one on details is that of the program.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import processing
from benchmarks.paper.peers.protocol import Peer
from processing.superres import SuperResolutionModel, read_superres_model
from rig.arrays import Bool

NORMALS = Path(__file__).with_name("weights") / "rdn-normals-x4.onnx"


class Low(NamedTuple):
    """A map of the low resolution, and the mask of the high one."""

    normals: processing.NormalMap
    mask: Bool


SCALE = 4


def models() -> tuple[SuperResolutionModel, SuperResolutionModel]:
    """Return the networks on details and on normals."""
    return read_superres_model(None, SCALE), read_superres_model(NORMALS, SCALE)


def _fit(model: SuperResolutionModel) -> Callable[[Low], processing.NormalMap]:
    return lambda low: (
        processing.super_resolve(
            low.normals, model.scale, model=model, self_ensemble=False, mask=low.mask
        ).normal_map
    )


PEER = Peer("RDN", "Zhang et al., CVPR 2018", _fit)
