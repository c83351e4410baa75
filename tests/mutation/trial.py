"""Run tests on a copy of the tree in which one module at a time has a fault."""

from __future__ import annotations

import multiprocessing
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

ROOT = Path(__file__).resolve().parents[2]
Verdict = Literal["killed", "timeout", "survived"]

# Imported once for all faults: these imports are most of the time of a short test.
_PRELOADED = (
    "cv2", "hypothesis", "numba", "numpy", "OpenImageIO", "pydantic", "pytest", "scipy.linalg",
    "scipy.ndimage", "scipy.optimize", "scipy.sparse.linalg", "serial",
)  # fmt: skip
_OPTIONS = (
    "-x", "-q", "--assert=plain", "--tb=line", "--timeout=0", "--hypothesis-seed=0",
    "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow",
)  # fmt: skip
# Limit of wall clock time relative to CPU time: a busy host is not an endless loop.
_WAITING = 6
_MOST_MEMORY = 8 << 30
_STRANGE = 97


@dataclass(frozen=True)
class Outcome:
    """Verdict, CPU time and output of the tests."""

    verdict: Verdict
    seconds: float
    output: str


class Trial:
    """A copy of the working tree for faults; the tree itself is never changed.

    Parameters
    ----------
    folder
        Folder for the copy; it must not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
        names = subprocess.run(words, cwd=ROOT, capture_output=True, check=True).stdout
        for name in filter(None, names.decode().split("\0")):
            source, copy = ROOT / name, folder / name
            if source.is_file():
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, copy)
        self._kernels = {
            module.relative_to(folder).as_posix(): module.read_text(encoding="utf-8")
            for module in folder.rglob("*.py")
            if "numba.njit" in module.read_text(encoding="utf-8")
        }
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(list(_PRELOADED))

    def original(self, module: str) -> str:
        """Return the text of a module without a fault."""
        return (self._folder / module).read_text(encoding="utf-8")

    def run(self, module: str, text: str, tests: tuple[str, ...], limit_s: float) -> Outcome:
        """Run tests on a module of this text until one fails.

        Parameters
        ----------
        module
            Path in the tree.
        text
            Text of the module while the tests run.
        tests
            Paths below ``tests``.
        limit_s
            Limit of CPU time in seconds.

        Raises
        ------
        RuntimeError
            If the tests never import the module, so that they cannot judge it.
        """
        path, log = self._folder / module, self._folder / "tests.log"
        original, before = path.read_bytes(), path.stat()
        log.write_text("", encoding="utf-8")
        for stale in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            stale.unlink()  # its validity is checked by whole seconds and size only
        path.write_text(text, encoding="utf-8")
        # Compiled again, because numba checks the source of a kernel, not of those that it calls.
        callers = [self._folder / caller for caller in self.compiled_from(module)]
        plain = {caller: caller.read_text(encoding="utf-8") for caller in callers}
        for caller in callers:
            caller.write_text(f"{plain[caller]}# {hash(text)}\n", encoding="utf-8")
        words = (self._folder, log, module, tests, limit_s)
        process = self._context.Process(target=_tests, args=words)
        try:
            process.start()
            process.join(_WAITING * limit_s)
            ended = process.exitcode is not None
        finally:
            _end_group(process.pid)
            process.join()
            path.write_bytes(original)
            os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
            for caller in callers:
                caller.write_text(plain[caller], encoding="utf-8")
        output = log.read_text(encoding="utf-8", errors="replace").rstrip()
        if process.exitcode == _STRANGE:
            raise RuntimeError(f"{module} is not what {', '.join(tests)} import")
        if not ended or process.exitcode in (-signal.SIGXCPU, -signal.SIGKILL):
            return Outcome("timeout", limit_s, output)
        # A crash also counts as detected, but prints no time.
        used = float(found[1]) if (found := re.search(r"processor time (\S+)$", output)) else 0.0
        return Outcome("survived" if process.exitcode == 0 else "killed", used, output)

    def worlds(self, module: str, text: str, most: int) -> int | None:
        """Run recordings in virtual time; return the seed that fails, None if none does.

        Parameters
        ----------
        module, text
            As for `run`.
        most
            Number of seeds.
        """
        path = self._folder / module
        original = path.read_bytes()
        path.write_text(text, encoding="utf-8")
        words = [sys.executable, "-B", "benchmarks/world.py", "--stop"]
        places = {"PYTHONPATH": str(self._folder)}
        try:
            done = subprocess.run(
                [*words, "--count", str(most)],
                cwd=self._folder,
                env=os.environ | places,
                capture_output=True,
                text=True,
                check=False,
            )
        finally:
            path.write_bytes(original)
        found = re.search(r"^seed (\d+): .*", done.stdout, re.MULTILINE)
        if done.returncode == 0 or found is None:
            if done.returncode:
                raise RuntimeError(f"{module}: {done.stderr}")
            return None
        print(f"    {found[0]}")
        return int(found[1])

    def compiled_from(self, module: str) -> set[str]:
        """Return the modules with kernels that call, directly or not, functions of a module."""
        callers: set[str] = set()
        of = [module] if module in self._kernels else []
        while of:
            name = of.pop().removesuffix(".py").replace("/", ".")
            found = {m for m, text in self._kernels.items() if f"from {name} import" in text}
            of += found - callers
            callers |= found
        return callers


def _tests(folder: Path, log: Path, module: str, tests: tuple[str, ...], limit_s: float) -> None:
    """Run pytest in a forked process, and exit with its exit code."""
    import numba
    import pytest

    os.setsid()
    os.chdir(folder)
    # Also for the processes that the tests start.
    os.environ["PYTHONPATH"] = str(folder)
    # Compiled code is cached by a hash of its source: a fault is compiled again.
    os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = str(folder / ".numba")
    # Replaces the working tree, which an editable install adds to the path.
    sys.path[:] = [str(folder), *(entry for entry in sys.path if Path(entry or ".") != ROOT)]
    stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(stream, 1)
    os.dup2(stream, 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    code = int(pytest.main([*_OPTIONS, *(f"tests/{name}" for name in tests)]))
    loaded = sys.modules.get(module.removesuffix(".py").replace("/", "."))
    # A failing import counts as a detected fault.
    if code == 0 and Path(getattr(loaded, "__file__", None) or "") != folder / module:
        code = _STRANGE
    print("processor time", sum(os.times()[:4]), flush=True)
    os._exit(code)


def _end_group(pid: int | None) -> None:
    """End processes that a test left running; the tests lead their process group."""
    if pid is None:
        return
    try:
        os.killpg(pid, signal.SIGKILL)
    except ProcessLookupError:
        return
