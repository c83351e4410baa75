"""A virtual board for the tests of the rig, and the light of its LEDs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from acquisition import NoiseModel
from rig import Board, CameraFrame, Rig, RigConfig
from rig.host import clock
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

    def __init__(self, virtual, open_state: Callable[[], BenchState]) -> None:
        self.virtual = virtual
        self.state = open_state()
        self._open_state = open_state

    def rig(self, *, faults=None, on_close: Callable[[], None] = lambda: None, **config) -> Rig:
        config = {"settle_ms": 0, "frame_timeout_s": 0.05, **config}
        return Rig(
            Board(self.virtual.port),
            self.camera(faults=faults),
            RigConfig(name="test", driver="test", **config),
            on_close=on_close,
            open_camera=lambda: self.camera(),
        )

    def camera(self, **options) -> VirtualCamera:
        return VirtualCamera(
            code_plane,
            size=SIZE,
            bench=self._open_state(),
            # 10 electrons per grey value: the LED's code at 1000 us is 100 DN per LED.
            formation=ImageFormation(NoiseModel(10.0, 0.0, 0.0, 12), noisy=False),
            **options,
        )


def led_on(bench: Bench) -> int | None:
    """Return the LED that is on now."""
    return bench.state.led(clock.monotonic_ns())


@pytest.fixture(scope="session", autouse=True)
def _quick_starts(quick_starts) -> None:
    """Fork the boards and cameras; tests/simulator starts them as programs do."""


@contextmanager
def process_bench() -> Iterator[Bench]:
    """Start a board in a process."""
    with VirtualBoard(36) as virtual:
        bench = Bench(virtual, lambda: BenchState(virtual.bench_state_path))
        yield bench
        bench.state.close()


@pytest.fixture(scope="session")
def shared_bench() -> Iterator[Bench]:
    with process_bench() as bench:
        yield bench


@pytest.fixture
def own_bench() -> Iterator[Bench]:
    """A bench for a test that kills the process of its board."""
    with process_bench() as bench:
        yield bench


@pytest.fixture
def bench(world) -> Bench:
    """A bench in virtual time."""
    return Bench(world.board, lambda: world.board.view)


@pytest.fixture
def real_bench(shared_bench: Bench) -> Iterator[Bench]:
    """The bench with a board in a process that all tests share: they leave it alive."""
    shared_bench.virtual.set_faults()
    yield shared_bench
    shared_bench.virtual.set_faults()


@pytest.fixture(params=["world", "process"])
def each_bench(request) -> Bench:
    """A bench in virtual time, and one with a board in a process."""
    return request.getfixturevalue("bench" if request.param == "world" else "real_bench")


@pytest.fixture
def board(bench) -> Iterator[Board]:
    """A client of the bench's virtual board, which is dark."""
    board = Board(bench.virtual.port)
    board.off()
    yield board
    board.close()


@pytest.fixture
def real_board(real_bench) -> Iterator[Board]:
    """A client of the board in a process, which is dark."""
    board = Board(real_bench.virtual.port)
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
