"""Build the virtual camera's library with the local C compiler in the user's cache."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

from acquisition import StorageError, make_folder, write_durably
from rig import RigError
from simulator.bench.owned_folder import OwnedFolder

_SOURCES = Path(__file__).parent
_FLAGS = tuple(
    """
    -std=c11 -D_GNU_SOURCE -Wall -Wextra -Wpedantic -O3 -ffp-contract=off
    -fno-math-errno -fvisibility=hidden -fPIC -pthread -shared
    """.split()  # noqa: SIM905
)
_LIBRARIES = ("-lm", "-ldl")
_TIMEOUT_S = 300.0


class CompilerError(RigError):
    """No C compiler is found, or it cannot build the virtual camera."""


def build() -> Path:
    """Build the GenTL producer unless it is in the cache.

    The cache is the folder ``sgp`` in ``$XDG_CACHE_HOME`` or ``~/.cache``. The name of the file's
    folder has a hash of sources, flags and compiler, so every version has its own folder. The
    compiler is ``$CC`` if it is set, otherwise the first of ``cc``, ``gcc`` and ``clang`` that is
    found. Processes can build at the same time: the complete file appears in one step.

    Returns
    -------
    Path
        Path of the ``.cti``, a shared library.

    Raises
    ------
    CompilerError
        If there is no compiler, it fails, or the cache cannot be written.
    """
    compiler = _compiler()
    sources = sorted(_SOURCES.glob("*.c"))
    version = _run([*compiler, "--version"])
    digest = hashlib.sha256("\0".join((*compiler, *_FLAGS, version)).encode())
    for path in sorted((*sources, *_SOURCES.glob("*.h"))):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    folder = _cache() / f"gentl-{digest.hexdigest()[:16]}"
    cti = folder / "sgp.cti"
    if cti.exists():
        return cti
    try:
        make_folder(folder)
        with closing(OwnedFolder("build-", folder)) as scratch:
            built = scratch.path / cti.name
            command = [*compiler, *_FLAGS, *map(str, sources), "-o", str(built), *_LIBRARIES]
            # Also for the compiler's temporary files, which remain if it is killed.
            _run(command, os.environ | {"TMPDIR": str(scratch.path)})
            write_durably(cti, built.read_bytes())
    except (OSError, StorageError) as error:
        raise CompilerError(
            f"{folder}: the virtual camera cannot be built there ({error}); "
            "set XDG_CACHE_HOME to a folder that can be written"
        ) from error
    return cti


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sgp"


def _compiler() -> list[str]:
    wanted = os.environ.get("CC")
    for name in [wanted] if wanted else ["cc", "gcc", "clang"]:
        command = shlex.split(name)
        if command and shutil.which(command[0]):
            return command
    raise CompilerError(
        f"the virtual camera needs a C compiler: {wanted or 'cc, gcc or clang'} was not found; "
        "install one (Debian: apt install gcc) or name it in CC"
    )


def _run(command: list[str], environment: Mapping[str, str] | None = None) -> str:
    try:
        done = subprocess.run(
            command,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired as error:
        raise CompilerError(
            f"the C compiler {command[0]} did not end within {_TIMEOUT_S:g} s"
        ) from error
    if done.returncode:
        complaints = [line for line in done.stderr.splitlines() if "error" in line.lower()]
        first = (complaints or done.stderr.splitlines() or ["no reason given"])[0]
        raise CompilerError(f"the C compiler {command[0]} cannot build the virtual camera: {first}")
    return done.stdout
