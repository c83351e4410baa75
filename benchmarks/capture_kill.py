"""Kill the recording process at random moments, check the session that is left, and resume it.

36 lights and a dark frame on the simulated rig, small frames, noise off, 2 ms exposures; triggered
by software, by the board and in a sequence in turn. For each kill this program checks that every
journal line and every frame that was reported as safe still exists; that every frame that counts
has the pixels of its LED, computed here and rounded; that the session verifies before and after
`resume`; that it is complete afterwards; and when the last LED turned off, from the bench state.

Exit code 1 if any of these checks fails.
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
    LABELS,
    MODES,
    PLAN,
    bench_of,
    ended,
    forked,
    is_complete,
    last_light_ns,
    open_planes,
    open_state,
    plan_for,
    wait_for,
    wrong_frames,
)
from harness import busy, busy_option, command_line

from acquisition import RecordingHooks, Session, record, resume, verify_session

MOST_DARK_S = 1.0


def recording(folder, mode, camera):
    """Return a recording that writes its bench state to a file, and then the name of each frame."""

    def work():
        safe = os.open(folder.with_suffix(".safe"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        with open_planes(mode, camera=camera) as rig:
            started = folder.with_suffix(".started")
            part = started.with_suffix(".part")
            part.write_text(json.dumps(str(bench_of(rig))))
            part.rename(started)
            record(
                rig,
                plan_for(mode),
                folder,
                LABELS,
                hooks=RecordingHooks(
                    on_frame=lambda line: os.write(safe, f"{line.file}\n".encode())
                ),
            )

    return work


def resuming(folder, mode, camera):
    def work():
        with open_planes(mode, camera=camera) as rig:
            resume(rig, folder)

    return work


def main():
    parser = command_line(__doc__)
    parser.add_argument("--kills", type=int, default=200, help="number of recordings to kill")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random moments")
    parser.add_argument(
        "--camera", default="auto", choices=("auto", "gentl", "inside"), help="virtual camera"
    )
    busy_option(parser)
    options = parser.parse_args()
    root = Path(tempfile.mkdtemp(prefix="sgp-kill-"))
    # Killed processes cannot remove the files of their virtual cameras.
    os.environ["TMPDIR"] = tempfile.tempdir = str(root)
    try:
        with busy(options.busy):
            sys.exit(run(options, root))
    finally:
        shutil.rmtree(root, ignore_errors=True)


def run(options, root):
    took_s = {}
    # The first recording fills caches.
    for number, mode in enumerate((MODES[0], *MODES)):
        folder = root / f"whole{number}"
        pid = forked(recording(folder, mode, options.camera))
        wait_for(folder.with_suffix(".started"))
        began = time.monotonic()
        if ended(pid) or not is_complete(folder) or wrong_frames(folder):
            raise SystemExit(f"a recording without a kill ({mode}) is not correct")
        took_s[mode] = time.monotonic() - began
    times = ", ".join(f"{mode} {seconds:.2f} s" for mode, seconds in took_s.items())
    print(f"{len(PLAN.shots())} frames without a kill: {times}")
    dice = random.Random(options.seed)
    counts = {"frames": 0, "lost": 0, "wrong": 0, "damaged": 0, "ended before": 0, "no session": 0}
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
        f"pixels: {counts['wrong']}, sessions damaged or incomplete before or after resuming: "
        f"{counts['damaged']}\n"
        f"LEDs off after a kill: at most {max(dark_s):.3f} s, median {median(dark_s):.3f} s"
    )
    bad = counts["lost"] or counts["wrong"] or counts["damaged"] or max(dark_s) > MOST_DARK_S
    print("FAILED" if bad else "passed")
    return bool(bad)


def one(folder, mode, camera, after_s, counts, dark_s, missing):
    """Kill one recording, resume it, and return one line for each problem."""
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
        if not is_complete(folder):
            counts["damaged"] += 1
            problems.append("does not verify as complete")
        problems += wrong
    else:
        counts["no session"] += 1
    dark_s.append(max(0.0, (last_light_ns(state, path) - killed_ns) / 1e9))
    state.close()
    if dark_s[-1] > MOST_DARK_S:
        problems.append(f"an LED was on for {dark_s[-1]:.3f} s after the kill")
    return problems


def left_behind(folder, counts, missing):
    """Check a session whose writer was killed."""
    report = verify_session(folder)
    problems = list(report.problems)
    counts["damaged"] += bool(problems)
    session = Session.open(folder)
    recorded = {frame.line.file for frame in session.frames}
    counts["frames"] += len(recorded)
    missing.append(len(session.missing))
    list_of_safe = folder.with_suffix(".safe")
    safe = list_of_safe.read_text().splitlines() if list_of_safe.exists() else []
    lost = [file for file in safe if file not in recorded]
    counts["lost"] += len(lost)
    wrong = wrong_frames(folder)
    counts["wrong"] += len(wrong)
    return [*problems, *wrong, *(f"{file} was reported as safe and is lost" for file in lost)]


def lines(folder):
    """Return the frame lines of the journal, unparsed."""
    path = folder / "journal.jsonl"
    data = path.read_bytes() if path.exists() else b""  # killed before the first line
    return [
        line
        for line in data.splitlines()
        if line.startswith(b'{"kind":"frame"') and line.endswith(b"}")
    ]


if __name__ == "__main__":
    main()
