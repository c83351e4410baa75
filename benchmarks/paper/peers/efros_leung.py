"""Efros-Leung, the paper's own synthesis: a sheet of detail that grows pixel by pixel.

A. Efros and T. Leung, "Texture synthesis by non-parametric sampling", ICCV 1999. The method is part
of the program (``sgp detail synthesize --method efros-leung``).
"""

from __future__ import annotations

from collections.abc import Callable

import processing
from benchmarks.paper.peers.protocol import Peer

# Side of the neighbourhoods in pixels.
SIDE_PX = 11


def _fit(exemplar: processing.NormalMap) -> Callable[[tuple[int, int]], processing.NormalMap]:
    return lambda size: processing.synthesis.efros_leung(exemplar, size, patch=SIDE_PX).detail


PEER = Peer("Efros-Leung", "Efros and Leung, ICCV 1999", _fit)
