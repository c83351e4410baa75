"""Hosts that end without saying goodbye: the board is dark in time, and nothing keeps running."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simulator._bench_state import BenchState

HOLD_MS = 1500

HOST = """
import json, sys, time
import numpy as np
from acquisition import NoiseModel
from rig import Board, Rig, RigConfig
from simulator._bench_state import BenchState
from simulator._virtual_board import VirtualBoard
from simulator._virtual_camera import VirtualCamera

virtual = VirtualBoard(36)
camera = VirtualCamera(
    lambda led: np.zeros((2, 2), np.float32),
    size=(2, 2),
    bench=BenchState(virtual.bench_state_path),
    noise=NoiseModel(1.0, 1.0, 0.0, 12),
)
config = RigConfig(name="test", driver="test")
rig = Rig(Board(virtual.port), camera, config, on_close=virtual.close)
print(json.dumps({"bench": str(virtual.bench_state_path), "pid": virtual.pid}), flush=True)
sys.stdin.readline()
rig.board.on(7, int(sys.argv[1]))
print("on", flush=True)
"""


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
def host():
    """Start a host program; give its process, its board's pid and bench state, LED 7 burning."""
    started = []

    def start(hold_ms: int, then: str):
        process = subprocess.Popen(
            [sys.executable, "-c", HOST + then, str(hold_ms)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        told = json.loads(process.stdout.readline())
        bench = BenchState(Path(told["bench"]))
        started.append((process, told["pid"], bench))
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "on\n"
        return process, told["pid"], bench

    yield start
    for process, pid, bench in started:
        process.kill()
        process.communicate()
        bench.close()
        if running(pid):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGTERM], ids=lambda s: s.name)
def test_a_killed_host_leaves_a_dark_board_by_the_end_of_the_hold(host, death):
    process, pid, bench = host(HOLD_MS, "time.sleep(60)")
    lit = bench.periods()[-1]
    assert bench.led(time.monotonic_ns()) == 7
    os.kill(process.pid, death)
    process.wait()
    # The board outlives its host, as a board on a bench does: only the hold ends the light.
    time.sleep(0.3)
    assert bench.led(time.monotonic_ns()) == 7
    assert running(pid)
    assert wait_until(lambda: bench.led(time.monotonic_ns()) is None, 2 * HOLD_MS / 1000)
    assert bench.periods()[-1] == lit
    assert lit.end_ns - lit.start_ns == HOLD_MS * 1_000_000
    assert wait_until(lambda: not running(pid), 3)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("then", ["", "raise ValueError"], ids=["end", "error"])
def test_a_host_that_forgets_to_close_turns_the_light_off_on_its_way_out(host, then):
    process, pid, bench = host(10_000, then)
    process.wait()
    assert bench.led(time.monotonic_ns()) is None
    assert wait_until(lambda: not running(pid), 3)
