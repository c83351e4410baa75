"""A virtual board for the tests of the rig, and the light of its LEDs."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from acquisition import NoiseModel
from rig import Board, CameraFrame, Rig, RigConfig
from simulator.bench import BenchState
from simulator.camera import ImageFormation, VirtualCamera
from simulator.led_board import VirtualBoard
from tests.rig.camera_benches import GenICamBench

SIZE = (4, 6)


def code_plane(led: int | None) -> np.ndarray:
    """Return a plane that encodes its LED: (LED + 1) electrons per microsecond, 0 if dark."""
    return np.full(SIZE, 0 if led is None else led + 1, np.float32)


def led_seen(frame: CameraFrame) -> int | None:
    """Decode the LED from the pixels: `code_plane` gives 100 DN per LED and 1000 us, 0 if dark."""
    assert frame.pixels.dtype == np.uint16
    assert len(np.unique(frame.pixels)) == 1
    code, rest = divmod(int(frame.pixels[0, 0]), 100)
    assert rest == 0
    return code - 1 if code else None


class Bench:
    """A virtual board with its bench state, and rigs opened on them."""

    def __init__(self) -> None:
        self.virtual = VirtualBoard(36)
        self.state = BenchState(self.virtual.bench_state_path)

    def rig(self, *, faults=None, on_close: Callable[[], None] = lambda: None, **config) -> Rig:
        config = {"settle_ms": 0, "frame_timeout_s": 0.05, **config}
        camera = VirtualCamera(
            code_plane,
            size=SIZE,
            bench=BenchState(self.virtual.bench_state_path),
            faults=faults,
            # 10 electrons per grey value: the LED's code at 1000 us is 100 DN per LED.
            formation=ImageFormation(NoiseModel(10.0, 0.0, 0.0, 12), noisy=False),
        )
        return Rig(
            Board(self.virtual.port),
            camera,
            RigConfig(name="test", driver="test", **config),
            on_close=on_close,
        )

    def close(self) -> None:
        self.state.close()
        self.virtual.close()


def led_on(bench: Bench) -> int | None:
    """Return the LED that is on now."""
    return bench.state.led(time.monotonic_ns())


@pytest.fixture(scope="session")
def shared_bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def bench(shared_bench: Bench) -> Iterator[Bench]:
    """The shared bench, for tests that leave its process alive."""
    shared_bench.virtual.set_faults()
    yield shared_bench
    shared_bench.virtual.set_faults()


@pytest.fixture
def own_bench() -> Iterator[Bench]:
    """A bench for a test that kills its board."""
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def board(bench) -> Iterator[Board]:
    """A client of the bench's virtual board, which is dark."""
    board = Board(bench.virtual.port)
    board.off()
    yield board
    board.close()


@pytest.fixture
def make(tmp_path) -> Iterator[Callable[..., GenICamBench]]:
    """Return a function that creates benches; each is closed after the test."""
    made: list[GenICamBench] = []

    def make(**options):
        folder = tmp_path / f"{len(made)}"
        folder.mkdir()
        made.append(GenICamBench(folder, **options))
        return made[-1]

    yield make
    for bench in made:
        bench.close()
