"""A batch on a Dask cluster of two workers on loopback: results, failures, and what is done again.

Sessions with noise of their own are processed by `sgp batch` here and on the cluster; all maps,
pictures and meshes have to be equal, byte by byte. Then nothing is changed, a worker is killed in
the middle of a batch, files are touched, sessions are compacted, one is replaced, one is damaged,
and the scheduler is stopped. Each line has the figures, and WRONG if they are not as they have to
be; the exit code is then 1. Small images make the work short, so that the time beyond the work is a
larger share of it than with those of a camera.

    python benchmarks/batch_cluster.py --sessions 24 --megapixels 0.1
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from harness import command_line
from stereo_costs import dome, session
from whole_commands import files_in

from acquisition import Lights

SGP = [sys.executable, "-m", "sgp"]
_KINDS = (".exr", ".png", ".ply")
_POLL_S = 0.05


@dataclass
class Verdicts:
    """Print what was found, and count what is wrong."""

    wrong: int = 0

    def add(self, name: str, text: str, *, good: bool) -> None:
        self.wrong += not good
        print(f"{name:34}{text}{'' if good else '   WRONG'}", flush=True)


@dataclass
class Cluster:
    """A scheduler and its workers, by their process numbers."""

    address: str
    scheduler: int
    workers: list[int]

    def cpu_s(self) -> float:
        """Return the CPU seconds of these processes so far."""
        return sum(_cpu_s(pid) for pid in (self.scheduler, *self.workers))


@contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    """Run a scheduler and two workers with one thread each on loopback."""
    file = folder / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    here = ["--host", "127.0.0.1", "--no-dashboard"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    words = [*dask, "scheduler", "--port", "0", "--scheduler-file", str(file), *here]
    running = [subprocess.Popen(words, **quiet)]
    try:
        while not file.exists():
            time.sleep(_POLL_S)
        address = json.loads(file.read_text())["address"]
        one = [*dask, "worker", address, "--nthreads", "1", *here]
        running += [subprocess.Popen(one, **quiet) for _ in range(2)]
        from distributed import Client

        with Client(address) as client:
            client.wait_for_workers(2, timeout=300)
            workers = list(client.run(os.getpid).values())
        yield Cluster(address, running[0].pid, workers)
    finally:
        for process in running[::-1]:
            process.terminate()
            process.wait()


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def record(folder: Path, megapixels: float, seed: int) -> None:
    """Record a session of 36 images."""
    side = round((megapixels * 1e6) ** 0.5)
    session(folder, Lights(directions=dome(36)), side, gloss=True, seed=seed)


def sessions(root: Path, megapixels: float, count: int) -> list[Path]:
    """Record sessions, each with noise of its own."""
    folders = [root / f"s{i:02}" for i in range(count)]
    for seed, folder in enumerate(folders):
        record(folder, megapixels, seed)
    (root / "recipe.toml").write_text('[run]\nlights = "s00.json"\nmask = "s00.png"\n')
    return folders


@dataclass
class Answer:
    """What a batch said and cost."""

    code: int
    errors: str
    wall_s: float
    cpu_s: float
    rows: dict[str, dict[str, str]]
    computed: int

    @property
    def done(self) -> int:
        return sum(row["status"] == "done" for row in self.rows.values())

    @property
    def work_s(self) -> float:
        return sum(float(row["cpu_seconds"]) for row in self.rows.values())


def batch(words: list[str], out: Path, kill: int | None = None) -> Answer:
    """Run a batch; kill a process of the cluster when the first source is done."""
    before, begun = os.times(), time.perf_counter()
    command = [*SGP, "batch", *words, "--out", str(out), "--json"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        if kill is not None:
            while run.poll() is None and not any(out.glob("state/*.json")):
                time.sleep(_POLL_S)
            os.kill(kill, signal.SIGKILL)
        printed, errors = run.communicate()
    wall, spent = time.perf_counter() - begun, os.times()
    cpu = spent.children_user + spent.children_system
    cpu -= before.children_user + before.children_system
    rows = {}
    if (out / "batch.csv").exists():
        with (out / "batch.csv").open(newline="") as file:
            rows = {row["name"]: row for row in csv.DictReader(file)}
    computed = json.loads(printed)["metrics"]["computed"] if run.returncode in (0, 4) else 0
    return Answer(run.returncode, errors, wall, cpu, rows, computed)


def equal(one: Path, other: Path) -> tuple[int, int]:
    """Return how many maps, pictures and meshes of two batches are equal, and their number."""
    found = [path.relative_to(one) for path in files_in(one) if path.suffix in _KINDS]
    same = sum(
        (other / path).is_file() and (one / path).read_bytes() == (other / path).read_bytes()
        for path in found
    )
    return same, len(found)


def check(root: Path, megapixels: float, count: int) -> int:
    """Run everything; return how many verdicts are wrong."""
    verdicts, folders = Verdicts(), sessions(root, megapixels, count)
    asked = [*map(str, folders), "--recipe", str(root / "recipe.toml")]
    here, there, lost = root / "here", root / "there", root / "lost"
    local = batch([*asked, "--workers", "2"], here)
    verdicts.add(
        "here, two workers",
        f"{local.done} of {count} done, work {local.work_s / count:.2f} CPU s each, "
        f"{local.wall_s:.0f} s",
        good=local.code == 0 and local.done == count,
    )
    with cluster(root) as found:
        away = [*asked, "--scheduler", found.address]
        # Both workers load their libraries.
        batch([*map(str, folders[:2]), *away[count:]], root / "warm")
        before = found.cpu_s()
        answer = batch(away, there)
        workers = found.cpu_s() - before
        same, of_all = equal(here, there)
        verdicts.add(
            "Dask, two workers",
            f"{answer.done} of {count} done, {same} of {of_all} files equal, {answer.wall_s:.0f} s",
            good=answer.code == 0 and answer.done == count and same == of_all > 0,
        )
        beyond = (answer.cpu_s + workers - answer.work_s) / count
        print(
            f"{'  beyond the work, each':34}{1e3 * beyond:.0f} CPU ms of "
            f"{answer.work_s / count:.2f} CPU s: {beyond * count / answer.work_s:.1%}"
        )
        again = batch(away, there)
        verdicts.add(
            "the same again",
            f"{again.computed} computed, {again.wall_s:.1f} s, {again.cpu_s:.1f} CPU s",
            good=again.code == 0 and again.computed == 0,
        )
        killed = batch(away, lost, kill=found.workers[0])
        same, of_all = equal(here, lost)
        verdicts.add(
            "one of two workers is killed",
            f"{killed.done} of {count} done, {same} of {of_all} files equal",
            good=killed.code == 0 and killed.done == count and same == of_all,
        )
        changes(verdicts, folders, away, there, megapixels)
    unreachable(verdicts, away, root / "none")
    return verdicts.wrong


def changes(
    verdicts: Verdicts, folders: list[Path], away: list[str], out: Path, megapixels: float
) -> None:
    """Touch, compact, replace and damage sessions; report what is computed again."""
    for frame in (folders[1] / "frames").iterdir():
        os.utime(frame)
    touched = batch(away, out)
    verdicts.add(
        "all frames of one touched",
        f"{touched.computed} computed, {touched.wall_s:.1f} s",
        good=touched.code == 0 and touched.computed == 0,
    )
    for folder in folders[2:4]:
        command = [*SGP, "capture", "compact", str(folder)]
        subprocess.run(command, check=True, capture_output=True)
    compacted = batch(away, out)
    verdicts.add(
        "two sessions compacted",
        f"{compacted.computed} computed, {compacted.wall_s:.1f} s",
        good=compacted.code == 0 and compacted.computed == 0,
    )
    shutil.rmtree(folders[4])
    record(folders[4], megapixels, seed=10_000)
    other = batch(away, out)
    verdicts.add(
        "one recorded again",
        f"{other.computed} computed",
        good=other.code == 0 and other.computed == 1 and f"{folders[4].name}: c" in other.errors,
    )
    frame = sorted((folders[5] / "frames").iterdir())[3]
    frame.write_bytes(frame.read_bytes()[: frame.stat().st_size // 2])
    damaged = batch(away, out)
    row = damaged.rows[folders[5].name]
    verdicts.add(
        "one frame cut short",
        f"exit code {damaged.code}, {damaged.computed} computed, {damaged.done} done",
        good=damaged.code == 4
        and damaged.computed == 1
        and damaged.done == len(folders) - 1
        and row["status"] == "failed",
    )


def unreachable(verdicts: Verdicts, away: list[str], out: Path) -> None:
    """Name a scheduler that no longer exists."""
    answer = batch(away, out)
    lines = answer.errors.splitlines()
    verdicts.add(
        "the scheduler is gone",
        f"exit code {answer.code}, {answer.wall_s:.1f} s: {lines[-1] if lines else ''}",
        good=answer.code == 3 and len(lines) == 1,
    )


def main() -> None:
    """Print the table."""
    parser = command_line(__doc__)
    parser.add_argument("--sessions", type=int, default=24, help="at least 6")
    parser.add_argument("--megapixels", type=float, default=0.1, help="of an image")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sgp-cluster-") as name:
        wrong = check(Path(name), options.megapixels, options.sessions)
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
