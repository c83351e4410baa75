"""Damage files and check that every reader refuses them as declared, quickly, in little memory.

python benchmarks/fuzz_readers.py [--files 10000] [--seed 0] [--only image,mesh] [--case image/17]

Every reader of files from other people gets files with flipped bits, numbers that are often
mishandled, deep nesting, and pieces that are cut out, repeated and swapped. Each file is read in a
forked process, so that a crash is detected and does no harm. A file is read well if it is accepted,
or refused with an error that the reader declares, without a warning, in less than 5 s of processor
time and with less than 1 GB of additional memory.

A case is named by reader and number, and depends only on these and the seed: `--case image/17`
creates its file again, keeps it under `--keep` and reads it in this process, with a stack trace.

Exit code 1 if a file was read badly.
"""

from __future__ import annotations

import os

# Threads do not survive a fork. This must be set before a library that starts threads is loaded.
os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
os.environ["NUMBA_THREADING_LAYER"] = "workqueue"

import argparse
import gc
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import cv2
import OpenImageIO as oiio  # noqa: N813 - its own name for itself
from fuzz_seeds import Seed, drawn, seeds

from acquisition import (
    DataError,
    MissingPathError,
    Session,
    Source,
    read_camera,
    read_image,
    read_lights,
    read_mask,
    read_plan,
    read_source,
    verify_session,
)
from acquisition.imports import read_import
from acquisition.imports.image import read_for_import
from acquisition.pixels import image_facts, read_raw
from acquisition.pixels.icc_curve import icc_curve
from acquisition.value_files import read_flat, read_sensor, read_transfer
from processing import read_geometry, read_normals
from processing.relight import read_ptm
from processing.surface import read_x3p
from rig import RigConfigError, UnreadableError, read_rig_config
from simulator import read_scene
from simulator.shapes import MeshBody

SECONDS = 5.0
MEGABYTES = 1000
# The wall time may be longer if the machine is busy.
_PATIENCE_S = 20.0
# Limit of the address space, so that a reader cannot take all memory of the machine.
_ADDRESSES = 6 << 30


def _session(path: Path) -> None:
    verify_session(path)
    session = Session.open(path)
    for frame in session.frames:
        frame.read()
    _ = (session.lights, session.camera_model, session.sensor)


def _all_of(source: Source) -> None:
    for frame in source.frames:
        frame.read()


def _source(path: Path) -> None:
    _all_of(read_source(path))


def _import(path: Path) -> None:
    _all_of(read_import(path))


@dataclass(frozen=True)
class Reader:
    """A reader, the kind of seed it takes, and the errors it declares."""

    read: Callable[[Path], object]
    kind: str
    declared: tuple[type[Exception], ...] = (DataError, MissingPathError)


READERS: dict[str, Reader] = {
    "image": Reader(read_image, "image"),
    "import": Reader(read_for_import, "image"),
    "facts": Reader(image_facts, "image"),
    "raw-facts": Reader(image_facts, "raw"),
    "icc": Reader(lambda path: icc_curve(path.read_bytes()), "icc", (UnreadableError,)),
    "transfer": Reader(read_transfer, "transfer"),
    "mask": Reader(read_mask, "mask"),
    "raw": Reader(read_for_import, "raw"),
    "raw-pixels": Reader(read_raw, "raw"),
    "lights": Reader(read_lights, "lights"),
    "camera": Reader(lambda path: read_camera(path, (24, 32)), "camera"),
    "sensor": Reader(read_sensor, "sensor"),
    "flat": Reader(read_flat, "flat"),
    "plan": Reader(lambda path: read_plan(path).shots(), "plan"),
    "rig": Reader(read_rig_config, "rig", (RigConfigError,)),
    "scene": Reader(read_scene, "scene"),
    "normals": Reader(read_normals, "normals"),
    "ptm": Reader(read_ptm, "ptm"),
    "x3p": Reader(read_x3p, "x3p"),
    "mesh": Reader(read_geometry, "mesh"),
    "scene-mesh": Reader(lambda path: MeshBody.read(path, radius_mm=20), "mesh"),
    "diligent": Reader(_source, "diligent"),
    "stack": Reader(_import, "stack"),
    "session": Reader(_session, "session"),
    "session-source": Reader(_source, "session"),
    "export": Reader(_source, "export"),
}


@dataclass(frozen=True)
class Case:
    """One damaged file: its reader and number, the seed, the damaged file's name and content."""

    reader: str
    number: int
    seed: Seed
    target: str
    data: bytes

    @property
    def name(self) -> str:
        return f"{self.reader}/{self.number}"


@dataclass(frozen=True)
class Outcome:
    """Result of reading: ``read``, ``refused`` or a kind of failure; its cost; the message."""

    verdict: str
    seconds: float
    megabytes: float
    words: str = ""

    @property
    def bad(self) -> bool:
        return self.verdict not in ("read", "refused")


@dataclass
class Tally:
    """Results of one reader."""

    verdicts: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    megabytes: float = 0.0

    def add(self, outcome: Outcome) -> None:
        self.verdicts[outcome.verdict] += 1
        self.seconds = max(self.seconds, outcome.seconds)
        self.megabytes = max(self.megabytes, outcome.megabytes)


class Place:
    """A folder with the files of every seed, one of which is damaged at a time."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._written: set[Path] = set()

    def write(self, case: Case) -> Path:
        """Write the files of a case; return the path for the reader."""
        folder = self._root / case.reader / case.seed.name
        for name, data in case.seed.files.items() if folder not in self._written else ():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        self._written.add(folder)
        (folder / case.target).write_bytes(case.data)
        return folder / case.seed.entry

    def clean(self, case: Case) -> None:
        """Restore the undamaged file."""
        folder = self._root / case.reader / case.seed.name
        (folder / case.target).write_bytes(case.seed.files[case.target])


def case_of(by_kind: dict[str, list[Seed]], seed: int, reader: str, number: int) -> Case:
    """Create a case; the same seed, reader and number give the same file."""
    dice = Random(f"{seed} {reader} {number}")
    undamaged = dice.choice(by_kind[READERS[reader].kind])
    target, data = drawn(undamaged, dice)
    return Case(reader, number, undamaged, target, data)


def in_child(reader: Reader, path: Path) -> Outcome:
    """Read a file in a forked process."""
    receive, send = os.pipe()
    begun = time.monotonic()
    child = os.fork()
    if not child:
        os.close(receive)
        _child(reader, path, send)
    os.close(send)
    words = b""
    late = False
    while True:
        left = _PATIENCE_S - (time.monotonic() - begun)
        if not select.select([receive], [], [], max(left, 0))[0]:
            late = True
            os.kill(child, signal.SIGKILL)
            break
        piece = os.read(receive, 65536)
        if not piece:
            break
        words += piece
    os.close(receive)
    _, status, usage = os.wait4(child, 0)
    seconds = usage.ru_utime + usage.ru_stime
    before_kb, _, answer = words.decode("utf-8", "replace").partition("\n")
    megabytes = max(0, usage.ru_maxrss - int(before_kb or 0)) / 1000
    verdict, _, said = answer.partition("\n")
    if late or os.WIFSIGNALED(status) or verdict == "":
        code = os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)
        slow = late or code == signal.SIGXCPU
        verdict, said = ("slow", "") if slow else ("crashed", f"ended by {code}")
    elif verdict in ("read", "refused") and seconds > SECONDS:
        verdict = "slow"
    elif verdict in ("read", "refused") and megabytes > MEGABYTES:
        verdict = "large"
    return Outcome(verdict, seconds, megabytes, said)


def _child(reader: Reader, path: Path, send: int) -> None:
    try:
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        # Less than that of the parent, because library pages count only when they are used again.
        os.write(send, f"{_resident_kb()}\n".encode())
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS) * 2, int(SECONDS) * 2 + 1))
        size = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * 4096
        resource.setrlimit(resource.RLIMIT_AS, (size + _ADDRESSES, size + _ADDRESSES))
        try:
            reader.read(path)
            answer = "read\n"
        except reader.declared as error:
            answer = "refused\n" if "\n" not in str(error) else f"undeclared\nlines: {error}"
        except BaseException as error:  # noqa: BLE001 - undeclared errors are what this program searches for
            where = traceback.extract_tb(error.__traceback__)
            place = next(
                (f for f in reversed(where) if "site-packages" not in f.filename), where[-1]
            )
            answer = (
                f"undeclared\n{type(error).__name__}: {str(error)[:150]!r} at "
                f"{Path(place.filename).name}:{place.lineno}"
            )
        os.write(send, answer.encode("utf-8", "replace")[:4000])
    finally:
        os._exit(0)


def _resident_kb() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4


def again(case: Case, keep: Path) -> int:
    """Read one case in this process, with a stack trace."""
    path = Place(keep).write(case)
    print(f"{case.name}: {case.seed.name}, {case.target}, {len(case.data)} bytes, in {path}")
    try:
        print("read:", repr(READERS[case.reader].read(path))[:200])
    except READERS[case.reader].declared as error:
        print("refused:", error)
    return 0


def run(names: list[str], files: int, seed: int) -> int:
    """Read the given number of damaged files; print a table and the files that were read badly."""
    by_kind = seeds()
    tallies = {name: Tally() for name in names}
    bad: list[tuple[Case, Outcome]] = []
    with tempfile.TemporaryDirectory(prefix="sgp-fuzz-", dir=_fast()) as root:
        place = Place(Path(root))
        _warm(names, by_kind, place)
        gc.freeze()  # memory that the children do not touch stays shared
        for index in range(files):
            name = names[index % len(names)]
            case = case_of(by_kind, seed, name, index // len(names))
            outcome = in_child(READERS[name], place.write(case))
            place.clean(case)
            tallies[name].add(outcome)
            if outcome.bad:
                bad.append((case, outcome))
            if (index + 1) % 1000 == 0:
                print(f"{index + 1} files, {len(bad)} read badly", file=sys.stderr, flush=True)
    _print(tallies, bad)
    print(f"{files} files, seed {seed}: {len(bad)} read badly")
    print("failed" if bad else "passed")
    return bool(bad)


def _fast() -> str | None:
    memory = Path("/dev/shm")
    return str(memory) if os.access(memory, os.W_OK) else None


def _warm(names: list[str], by_kind: dict[str, list[Seed]], place: Place) -> None:
    """Read every undamaged file once, so that libraries are loaded; report refused files."""
    for name in names:
        for seed in by_kind[READERS[name].kind]:
            target = seed.targets[0]
            path = place.write(Case(name, 0, seed, target, seed.files[target]))
            try:
                READERS[name].read(path)
            except READERS[name].declared as error:
                # For example, a point cloud is not a mesh, and an EXR is not a frame.
                print(f"{name}: {seed.name} is refused undamaged: {error}"[:150])


def _print(tallies: dict[str, Tally], bad: list[tuple[Case, Outcome]]) -> None:
    verdicts = ("read", "refused", "undeclared", "crashed", "slow", "large")
    print(
        f"{'reader':<15}" + "".join(f"{verdict:>11}" for verdict in verdicts) + "    max s  max MB"
    )
    for name, tally in tallies.items():
        counts = "".join(f"{tally.verdicts[verdict]:>11}" for verdict in verdicts)
        print(f"{name:<15}{counts}{tally.seconds:>9.2f}{tally.megabytes:>8.0f}")
    for case, outcome in bad[:100]:
        print(
            f"{case.name}: {outcome.verdict}, {case.seed.name} {case.target}, "
            f"{outcome.seconds:.1f} s, {outcome.megabytes:.0f} MB {outcome.words}"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default=",".join(READERS), help="readers, separated by commas")
    parser.add_argument("--case", help="reader/number of one case to read again")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-case"), help="folder for its file")
    options = parser.parse_args()
    oiio.attribute("threads", 1)
    oiio.attribute("exr_threads", -1)
    cv2.setNumThreads(0)
    # A warning counts as an undeclared error.
    warnings.simplefilter("error")
    if options.case:
        reader, _, number = options.case.partition("/")
        shutil.rmtree(options.keep, ignore_errors=True)
        return again(case_of(seeds(), options.seed, reader, int(number)), options.keep)
    return run(options.only.split(","), options.files, options.seed)


if __name__ == "__main__":
    sys.exit(main())
