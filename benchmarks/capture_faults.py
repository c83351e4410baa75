"""Check that recordings with a failing disk, camera, board or clock end dark and can be resumed.

python benchmarks/capture_faults.py [--only NAME]

Each fault is injected into `capture run` in a process of its own, on the simulated rig; then
`capture resume` completes the session without the fault. The program prints the exit code, the
error line that the operator sees, and the time between the end of the last light, from the bench
state, and that line.

The full disk and the read-only disks are separate file systems, mounted in a user namespace that
this program enters first. If the system does not allow a user namespace, this is reported and
counts as failed. Linux does not make a file system read-only while it has a file open for writing,
such as the journal. In the middle of a recording, the file system is therefore covered by a
read-only mount of itself, so that every new frame is refused.

Exit code 1 if a fault does not end as expected.
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

from capture_bench import PLAN, is_complete, last_light_ns, open_state, wrong_frames
from capture_struck import BENCH, FAULT_AT, SHOT

from acquisition import Session, verify_session

NAMESPACE = "SGP_CAPTURE_FAULTS_NAMESPACE"
STRUCK = Path(__file__).with_name("capture_struck.py")
TIMEOUT_S = 60.0

FIRST, MIDDLE, RESUMED = (
    "disk read-only at first",
    "disk read-only in the middle",
    "disk read-only on resuming",
)
# Name: expected exit code, and words that the error line must contain.
FAULTS = {
    "disk full": (3, "No space left"),
    FIRST: (3, "Read-only file system"),
    MIDDLE: (3, "Read-only file system"),
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
            problems = run_with_fault(name, root / name.replace(" ", "-").replace(",", ""))
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
    """Restart this program in a user namespace, which allows mounting, if the system permits it."""
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
    """Cover a file system with a read-only mount of itself, in one step."""
    same = disk.with_name("same")
    same.mkdir()
    mount("--bind", disk, same)
    mount("-o", "remount,bind,ro", same)
    mount("--bind", same, disk)
    subprocess.run(["umount", str(same)], check=True)


def repair(name, disk):
    """Make a disk writable again."""
    if name == MIDDLE:
        subprocess.run(["umount", str(disk)], check=True)
    elif name.startswith("disk"):
        mount("-o", "remount,rw,size=8m", disk)


def unmount(root):
    for path in root.glob("*/disk"):
        subprocess.run(["umount", "-R", str(path)], check=False, capture_output=True)


# ---------------------------------------------------------------- one fault


def run_with_fault(name, root):
    """Record with a fault, resume, and return one line for each problem."""
    disk = root / "disk"
    disk.mkdir(parents=True)
    folder = disk / "session"
    if name.startswith("disk"):
        if os.environ[NAMESPACE] != "yes":
            print(f"{name}: skipped, this system does not allow a user namespace (unshare -rm)")
            return [f"{name} was not tested"]
        size = "128k" if name == "disk full" else "8m"
        mount("-t", "tmpfs", "-o", f"size={size}{',ro' if name == FIRST else ''}", "none", disk)
    if name == RESUMED:
        run("none", "run", folder, at_frame=interrupt)
        mount("-o", "remount,ro", disk)
    end = run(
        name,
        "resume" if name == RESUMED else "run",
        folder,
        at_frame=(lambda _: cover(disk)) if name == MIDDLE else None,
    )
    return check_end(name, folder, *end) + check_resumed(name, disk, folder)


def check_end(name, folder, code, line, dark_s, unclear):
    """Print how a recording with a fault has ended, and return one line for each problem."""
    expected, words = FAULTS[name]
    frames = len(Session.open(folder).frames) if folder.exists() else 0
    dark = "no LED was on" if dark_s is None else f"dark {dark_s:.3f} s before the line"
    print(f"{name}: exit code {code}, {frames} frames intact, {dark if code else 'done'}\n  {line}")
    problems = list(unclear)
    if code != expected:
        problems.append(f"exit code {code} instead of {expected}")
    if words not in line:
        problems.append(f"the line does not contain {words!r}")
    # A resumed recording begins with a light, before it writes.
    if code and (dark_s is None) is not (name == FIRST):
        problems.append(f"last light {dark_s} s before the line")
    if code and dark_s is not None and dark_s < 0:
        problems.append("an LED was still on after the line")
    if name == FIRST:
        return problems + ([f"{folder} was created"] if folder.exists() else [])
    report = verify_session(folder)
    problems += report.problems
    if code and (report.complete or not 0 < frames < len(PLAN.shots())):
        problems.append(f"{frames} frames, complete: {report.complete}")
    return problems


def check_resumed(name, disk, folder):
    """Repair the fault, complete the session, and return one line for each problem."""
    repair(name, disk)
    before = [frame.line for frame in Session.open(folder).frames] if folder.exists() else []
    problems = []
    if FAULTS[name][0]:
        code, line, _, _ = run("none", "run" if name == FIRST else "resume", folder)
        if code:
            problems.append(f"resuming ended with {code}: {line}")
    if not is_complete(folder):
        problems.append("the session is not intact and complete")
    if [frame.line for frame in Session.open(folder).frames][: len(before)] != before:
        problems.append("resuming changed the recorded frames")
    return problems + wrong_frames(folder)


def interrupt(process):
    """Send SIGINT, as Ctrl-C does."""
    process.send_signal(signal.SIGINT)


def run(fault, command, folder, at_frame=None):
    """Run a command with a fault in a process; ``at_frame`` is called after some frames,
    while the recording waits.

    Returns the exit code, the error line, the time from the end of the last light to that line
    (None if no LED was on), and one line for each problem with the output. Earlier notes do not
    count, because the recording continues after them.
    """
    words = [sys.executable, str(STRUCK), fault, command, str(folder)]
    process = subprocess.Popen(
        words,
        stdin=subprocess.DEVNULL if at_frame is None else subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    watch = threading.Timer(TIMEOUT_S, process.kill)
    watch.start()
    lines, line_ns, state, path, frames = [], [], None, None, 0
    with process:
        for line in process.stderr:
            if line.startswith(BENCH):
                path = Path(line.removeprefix(BENCH).strip())
                state = open_state(path)
            elif line.startswith(SHOT):
                frames += 1
                if frames == FAULT_AT and at_frame is not None:
                    at_frame(process)
                    process.stdin.close()  # the recording continues
            else:
                line_ns.append(time.monotonic_ns())
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
            dark_s = (line_ns[lines.index(errors[-1])] - last_ns) / 1e9
        state.close()
    return code, (errors or lines or [""])[-1], dark_s, unclear


if __name__ == "__main__":
    main()
