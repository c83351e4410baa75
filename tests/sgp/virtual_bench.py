"""A bench of a virtual board and a virtual camera, and serial devices of other kinds."""

import contextlib
import json
import os
import threading
import time
import tty
from pathlib import Path

import numpy as np

from acquisition import NoiseModel
from simulator.bench import BenchState
from simulator.camera import GentlCamera
from simulator.led_board import VirtualBoard
from tests.simulator.camera_options import grouped

SIZE = (24, 32)
NOISE = NoiseModel(10.0, 0.0, 64.0, 12)


def plane(led):
    return np.full(SIZE, 0.0 if led is None else led + 1, np.float32)


class Bench:
    """A virtual board and a virtual GenICam camera, as a rig file of the driver ``bench``."""

    def __init__(self, folder: Path, leds: int = 36) -> None:
        self.board = VirtualBoard(leds)
        self.state = BenchState(self.board.bench_state_path)
        self.options = {"port": self.board.port}
        self.keys = {}
        self.file = folder / "rig.toml"
        self._camera = None

    def camera(self, **options):
        self._camera = GentlCamera(
            plane,
            **grouped(
                **{
                    "size": SIZE,
                    "leds": 36,
                    "noise": NOISE,
                    "noisy": False,
                    "serial": "cam-7",
                    "bench_state_path": self.board.bench_state_path,
                    **options,
                }
            ),
        )
        self.options["cti"] = str(self._camera.cti)
        return self._camera

    @property
    def rig(self) -> Path:
        if self._camera is None and "cti" not in self.options:
            self.camera()
        keys = {"name": "bench 1", "driver": "bench", "frame_timeout_s": 0.3, **self.keys}
        tables = ((keys, ""), (self.options, "[options]\n"))
        lines = (
            head + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
            for table, head in tables
        )
        self.file.write_text("".join(lines))
        return self.file

    def dark(self) -> bool:
        return self.state.led(time.monotonic_ns()) is None

    def close(self) -> None:
        self.state.close()
        self.board.close()
        if self._camera is not None:
            self._camera.close()


@contextlib.contextmanager
def device(answer):
    """A serial device of another kind: ``answer`` maps received bytes to sent bytes."""
    master, slave = os.openpty()
    tty.setraw(slave)
    stop = threading.Event()

    def talk():
        os.set_blocking(master, False)
        while not stop.wait(0.01):
            with contextlib.suppress(OSError):
                os.write(master, answer(os.read(master, 4096)))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        stop.set()
        thread.join()
        os.close(master)
        os.close(slave)
