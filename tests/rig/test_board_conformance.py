"""Every board (virtual, host-built, or simulated AVR) conforms to the protocol."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.rig.conformance import CHECKS, BoardUnderTest, check, run_checks
from tests.rig.conformance.world import WorldUnderTest
from tests.rig.firmware import builds

VIRTUAL = [sys.executable, "-m", "simulator.board", "36", "events"]
# The virtual board and the AVR simulator have a simulated clock, which is exact.
BOARDS: dict[str, tuple[Callable[[Path], list[str]], int]] = {
    "virtual": (lambda _: VIRTUAL, 20),
    "host": (builds.host, 50_000),
    "atmega328p": (lambda folder: builds.avr(folder, "atmega328p"), 60),
    "atmega2560": (lambda folder: builds.avr(folder, "atmega2560"), 60),
}
# test_board_differential has the firmware in the quick tests.
SLOW = ("host", "atmega328p", "atmega2560")
# Some of each kind, which take little real time.
IN_PROCESS = {
    "ID returns the identity of the board",
    "ON is answered when the LED is on, OFF when it is off",
    "OFF ends a flash, which is then not answered",
    "a line may arrive byte by byte",
    "a repeated RUN does not run again",
    "an exposure-active input that stays high has no edge",
}
assert set(CHECKS) >= IN_PROCESS


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in BOARDS
    ],
)
def board(request, tmp_path_factory) -> Iterator[BoardUnderTest]:
    build, late_us = BOARDS[request.param]
    command = build(builds.built(tmp_path_factory))
    with BoardUnderTest(command, late_us=late_us) as board:
        yield board


@pytest.mark.parametrize("name", CHECKS)
def test_the_board_of_a_world(world, name):
    check(WorldUnderTest(world), name)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in IN_PROCESS else [pytest.mark.slow]) for name in CHECKS],
)
def test_board(board, name):
    # A busy computer may keep a board program from running while a check waits for it.
    assert run_checks(board, [name], attempts=3) == []
