"""Memory and CPU time of commands on recordings larger than memory, against smaller ones.

A recording of --lights images of a relief with highlights and noise, as 16-bit TIFF, is made for
each size, the reference first. Its rows repeat, so that recording it is quick. Each command runs
in a process of its own with --memory. The table has the CPU seconds, the CPU time per pixel and
its ratio to the reference, the peak of the resident memory, and the largest size of the result
with its temporary files. --folder keeps the recordings for the next run; they need 2 bytes for each
pixel and light. The first run may compile kernels: run a small one before.

    NUMBA_NUM_THREADS=1 python benchmarks/large_recordings.py --megapixels 20
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from harness import command_line
from stereo_costs import dome, session
from whole_commands import cost

from acquisition import Lights

SGP = [sys.executable, "-m", "sgp"]
_POLL_S = 1.0


def recorded(root: Path, megapixels: float, lights: int) -> Path:
    """Return a session of that size; one that exists is kept."""
    folder = root / f"{lights}-of-{round(1e3 * megapixels)}k"
    if not (folder / "COMPLETE").exists():
        shutil.rmtree(folder, ignore_errors=True)
        side = round((megapixels * 1e6) ** 0.5)
        session(folder, Lights(directions=dome(lights)), side, gloss=True)
    return folder


@contextmanager
def largest_size(folder: Path) -> Iterator[list[int]]:
    """Yield a list whose only value is the largest size of a folder so far, bytes on the disk."""
    largest, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(_POLL_S):
            largest[0] = max(largest[0], _on_disk(folder))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield largest
    finally:
        ended.set()
        watcher.join()
        largest[0] = max(largest[0], _on_disk(folder))


def _on_disk(folder: Path) -> int:
    size = 0
    for path in folder.rglob("*"):
        try:
            size += path.stat().st_blocks * 512
        except FileNotFoundError:  # removed in between
            continue
    return size


def commands(source: Path, out: Path, methods: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield names and words of the commands."""
    lights, mask = (str(source.with_suffix(end)) for end in (".json", ".png"))
    given = ["--lights", lights, "--mask", mask, "--out", str(out)]
    for method in methods:
        yield f"normals --method {method}", ["normals", str(source), "--method", method, *given]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--megapixels", type=float, default=100.0, help="of an image")
    parser.add_argument("--reference", type=float, default=5.0, help="megapixels to compare with")
    parser.add_argument("--lights", type=int, default=36, help="number of images")
    parser.add_argument("--memory", default="2G", help="limit that the commands get")
    parser.add_argument("--methods", nargs="+", default=["ls", "cauchy"])
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
        of_reference: dict[str, float] = {}
        for megapixels in (options.reference, options.megapixels):
            source, out = recorded(root, megapixels, options.lights), root / "out"
            for label, words in commands(source, out, options.methods):
                shutil.rmtree(out, ignore_errors=True)
                with largest_size(out) as largest:
                    cpu, wall, peak = cost([*SGP, *words, "--memory", options.memory])
                us = cpu / megapixels
                ratio = us / of_reference.setdefault(label, us)
                print(
                    f"{label:26}{megapixels:6g}{cpu:9.1f}{us:8.2f}{ratio:7.2f}"
                    f"{peak * 1e9 / 2**20:10.0f}{largest[0] / 2**20:11.0f}{wall:8.0f}",
                    flush=True,
                )
            shutil.rmtree(out, ignore_errors=True)


if __name__ == "__main__":
    main()
