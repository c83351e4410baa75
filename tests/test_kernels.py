"""Compiled functions of which a process could hold two copies that round differently."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

ROOT = Path(__file__).parents[1]


def compiled() -> dict[str, Dispatcher]:
    """Return all functions of the packages that numba compiles."""
    found = {}
    for package in ("acquisition", "calibration", "processing", "simulator"):
        for path in sorted((ROOT / package).rglob("*.py")):
            if "numba" in path.read_text(encoding="utf-8"):
                name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                for value in vars(importlib.import_module(name)).values():
                    if isinstance(value, Dispatcher):
                        function = value.py_func
                        found[f"{function.__module__}.{function.__qualname__}"] = value
    return found


def callees(kernel: Dispatcher) -> list[Dispatcher]:
    function = kernel.py_func
    used = [function.__globals__.get(name) for name in function.__code__.co_names]
    return [value for value in used if isinstance(value, Dispatcher)]


def test_parts_that_may_round_differently_have_no_code_of_their_own() -> None:
    kernels = compiled()
    assert len(kernels) > 200
    free: set[Dispatcher] = set()
    while True:
        more = {
            kernel
            for kernel in kernels.values()
            if kernel not in free
            and (kernel.targetoptions.get("fastmath") or free.intersection(callees(kernel)))
        }
        if not more:
            break
        free |= more
    called = {callee for kernel in kernels.values() for callee in callees(kernel)}
    copied = [
        name
        for name, kernel in kernels.items()
        if kernel in free & called
        and not kernel.targetoptions.get("forceinline")
        and kernel.targetoptions.get("inline") != "always"
    ]
    assert not copied, "see INLINED in rig/kernels/parts.py"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_first_run_after_installation_equals_the_second(tmp_path: Path) -> None:
    def run(words: str, environment: Mapping[str, str]) -> None:
        command = [sys.executable, "-m", "sgp", *words.split()]
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)

    run("simulate coin --out coin --size 160x128 --led-count 12", os.environ)
    of_its_own = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    for name in ("first", "second"):
        run(f"run coin --lights coin/derived/truth/lights.json --out {name}", of_its_own)
        run(f"detail synthesize {name}/normals --size 64x64 --out {name}/sheet", of_its_own)
        maps = f"{name}/sheet/detail.exr {name}/normals"
        run(f"detail transfer {maps} --out {name}/turned --refine 1", of_its_own)
    for path in sorted(tmp_path.glob("first/**/*.*")):
        if path.suffix in (".exr", ".png", ".ply"):
            other = tmp_path / "second" / path.relative_to(tmp_path / "first")
            assert path.read_bytes() == other.read_bytes(), path.name
