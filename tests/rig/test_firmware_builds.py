"""The firmware builds for every board without a warning, is small, and loses no command."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.rig.conformance import BoardUnderTest, run_checks
from tests.rig.conformance.board import line
from tests.rig.firmware import builds

COMMANDS = 10_000
SKETCH_CHECKS = (
    "no LED is on and the trigger is low from the start",
    "the requested LED turns on",
    "LEVEL dims an LED from the next time it is turned on",
    "a flash turns on, settles, triggers and turns off as declared",
    "a sequence keeps its times and reports every step",
    "silence turns off an LED that ON turned on",
)


def test_the_core_needs_no_library(tmp_path: Path) -> None:
    builds.need("g++")
    builds.run("make", "-C", builds.FIRMWARE, f"OUT={tmp_path}", "free")


def test_the_images_leave_room_for_the_stack(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = builds.built(tmp_path_factory)
    for mcu in ("atmega328p", "atmega2560"):
        builds.avr(folder, mcu)
    sizes = builds.run("make", "-s", "-C", builds.FIRMWARE, f"OUT={folder}", "sizes").splitlines()
    assert len(sizes) == 2
    assert all(int(text.split(", ")[2].split()[0]) >= 250 for text in sizes)


@pytest.mark.slow
def test_the_sketch_is_a_board_on_an_uno(tmp_path: Path) -> None:
    command = builds.sketch(tmp_path)
    size = builds.run("avr-size", tmp_path / "arduino.elf").splitlines()[1].split()
    assert int(size[0]) + int(size[1]) < 12_000
    assert int(size[1]) + int(size[2]) < 2048 - 250
    with BoardUnderTest(command, late_us=60) as board:
        assert run_checks(board, SKETCH_CHECKS) == []


def test_a_build_without_a_folder_goes_into_the_cache_of_this_user(tmp_path: Path) -> None:
    builds.need("make")
    steps = builds.run("make", "-n", "-C", builds.FIRMWARE, f"XDG_CACHE_HOME={tmp_path}", "host")
    assert f"{tmp_path}/sgp/firmware-" in steps
    steps = builds.run("make", "-n", "-C", builds.FIRMWARE, "XDG_CACHE_HOME=", "host")
    assert f"{Path.home()}/.cache/sgp/firmware-" in steps
    assert "/tmp/" not in steps.replace(str(builds.FIRMWARE), "")


@pytest.mark.slow
def test_no_command_of_a_random_series_is_lost(tmp_path: Path) -> None:
    draw = random.Random(7)
    with BoardUnderTest(builds.host(tmp_path), late_us=100_000) as board:
        lit, damaged = "-", 0
        board.reset()
        for _ in range(COMMANDS):
            kind, led, number = draw.randrange(8), draw.randrange(36), draw.randrange(1, 4096)
            if kind == 0:
                assert board.ok(f"ON {led} 60000") == f"{led} 60000"
                lit = str(led)
            elif kind == 1:
                assert board.ok("OFF") == lit
                lit = "-"
            elif kind == 2:
                assert board.ok(f"LEVEL {led} {number}") == f"{led} {number}"
            elif kind == 3:
                step = f"{led} {led} {number} {number + 9} {number}"
                assert board.ok(f"STEP {step}") == step
            elif kind == 4:
                status = board.status()
                assert (status.led, status.faults, status.trips) == (lit, damaged, 0)
            elif kind == 5:
                assert board.ask(f"ON {36 + led} 1") == f"E3 ON {36 + led} 1"
            elif kind == 6:
                text = bytearray(line(number, f"ON {led} 1000"))
                text[draw.randrange(len(text) - 1)] ^= 1 << draw.randrange(3)
                board.write(bytes(text))
                damaged += 1
            else:
                assert board.ok(f"FLASH {led} 0 10").startswith(f"{led} ")
                lit = "-"
