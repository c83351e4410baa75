"""Flip single bits of recorded sessions and check that `verify` names the file.

python benchmarks/capture_flips.py [--flips 1000] [--seed 0]

There are three sessions: complete; incomplete; incomplete with a torn last line. Bits are drawn
from frames, journal, session.toml and COMPLETE, each kind equally often. A flip in the torn line
itself may be reported as torn. All others must be reported as problems that name the file, and no
damaged pixel may be read.

Exit code 1 if a flip is not detected.
"""

import argparse
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from acquisition import CapturePlan, DataError, Labels, Session, verify_session
from acquisition.session import Manifest, SessionWriter

PLAN = CapturePlan(leds=tuple(range(36)), exposures_us=(5000.0,))
SIZE = (48, 64)
JOURNAL = "journal.jsonl"


def picture(index):
    return np.random.default_rng(index).integers(0, 4096, SIZE).astype(np.uint16)


def session(folder, kind):
    """Write a session of the plan, with only 20 frames if it must be incomplete."""
    camera = {"width": SIZE[1], "height": SIZE[0], "bit_depth": 12}
    manifest = Manifest.begin(
        folder,
        plan=PLAN,
        camera=camera,
        labels=Labels(operator="benchmark", object_name="noise", notes="two\nlines"),
    )
    with SessionWriter.create(folder, manifest) as writer:
        for index, shot in enumerate(writer.missing):
            if kind != "complete" and index == 20:
                break
            writer.write_frame(shot, picture(index))
        else:
            writer.write_event("checked", checks=[{"name": "disk", "state": "ok", "text": "room"}])
            writer.complete()
    if kind == "torn":
        path = folder / JOURNAL
        data = path.read_bytes()
        path.write_bytes(data[:-200])
    return folder


def named(folder, path, bit):
    """Flip a bit and return the outcome of verifying and reading: named, torn, missed or read."""
    data = path.read_bytes()
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    path.write_bytes(changed)
    try:
        found = verify_session(folder)
        if not any(str(path) in problem for problem in found.problems):
            cut_off = path.name == JOURNAL and bit // 8 > data.rfind(b"\n")
            torn = "line was interrupted"
            reported = any(torn in text and str(path) in text for text in map(str, found.warnings))
            return "torn" if cut_off and reported else "missed"
        return "read" if reads_wrong(folder) else "named"
    finally:
        path.write_bytes(data)


def reads_wrong(folder):
    """Return whether a frame can be read with wrong pixels."""
    order = {shot.key: index for index, shot in enumerate(PLAN.shots())}
    try:
        frames = Session.open(folder).frames
    except DataError:
        return False
    for frame in frames:
        try:
            pixels = frame.read()
        except DataError:
            continue
        if not np.array_equal(pixels, picture(order[frame.line.key])):
            return True
    return False


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--flips", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sgp-flips-") as root:
        kinds = ("complete", "incomplete", "torn")
        sys.exit(run(options, [session(Path(root) / kind, kind) for kind in kinds]))


def run(options, folders):
    dice = random.Random(options.seed)
    counts, bad = Counter(), 0
    # The frame whose line is torn does not count: it will be taken again.
    recorded = {folder: [f.path for f in Session.open(folder).frames] for folder in folders}
    for _ in range(options.flips):
        folder = dice.choice(folders)
        kinds = [folder / "session.toml", folder / JOURNAL, None]
        kinds += [folder / "COMPLETE"] if (folder / "COMPLETE").exists() else []
        path = dice.choice(kinds) or dice.choice(recorded[folder])
        bit = dice.randrange(8 * path.stat().st_size)
        outcome = named(folder, path, bit)
        name = "frames" if path.parent.name == "frames" else path.name
        counts[f"{folder.name:<11} {name:<13} {outcome}"] += 1
        if outcome in ("missed", "read"):
            bad += 1
            print(f"{path}: bit {bit} was {outcome}")
    for line, count in sorted(counts.items()):
        print(f"{line:<34} {count:>5}")
    print(f"{options.flips} flips, {bad} not detected: {'FAILED' if bad else 'passed'}")
    return bool(bad)


if __name__ == "__main__":
    main()
