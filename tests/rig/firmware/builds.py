"""Builds the board programs for tests: the firmware for Linux, and for AVR in simavr.

Each function returns the command that starts the program. A program prints ``{"port": PATH}``,
then one line ``{"us": T, "lit": [LED, ...]}`` or ``{"us": T, "trigger": 0 or 1}`` for every edge;
its standard input accepts the lines ``active 0``, ``active 1`` and ``reset``; it ends when its
standard input is closed.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FIRMWARE = HERE.parents[2] / "rig" / "firmware"
AVR_LIBC = Path("/usr/lib/avr/include/avr/io.h")
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr/cores/arduino/Arduino.h")
SIMAVR = Path("/usr/include/simavr/sim_avr.h")
LIBELF = Path("/usr/include/libelf.h")


def built(factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which all workers of a test run build the firmware once."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "firmware"
    folder.mkdir(exist_ok=True)
    return folder


def host(folder: Path, firmware: Path = FIRMWARE) -> list[str]:
    """Build the firmware as a Linux program; skip the test if there is no g++.

    Sources with a planted fault are compiled without optimization, which takes half the time.
    """
    need("g++")
    _make(folder, firmware, "host", *([] if firmware == FIRMWARE else ["OPTIMIZE=-O0"]))
    return [str(folder / "board-host")]


def avr(folder: Path, mcu: str = "atmega328p", firmware: Path = FIRMWARE) -> list[str]:
    """Build the image of a processor and simavr's bridge; skip the test if a tool is missing."""
    need_avr()
    return _in_simavr(folder, firmware, f"board-{mcu}.elf", mcu)


def sketch(folder: Path) -> list[str]:
    """Build the Arduino sketch for an Uno, and simavr's bridge; skip the test as `avr` does."""
    need_avr()
    if not ARDUINO.exists():
        pytest.skip(f"the sketch needs arduino-core-avr: no {ARDUINO}")
    return _in_simavr(folder, FIRMWARE, "arduino.elf", "atmega328p")


def changed(folder: Path, file: str, old: str, new: str) -> Path:
    """Copy the firmware's sources and replace a text that must occur exactly once."""
    shutil.copytree(FIRMWARE, folder)
    source = folder / file
    text = source.read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{file} has {text.count(old)} times {old!r}"
    source.write_text(text.replace(old, new), encoding="utf-8")
    return folder


def need(program: str) -> None:
    """Skip the test if a program is missing."""
    if shutil.which(program) is None:
        pytest.skip(f"the firmware needs {program}: not found")


def need_avr() -> None:
    """Skip the test if the AVR compiler or its library is missing."""
    need("avr-g++")
    if not AVR_LIBC.exists():
        pytest.skip(f"the AVR image needs avr-libc: no {AVR_LIBC}")


def run(*command: str | Path) -> str:
    """Run a build command and return its output; raise an error with the output if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    if done.returncode != 0:
        raise AssertionError(f"{command[0]} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def _in_simavr(folder: Path, firmware: Path, image: str, mcu: str) -> list[str]:
    need("gcc")
    for header, package in ((SIMAVR, "libsimavr-dev"), (LIBELF, "libelf-dev")):
        if not header.exists():
            pytest.skip(f"the AVR image needs {package}: no {header}")
    _make(folder, firmware, str(folder / image))
    return [str(_bridge(folder)), str(folder / image), mcu]


def _make(folder: Path, firmware: Path, *targets: str) -> None:
    """Build in a folder, one process at a time, and check that no source folder changes."""
    need("make")
    with _alone(folder):
        before = sorted(firmware.rglob("*"))
        run("make", "-C", firmware, f"OUT={folder}", *targets)
        assert sorted(firmware.rglob("*")) == before


def _bridge(folder: Path) -> Path:
    source, program = HERE / "bridge.c", folder / "bridge"
    with _alone(folder):
        if not program.exists():
            strict = ("-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror")
            run("gcc", *strict, "-o", program, source, "-lsimavr", "-lelf", "-lutil")
    return program


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
