"""The simulated rig as a whole: the real client and controller on virtual devices."""

import os
import time

import numpy as np
import pytest

from acquisition import NoiseModel
from rig import BoardError, RigConfig, RigError
from simulator import _simulated_rig
from simulator._simulated_rig import simulated_rig

H, W = 512, 640
NOISE = NoiseModel(2.5, 2.0, 64.0, 12)
CONFIG = RigConfig(name="simulated", driver="simulated")


def planes(led):
    """A bright spot that moves with the LED."""
    plane = np.zeros((H, W), np.float32)
    if led is not None:
        plane[10 * led : 10 * led + 10] = 0.5
    return plane


def test_a_pass_of_36_leds_sees_every_led_in_time_and_leaves_nothing():
    rig = simulated_rig(planes, CONFIG, size=(H, W), noise=NOISE, seed=1, camera_name="cam-1")
    with rig:
        assert rig.camera.info.serial == "cam-1"
        assert rig.board.identity.leds == 36
        start = time.monotonic()
        shots = [rig.shoot(led, 10_000) for led in range(36)]
        seconds = time.monotonic() - start
    for led, shot in enumerate(shots):
        rows = shot.frame.pixels.astype(np.float64).mean(axis=1)
        lit = np.flatnonzero(rows > 1000)
        assert lit.tolist() == list(range(10 * led, 10 * led + 10))
        # 0.5 e/us * 10 ms / 2.5 e/DN + 64 DN
        assert rows[lit].mean() == pytest.approx(2064, abs=2)
    # 1.3 s where nothing else runs, 0.43 of it exposures and settling. If every command had to be
    # repeated once it would be 19.
    assert seconds < 10.0


def test_the_same_seed_gives_the_same_bytes():
    def take():
        with simulated_rig(planes, CONFIG, size=(H, W), noise=NOISE, seed=5, realtime=False) as rig:
            return [rig.shoot(led, 10_000).frame.pixels for led in (3, 3, None, 4)]

    one, other = take(), take()
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(one[0], one[1])


def test_closing_ends_the_boards_process(monkeypatch):
    boards = []

    class Noted(_simulated_rig.VirtualBoard):
        def __init__(self, leds):
            super().__init__(leds)
            boards.append(self)

    monkeypatch.setattr(_simulated_rig, "VirtualBoard", Noted)
    simulated_rig(planes, CONFIG, size=(H, W), noise=NOISE).close()

    def broken(*args, **options):
        raise RigError("the camera does not open")

    monkeypatch.setattr(_simulated_rig, "VirtualCamera", broken)
    with pytest.raises(RigError, match="the camera does not open"):
        simulated_rig(planes, CONFIG, size=(H, W), noise=NOISE)
    assert len(boards) == 2
    for board in boards:
        assert not board.bench_state_path.exists()
        with pytest.raises(ProcessLookupError):
            os.kill(board.pid, 0)


def test_two_rigs_at_once_keep_their_lights_apart():
    options = {"size": (H, W), "noise": NOISE, "noisy": False, "realtime": False}
    with (
        simulated_rig(planes, CONFIG, **options) as one,
        simulated_rig(planes, CONFIG, **options) as other,
    ):
        other.board.on(30, 5000)
        pixels = one.shoot(2, 10_000).frame.pixels
        assert np.flatnonzero(pixels.max(axis=1) > 100).tolist() == list(range(20, 30))
        with pytest.raises(BoardError, match="error 3"):
            other.board.on(36, 100)
