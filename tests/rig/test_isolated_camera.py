"""A camera in a separate process, whose GenTL producer hangs or crashes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time

import pytest

from rig import CameraError, CameraGoneError
from rig.genicam import isolated
from tests.rig.camera_benches import EXPOSURE_US, IsolatedBench, grey

# A computer with other load may need longer.
PATIENCE_S = 20.0


@pytest.fixture
def bench(tmp_path):
    bench = IsolatedBench(tmp_path)
    yield bench
    bench.close()


def armed(bench):
    camera = bench.open()
    camera.configure(exposure_us=EXPOSURE_US)
    camera.arm()
    return camera


def shoot(bench, camera, led):
    bench.light(led)
    frame = camera.fetch(camera.trigger(), 5.0)
    assert (frame.pixels == grey(led)).all()


def is_alive(pid):
    """Return whether a process runs; one that has ended may still wait for its parent."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def check_ends(pid):
    ends_s = time.monotonic() + PATIENCE_S
    while is_alive(pid) and time.monotonic() < ends_s:
        time.sleep(0.02)
    assert not is_alive(pid)


@pytest.mark.parametrize("when", ["waiting", "idle"])
@pytest.mark.parametrize(
    ("number", "said"),
    [
        pytest.param(signal.SIGKILL, r"the process of its GenTL producer ended \(-9\)", id="dies"),
        pytest.param(signal.SIGSTOP, "its GenTL producer is stuck", id="hangs"),
    ],
)
def test_a_producer_that_fails_is_ended_and_started_again(bench, monkeypatch, when, number, said):
    camera = armed(bench)
    shoot(bench, camera, 3)
    if when == "waiting":
        camera.configure(exposure_us=5_000_000)
        frame_id = camera.trigger()

        def fail():
            camera.fetch(frame_id, 0.2, lambda: os.kill(camera.pid, number))

    else:

        def fail():
            os.kill(camera.pid, number)
            camera.trigger()

    with monkeypatch.context() as patched:
        if number == signal.SIGSTOP:
            for limit in ("_CALL_S", "_FRAME_S", "_WAITING_EVERY_S"):
                patched.setattr(isolated, limit, 0.05)
        with pytest.raises(CameraGoneError, match=f"c7 no longer answers: {said}"):
            fail()
    assert not is_alive(camera.pid)
    for act in (camera.arm, camera.disarm, camera.trigger, lambda: camera.fetch(9, 1.0)):
        with pytest.raises(CameraGoneError, match=said):
            act()
    camera.close()
    with pytest.raises(CameraError, match="c7 is closed"):
        camera.arm()
    shoot(bench, armed(bench), 5)


@pytest.fixture
def real_start(monkeypatch):
    """Start the process of a camera as programs do."""
    monkeypatch.setattr(isolated, "subprocess", subprocess)


@pytest.mark.usefixtures("real_start")
def test_the_process_ends_with_the_camera(bench):
    camera = armed(bench)
    shoot(bench, camera, 6)
    assert is_alive(camera.pid)
    camera.close()
    assert not is_alive(camera.pid)


def test_ctrl_c_does_not_reach_the_camera(bench):
    camera = armed(bench)
    # What a terminal sends goes to the group of its foreground process.
    assert os.getpgid(camera.pid) != os.getpgid(0)
    os.kill(camera.pid, signal.SIGINT)
    shoot(bench, camera, 2)


def test_a_camera_that_does_not_open_leaves_no_process(bench, monkeypatch):
    started = []

    def start(*words, **options):
        started.append(popen(*words, **options))
        return started[-1]

    popen = isolated.subprocess.Popen
    monkeypatch.setattr(isolated.subprocess, "Popen", start)
    with pytest.raises(CameraError, match=r"no camera c9; found: c7"):
        bench.open(serial="c9")
    assert started[0].returncode == 0


_HOST = """
import sys, time
from rig.genicam import open_isolated
camera = open_isolated(sys.argv[1])
camera.configure(exposure_us=5_000_000)
camera.arm()
frame = camera.trigger()
def ready():
    print(camera.pid, flush=True)
if sys.argv[2] == "waiting":
    camera.fetch(frame, 60, ready)
ready()
time.sleep(60)
"""


def test_a_killed_host_leaves_no_process_and_no_open_camera(tmp_path, forks):
    """While it waits for a frame, and while it does nothing; both start at the same time."""
    hosts = {}
    for when in ("waiting", "idle"):
        (tmp_path / when).mkdir()
        bench = IsolatedBench(tmp_path / when)
        hosts[when] = bench, forks.start(_HOST, bench.device.cti, when)
    for bench, host in hosts.values():
        pid = int(host.stdout.readline())
        assert is_alive(pid)
        host.end()
        check_ends(pid)
        shoot(bench, armed(bench), 4)
        bench.close()


def test_a_library_that_holds_the_lock_for_ever_ends_the_process(forks):
    stuck = (
        "import ctypes; from rig.genicam.isolated_process import end_if_stuck; "
        "end_if_stuck(0.1); ctypes.PyDLL(None).sleep(600)"
    )
    assert forks.run(stuck).returncode == 1


_NOISY = """
import os
from rig.genicam import camera, isolated_process
def noisy(**words):
    os.write(1, b"found 1 camera\\n")
    raise camera.CameraError("refused")
camera.open_genicam = noisy
isolated_process.main()
"""


def test_what_a_library_prints_is_no_reply(forks):
    ended = forks.start(_NOISY)
    ended.stdin.write('{"number": 1, "call": "open", "words": {}}\n')
    ended.communicate()
    ended.end()
    assert json.loads(ended.out) == {"number": 1, "error": ["CameraError", "refused", {}]}
    assert ended.err == "found 1 camera\n"
    assert ended.returncode == 0
