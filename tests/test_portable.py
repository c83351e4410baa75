"""Processing needs nothing that only Unix has, and no package of the rig."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Libraries are imported before the platform changes: they choose their files by it.
WINDOWS = """
import importlib, multiprocessing.connection, os, pkgutil, sys, types
import asyncio, concurrent.futures, ctypes, logging, shutil, socket, subprocess, tempfile, zipfile
import cv2, cyclopts, lazy_loader, numba, numpy, OpenImageIO, rawpy
import scipy.interpolate, scipy.ndimage, scipy.optimize, scipy.signal, scipy.sparse.linalg
import scipy.spatial, scipy.stats
absent = "fcntl grp harvesters harvesters.core pty pwd resource serial termios"
sys.modules |= dict.fromkeys(absent.split())
sys.modules["msvcrt"] = types.ModuleType("msvcrt")
unix = "fork posix_fadvise pread pwrite getuid geteuid sched_getaffinity statvfs fchmod"
for name in unix.split() + ["O_NOFOLLOW", "O_NONBLOCK", "O_DIRECTORY", "register_at_fork"]:
    if hasattr(os, name):
        delattr(os, name)
os.O_BINARY = 0
sys.platform = "win32"
for package in ("acquisition", "calibration", "processing", "sgp"):
    path = importlib.import_module(package).__path__
    for module in pkgutil.walk_packages(path, package + "."):
        try:
            importlib.import_module(module.name)
        except ImportError as error:
            print(module.name, error)
"""


@pytest.mark.slow
def test_only_recording_needs_a_serial_port() -> None:
    command = [sys.executable, "-P", "-c", WINDOWS]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    failed = done.stdout.splitlines()
    names = ("engine", "metering", "preflights", "preview", "selftests")
    recording = ("sgp.screen.", *(f"acquisition.{name}." for name in names))
    assert [line for line in failed if not line.startswith(recording)] == []
    # The test would see a module that is missing.
    assert any("import of serial halted" in line for line in failed)
