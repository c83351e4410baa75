"""The AVR images in simavr: edges in simulated time; no LED is on during boot, reset and hang."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from simulator.world import World
from tests.conftest import a_world
from tests.quick_sample import quick
from tests.rig.conformance.board import BoardUnderTest
from tests.rig.conformance.stepped import SteppedUnderTest
from tests.rig.firmware import builds

# An edge is at most this much later than declared, and never earlier.
LATE_US = 20
# Tolerance of a time that the board reports, relative to the wires.
REPORTED_US = 8
MCUS = ("atmega328p", "atmega2560")
Commands = Callable[[str], list[str]]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    yield from a_world(tmp_path_factory)


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Commands:
    folder = builds.built(tmp_path_factory)
    return lambda mcu: builds.avr(folder, mcu)


@pytest.fixture(scope="module", params=quick(MCUS, every=2))
def shared(
    world: World, commands: Commands, request: pytest.FixtureRequest
) -> Iterator[BoardUnderTest]:
    with SteppedUnderTest(commands(request.param), world, late_us=LATE_US) as board:
        yield board


@pytest.fixture
def board(shared: BoardUnderTest) -> BoardUnderTest:
    shared.prepare()
    return shared


@pytest.fixture
def uno(world: World, commands: Commands) -> Iterator[BoardUnderTest]:
    """A freshly started atmega328p."""
    with SteppedUnderTest(commands("atmega328p"), world, late_us=LATE_US) as board:
        yield board


@pytest.mark.parametrize("shared", MCUS, indirect=True)
@pytest.mark.parametrize(
    ("settle_us", "hold_us"),
    quick(
        [
            pytest.param(0, 10, id="shortest"),
            pytest.param(0, 200, id="as long as the pulse"),
            pytest.param(1, 210, id="just longer than the pulse"),
            pytest.param(2000, 5000, id="usual"),
            pytest.param(33333, 66666, id="past the overflow of the timer"),
            pytest.param(0, 300_000, id="long"),
        ],
        every=6,
    ),
)
def test_a_flash_keeps_its_times(board: BoardUnderTest, settle_us: int, hold_us: int) -> None:
    report = board.ok(f"FLASH 7 {settle_us} {hold_us}").split()
    edges = board.flash(7)
    assert edges.on is not None
    assert edges.off is not None
    assert edges.down is not None
    assert 0 <= edges.up - edges.on - settle_us <= LATE_US
    assert 0 <= edges.off - edges.up - hold_us <= LATE_US
    assert 0 <= edges.down - edges.up - min(200, hold_us) <= LATE_US
    assert abs(int(report[2]) - (edges.off - edges.on)) <= REPORTED_US


def test_edges_keep_their_times_while_the_host_talks(board: BoardUnderTest) -> None:
    steps = [(k, 3 * k, 700, 3000, 2500) for k in range(12)]
    for step in steps:
        board.ok("STEP {} {} {} {} {}".format(*step))
    board.ok("RUN 12 T")
    # Queries without pause, with noise between them.
    while board.status().state == "RUN":
        board.write(b"x" * 40 + b"\n")
        board.ask("DID 0")
    dark_us = triggered_us = reported_us = None
    for k, led, settle_us, hold_us, gap_us in steps:
        edges = board.flash(led)
        assert edges.on is not None
        assert edges.off is not None
        assert 0 <= edges.up - edges.on - settle_us <= LATE_US
        assert 0 <= edges.off - edges.up - hold_us <= LATE_US
        _, reported_led, trigger_us, lit_us, _ = board.ok(f"DID {k}").split()
        assert reported_led == str(led)
        assert abs(int(lit_us) - (edges.off - edges.on)) <= REPORTED_US
        if dark_us is not None and triggered_us is not None and reported_us is not None:
            assert 0 <= edges.on - dark_us - gap_us <= LATE_US
            apart_us = int(trigger_us) - reported_us
            assert abs(apart_us - (edges.up - triggered_us)) <= REPORTED_US
        dark_us, triggered_us, reported_us = edges.off, edges.up, int(trigger_us)


def test_the_watchdog_acts_when_its_time_is_over(board: BoardUnderTest) -> None:
    board.ok("ON 3 60000")
    lit_us = board.lit(3)
    # The ON command was the last sign of life, a moment before the light.
    silence_us = board.identity.watchdog_ms * 1000
    assert silence_us - 10_000 <= board.lit() - lit_us <= silence_us + 2000
    assert board.status().state == "IDLE"


def test_a_declared_flash_outlasts_the_watchdog(board: BoardUnderTest) -> None:
    board.ok("FLASH 3 0 1500000")
    edges = board.flash(3)
    assert edges.off is not None
    assert 0 <= edges.off - edges.up - 1_500_000 <= LATE_US


@pytest.mark.parametrize("led", [0, 1, 22, 23, 24, 35])
def test_brightness_reaches_the_channel_of_its_led(board: BoardUnderTest, led: int) -> None:
    for level in (1, 2048, 0x555, 0xAAA, 4095):
        board.ok(f"LEVEL {led} {level}")
        board.ok(f"ON {led} 1000")
        assert levels(board) == [([led], [level])]
        board.ok("OFF")
        assert levels(board) == [([], [])]


def test_no_led_is_on_from_power_on(uno: BoardUnderTest) -> None:
    # The bridge's latches hold full brightness for every channel until they are loaded.
    uno.lit()
    uno.ok("ON 5 1000")
    uno.lit(5)


def test_a_reset_turns_the_led_off_and_it_stays_off(uno: BoardUnderTest) -> None:
    uno.ok("LEVEL 5 100")
    uno.ok("ON 5 1000")
    uno.drain()
    uno.reset()
    uno.lit()
    uno.no_edge()
    uno.ok("ON 5 1000")
    assert levels(uno) == [([5], [4095])]


def test_a_reset_clears_a_running_sequence(uno: BoardUnderTest) -> None:
    uno.ok("STEP 0 5 0 59000000 0")
    uno.ok("RUN 1 T")
    uno.drain()
    uno.reset()
    uno.lit()
    uno.no_edge()
    assert uno.status().state == "IDLE"
    assert uno.ask("RUN 1 T") == "E7 RUN 1 T"


def test_a_hung_program_is_reset_and_the_led_turns_off(
    world: World, commands: Commands, tmp_path: Path
) -> None:
    (tmp_path / "bridge").symlink_to(commands("atmega328p")[0])
    hung = builds.changed(
        tmp_path / "firmware",
        "core/commands.cpp",
        "bool busy() {",
        "bool busy() { while (light::led() == 9);",
    )
    with SteppedUnderTest(builds.avr(tmp_path, firmware=hung), world, late_us=LATE_US) as board:
        board.lit()
        board.ok("ON 9 60000")
        lit_us = board.lit(9)
        board.send("LEVEL 9 9")
        assert board.lit() - lit_us < 400_000
        board.greet()
        assert board.status().state == "IDLE"


@pytest.mark.slow
def test_the_stack_never_reaches_the_data(uno: BoardUnderTest) -> None:
    for k in range(uno.identity.steps):
        uno.ok(f"STEP {k} {k % 36} 1000000 59000000 1000000")
    longest = "NONSENSE " + "x" * 40
    for words in ("FLASH 35 1 100", "RUN 48 A", "DID 47", "STATUS", "OFF", longest, "ID"):
        uno.ask(words)
    uno.drain()
    uno.order("stack")
    event = uno.next_event(10)
    assert event is not None
    assert event["untouched"] >= 100


def levels(board: BoardUnderTest) -> list[tuple[list[int], list[int]]]:
    """Return the LEDs that have been on since, and their brightness."""
    return [(event["lit"], event["levels"]) for event in board.drain() if "lit" in event]


@pytest.mark.slow
def test_the_processor_reports_its_temperature(commands: Commands) -> None:
    # simavr's sensor is set to its 314 mV of 25 C; the 2560 has none.
    temperatures = []
    for mcu in MCUS:
        with BoardUnderTest(commands(mcu), late_us=LATE_US) as board:
            temperatures.append(board.ok("STATUS").split()[4])
    assert abs(int(temperatures[0]) - 2982) <= 11
    assert temperatures[1] == "-"
