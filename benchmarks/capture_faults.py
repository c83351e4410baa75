"""What an operator sees when disk, camera, board or clock fail: dark, one line, and resumable.

python benchmarks/capture_faults.py [--only NAME]

Each fault strikes `capture run` in a process of its own, on the simulated rig; then `capture
resume` finishes the session without it. Printed are the exit code, the error line the operator
gets, and how long before that line the last LED went out, from the bench state.

The full disk and the read-only one are file systems of their own, mounted in a user namespace that
this program enters first; where the system does not allow one, that is said and counts as failed.

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
from datetime import UTC, datetime, timedelta
from pathlib import Path

from capture_bench import (
    PLAN,
    bench_of,
    is_whole,
    last_light_ns,
    open_planes,
    open_state,
    wrong_frames,
)

from acquisition import Session, verify_session

NAMESPACE = "SGP_CAPTURE_FAULTS_NAMESPACE"
BENCH, SHOT = "bench: ", "frame: "
# The frame, command or write from which on things go wrong.
AT = 14
STALL_S = 1.5
TIMEOUT_S = 60.0

# Name: exit codes that are right, and a word that the line must hold.
FAULTS = {
    "disk full": ((3,), "No space left"),
    "disk read-only": ((3,), "Read-only file system"),
    "writer stalled": ((3,), "has taken no frame"),
    "camera unplugged": ((3,), "camera"),
    "board reset": ((3,), "LED board"),
    "board reset, retakes": ((0,), ""),
    "clock jump": ((0,), ""),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", choices=FAULTS)
    parser.add_argument("--child", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        child(*options.child)
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


def unmount(root):
    for path in root.glob("*/disk"):
        subprocess.run(["umount", str(path)], check=False, capture_output=True)


# ---------------------------------------------------------------- one fault


def strike(name, root):
    """Let a fault strike a recording, resume it, and return what is wrong."""
    codes, word = FAULTS[name]
    disk = root / "disk"
    disk.mkdir(parents=True)
    folder = disk / "session"
    on_disk = name.startswith("disk")
    if on_disk and os.environ[NAMESPACE] != "yes":
        print(f"{name}: not shown, this system allows no user namespace (unshare -rm)")
        return [f"{name} was not tried"]
    if on_disk:
        mount("-t", "tmpfs", "-o", f"size={'128k' if name == 'disk full' else '8m'}", "none", disk)
    if name == "disk read-only":
        # Linux makes nothing read-only that is being written: so it is found so on resuming.
        run("none", "run", folder, stop_at=AT)
        mount("-o", "remount,ro", disk)
        command = "resume"
    else:
        command = "run"
    code, line, dark_s, unclear = run(name, command, folder)
    frames = len(Session.open(folder).frames)
    dark = "" if code == 0 else "nothing was lit"
    if code and dark_s is not None:
        dark = f"dark {dark_s:.3f} s before the line"
    print(f"{name}: exit code {code}, {frames} frames whole, {dark or 'done'}\n  {line}")
    problems = list(unclear)
    if code not in codes:
        problems.append(f"exit code {code} instead of {codes[0]}")
    if word not in line:
        problems.append(f"the line does not say {word!r}")
    if code and dark_s is not None and dark_s < 0:
        problems.append("an LED burned on after the line")
    found = verify_session(folder)
    problems += found.problems
    if code == 0:
        return problems + ([] if is_whole(folder) else ["the session is not complete"])
    if found.complete or not 0 < frames < len(PLAN.shots()):
        problems.append(f"{frames} frames, complete: {found.complete}")
    if on_disk:
        mount("-o", "remount,rw,size=8m", disk)
    before = [frame.line for frame in Session.open(folder).frames]
    code, line, _, _ = run("none", "resume", folder)
    if code or not is_whole(folder):
        problems.append(f"resume ended with {code}: {line}")
    if [frame.line for frame in Session.open(folder).frames][: len(before)] != before:
        problems.append("resuming changed what was recorded")
    return problems + wrong_frames(folder)


def run(fault, command, folder, stop_at=None):
    """Run a command in a process that a fault strikes.

    Returns its exit code, its error line, how long before that the last light went out (None where
    none was lit), and what is wrong with its words. Notes that come earlier count for nothing: work
    goes on after them.
    """
    words = [sys.executable, __file__, "--child", fault, command, str(folder)]
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
                if frames == stop_at:
                    process.send_signal(signal.SIGINT)
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


# ---------------------------------------------------------------- inside the process that is struck


def child(fault, command, folder):
    """Run a command with a fault planted."""
    import sgp.commands.capture as capture
    from sgp.app import _group
    from sgp.app import run as front_door

    PLANTS.get(fault, lambda: None)()
    plan = PLAN.changed(retakes=3) if fault.endswith("retakes") else PLAN

    def opened(_):
        rig = open_planes()
        print(f"{BENCH}{bench_of(rig)}", file=sys.stderr, flush=True)
        return rig

    class Talk(capture.CaptureTalk):
        def on_frame(self, line, done, total):
            super().on_frame(line, done, total)
            print(f"{SHOT}{line.file}", file=sys.stderr, flush=True)

    capture.open_rig = opened
    capture.CaptureTalk = Talk
    capture.chosen_plan = lambda *_: (plan, ())
    sys.exit(front_door(_group("capture"), [command, folder, "--skip-check"]))


def stall():
    """From some write on, fsync does not come back."""
    import acquisition

    real, calls = os.fsync, [0]

    def fsync(descriptor):
        calls[0] += 1
        if calls[0] > 3 * AT:
            threading.Event().wait()
        real(descriptor)

    os.fsync = fsync
    sgp_record = acquisition.record
    import sgp.commands.capture as capture

    capture.record = lambda *words, **more: sgp_record(*words, **more, stall_s=STALL_S)


def unplug():
    """The camera is unplugged instead of exposing."""
    import simulator._simulated_rig as simulated

    class Unplugged(simulated.GentlCamera):
        def __init__(self, *words, **more):
            super().__init__(*words, **more)
            self.set_fault(AT, "unplug")

    simulated.GentlCamera = Unplugged


def reset():
    """The board restarts in the middle of a command."""
    import simulator._simulated_rig as simulated
    from simulator._board.faults import BoardFault

    class Restarting(simulated.VirtualBoard):
        def __init__(self, *words):
            super().__init__(*words)
            self.set_faults(BoardFault(kind="reset", verb="OFF", skip=AT + 2))

    simulated.VirtualBoard = Restarting


def jump():
    """The clock on the wall is wrong by another number of hours every time it is read."""
    import acquisition._session.writer as session_writer

    calls = [0]

    def now():
        calls[0] += 1
        return datetime.now(UTC) + timedelta(hours=(-1, 24, 0)[calls[0] % 3])

    real = session_writer.SessionWriter.create.__func__
    session_writer.SessionWriter.create = classmethod(
        lambda cls, folder, manifest: real(cls, folder, manifest, clock=now)
    )
    real_time = time.time
    time.time = lambda: real_time() + (-3600, 86400, 0)[calls[0] % 3]


PLANTS = {
    "writer stalled": stall,
    "camera unplugged": unplug,
    "board reset": reset,
    "board reset, retakes": reset,
    "clock jump": jump,
}


if __name__ == "__main__":
    main()
