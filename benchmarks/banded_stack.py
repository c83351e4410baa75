"""CPU time and memory of a large session read in bands of rows, against the complete stack.

A session of --lights frames of 5472 x 3648 px, with dark frames and noise, is recorded into
--folder, which keeps it for the next run. Each row of the table is measured in a process of its
own, and has CPU seconds, the ratio to the complete stack, and the growth of the resident memory:

- whole: `linear_stack`. This is the yardstick;
- bands: `open_stack`, and all of its bands one after the other.

Both compute a hash of their values, band by band. The hashes must agree.

    python benchmarks/banded_stack.py --folder /tmp/banded
"""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

import numpy as np
from harness import Cost, alone, command_line, measured
from sessions import write_session

from acquisition import read_source
from acquisition.plan import PlannedShot
from calibration import linear_stack, open_stack
from rig.arrays import UInt16

WIDTH, HEIGHT = 5472, 3648
ROWS = 64
_TIMES_US = (20_000.0, 5_000.0)


def record(folder: Path, lights: int, brackets: int) -> None:
    """Record noise; a session that exists is kept."""
    if (folder / "COMPLETE").exists():
        return
    noise = np.random.default_rng(0).normal(0, 12, (HEIGHT, WIDTH)).astype(np.float32)
    slope = np.linspace(300, 4200, WIDTH, dtype=np.float32)

    def frame(i: int, shot: PlannedShot) -> UInt16:
        share = (shot.exposure_us or 0.0) / _TIMES_US[0] if shot.role == "light" else 0.0
        pixels = 100 + share * slope + np.roll(noise, 7919 * i)
        return np.clip(np.rint(pixels), 0, 4095).astype(np.uint16)

    write_session(
        folder,
        "noise",
        frame,
        lights=lights,
        size=(HEIGHT, WIDTH),
        exposures_us=_TIMES_US[:brackets],
        black_level_dn=100,
        read_noise_e=3.0,
    )


def whole(folder: Path) -> tuple[Cost, str]:
    """Read the complete stack."""
    source = read_source(folder)

    def work() -> str:
        stack, digest = linear_stack(source), hashlib.sha256()
        for first in range(0, HEIGHT, ROWS):
            part = stack.rows(first, min(first + ROWS, HEIGHT)).values
            digest.update(np.ascontiguousarray(part).data)
        return digest.hexdigest()

    return measured(work)


def bands(folder: Path) -> tuple[Cost, str]:
    """Read the stack in bands."""
    source = read_source(folder)

    def work() -> str:
        digest = hashlib.sha256()
        with open_stack(source) as stack:
            for _, band in stack.bands(ROWS):
                digest.update(band.values.data)
        return digest.hexdigest()

    return measured(work)


def main() -> None:
    """Print the table."""
    parser = command_line(__doc__)
    parser.add_argument("--lights", type=int, default=36, help="number of lights")
    parser.add_argument("--brackets", type=int, default=1, choices=(1, 2), help="exposure times")
    parser.add_argument("--folder", type=Path, help="folder of the session")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.folder or Path(temporary)) / f"{options.lights}x{options.brackets}"
        folder.parent.mkdir(parents=True, exist_ok=True)
        record(folder, options.lights, options.brackets)
        print(f"{'':8}{'CPU s':>8}{'ratio':>8}{'wall s':>8}{'MB':>8}")
        yardstick, expected = alone(whole, folder)
        for name, (cost, found) in (
            ("whole", (yardstick, expected)),
            ("bands", alone(bands, folder)),
        ):
            ratio = cost.cpu_s / yardstick.cpu_s
            print(
                f"{name:8}{cost.cpu_s:8.1f}{ratio:8.2f}{cost.wall_s:8.1f}{cost.peak_mb:8.0f}",
                flush=True,
            )
            if found != expected:
                raise SystemExit("the values differ")


if __name__ == "__main__":
    main()
