"""Programs that receive a signal to end turn their LEDs off first, even if they are stuck."""

import signal
import time

import pytest

from rig import Board
from tests.quick_sample import quick

# Opens rigs on these ports, with a camera that never delivers, and reports when the LED is on.
HOST = """
import os, signal, sys, threading, time
import numpy as np
from rig import Board, CameraInfo, Rig, RigConfig

class Stuck:
    info = CameraInfo("x", "x", "x", 4, 4, "Mono12", 12, None, 1.0, 1e9)
    def configure(self, *, exposure_us, gain_db=0.0): return exposure_us
    def arm(self, trigger="software"): pass
    def trigger(self): return 0
    def expect(self): return 0
    def fetch(self, frame_id, timeout_s, waiting=None):
        print("lit", flush=True)
        while True:
            time.sleep(0.05)
            waiting()
    def disarm(self): pass
    def close(self): pass

def opened(port):
    config = RigConfig(name="x", driver="x", settle_ms=0, frame_timeout_s=50)
    return Rig(Board(port), Stuck(), config)

def stuck_writer():
    def write():
        reader, writer = os.pipe()
        while True:
            os.write(writer, bytes(1 << 16))
    threading.Thread(target=write).start()

def handled(number, frame):
    print("handled", flush=True)
    os._exit(7)

ports = sys.argv[1:]
{body}
"""
SHOOT = "with opened(ports[0]) as rig: rig.shoot(5, 1000.0)"
ON = "rigs = [opened(port) for port in ports]\nfor rig in rigs: rig.board.on(5, 50_000)\n"
LOOK_ALIVE = """
print("lit", flush=True)
while True:
    time.sleep(0.05)
    for rig in rigs: rig.board.ping()
"""


@pytest.fixture
def start(forks):
    """Return a function that starts a program on benches and waits until the LED is on."""
    started = []

    def start(body, *benches):
        ports = (bench.virtual.port for bench in benches)
        host = forks.start(HOST.replace("{body}", body), *ports)
        started.append(host)
        assert host.stdout.readline() == "lit\n", host.stderr.read()
        return host

    yield start
    for host in started:
        host.end()


def end(host):
    """Return the exit code, output and errors of a program that should have ended by now."""
    out, err = host.communicate()
    return host.returncode, out, err


def went_dark(bench):
    """Return whether the LED turns off within 10 s, which is before the end of its hold."""
    ends = time.monotonic() + 10
    while bench.state.led(time.monotonic_ns()) is not None:
        if time.monotonic() > ends:
            return False
        time.sleep(0.01)
    return True


def trips(bench):
    board = Board(bench.virtual.port)
    try:
        return board.status().trips
    finally:
        board.close()


@pytest.mark.parametrize(
    ("body", "number", "code"),
    quick(
        [
            pytest.param(SHOOT, signal.SIGTERM, 143, id="SIGTERM, camera stuck"),
            pytest.param(SHOOT, signal.SIGHUP, 129, id="SIGHUP, camera stuck"),
            pytest.param(SHOOT, signal.SIGINT, -signal.SIGINT, id="Ctrl-C, camera stuck"),
            pytest.param(ON + LOOK_ALIVE, signal.SIGTERM, 143, id="SIGTERM, never closed"),
            pytest.param(
                "signal.signal(signal.SIGTERM, handled)\n" + SHOOT,
                signal.SIGTERM,
                7,
                id="SIGTERM, a handler that never returns",
            ),
        ],
        every=2,
    ),
)
def test_a_signal_turns_the_led_off_and_ends_the_program_as_usual(
    start, own_bench, body, number, code
):
    host = start(body, own_bench)
    assert own_bench.state.led(time.monotonic_ns()) == 5
    host.send_signal(number)
    ended, out, err = end(host)
    assert went_dark(own_bench)
    assert ended == code
    assert ("KeyboardInterrupt" in err) == (number == signal.SIGINT)
    assert ("handled" in out) == (code == 7)
    assert trips(own_bench) == 0


def test_a_stuck_thread_keeps_the_program_alive_but_not_the_led_on(start, own_bench):
    host = start("stuck_writer()\n" + SHOOT, own_bench)
    host.send_signal(signal.SIGTERM)
    assert went_dark(own_bench)
    time.sleep(0.1)
    # Python waits for the writer thread, so turning the LED off must not depend on that.
    assert host.poll() is None
    host.kill()
    assert trips(own_bench) == 0


def test_an_ignored_signal_remains_ignored(start, own_bench):
    host = start("signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + SHOOT, own_bench)
    host.send_signal(signal.SIGHUP)
    time.sleep(0.1)
    assert own_bench.state.led(time.monotonic_ns()) == 5
    host.send_signal(signal.SIGTERM)
    assert end(host)[0] == 143
    assert went_dark(own_bench)


def test_the_leds_of_all_rigs_of_a_program_turn_off(start, real_bench, own_bench):
    host = start(ON + LOOK_ALIVE, real_bench, own_bench)
    host.send_signal(signal.SIGTERM)
    assert end(host)[0] == 143
    assert went_dark(real_bench)
    assert went_dark(own_bench)


def test_a_program_that_does_not_close_turns_the_led_off(start, own_bench):
    host = start(ON + "print('lit', flush=True)", own_bench)
    assert end(host)[0] == 0
    assert went_dark(own_bench)
    assert trips(own_bench) == 0
