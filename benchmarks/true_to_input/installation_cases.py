"""Installations that cannot be written, and caches of compiled kernels that fail."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from true_to_input.case import Outcome, cases, emptied, later

_PACKAGES = ("acquisition", "calibration", "processing", "rig", "sgp", "simulator")
_NOWHERE = "/proc/nonexistent"
# A command that compiles few kernels.
_COMBINE = (
    *("-m", "sgp", "detail", "combine", "map.png", "map.png", "--force", "--json", "--out"),
    "out",
)
_NOTEBOOK = (
    "-W",
    "always",
    "-c",
    "import numpy as np, processing\n"
    "n = np.zeros((9, 9, 3), np.float32); n[..., 2] = 1\n"
    "n = processing.NormalMap.from_vectors(n)\n"
    "print('{\"ok\":', 'true}' if processing.ssim(n, n) > 0.99 else 'false}')",
)


class _Ran(NamedTuple):
    code: int
    ok: bool
    err: str


class _Installation:
    """A copy of the program, and a run of it in a mount namespace of its own (Linux)."""

    def __init__(self, folder: Path) -> None:
        import sgp

        self.folder, self.packages = folder, folder / "installed"
        self.work, self.temporary = folder / "work", folder / "tmp"
        for path in (self.packages, self.work, self.temporary):
            path.mkdir()
        for name in _PACKAGES:
            shutil.copytree(
                Path(sgp.__file__).parents[1] / name,
                self.packages / name,
                # No kernels; modules need not be compiled again.
                ignore=shutil.ignore_patterns("*.nb[ci]"),
            )
        flat = np.full((24, 32, 3), (65535, 32768, 32768), np.uint16)
        cv2.imwrite(str(self.work / "map.png"), flat)

    def run(
        self,
        words: Sequence[str] = _COMBINE,
        *,
        locked: Sequence[Path] = (),
        mounts: Sequence[str] = (),
        **environment: str,
    ) -> _Ran:
        """Run Python with folders that cannot be written; the working directory is `work`."""
        lines = [
            f"mount --bind {shlex.quote(str(path))} {shlex.quote(str(path))}" for path in locked
        ]
        # Mounted after a folder around it, and before that is locked.
        lines.append(f"mount --bind {shlex.quote(str(self.work))} {shlex.quote(str(self.work))}")
        lines += [f"mount -o remount,bind,ro {shlex.quote(str(path))}" for path in locked]
        lines += [*mounts, f"cd {shlex.quote(str(self.work))}"]
        lines.append(shlex.join(["exec", sys.executable, *words]))
        base = {
            name: value
            for name, value in os.environ.items()
            if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME", "TMPDIR", "MPLCONFIGDIR")
        }
        base |= {"PYTHONPATH": str(self.packages), "PYTHONDONTWRITEBYTECODE": "1"}
        base |= {"HOME": _NOWHERE, "TMPDIR": str(self.temporary), **environment}
        script = " && ".join(lines)
        done = subprocess.run(
            ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script],
            env=base,
            capture_output=True,
            text=True,
            check=False,
        )
        try:
            ok = bool(json.loads(done.stdout).get("ok", True))
        except ValueError:
            ok = False
        return _Ran(done.returncode, ok and done.returncode == 0, done.stderr)

    def kernels(self, place: Path) -> list[Path]:
        return sorted(place.rglob("*.nb[ci]"))


def _last(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else ""


def _judged(ran: _Ran, *, stated: Sequence[str] = (), silent: Sequence[str] = ()) -> Outcome:
    """Judge a run: its result, what stderr must mention and must not mention."""
    if not ran.ok:
        return Outcome("wrong", f"exit {ran.code}: {_last(ran.err)}")
    missing = [word for word in stated if word not in ran.err]
    extra = [word for word in (*silent, "Traceback") if word in ran.err]
    if missing or extra:
        return Outcome("vague", f"not stated: {missing}; but: {extra}; {_last(ran.err)}")
    return Outcome("applied and stated" if stated else "right", _last(ran.err) or "runs")


def _kept(place: _Installation, folder: Path, **options: object) -> Outcome:
    """Judge that kernels are kept in a folder: the second run finds them."""
    first = place.run(**options)  # type: ignore[arg-type]
    if not first.ok:
        return _judged(first)
    kept = place.kernels(folder)
    second = place.run(**options)  # type: ignore[arg-type]
    if not kept or place.kernels(folder) != kept:
        return Outcome("wrong", f"{len(kept)} files in {folder.name}: {_last(first.err)}")
    return _judged(second, silent=("compil",))


def _readonly_no_home(folder: Path) -> Outcome:
    place = _Installation(folder)
    return _kept(place, place.temporary, locked=[place.packages])


def _says_once(folder: Path) -> Outcome:
    place = _Installation(folder)
    first = _judged(place.run(), stated=("compil", "once"), silent=("compiling\n\n",))
    second = _judged(place.run(), silent=("compil",))
    return second if first.kind == "applied and stated" and second.kind != "right" else first


@later
def _nowhere(folder: Path, words: Sequence[str] = _COMBINE) -> Outcome:
    place = _Installation(folder)
    outside = [Path(name) for name in ("/tmp", "/var/tmp", "/dev/shm") if Path(name).is_dir()]
    ran = place.run(words, locked=[*outside, place.folder])
    if ran.err.count("every run") > 1:
        return Outcome("vague", "stated more than once")
    return _judged(ran, stated=("every run", "NUMBA_CACHE_DIR"))


def _user_cache(folder: Path) -> Outcome:
    place = _Installation(folder)
    home = folder / "home"
    home.mkdir()
    return _kept(place, home, locked=[place.packages], HOME=str(home))


def _hostile(folder: Path) -> Outcome:
    """Folders of all likely names lie in the temporary folder, open to everyone."""
    place = _Installation(folder)
    place.run(locked=[place.packages])
    names = [path.name for path in place.temporary.iterdir() if place.kernels(path)]
    shutil.rmtree(place.temporary)
    place.temporary.mkdir()
    for name in names:
        (place.temporary / name).mkdir()
        (place.temporary / name).chmod(0o777)
    ran = place.run(locked=[place.packages, Path("/var/tmp"), Path("/dev/shm")])
    if any(place.kernels(place.temporary / name) for name in names):
        return Outcome("wrong", "a folder that everyone can write is used")
    return _judged(ran)


def _full(folder: Path) -> Outcome:
    place = _Installation(folder)
    cache = folder / "cache"
    cache.mkdir()
    mount = f"mount -t tmpfs -o size=16k none {shlex.quote(str(cache))}"
    ran = place.run(mounts=[mount], NUMBA_CACHE_DIR=str(cache))
    return _judged(ran, stated=("every run",))


@cache
def _compiled(folder: Path) -> _Installation:
    """Return an installation with kernels; a case that damages them ends with new ones."""
    place = _Installation(emptied(folder / "compiled"))
    place.run()
    return place


@later
def _corrupted(folder: Path, kind: str) -> Outcome:
    place = _compiled(folder.parent)
    files = [path for path in place.kernels(place.packages) if path.suffix == kind[:4]]
    if not files:
        return Outcome("wrong", "no kernels are kept")
    for number, path in enumerate(files):
        data = path.read_bytes()
        middle = len(data) // 2
        changed = {
            "cut": data[:middle],
            "empty": b"",
            "noise": bytes(np.random.default_rng(number).integers(0, 256, len(data), np.uint8)),
            "flips": data[:middle] + bytes(255 - one for one in data[middle : middle + 64])
            + data[middle + 64 :],
        }[kind[5:]]  # fmt: skip
        path.write_bytes(changed)
    again = _judged(place.run(), stated=("compil",))
    if again.kind != "applied and stated":
        return again
    return _judged(place.run(), silent=("compil",))


def _doctor(folder: Path) -> Outcome:
    place = _Installation(folder)
    ran = place.run(("-m", "sgp", "doctor", "--json"), locked=[place.packages])
    text = ran.err + str(ran.code)
    out = place.run(
        ("-c", "import subprocess, sys\n"
         "done = subprocess.run([sys.executable, '-m', 'sgp', 'doctor'], capture_output=True, "
         "text=True)\ntext = ''.join(done.stdout.split())  # lines end within long names\n"
         "print('{\"ok\":', 'true}' if 'kernels' in text and "
         f"{str(place.temporary)!r} in text else 'false}}')"),
        locked=[place.packages],
    )  # fmt: skip
    if not out.ok:
        return Outcome("wrong", f"the folder is not named; {text[-80:]}")
    return Outcome("applied and stated", "doctor names the folder of the kernels")


def _other_numba(folder: Path) -> Outcome:
    """A numba whose caches need one more argument: the package runs as numba alone would."""
    script = (
        "import numba.core.caching as caching, numba.core.dispatcher as dispatcher\n"
        "begin = caching.FunctionCache.__init__\n"
        "caching.FunctionCache.__init__ = lambda self, function, more: begin(self, function)\n"
        "dispatcher.Dispatcher.enable_caching = lambda self: setattr(\n"
        "    self, '_cache', dispatcher.FunctionCache(self.py_func, 'more'))\n"
    )
    words = (*_NOTEBOOK[:-1], script + _NOTEBOOK[-1])
    return _judged(_Installation(folder).run(words))


def _together(folder: Path) -> Outcome:
    """Three processes compile the same kernels at once; a fourth one finds them."""
    place = _Installation(folder)
    with ThreadPoolExecutor(3) as pool:
        ran = [*pool.map(lambda out: place.run((*_COMBINE[:-1], out)), ("a", "b", "c"))]
    bad = next((one for one in ran if not one.ok), None)
    return _judged(bad or place.run(), silent=("compil",))


CASES = cases(
    5,
    (
        ("readonly_no_home", "runs, keeps kernels", _readonly_no_home),
        ("says_that_it_compiles", "one line, once", _says_once),
        ("doctor_names_the_folder", "named", _doctor),
        ("nothing_can_be_written", "runs, stated once", _nowhere()),
    ),
    (
        ("nothing_for_a_notebook", "runs, one warning", _nowhere(_NOTEBOOK)),
        ("readonly_with_home", "kept in the user's cache", _user_cache),
        ("hostile_temporary_folder", "not used", _hostile),
        ("cache_disk_full", "runs, stated", _full),
        ("another_numba", "numba's own cache", _other_numba),
        ("compiled_by_three", "all run, kernels are kept", _together),
        *(
            (f"cache{kind.replace(' ', '_')}", "compiled again", _corrupted(kind))
            for kind in (
                ".nbi cut", ".nbi empty", ".nbi noise", ".nbc cut", ".nbc noise", ".nbc flips"
            )
        ),
    ),
)  # fmt: skip
