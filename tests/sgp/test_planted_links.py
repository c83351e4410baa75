"""Links planted in an output folder never redirect a write: every command, every name."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from acquisition import verify_session, write_mask

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs links, pipes and a rig")

RIG = """
name = "small"
driver = "simulated"
leds = 4
[options]
scene = "coin"
width = 64
height = 52
"""
GREY = """
name = "grey"
driver = "simulated"
leds = 1
[options]
scene = "white-plane"
width = 80
height = 64
camera = "inside"
realtime = false
"""
SERIES = f'leds = "0-0"\nexposures_us = {[500 * n for n in range(1, 82, 8)]}\nrepeats = 2\n'
PLAN = "leds = [0, 1, 2, 3]\nexposures_us = [5000.0]\n"
# A complete session loses COMPLETE and its last line, so that its last frame has no line.
CUT_OFF = """
import shutil
shutil.copytree(ROOT / "s", ROOT / "cut")
(ROOT / "cut/COMPLETE").unlink()
lines = (ROOT / "cut/journal.jsonl").read_bytes().splitlines(True)
last = max(n for n, line in enumerate(lines) if b'"kind":"frame"' in line)
(ROOT / "cut/journal.jsonl").write_bytes(b"".join(lines[:last]))
"""
# Call every writer; each line reads the results of the lines before it.
COMMANDS = """
    capture run {root}/s --rig {root}/rig.toml --plan {root}/plan.toml
    CUT OFF
    capture resume {root}/cut --rig {root}/rig.toml
    capture compact {root}/s
    simulate coin --out {root}/sim --size 64x52 --led-count 6
    capture export {root}/sim --lights {lights} --format diligent --out {root}/diligent
    capture export {root}/sim --lights {lights} --format diligent --out {root}/diligent --force
    capture import {root}/diligent --out {root}/imported
    normals {root}/sim --lights {lights} --out {root}/normals
    surface {root}/normals --out {root}/surface --obj --stl --glb
    capture info {root}/s --sheet {root}/sheet.png
    capture compact {root}/s
    simulate coin --out {root}/plain --size 64x52 --led-count 6 --format diligent
    capture export {root}/sim --lights {lights} --format lp --out {root}/lp
    capture export {root}/sim --format exr --out {root}/exr
    capture export {root}/sim --lights {lights} --format alicevision --out {root}/alicevision
    calibrate intensities {root}/sim --lights {lights} --out {root}/card.json
    capture run {root}/grey --rig {root}/grey.toml --plan {root}/series.toml --skip-check
    calibrate sensor {root}/grey --out {root}/sensor
    simulate spheres --out {root}/spheres --size 320x256 --led-count 6 --exposure-us 9000
    calibrate spheres {root}/spheres --out {root}/lights.json
    run {root}/sim --lights {lights} --out {root}/run
    normals {root}/sim --lights {lights} --out {root}/normals --force
    detail separate {root}/normals --out {root}/parts
    detail combine {root}/parts/shape.exr {root}/parts/detail.exr --out {root}/back
    detail transfer {root}/normals {root}/normals --out {root}/transfer
    detail properties {root}/normals --out {root}/properties
    detail synthesize {root}/normals --size 60x60 --patch 12 --out {root}/sheet
    detail fill {root}/normals --patch 9 --holes {root}/holes.png --out {root}/filled
    detail superres {root}/normals --scale 2 --method bicubic --out {root}/large
    curvature {root}/normals --out {root}/curvature
    export {root}/normals --out {root}/rti
    relight {root}/rti/relight.ptm --light 0,1,1 --out {root}/above.png
    compare {root}/normals {root}/back --out {root}/compare
    project {root}/surface/surface.ply --out {root}/project
    rig snap --rig {root}/rig.toml --led 1 --out {root}/snap.tif
"""


def commands(root: Path) -> list[list[str]]:
    lights = root / "sim/derived/truth/lights.json"
    lines = [line.strip() for line in COMMANDS.format(root=root, lights=lights).split("\n")]
    return [["python", CUT_OFF] if line == "CUT OFF" else line.split() for line in lines if line]


@pytest.mark.slow
@pytest.mark.parametrize("kinds", ["link", "dangling hard pipe"])
@pytest.mark.timeout(900)
def test_no_writer_follows_planted_links(tmp_path: Path, kinds: str) -> None:
    root, victims = tmp_path / "root", tmp_path / "victims"
    root.mkdir()
    victims.mkdir()
    (root / "rig.toml").write_text(RIG, encoding="utf-8")
    (root / "plan.toml").write_text(PLAN, encoding="utf-8")
    (root / "grey.toml").write_text(GREY, encoding="utf-8")
    (root / "series.toml").write_text(SERIES, encoding="utf-8")
    holes = np.zeros((52, 64), np.bool_)
    holes[24:30, 30:36] = True
    write_mask(root / "holes.png", holes)
    program = Path(__file__).with_name("planting.py")
    done = subprocess.run(
        [sys.executable, program, root, victims, kinds, json.dumps(commands(root))],
        capture_output=True,
        text=True,
        check=False,
        timeout=800,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert [end for end in found["ended"] if end[1] != 0] == []
    assert found["followed"] == []
    assert found["unseen"] == []
    planted = len(found["planted"])
    assert planted > 400
    whole = {path.name for path in victims.iterdir() if path.read_bytes() == b"mine"}
    turns = kinds.split()
    victim = [turns[number % len(turns)] in ("link", "hard") for number in range(planted)]
    assert whole == {str(number) for number in range(planted) if victim[number]}
    assert list(victims.iterdir()) == [] or whole
    left = [path for path in root.rglob("*") if path.is_symlink() or path.is_fifo()]
    assert [*left, *root.rglob(".*")] == []
    for name in ("s", "cut", "sim", "imported"):
        found = verify_session(root / name)
        assert (found.problems, found.complete) == ((), True)
