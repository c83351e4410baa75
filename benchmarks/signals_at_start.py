"""End commands by signals while numba compiles their code, and count how they end.

python benchmarks/signals_at_start.py [--signals 200] [--seed 0] [--keep FOLDER]

Each trial starts a command and sends SIGINT, SIGTERM or SIGHUP at a random moment between its start
and its usual end. The numba cache contains what the commands before it in the list have compiled,
so that each kernel is compiled in the trials of one command only. How a command may end:

clean       exit code 128 + the signal's number and one line on stderr that names the signal
no line     the same exit code without a line, or with more than one
killed      the signal's default action ended the process without a message
done        the command had already ended
FAULT       anything else: another exit code, SIGSEGV, SIGABRT
HANG        the command still ran five minutes after the signal

Every trial has a temporary folder of its own; files that are left there are counted as well.

Exit code 1 if a trial ended in FAULT or HANG.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from harness import command_line

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
PATIENCE_S = 300.0
KINDS = ("clean", "no line", "killed", "done", "FAULT", "HANG")
START = (
    "import signal\n"
    # A shell ignores these signals for background processes, and children inherit this.
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
    "import sgp\n"
)
RIG = """name = "small"
driver = "simulated"
leds = 4
[options]
width = 96
height = 80
"""


def program(*words):
    """Return the command line of ``sgp``, or of ``capture`` if that is the first word."""
    entry, rest = ("capture", words[1:]) if words[0] == "capture" else ("main", words)
    return [sys.executable, "-P", "-c", f"{START}sgp.{entry}()", *map(str, rest)]


def prepare(root):
    """Record and process a small scene; return the commands that will be interrupted."""
    session, normals, rig = root / "session", root / "normals", root / "rig.toml"
    rig.write_text(RIG)
    size = "--led-count", 6, "--size", "96x80"
    lights = "--lights", session / "derived" / "truth" / "lights.json"
    for words in (
        ("simulate", "coin", "--out", session, *size),
        ("normals", session, *lights, "--out", normals),
    ):
        subprocess.run(program(*words), check=True, stdout=subprocess.DEVNULL)
    return {
        "capture run": ("capture", "run", "--rig", rig),
        "sgp simulate": ("simulate", "coin", *size),
        "sgp detail separate": ("detail", "separate", normals),
        "sgp surface": ("surface", normals),
        "sgp normals": ("normals", session, *lights, "--method", "cauchy"),
        "sgp run": ("run", session, *lights),
    }


class Trial:
    """One run of a command with a copy of a cache, in a folder of its own."""

    def __init__(self, root, words, cache):
        self.folder = Path(tempfile.mkdtemp(dir=root))
        self.cache = shutil.copytree(cache, self.folder / "cache")
        self.errors = self.folder / "stderr"
        scratch = self.folder / "tmp"
        scratch.mkdir()
        out = self.folder / "out"
        # `capture run` takes its folder as an argument, the other commands as an option.
        words = (*words, out) if words[0] == "capture" else (*words, "--out", out)
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(self.cache),
            "TMPDIR": str(scratch),
            "PYTHONFAULTHANDLER": "1",
        }
        with self.errors.open("wb") as errors:
            self.process = subprocess.Popen(
                program(*words),
                stdout=subprocess.DEVNULL,
                stderr=errors,
                env=environment,
                cwd=self.folder,
                start_new_session=True,
            )

    def kind(self, number):
        """Wait until the command ends and return how it ended."""
        try:
            code = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            # The fault handler prints the stacks of all threads on this signal.
            self.process.send_signal(signal.SIGABRT)
            time.sleep(1)
            self.process.kill()
            self.process.wait()
            return "HANG"
        if code == 0:
            return "done"
        if code == -number:
            return "killed"
        if code != 128 + number:
            return "FAULT"
        said = [text for text in self.text().splitlines() if text.startswith("error: ")]
        traced = "Traceback" in self.text() or "Exception ignored" in self.text()
        return "clean" if len(said) == 1 and "stopped by" in said[0] and not traced else "no line"

    def text(self):
        return self.errors.read_text(errors="replace")

    def left(self):
        """Return what remains in the temporary folder after the board's process has ended."""
        ends_s = time.monotonic() + 3
        while (left := os.listdir(self.folder / "tmp")) and time.monotonic() < ends_s:
            time.sleep(0.05)
        return left


def main():
    parser = command_line(__doc__)
    parser.add_argument("--signals", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--keep", type=Path, help="folder for stderr of trials that did not end clean"
    )
    options = parser.parse_args()
    root = Path(tempfile.mkdtemp(prefix="sgp-signals-"))
    try:
        sys.exit(run(options, root))
    finally:
        shutil.rmtree(root, ignore_errors=True)


def run(options, root):
    draw = random.Random(options.seed)
    # With few signals, only the first commands are interrupted.
    commands = dict(list(prepare(root).items())[: options.signals])
    usual_s, caches = {}, {}
    cache = root / "empty"
    cache.mkdir()
    for name, words in commands.items():
        caches[name] = cache
        began_s = time.monotonic()
        trial = Trial(root, words, cache)
        if trial.process.wait(600) != 0:
            raise SystemExit(f"{name} fails without a signal:\n{trial.text()}")
        usual_s[name] = time.monotonic() - began_s
        cache = trial.cache
        print(f"{name}: {usual_s[name]:.1f} s with the kernels of those above", flush=True)
    table = {name: Counter() for name in commands}
    left = Counter()
    try:
        for turn in range(options.signals):
            name = list(commands)[turn % len(commands)]
            number = SIGNALS[(turn + turn // len(commands)) % len(SIGNALS)]
            after_s = draw.uniform(0.05, usual_s[name])
            trial = Trial(root, commands[name], caches[name])
            table[name][strike(trial, name, number, after_s, left, options.keep)] += 1
            if (turn + 1) % 20 == 0:
                print(f"{turn + 1} signals ...", flush=True)
    except KeyboardInterrupt:
        pass  # print the table of the trials so far
    print(f"\n{'':22}" + "".join(f"{kind:>9}" for kind in KINDS))
    for name, counts in table.items():
        print(f"{name:22}" + "".join(f"{counts[kind]:9}" for kind in KINDS))
    print("left in the temporary folders:", dict(left) or "nothing")
    return int(any(counts[kind] for counts in table.values() for kind in ("FAULT", "HANG")))


def strike(trial, name, number, after_s, left, keep):
    """Send a command a signal after a time, and return how the command ended."""
    time.sleep(after_s)
    trial.process.send_signal(number)
    kind = trial.kind(number)
    left.update(file.rpartition("-")[0] or file for file in trial.left())
    if kind not in ("clean", "done", "killed"):
        code = trial.process.returncode
        print(f"{name}, {number.name} after {after_s:.2f} s: {kind}, exit code {code}")
        print("\n".join(f"    {line}" for line in trial.text().splitlines()[-12:]))
        sys.stdout.flush()
        if keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{trial.folder.name}-{number.name}.txt").write_text(trial.text())
    shutil.rmtree(trial.folder, ignore_errors=True)
    return kind


if __name__ == "__main__":
    main()
