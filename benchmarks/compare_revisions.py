"""Do two revisions of the program give the same results, byte for byte?

    python benchmarks/compare_revisions.py OLD            # a checkout against this one
    python benchmarks/compare_revisions.py OLD --only surface --keep /tmp/both

Each command of `COMMANDS` runs with both revisions, in a folder of the same path. Compared are the
exit code, what it prints, and every file; of records, tables and pages, clocks are left out. Inputs
come from the old revision. The exit code is 1 if anything differs.
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
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself

HERE = Path(__file__).resolve().parents[1]
CROPPED = "--size 320x256"
# In order: later commands read what earlier ones wrote. Those before "---" make the inputs.
COMMANDS = f"""
simulate coin --out coin {CROPPED} --led-count 12
simulate spheres --out balls {CROPPED}
simulate white-plane --out card {CROPPED} --led-count 12
simulate coin-with-spheres --out both {CROPPED} --led-count 12
simulate textile --out cloth {CROPPED} --led-count 12
simulate painted.toml --out painted
capture export coin --lights coin/derived/truth/lights.json --format diligent --out coin-images
capture export coin --lights coin/derived/truth/lights.json --format lp --out coin-lp
capture export cloth --lights cloth/derived/truth/lights.json --format diligent --out cloth-images
---
simulate ripples --out ripples --size 160x128 --led-count 12
capture verify coin
capture info coin
capture plan plan.toml
capture run recorded --rig simulated --plan plan.toml
capture verify recorded
capture resume recorded --rig simulated
capture export recorded --format exr --out recorded-exr
capture import coin-images --out imported
capture compact recorded
inspect coin --lights coin/derived/truth/lights.json
calibrate spheres balls --out balls.json
calibrate spheres balls --radius-mm 20.2,14.1,16.1,20.2 --out near.json
calibrate intensities card --lights card/derived/truth/lights.json --out card.json
calibrate flat card --lights card/derived/truth/lights.json --out flat
calibrate check balls.json balls/derived/truth/lights.json
calibrate camera coin
calibrate sensor coin --out sensor
normals coin --lights coin/derived/truth/lights.json --out n-best
normals coin --lights coin/derived/truth/lights.json --method cauchy --out n-cauchy
normals coin --lights coin/derived/truth/lights.json --method trimmed --out n-trimmed
normals coin --lights coin/derived/truth/lights.json --method ls --distant --out n-ls
normals painted --lights painted/derived/truth/lights.json --channel rgb --out n-rgb
normals painted --lights painted/derived/truth/lights.json --channel joint --out n-joint
normals painted --lights painted/derived/truth/lights.json --channel mosaic --out n-mosaic
normals coin --lights coin/derived/truth/lights.json --flat flat --exclude 3 --out n-flat
normals coin --lights coin/derived/truth/lights.json --downscale 2 --semi-calibrated --out n-semi
normals coin-images --out n-images
normals coin-lp --crop 40,30,200,180 --out n-lp
run coin --lights coin/derived/truth/lights.json --out run --glb --stl --obj --height-sigma
run coin --lights coin/derived/truth/lights.json --out run-least --memory 432M
run both --spheres --out run-spheres
surface n-best --out s-plain
surface n-best --out s-jumps --discontinuity
surface n-best --out s-camera --camera coin/derived/truth/camera.json --close --triangles 3000
surface n-best --out s-sigma --sigma n-best/normal_sigma_deg.exr --height-sigma
curvature n-best --scale 2 --out curvature
detail separate n-best --out parts
detail separate n-best --filter bilateral --out parts-bilateral
detail combine parts/shape.exr parts/detail.exr --out combined
detail transfer n-images n-best --out transferred --at 100,90 --scale 0.8 --rotate-deg 10
detail properties n-best --out properties
detail synthesize n-images --size 200x160 --tileable --out sheet
detail synthesize n-images --onto n-best --out onto
detail fill n-best --holes holes.png --out filled
detail superres n-lp --scale 2 --out large
compare n-best n-ls
project s-plain/surface.ply --out projected --size 160x128
export run --out viewer
relight viewer/relight.ptm --light 0.3,0.4,1 --out relit.png
report run --force
batch coin-lp coin-images --out batch --workers 1
"""
FILES = {
    "plan.toml": "leds = '0-11'\nexposures_us = [5000.0]\n",
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
# Clocks, durations and the load of the machine in texts; keys of the same in records and tables.
UNSTABLE = re.compile(
    r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|\+00:00)?|\d+(\.\d+)? (s|ms|min|h)\b"
    r"|[\d.]+ a minute|[\d.]+ [KMG]B"
)
# Hashes of files that contain clocks: the lines of a journal, a manifest.
CLOCKS = re.compile(r"seconds|_utc$|_ns$|_s$|_mb_per_s$|free_|line_sha|toml_sha|timestamp")


def stable(text: str) -> str:
    return UNSTABLE.sub("~", text)


def without_clocks(value: object) -> object:
    """Return a value of JSON without clocks, and with the names of temporary files shortened."""
    if isinstance(value, dict):
        return {k: without_clocks(v) for k, v in value.items() if not CLOCKS.search(k)}
    if isinstance(value, list):
        return [without_clocks(each) for each in value]
    return stable(value) if isinstance(value, str) else value


def content_of(path: Path, checkout: Path) -> str:
    """Return what must be equal in a file: a hash, or the text without what may differ."""
    if path.suffix == ".exr":  # whose header states the date
        pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
        return hashlib.sha256(pixels.tobytes()).hexdigest()
    if path.suffix in (".png", ".tif", ".ply", ".glb", ".stl", ".obj", ".mtl", ".jpg", ".ptm"):
        return hashlib.sha256(path.read_bytes()).hexdigest()
    text = path.read_text(encoding="utf-8", errors="replace").replace(str(checkout), "CHECKOUT")
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


def state_of(folder: Path, checkout: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): content_of(path, checkout) for path in files}


def run_command(checkout: Path, words: str, folder: Path) -> tuple[int, str, str]:
    environment = {**os.environ, "PYTHONPATH": str(checkout), "COLUMNS": "100"}
    command = [sys.executable, "-c", "import sgp; sgp.main()", *shlex.split(words)]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    out, err = (text.replace(str(checkout), "CHECKOUT") for text in (done.stdout, done.stderr))
    return done.returncode, stable(out), stable(err)


def differences(old: dict[str, str], new: dict[str, str]) -> list[str]:
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
    inputs, commands = (part.strip().splitlines() for part in COMMANDS.split("---\n"))
    with tempfile.TemporaryDirectory() as scratch:
        top = (given.keep or Path(scratch)).resolve()
        folder, kept = top / "work", {"old": top / "old", "new": top / "new"}
        for path in (folder, *kept.values(), top / "inputs"):
            shutil.rmtree(path, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, text in FILES.items():
            (folder / name).write_text(text, encoding="utf-8")
        _write_holes(folder / "holes.png")
        for words in inputs:
            code, _, errors = run_command(given.old.resolve(), words, folder)
            if code:
                print(f"{words}: exit {code}: {errors.strip()}")
        folder.rename(top / "inputs")
        outcomes = {}
        checkouts = {"old": given.old.resolve(), "new": HERE}
        for name, checkout in checkouts.items():
            # The same path for both, because records and messages contain it.
            shutil.copytree(top / "inputs", folder)
            outcomes[name] = [run_command(checkout, words, folder) for words in commands]
            folder.rename(kept[name])
        states = {name: state_of(kept[name], checkouts[name]) for name in kept}
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


def _write_holes(path: Path) -> None:
    holes = np.zeros((256, 320), np.uint8)
    cv2.circle(holes, (160, 128), 9, 255, -1)
    cv2.imwrite(str(path), holes)


if __name__ == "__main__":
    raise SystemExit(main())
