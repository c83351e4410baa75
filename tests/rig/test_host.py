"""Rig and recordings use the operating system only through `rig.host`."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Vendor libraries, kernels and the end of programs are outside a world.
OUTSIDE = ("rig/host/", "rig/genicam/", "rig/kernels/", "rig/processes/")
FORBIDDEN = {
    "time": {"monotonic", "monotonic_ns", "sleep"},
    "threading": {"Thread", "Lock", "RLock", "Condition", "Event", "Timer"},
    "signal": {"signal", "getsignal"},
    "atexit": {"register", "unregister"},
    "serial": {"Serial"},
    "secrets": {"randbelow"},
    "os": {"fsync", "write", "pwrite", "replace", "rename", "unlink", "mkdir", "rmdir", "kill"},
}
# Files and locks of stages of processing and of readers, which no recording uses.
ALLOWED = {
    ("acquisition/files/band_file.py", "os.fsync"),
    ("acquisition/source/linear_frames.py", "threading.Lock"),
}


def used(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            yield f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{name.name}" for name in node.names)


@pytest.mark.parametrize("package", ["rig", "acquisition"])
def test_the_system_is_used_through_one_package(package: str) -> None:
    forbidden = {f"{module}.{name}" for module, names in FORBIDDEN.items() for name in names}
    found = set()
    for path in sorted((ROOT / package).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(OUTSIDE):
            found |= {(name, call) for call in used(path) if call in forbidden}
    assert found == {one for one in ALLOWED if one[0].startswith(package)}
