"""Kill the recording process at random moments, look at what is left, and resume.

36 lights and a dark frame on the simulated rig, small frames, noise off, 2 ms exposures; triggered
by software, by the board and in a sequence in turn. For each kill: every line that was in the
journal, and every frame that had been reported, is there afterwards; everything that counts has the
pixels that its LED gives, worked out here and rounded; the session verifies, before and after
`resume`; after it, it is complete; and the bench state says when the last LED went out.

Exit code 1 where any of this fails.
"""

import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from capture_bench import (
    MODES,
    PLAN,
    TOLD,
    bench_of,
    ended,
    forked,
    is_whole,
    last_light_ns,
    open_planes,
    open_state,
    plan_for,
    wait_for,
    wrong_frames,
)
from harness import busy, busy_option, command_line

from acquisition import Session, record, resume, verify_session

MOST_DARK_S = 1.0


def recording(folder, mode, camera):
    """Return a recording that tells its bench state when the rig is open, and each safe frame."""

    def work():
        told = os.open(folder.with_suffix(".told"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        with open_planes(mode, camera=camera) as rig:
            started = folder.with_suffix(".started")
            part = started.with_suffix(".part")
            part.write_text(json.dumps(str(bench_of(rig))))
            part.rename(started)
            record(
                rig,
                plan_for(mode),
                folder,
                **TOLD,
                on_frame=lambda line: os.write(told, f"{line.file}\n".encode()),
            )

    return work


def resuming(folder, mode, camera):
    def work():
        with open_planes(mode, camera=camera) as rig:
            resume(rig, folder)

    return work


def main():
    parser = command_line(__doc__)
    parser.add_argument("--kills", type=int, default=200, help="recordings that are killed")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument(
        "--camera", default="auto", choices=("auto", "gentl", "inside"), help="which virtual one"
    )
    busy_option(parser)
    options = parser.parse_args()
    root = Path(tempfile.mkdtemp(prefix="sgp-kill-"))
    # Processes that are killed cannot clear up their virtual cameras.
    os.environ["TMPDIR"] = tempfile.tempdir = str(root)
    try:
        with busy(options.busy):
            sys.exit(run(options, root))
    finally:
        shutil.rmtree(root, ignore_errors=True)


def run(options, root):
    took_s = {}
    # The first one fills caches.
    for number, mode in enumerate((MODES[0], *MODES)):
        folder = root / f"whole{number}"
        pid = forked(recording(folder, mode, options.camera))
        wait_for(folder.with_suffix(".started"))
        began = time.monotonic()
        if ended(pid) or not is_whole(folder) or wrong_frames(folder):
            raise SystemExit(f"a recording that nobody kills ({mode}) is not right")
        took_s[mode] = time.monotonic() - began
    times = ", ".join(f"{mode} {seconds:.2f} s" for mode, seconds in took_s.items())
    print(f"{len(PLAN.shots())} frames if nobody kills: {times}")
    dice = random.Random(options.seed)
    counts = {"frames": 0, "lost": 0, "wrong": 0, "unwhole": 0, "ended before": 0, "no session": 0}
    dark_s, missing = [], []
    for number in range(options.kills):
        folder = root / f"k{number}"
        mode = MODES[number % len(MODES)]
        after_s = dice.uniform(0, took_s[mode])
        problems = one(folder, mode, options.camera, after_s, counts, dark_s, missing)
        for problem in problems:
            print(f"kill {number} ({mode}): {problem}")
        for path in root.glob(f"k{number}*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if number % 20 == 19:
            print(f"{number + 1} kills ...", flush=True)
    print(
        f"{options.kills} kills, {counts['ended before']} after the end, {counts['no session']} "
        f"before the session began; missing shots after a kill: {min(missing, default=0)} to "
        f"{max(missing, default=0)}\n"
        f"journalled frames: {counts['frames']}, lost: {counts['lost']}, accepted with wrong "
        f"pixels: {counts['wrong']}, sessions not whole before or after resuming: "
        f"{counts['unwhole']}\n"
        f"LEDs off after a kill: at most {max(dark_s):.3f} s, median {median(dark_s):.3f} s"
    )
    bad = counts["lost"] or counts["wrong"] or counts["unwhole"] or max(dark_s) > MOST_DARK_S
    print("FAILED" if bad else "passed")
    return bool(bad)


def one(folder, mode, camera, after_s, counts, dark_s, missing):
    """Kill one recording, resume it, and return what is wrong, one line each."""
    pid = forked(recording(folder, mode, camera))
    path = Path(wait_for(folder.with_suffix(".started")))
    state = open_state(path)
    time.sleep(after_s)
    os.kill(pid, signal.SIGKILL)
    killed_ns = time.monotonic_ns()
    counts["ended before"] += ended(pid) != -signal.SIGKILL
    problems = []
    if (folder / "session.toml").exists():
        problems += left_behind(folder, counts, missing)
        complete = Session.open(folder).complete
        before = [] if complete else lines(folder)
        if not complete and ended(forked(resuming(folder, mode, camera))):
            problems.append("could not be resumed")
        lost = [line for line in before if line not in lines(folder)]
        counts["lost"] += len(lost)
        problems += [f"line lost by resuming: {line[:80]}" for line in lost]
        wrong = wrong_frames(folder)
        counts["wrong"] += len(wrong)
        if not is_whole(folder):
            counts["unwhole"] += 1
            problems.append("does not verify as complete")
        problems += wrong
    else:
        counts["no session"] += 1
    dark_s.append(max(0.0, (last_light_ns(state, path) - killed_ns) / 1e9))
    state.close()
    if dark_s[-1] > MOST_DARK_S:
        problems.append(f"an LED burned for {dark_s[-1]:.3f} s after the kill")
    return problems


def left_behind(folder, counts, missing):
    """Judge a session whose writer was killed."""
    found = verify_session(folder)
    problems = list(found.problems)
    counts["unwhole"] += bool(problems)
    session = Session.open(folder)
    recorded = {frame.line.file for frame in session.frames}
    counts["frames"] += len(recorded)
    missing.append(len(session.missing))
    told = folder.with_suffix(".told")
    safe = told.read_text().splitlines() if told.exists() else []
    lost = [file for file in safe if file not in recorded]
    counts["lost"] += len(lost)
    wrong = wrong_frames(folder)
    counts["wrong"] += len(wrong)
    return [*problems, *wrong, *(f"{file} was reported as safe and is lost" for file in lost)]


def lines(folder):
    """Return the journal's frame lines as they stand there."""
    path = folder / "journal.jsonl"
    data = path.read_bytes() if path.exists() else b""  # killed before the first line
    return [
        line
        for line in data.splitlines()
        if line.startswith(b'{"kind":"frame"') and line.endswith(b"}")
    ]


if __name__ == "__main__":
    main()
