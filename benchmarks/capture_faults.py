"""What an operator sees when disk, camera, board or clock fail: dark, one line, and resumable.

python benchmarks/capture_faults.py [--only NAME]

Each fault strikes `capture run` in a process of its own, on the simulated rig; then `capture
resume` finishes the session without it. Printed are the exit code, the error line the operator
gets, and how long before that line the last LED went out, from the bench state.

The full disk and the read-only ones are file systems of their own, mounted in a user namespace that
this program enters first; where the system does not allow one, that is said and counts as failed.
Linux makes no file system read-only that has a file open for writing, as the journal is: in the
midst of a recording a read-only mount of the same is laid over it, and what is opened from then on,
each new frame, is refused.

Exit code 1 where a fault does not end as it should.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from capture_bench import PLAN, is_whole, last_light_ns, open_state, wrong_frames
from capture_struck import BENCH, FAULT_AT, SHOT

from acquisition import Session, verify_session

NAMESPACE = "SGP_CAPTURE_FAULTS_NAMESPACE"
STRUCK = Path(__file__).with_name("capture_struck.py")
TIMEOUT_S = 60.0

FIRST, MIDST, RESUMED = (
    "disk read-only at first",
    "disk read-only in the midst",
    "disk read-only on resuming",
)
# Name: exit code that is right, and words that the line must hold.
FAULTS = {
    "disk full": (3, "No space left"),
    FIRST: (3, "Read-only file system"),
    MIDST: (3, "Read-only file system"),
    RESUMED: (3, "Read-only file system"),
    "writer stalled": (3, "no write has finished"),
    "camera unplugged": (3, "camera"),
    "board reset": (3, "LED board"),
    "board reset, retakes": (0, ""),
    "clock jump": (0, ""),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", choices=FAULTS)
    options = parser.parse_args()
    enter_namespace()
    root = Path(tempfile.mkdtemp(prefix="sgp-faults-"))
    bad = 0
    try:
        for name in [options.only] if options.only else FAULTS:
            problems = strike(name, root / name.replace(" ", "-").replace(",", ""))
            bad += bool(problems)
            for problem in problems:
                print(f"  WRONG: {problem}")
    finally:
        unmount(root)
        shutil.rmtree(root, ignore_errors=True)
    print("FAILED" if bad else "passed")
    sys.exit(bool(bad))


# ---------------------------------------------------------------- the disks


def enter_namespace():
    """Start anew inside a user namespace, where mounting is allowed, if the system lets us."""
    if NAMESPACE in os.environ:
        return
    os.environ[NAMESPACE] = "yes"
    probe = subprocess.run(["unshare", "-rm", "true"], capture_output=True, check=False)
    if probe.returncode == 0:
        sys.stdout.flush()
        os.execvp("unshare", ["unshare", "-rm", sys.executable, *sys.argv])
    os.environ[NAMESPACE] = "no"


def mount(*words):
    subprocess.run(["mount", *map(str, words)], check=True)


def cover(disk):
    """Lay a read-only mount of a file system over it, from one moment to the next."""
    same = disk.with_name("same")
    same.mkdir()
    mount("--bind", disk, same)
    mount("-o", "remount,bind,ro", same)
    mount("--bind", same, disk)
    subprocess.run(["umount", str(same)], check=True)


def mend(name, disk):
    """Make a disk good again."""
    if name == MIDST:
        subprocess.run(["umount", str(disk)], check=True)
    elif name.startswith("disk"):
        mount("-o", "remount,rw,size=8m", disk)


def unmount(root):
    for path in root.glob("*/disk"):
        subprocess.run(["umount", "-R", str(path)], check=False, capture_output=True)


# ---------------------------------------------------------------- one fault


def strike(name, root):
    """Let a fault strike a recording, resume it, and return what is wrong."""
    disk = root / "disk"
    disk.mkdir(parents=True)
    folder = disk / "session"
    if name.startswith("disk"):
        if os.environ[NAMESPACE] != "yes":
            print(f"{name}: not shown, this system allows no user namespace (unshare -rm)")
            return [f"{name} was not tried"]
        size = "128k" if name == "disk full" else "8m"
        mount("-t", "tmpfs", "-o", f"size={size}{',ro' if name == FIRST else ''}", "none", disk)
    if name == RESUMED:
        run("none", "run", folder, at_frame=interrupt)
        mount("-o", "remount,ro", disk)
    end = run(
        name,
        "resume" if name == RESUMED else "run",
        folder,
        at_frame=(lambda _: cover(disk)) if name == MIDST else None,
    )
    return told(name, folder, *end) + finished(name, disk, folder)


def told(name, folder, code, line, dark_s, unclear):
    """Print how a recording that a fault struck has ended, and return what is wrong with that."""
    right, words = FAULTS[name]
    frames = len(Session.open(folder).frames) if folder.exists() else 0
    dark = "nothing was lit" if dark_s is None else f"dark {dark_s:.3f} s before the line"
    print(f"{name}: exit code {code}, {frames} frames whole, {dark if code else 'done'}\n  {line}")
    problems = list(unclear)
    if code != right:
        problems.append(f"exit code {code} instead of {right}")
    if words not in line:
        problems.append(f"the line does not say {words!r}")
    if code and (dark_s is None) is not (name in (FIRST, RESUMED)):
        problems.append(f"last light {dark_s} s before the line")
    if code and dark_s is not None and dark_s < 0:
        problems.append("an LED burned on after the line")
    if name == FIRST:
        return problems + ([f"{folder} was made"] if folder.exists() else [])
    found = verify_session(folder)
    problems += found.problems
    if code and (found.complete or not 0 < frames < len(PLAN.shots())):
        problems.append(f"{frames} frames, complete: {found.complete}")
    return problems


def finished(name, disk, folder):
    """Mend the fault, go on, and return what is wrong with the session then."""
    mend(name, disk)
    before = [frame.line for frame in Session.open(folder).frames] if folder.exists() else []
    problems = []
    if FAULTS[name][0]:
        code, line, _, _ = run("none", "run" if name == FIRST else "resume", folder)
        if code:
            problems.append(f"going on ended with {code}: {line}")
    if not is_whole(folder):
        problems.append("the session is not whole and complete")
    if [frame.line for frame in Session.open(folder).frames][: len(before)] != before:
        problems.append("going on changed what was recorded")
    return problems + wrong_frames(folder)


def interrupt(process):
    """Press Ctrl-C."""
    process.send_signal(signal.SIGINT)


def run(fault, command, folder, at_frame=None):
    """Run a command in a process that a fault strikes; ``at_frame`` is done after some frames.

    Returns its exit code, its error line, how long before that the last light went out (None where
    none was lit), and what is wrong with its words. Notes that come earlier count for nothing: work
    goes on after them.
    """
    words = [sys.executable, str(STRUCK), fault, command, str(folder)]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    watch = threading.Timer(TIMEOUT_S, process.kill)
    watch.start()
    lines, told_ns, state, path, frames = [], [], None, None, 0
    with process:
        for line in process.stderr:
            if line.startswith(BENCH):
                path = Path(line.removeprefix(BENCH).strip())
                state = open_state(path)
            elif line.startswith(SHOT):
                frames += 1
                if frames == FAULT_AT and at_frame is not None:
                    at_frame(process)
            else:
                told_ns.append(time.monotonic_ns())
                lines.append(line.rstrip())
    watch.cancel()
    code = process.returncode
    unclear = [line for line in lines if "Traceback" in line or line.startswith("  File")]
    errors = [line for line in lines if line.startswith("error: ")]
    if code and len(errors) != 1:
        unclear.append(f"{len(errors)} error lines: {lines}")
    dark_s = None
    if state is not None:
        last_ns = last_light_ns(state, path)
        if errors and last_ns:
            dark_s = (told_ns[lines.index(errors[-1])] - last_ns) / 1e9
        state.close()
    return code, (errors or lines or [""])[-1], dark_s, unclear


if __name__ == "__main__":
    main()
