"""Memory and CPU time of commands on recordings larger than memory, against smaller ones.

A recording of --lights images of a relief with highlights and noise, as 16-bit TIFF, is made for
each size, the reference first. Its rows repeat, so that recording it is quick. `detail` and
`surface` read normals of waves with noise; 0.25 megapixels of them are the detail that is
transferred to the large map, and continued over a large sheet. Each command runs in a process of
its own with --memory. The table has the CPU seconds, the CPU time per pixel and its ratio to the
reference, the peak of the resident memory, and the largest size of the result with its temporary
files. --folder keeps the inputs for the next run; a recording needs 2 bytes for each pixel and
light. The first run may compile kernels: run a small one before.

    NUMBA_NUM_THREADS=1 python benchmarks/large_recordings.py --megapixels 20
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from harness import command_line, largest
from stereo_costs import dome, session
from whole_commands import cost

from acquisition import Lights, write_exr
from acquisition.files import ComputedRows
from rig.arrays import Float32

SGP = [sys.executable, "-m", "sgp"]
_COMMANDS = ("normals", "run", "separate", "transfer", "synthesize", "surface")
_OF_RECORDINGS = ("normals", "run")
_POLL_S = 1.0
# Megapixels of the map whose detail is transferred or continued.
_SOURCE = 0.25
# Of the slopes of the waves, and rows after which it repeats.
_NOISE, _NOISE_ROWS = 0.02, 128


def recorded(root: Path, megapixels: float, lights: int) -> Path:
    """Return a session of that size; one that exists is kept."""
    folder = root / f"{lights}-of-{round(1e3 * megapixels)}k"
    if not (folder / "COMPLETE").exists():
        shutil.rmtree(folder, ignore_errors=True)
        side = round((megapixels * 1e6) ** 0.5)
        session(folder, Lights(directions=dome(lights)), side, gloss=True)
    return folder


def on_disk(folder: Path) -> int:
    """Return the size of a folder, bytes on the disk."""
    size = 0
    for path in folder.rglob("*"):
        try:
            size += path.stat().st_blocks * 512
        except FileNotFoundError:  # removed in between
            continue
    return size


def waves(root: Path, megapixels: float) -> Path:
    """Return a file of normals of that size; one that exists is kept."""
    path = root / f"normals-of-{round(1e3 * megapixels)}k.exr"
    side = round((megapixels * 1e6) ** 0.5)
    noise = np.random.default_rng(0).normal(0, _NOISE, (_NOISE_ROWS, side, 2)).astype(np.float32)

    def rows(part: slice) -> Float32:
        y, x = np.arange(part.start, part.stop, dtype=np.float32), np.arange(side, dtype=np.float32)
        slopes = noise[np.arange(part.start, part.stop) % _NOISE_ROWS]
        slopes[..., 0] += 0.5 * np.sin(x / 70) + 0.3 * np.sin(x / 9)
        slopes[..., 1] += (0.5 * np.cos(y / 90) + 0.3 * np.cos(y / 13))[:, None]
        normals = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        return normals / np.linalg.norm(normals, axis=-1, keepdims=True)

    if not path.exists():
        write_exr(path, ComputedRows((side, side, 3), np.dtype(np.float32), rows))
    return path


def commands(
    root: Path, out: Path, megapixels: float, options: argparse.Namespace
) -> Iterator[tuple[str, list[str]]]:
    """Yield names and words of the commands."""
    for command in [name for name in _OF_RECORDINGS if name in options.commands]:
        source = recorded(root, megapixels, options.lights)
        lights, mask = (str(source.with_suffix(end)) for end in (".json", ".png"))
        given = [str(source), "--lights", lights, "--mask", mask, "--memory", options.memory]
        for method in options.methods:
            yield f"{command} --method {method}", [command, *given, "--method", method]
    if "separate" in options.commands:
        normals = str(waves(root, megapixels))
        yield "detail separate", ["detail", "separate", normals, "--memory", options.memory]
    if "transfer" in options.commands:
        maps = [str(waves(root, size)) for size in (_SOURCE, megapixels)]
        yield "detail transfer", ["detail", "transfer", *maps, "--memory", options.memory]
    if "synthesize" in options.commands:
        side = round((megapixels * 1e6) ** 0.5)
        given = [str(waves(root, _SOURCE)), "--size", f"{side}x{side}"]
        words = ["detail", "synthesize", *given, "--memory", options.memory]
        yield "detail synthesize", words
    if "surface" in options.commands:
        normals = str(waves(root, megapixels))
        yield "surface", ["surface", normals, "--memory", options.surface_memory]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--megapixels", type=float, default=100.0, help="of an image")
    parser.add_argument("--reference", type=float, default=5.0, help="megapixels to compare with")
    parser.add_argument("--lights", type=int, default=36, help="number of images")
    parser.add_argument("--memory", default="2G", help="limit that the commands get")
    parser.add_argument("--surface-memory", default="3500M", help="limit that `surface` gets")
    parser.add_argument("--commands", nargs="+", default=list(_COMMANDS), choices=_COMMANDS)
    parser.add_argument(
        "--methods", nargs="+", default=["ls", "cauchy"], help="of `normals` and `run`"
    )
    parser.add_argument("--folder", type=Path, help="folder of recordings and results")
    options = parser.parse_args()
    print(
        f"{options.lights} lights, --memory {options.memory}\n{'':26}{'Mpx':>6}{'CPU s':>9}"
        f"{'us/px':>8}{'ratio':>7}{'peak MiB':>10}{'files MiB':>11}{'wall s':>8}",
        flush=True,
    )
    with tempfile.TemporaryDirectory(prefix="sgp-large-") as name:
        root = options.folder or Path(name)
        root.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(root / "out", ignore_errors=True)
        of_reference: dict[str, float] = {}
        for megapixels in (options.reference, options.megapixels):
            out = root / "out"
            for label, words in commands(root, out, megapixels, options):
                with largest(partial(on_disk, out), _POLL_S) as size:
                    cpu, wall, peak = cost([*SGP, *words, "--out", str(out)])
                shutil.rmtree(out)
                us = cpu / megapixels
                ratio = us / of_reference.setdefault(label, us)
                print(
                    f"{label:26}{megapixels:6g}{cpu:9.1f}{us:8.2f}{ratio:7.2f}"
                    f"{peak * 1e9 / 2**20:10.0f}{size[0] / 2**20:11.0f}{wall:8.0f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
