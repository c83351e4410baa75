"""Train a peer of the paper's tables again: its weights come with the sources.

pu_net: the network on points.

dgts: generators of displacements; --exemplar names the material.

It requires torch and onnx: pip install "surface-geometry-processing[learned]". An interrupted
training continues if the same command is given again. (RDN on normals is trained by sgp detail
train --domain normals.)

    python -m benchmarks.paper.train pu_net --out pu-net.onnx
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.harness import command_line
from benchmarks.paper.peers.checkpoints import require_learned
from benchmarks.paper.peers.dgts import EXEMPLARS
from sgp.cli.console import Stages
from sgp.cli.exit import FAULT, error_text, exit_code

TRAINED = ("dgts", "pu_net")


def main(words: Sequence[str] | None = None) -> int:
    """Train a peer; return the exit code."""
    parser = command_line(__doc__)
    parser.add_argument("peer", choices=TRAINED, help="what to train")
    parser.add_argument("--out", type=Path, required=True, help="file of the weights (.onnx)")
    parser.add_argument("--steps", type=int, help="steps, instead of those of the peer")
    parser.add_argument("--exemplar", choices=EXEMPLARS, help="dgts: the material")
    options = parser.parse_args(words)
    if options.exemplar is not None and options.peer != "dgts":
        parser.error(f"--exemplar is not an option of {options.peer}")
    try:
        require_learned()
        training = import_module(f"benchmarks.paper.peers.{options.peer}_training")
        given = {
            name: getattr(options, name)
            for name in ("steps", "exemplar")
            if getattr(options, name) is not None
        }
        with Stages() as progress:
            training.train(options.out, progress, **given)
    except Exception as error:
        if exit_code(error) == FAULT:
            raise
        print(f"error: {error_text(error)}", file=sys.stderr)
        return exit_code(error)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
