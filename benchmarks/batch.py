"""What a batch costs beyond its work, and what that means for a lab and for a museum.

The first table compares `sgp batch` on copies of one session, with one worker, with `sgp run` on
one of them: CPU seconds for each source, and the time of a second run, which has nothing to do, and
of a third one after one file got a new time. The second table has the bytes of one object by
format, the third scales the measured rates: cores that are busy all day, and the size of recordings
and results. Run it on a computer without other work; the first run may compile kernels.

    python benchmarks/batch.py --sessions 24 --megapixels 1
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from harness import command_line
from stereo_costs import dome, session
from whole_commands import cost, files_in

from acquisition import Lights

SGP = [sys.executable, "-m", "sgp"]
_DAY_S = 86_400.0


def copies(root: Path, megapixels: float, count: int) -> list[Path]:
    """Record a session of 36 images, and return it with its copies."""
    side = round((megapixels * 1e6) ** 0.5)
    first = root / "s00"
    session(first, Lights(directions=dome(36)), side)
    (root / "recipe.toml").write_text('[run]\nlights = "s00.json"\nmask = "s00.png"\n')
    others = [root / f"s{i:02}" for i in range(1, count)]
    for other in others:
        shutil.copytree(first, other)
    return [first, *others]


def seconds(out: Path) -> list[float]:
    """Return the CPU seconds of the sources of a batch."""
    with (out / "batch.csv").open(newline="") as file:
        return [float(row["cpu_seconds"]) for row in csv.DictReader(file)]


def size(*places: Path) -> int:
    return sum(path.stat().st_size for path in files_in(*places))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--sessions", type=int, default=24)
    parser.add_argument("--megapixels", type=float, default=1.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sgp-batch-") as name:
        root = Path(name)
        sources = copies(root, options.megapixels, options.sessions)
        lights = ["--lights", str(root / "s00.json"), "--mask", str(root / "s00.png")]
        words = [*SGP, "run", str(sources[0]), *lights, "--out", str(root / "one"), "--force"]
        cost(words)
        alone, _, peak = cost(words)
        recipe = ["--recipe", str(root / "recipe.toml")]
        asked = [*SGP, "batch", *map(str, sources), *recipe]
        here = [*asked, "--out", str(root / "here"), "--workers", "1"]
        print(f"{options.sessions} sessions of 36 x {options.megapixels:g} megapixels")
        print(f"{'':34}{'CPU s':>8}{'wall s':>8}")
        print(f"{'sgp run, one session':34}{alone:8.2f}", flush=True)
        cpu, wall, _ = cost(here)
        each = cpu / len(sources)
        print(f"{'batch, one worker, each':34}{each:8.2f}{wall / len(sources):8.2f}", flush=True)
        beyond = cpu - sum(seconds(root / "here"))
        print(f"{'  beyond the work, all sources':34}{beyond:8.2f}   {beyond / cpu:.1%}")
        cpu, wall, _ = cost(here)
        print(f"{'again, nothing to do':34}{cpu:8.2f}{wall:8.2f}", flush=True)
        frame = next((sources[1] / "frames").iterdir())
        os.utime(frame)
        cpu, wall, _ = cost(here)
        print(f"{'again, one file touched':34}{cpu:8.2f}{wall:8.2f}", flush=True)
        recording, result = size(sources[0]), size(root / "one")
        storage(sources[0], root / "one")
        scale(each, peak, recording, result)


def storage(session: Path, result: Path) -> None:
    """Print the bytes of one object by format."""
    sizes = {"recording: TIFF, as recorded": size(session)}
    subprocess.run([*SGP, "capture", "compact", str(session)], check=True, capture_output=True)
    sizes["recording: TIFF, compacted"] = size(session)
    kinds = {".exr": "EXR maps", ".png": "PNG pictures and masks", ".ply": "PLY mesh"}
    kinds |= {".html": "HTML report", ".json": "JSON records"}
    for path in files_in(result):
        name = f"result: {kinds.get(path.suffix, 'other')}"
        sizes[name] = sizes.get(name, 0) + path.stat().st_size
    sizes["result, complete"] = size(result)
    print(f"\n{'bytes of one object':34}{'MB':>8}")
    for name, count in sizes.items():
        print(f"{name:34}{count / 1e6:8.2f}")


def scale(each_s: float, peak_gb: float, recording: int, result: int) -> None:
    """Print what numbers of objects need."""
    print(f"\n{'objects':>22}{'cores':>8}{'memory GB':>11}{'recordings':>14}{'results':>12}")
    rates = {"10 a day": 10.0, "1,000 a day": 1e3, "a million in a year": 1e6 / 365}
    for label, per_day in rates.items():
        cores = max(1, -(-per_day * each_s // _DAY_S))
        of_all = 1e6 if "million" in label else per_day
        print(
            f"{label:>22}{cores:8.0f}{cores * peak_gb:11.1f}"
            f"{_bytes(of_all * recording):>14}{_bytes(of_all * result):>12}"
        )
    print("recordings and results: all of the million, else those of one day")


def _bytes(count: float) -> str:
    power = 2 if count < 1e9 else 3 if count < 1e12 else 4 if count < 1e15 else 5
    return f"{count / 1000**power:.3g} {['MB', 'GB', 'TB', 'PB'][power - 2]}"


if __name__ == "__main__":
    main()
