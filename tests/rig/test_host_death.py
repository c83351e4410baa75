"""Hosts that end unexpectedly: all LEDs turn off in time, and no process keeps running."""

import json
import os
import signal
import time
from pathlib import Path

import pytest

from rig import Board
from rig.board import Step
from rig.host import clock
from simulator.bench import BenchState
from tests.quick_sample import quick

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")

S = 1_000_000_000
MS = 1_000_000
WATCHDOG_NS = 1 * S

# Beginning of a host program: it starts a board and prints its bench state and process id.
HOST = """
import json, sys, time
from rig import Board
from simulator.led_board import VirtualBoard

virtual = VirtualBoard(36)
board = Board(virtual.port)
print(json.dumps({"bench": str(virtual.bench_state_path), "pid": virtual.pid}), flush=True)
sys.stdin.readline()
"""
WAIT = """
print("done", flush=True)
time.sleep(60)
"""

# A host with a complete rig, which turns the LED off at exit if it can.
RIG = (
    HOST
    + """
import numpy as np
from acquisition import NoiseModel
from rig import Rig, RigConfig
from simulator.bench import BenchState
from simulator.camera import ImageFormation
from simulator.camera import VirtualCamera

camera = VirtualCamera(
    lambda led: np.zeros((2, 2), np.float32),
    size=(2, 2),
    bench=BenchState(virtual.bench_state_path),
    formation=ImageFormation(NoiseModel(1.0, 1.0, 0.0, 12)),
)
rig = Rig(board, camera, RigConfig(name="test", driver="test"), on_close=virtual.close)
rig.board.on(7, 60_000)
print("done", flush=True)
"""
)


def running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_until(condition, timeout_s: float) -> bool:
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


@pytest.fixture
def host(forks):
    """Return a function that starts a host and returns its process, board's pid and bench state."""
    started = []

    def start(program: str):
        process = forks.start(program)
        board = json.loads(process.stdout.readline())
        bench = BenchState(Path(board["bench"]))
        started.append((process, board["pid"], bench))
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "done\n"
        return process, board["pid"], bench

    yield start
    for process, pid, bench in started:
        process.end()
        bench.close()
        if running(pid):
            os.kill(pid, signal.SIGKILL)


def light(bench):
    return [period for period in bench.periods() if period.end_ns > period.start_ns]


@pytest.mark.parametrize(
    "death", quick([signal.SIGKILL, signal.SIGTERM], every=2), ids=lambda s: s.name
)
def test_the_board_is_dark_a_second_after_its_host_was_killed(host, death):
    process, pid, bench = host(HOST + "board.on(7, 60_000)" + WAIT)
    assert bench.led(time.monotonic_ns()) == 7
    os.kill(process.pid, death)
    died_ns = time.monotonic_ns()
    process.wait()
    # The board outlives its host, as a real board does; its watchdog turns the LED off.
    assert wait_until(lambda: not running(pid), 10)
    (lit,) = light(bench)
    assert lit.led == 7
    assert lit.end_ns - lit.start_ns <= WATCHDOG_NS + 10 * MS
    assert lit.end_ns - died_ns <= WATCHDOG_NS


@pytest.fixture
def board(bench):
    board = Board(bench.virtual.port)
    yield board
    board.close()


# Whether a host died or says nothing more is the same to the board.


def test_the_watchdog_time_begins_at_the_last_command(world, bench, board):
    board.on(7, 60_000)
    ends_ns = clock.monotonic_ns() + 3 * WATCHDOG_NS // 2
    while clock.monotonic_ns() < ends_ns:
        board.ping()
    assert bench.state.led(clock.monotonic_ns()) == 7
    silent_ns = clock.monotonic_ns()
    world.settle(3)
    (lit,) = light(bench.state)
    assert silent_ns < lit.end_ns <= silent_ns + WATCHDOG_NS


def test_a_flash_of_a_silent_host_lasts_to_its_declared_end(world, bench, board):
    board.begin_flash(7, 0, 2_000_000)
    world.settle(5)
    (lit,) = light(bench.state)
    assert (lit.led, lit.end_ns - lit.start_ns) == (7, 2 * S)


def test_a_sequence_of_a_silent_host_lasts_to_the_end_of_its_step(world, bench, board):
    board.load([Step(k, 0, 390_000, 10_000) for k in range(20)])
    board.run(20)
    world.settle(5)
    lit = light(bench.state)
    # RUN was the last command; the step that is running a second later ends as declared.
    assert [period.led for period in lit] == [0, 1, 2]
    assert lit[-1].end_ns - lit[0].start_ns == 1190 * MS
    assert len(bench.state.triggers()) == 3


def test_a_declared_flash_of_five_seconds_is_not_cut_off(bench, board):
    trips = board.status().trips
    report = board.flash(7, 1000, 5_000_000)
    lit = light(bench.state)[-1]
    assert report.lit_us == 5_001_000
    assert lit.end_ns - lit.start_ns == 5001 * MS
    assert board.status().trips == trips


@pytest.mark.parametrize("then", quick(["", "raise ValueError"], every=2), ids=["end", "error"])
def test_a_host_that_does_not_close_turns_the_led_off_at_exit(host, then):
    process, pid, bench = host(RIG + then)
    process.wait()
    assert bench.led(time.monotonic_ns()) is None
    assert wait_until(lambda: not running(pid), 3)
