"""Do two revisions of the program give the same results, byte for byte?

    python benchmarks/compare_revisions.py OLD            # a checkout against this one
    python benchmarks/compare_revisions.py OLD --only surface --keep /tmp/both

Each command of `COMMANDS` runs with both revisions at the same time, each in a folder of its own.
Compared are the exit code, what it prints, and every file; of records, tables and pages, clocks and
these folders are left out. Inputs come from the old revision. The exit code is 1 if anything
differs. `tests/sgp/test_memory_and_bands.py` compares results in memory and in bands likewise.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

HERE = Path(__file__).resolve().parents[1]
CROPPED = "--size 320x256"
COIN, PAINTED = (
    f"{name} --lights {name}/derived/truth/lights.json" for name in ("coin", "painted")
)
RADII = " ".join(f"--radius-mm {radius}" for radius in (20.2, 14.1, 16.1, 20.2))
# In order: later commands read what earlier ones wrote. Those before "---" make the inputs.
COMMANDS = f"""
simulate coin --out coin {CROPPED} --led-count 12
simulate spheres --out balls {CROPPED}
simulate white-plane --out card {CROPPED} --led-count 12
simulate coin-with-spheres --out both {CROPPED} --led-count 12
simulate textile --out cloth {CROPPED} --led-count 12
simulate charuco --out board --size 640x512 --led-count 4
simulate painted.toml --out painted
capture export {COIN} --format diligent --out coin-images
capture export {COIN} --format lp --out coin-lp
capture export cloth --lights cloth/derived/truth/lights.json --format diligent --out cloth-images
---
simulate ripples --out ripples --size 160x128 --led-count 12
simulate ripples --out ripples-stored {CROPPED} --led-count 12 --memory 130M
simulate list
capture verify coin
capture info coin
capture plan plan.toml
capture run recorded --rig simulated --plan plan.toml
capture verify recorded
capture resume recorded --rig simulated
capture export recorded --format exr --out recorded-exr
capture import coin-images --out imported
capture compact recorded
inspect {COIN}
calibrate spheres balls --out balls.json
calibrate spheres balls {RADII} --out near.json
calibrate intensities card --lights card/derived/truth/lights.json --out card.json
calibrate flat card --lights card/derived/truth/lights.json --out flat
calibrate check near.json balls/derived/truth/lights.json
calibrate board --out board.png
calibrate camera board --squares 10x8 --square-mm 26 --out camera
capture run brackets --rig simulated --plan brackets.toml
calibrate sensor brackets --out sensor
normals {COIN} --out n-best
normals {COIN} --method cauchy --out n-cauchy
normals {COIN} --method trimmed --out n-trimmed
normals {COIN} --method ls --distant --out n-ls
normals {COIN} --out n-least --memory 432M
normals {COIN} --flat flat --exclude 3 --out n-flat
normals {COIN} --downscale 2 --semi-calibrated --out n-semi
normals {COIN} --height-mm 4.5 --exclude auto --green-out down --out n-height
normals {PAINTED} --channel rgb --out n-rgb
normals {PAINTED} --channel joint --out n-joint
normals {PAINTED} --channel mosaic --out n-mosaic
normals {PAINTED} --out n-painted-least --memory 440M
normals coin-images --out n-images --json
normals coin-lp --crop 40,30,200,180 --out n-lp
normals cloth-images --out n-cloth
run {COIN} --out run --glb --stl --obj --height-sigma
run {COIN} --out run-least --memory 432M
run both --spheres --out run-spheres
run {PAINTED} --out run-painted --discontinuity --filter guided --w 4
surface n-best --out s-plain
surface n-best --out s-jumps --discontinuity --k 3
surface n-best --out s-camera --camera coin/derived/truth/camera.json --close --triangles 3000
surface n-best --out s-sigma --sigma n-best/normal_sigma_deg.exr --height-sigma
surface n-best --out s-mesh --obj --glb --albedo n-best/albedo.exr --mask disc.png --pixel-mm 0.4
surface n-best --out s-texture --normal-texture --stl --base 3 --pixel-mm 0.4 --prior prior.csv
surface n-best --out s-least --stl --memory 347M
curvature n-best --scale 2 --out curvature
curvature n-best --camera coin/derived/truth/camera.json --out curvature-mm
detail separate n-best --out parts
detail separate n-best --filter bilateral --out parts-bilateral
detail separate n-best --filter guided --w 4 --green-out down --out parts-guided
detail separate n-best --filter box --order 1 --w 3 --memory 319M --out parts-least
detail combine parts/shape.exr parts/detail.exr --out combined
detail transfer n-lp n-best --out t-cut --refine 2 --amplitude -0.7
detail transfer n-lp n-best --out t-mirrored --tile mirror --keep-target-detail
detail transfer n-images n-best --out t-put --at 100,90 --scale 0.8 --rotate-deg 10 --mirror
detail transfer n-images n-best --out t-masks --target-mask disc.png --at 90,60 --profile
detail transfer n-lp n-best --out t-least --refine 1 --memory 321M
detail properties n-best n-cloth --out properties
detail synthesize n-cloth --size 200x160 --tileable --mirror --out sheet
detail synthesize n-cloth --size 320x400 --rotate --memory 339M --out sheet-least
detail synthesize n-cloth --size 40x40 --crop 60,60,40,40 --method efros-leung --out sheet-pixels
detail synthesize n-cloth --onto n-best --seed 4 --out onto
detail fill n-best --holes holes.png --out filled
detail superres n-lp --scale 2 --out large
detail superres n-lp --scale 4 --method bicubic --pixel-mm 0.3 --out large-bicubic
detail superres n-lp --scale 2 --sampling points --memory 441M --out large-least
compare n-best n-ls
project s-plain/surface.ply --out projected --size 160x128
project s-mesh/surface.glb --view top --camera coin/derived/truth/camera.json --out projected-top
project points.xyz --out projected-points --size 64x64
export run --out viewer
relight viewer/relight.ptm --light 0.3,0.4,1 --out relit.png
report run --force
report n-best s-plain parts t-cut --out several.html
verify run
batch coin-lp coin-images --out batch --workers 1
normals coin --out refused
normals coin --lights nowhere.json --out refused
normals {COIN} --out refused --method mean
normals {COIN} --out n-best
normals {COIN} --out refused --exclude 0-9
normals {COIN} --out refused --memory 10M
normals {COIN} --out refused --channel rgb --memory 432M
run {COIN} --spheres --out refused
run {COIN} --out refused --glb --memory 340M
surface plan.toml --out refused
surface n-best --out refused --discontinuity --memory 347M
detail separate holes.png --out refused
detail transfer n-lp n-best --out refused --profile --memory 321M
detail superres n-lp --scale 3 --out refused
detail synthesize n-cloth --size 9x9 --out refused
calibrate spheres card --out refused.json
capture run recorded --rig simulated --plan plan.toml
capture import plan.toml --out refused
project holes.png --out refused
relight plan.toml --light 0,0,1 --out refused.png
report nowhere --out refused.html
verify parts/shape.exr
batch nowhere --out refused
"""
FILES = {
    "plan.toml": "leds = '0-11'\nexposures_us = [5000.0]\n",
    "brackets.toml": "leds = [0]\nrepeats = 2\n"
    "exposures_us = [500.0, 1000.0, 2000.0, 4000.0, 8000.0]\n",
    "prior.csv": "x_px,y_px,height_mm\n150,120,4\n170,140,5.5\n",
    "points.xyz": "".join(f"{i % 40} {i // 40} {(i % 7) / 4}\n" for i in range(1600)),
    "painted.toml": """
[object]
kind = "coin"
radius_mm = 70
[pattern]
kind = "colour-wheel"
[lights]
kind = "ring"
count = 12
[lens]
kind = "perspective"
width = 320
height = 256
cfa = "RGGB"
""",
}
# In texts: clocks, durations, the load of the machine, temporary folders, compiled kernels, and
# hashes, because some are of files with clocks; `sgp verify` checks those of a run. Keys of the
# same in records.
UNSTABLE = re.compile(
    r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|\+00:00)?|\d+(\.\d+)? (s|ms|min|h)\b"
    r"|compiling kernels.*\n"
    r"|[\d.]+ a minute|[\d.]+ [KMG]B|\b[0-9a-f]{64}\b|sgp-board-\w+|\b1\d{18}\b"
)
CLOCKS = re.compile(
    r"seconds|_utc$|_ns$|_s$|_mb_per_s$|free_|line_sha|toml_sha|timestamp|^uptime_ms$|^seq$|^bytes$"
)


def stable(text: str) -> str:
    return UNSTABLE.sub("~", text)


def without_clocks(value: object) -> object:
    """Return a value of JSON without clocks."""
    if isinstance(value, dict):
        return {k: without_clocks(v) for k, v in value.items() if not CLOCKS.search(k)}
    if isinstance(value, list):
        return [without_clocks(each) for each in value]
    return stable(str(value)) if isinstance(value, str | int) else value


def named(text: str, *places: Path) -> str:
    """Return a text without the paths of folders."""
    for number, place in enumerate(places):
        text = text.replace(str(place), f"PLACE-{number}")
    return text


def content_of(path: Path, *places: Path) -> str:
    """Return what must be equal in a file: a hash, or the text without what may differ.

    ``places`` are folders whose paths may differ.
    """
    if path.suffix == ".exr":  # whose header states the date
        pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
        return hashlib.sha256(pixels.tobytes()).hexdigest()
    if path.suffix in (".png", ".tif", ".ply", ".glb", ".stl", ".obj", ".mtl", ".jpg", ".ptm"):
        return hashlib.sha256(path.read_bytes()).hexdigest()
    text = named(path.read_text(encoding="utf-8", errors="replace"), *places)
    if path.suffix == ".json":
        return json.dumps(without_clocks(json.loads(text)))
    if path.suffix == ".jsonl":
        return "\n".join(json.dumps(without_clocks(json.loads(line))) for line in text.splitlines())
    if path.suffix == ".csv":
        head, *rows = csv.reader(text.splitlines())
        kept = [i for i, name in enumerate(head) if not CLOCKS.search(name)]
        return str([[row[i] for i in kept] for row in rows])
    # Pages show the same figures as the records.
    return re.sub(r"[\d.]+", "#", stable(text)) if path.suffix == ".html" else stable(text)


def state_of(folder: Path, *places: Path) -> dict[str, str]:
    """Return the contents of all files of a folder by their names; see `content_of`."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): content_of(path, folder, *places) for path in files}


def run_command(checkout: Path, words: str, folder: Path) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of a command of a revision."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "COLUMNS": "100"}
    command = [sys.executable, "-c", "import sgp; sgp.main()", *shlex.split(words)]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    out, err = (named(text, folder, checkout) for text in (done.stdout, done.stderr))
    return done.returncode, stable(out), stable(err)


def make_inputs(folder: Path, run: Callable[[str, Path], tuple[int, str, str]]) -> None:
    """Write what the commands read into a new folder; print what fails.

    ``run`` runs a command in a folder and returns exit code, stdout and stderr.
    """
    folder.mkdir(parents=True)
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    _write_discs(folder)
    for words in COMMANDS.partition("---")[0].strip().splitlines():
        code, _, errors = run(words, folder)
        if code:
            print(f"{words}: exit {code}: {errors.strip()}")


def differences(old: dict[str, str], new: dict[str, str]) -> list[str]:
    """Return a line for each file that is not equal in two states of a folder."""
    both = sorted(old.keys() | new.keys())
    return [
        f"{name} {'is gone' if name not in new else 'is new' if name not in old else 'differs'}"
        for name in both
        if old.get(name) != new.get(name)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path, help="folder of the other revision")
    parser.add_argument("--only", default="", help="commands that contain this, after the inputs")
    parser.add_argument("--keep", type=Path, help="keep the folders old and new here")
    given = parser.parse_args()
    commands = COMMANDS.partition("---")[2].strip().splitlines()
    with tempfile.TemporaryDirectory() as scratch:
        top = (given.keep or Path(scratch)).resolve()
        checkouts = {"old": given.old.resolve(), "new": HERE}
        for name in ("inputs", *checkouts):
            shutil.rmtree(top / name, ignore_errors=True)
        make_inputs(top / "inputs", partial(run_command, checkouts["old"]))

        def outcomes_of(name: str) -> list[tuple[int, str, str]]:
            shutil.copytree(top / "inputs", top / name)
            return [run_command(checkouts[name], words, top / name) for words in commands]

        with ThreadPoolExecutor() as pool:
            outcomes = dict(zip(checkouts, pool.map(outcomes_of, checkouts), strict=True))
        states = {name: state_of(top / name, checkout) for name, checkout in checkouts.items()}
        return _report(commands, outcomes, states, given.only)


def _report(
    commands: list[str],
    outcomes: dict[str, list[tuple[int, str, str]]],
    states: dict[str, dict[str, str]],
    only: str,
) -> int:
    found = 0
    for words, old, new in zip(commands, outcomes["old"], outcomes["new"], strict=True):
        if only not in words:
            continue
        parts = [
            f"{what}: {json.dumps(a)} became {json.dumps(b)}"
            for what, a, b in zip(("exit code", "stdout", "stderr"), old, new, strict=True)
            if a != b
        ]
        found += len(parts)
        print(f"{'differs' if parts else 'equal':8s} exit {new[0]}  {words}")
        for part in parts:
            print(f"    {part[:600]}")
    changed = differences(states["old"], states["new"])
    print(f"{len(changed)} of {len(states['new'])} files differ")
    for line in changed:
        print(f"    {line}")
    return 1 if found or changed else 0


def _write_discs(folder: Path) -> None:
    """Write masks of a small hole and of most of the coin."""
    for name, radius in (("holes.png", 9), ("disc.png", 60)):
        mask = np.zeros((256, 320), np.uint8)
        cv2.circle(mask, (160, 128), radius, 255, -1)
        cv2.imwrite(str(folder / name), mask)


if __name__ == "__main__":
    raise SystemExit(main())
