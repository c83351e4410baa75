"""The same faults in the world and on a real board: a pty, threads and the clock of the system."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from acquisition import DataError, Labels, StorageError, record, resume
from rig import Rig, RigConfig, RigError
from rig.board import Board
from simulator.bench.state import BenchState
from simulator.camera.sensor import ImageFormation
from simulator.led_board.faults import BoardFault, FaultKind
from simulator.led_board.virtual_board import VirtualBoard
from simulator.scene.rig_scenes import bench_sensor
from simulator.world import Schedule, World
from simulator.world.camera import CameraFault, WorldCamera
from simulator.world.invariants import SessionState
from simulator.world.trial import LEDS, PLAN

# Faults whose effect does not depend on the time that a step takes.
KINDS: tuple[FaultKind, ...] = (
    *("drop-command", "double-command", "corrupt-command", "lose-byte-command"),
    *("double-byte-command", "drop-reply", "double-reply", "corrupt-reply", "lose-byte-reply"),
    *("double-byte-reply", "banner", "wrong-led"),
)
CAMERA: tuple[CameraFault, ...] = ("lost", "twice")
CONFIG = RigConfig(name="world", driver="world", leds=LEDS, frame_timeout_s=1.0)
SAME = ("kind", "role", "led", "bracket", "repeat", "file", "file_sha256", "status", "event")
EVEN = ImageFormation(bench_sensor(), noisy=False)


def drawn(seed: int) -> tuple[list[BoardFault], dict[int, CameraFault]]:
    generator = random.Random(f"differential {seed}")
    board = [
        BoardFault(
            kind=(kind := generator.choice(KINDS)),
            verb=generator.choice(("ON", "OFF")),
            skip=generator.randrange(14),
            value=generator.randrange(LEDS if kind == "wrong-led" else 30),
        )
        for _ in range(generator.randrange(4))
    ]
    return board, {generator.randrange(16): generator.choice(CAMERA) for _ in range(2)}


def taken(open_rig: Callable[[], Rig], folder: Path) -> str:
    """Record as an operator does who tries again after an error; return the errors."""
    errors = []
    for _ in range(4):
        try:
            rig = open_rig()
            break
        except RigError as error:
            errors.append(type(error).__name__)
    with rig:
        for _ in range(4):
            try:
                if folder.exists():
                    resume(rig, folder)
                else:
                    record(rig, PLAN, folder, Labels())
                return "; ".join(errors)
            except (RigError, DataError, StorageError) as error:
                errors.append(type(error).__name__)
    return "; ".join([*errors, "incomplete"])


def journal(folder: Path) -> list[dict[str, Any]]:
    lines = SessionState.read(folder).lines
    return [{key: line.get(key) for key in SAME} for line in lines]


def in_world(seed: int, folder: Path) -> tuple[str, list[dict[str, Any]]]:
    board, camera = drawn(seed)
    folder.mkdir()
    world = World(Schedule(seed, ()), folder, leds=LEDS, formation=EVEN)
    world.camera_faults = camera
    for fault in board:
        world.board.add_fault(fault)

    def main() -> str:
        return taken(world.open_rig, world.disk.root / "s")

    ended = world.run("program", main)
    assert ended.error is None
    return str(ended.result), journal(world.disk.root / "s")


def in_reality(seed: int, folder: Path) -> tuple[str, list[dict[str, Any]]]:
    faults, camera = drawn(seed)
    folder.mkdir()
    with VirtualBoard(LEDS) as virtual:
        virtual.set_faults(*faults)

        def open_rig() -> Rig:
            board = Board(virtual.port)
            state = BenchState(virtual.bench_state_path)
            return Rig(board, WorldCamera(LEDS, state, EVEN, camera), CONFIG)

        return taken(open_rig, folder / "s"), journal(folder / "s")


SLOW = [pytest.param(first, marks=pytest.mark.slow) for first in range(8, 200, 48)]


# On a busy computer, a real recording may lose a frame and take it again.
ATTEMPTS = 4


@pytest.mark.parametrize("first", [0, *SLOW])
def test_journals_are_equal(first: int, tmp_path: Path) -> None:
    for seed in range(first, first + (24 if first else 4)):
        world = in_world(seed, tmp_path / f"world{seed}")
        for attempt in range(ATTEMPTS):
            real = in_reality(seed, tmp_path / f"real{seed}-{attempt}")
            if real == world:
                break
        assert real == world, seed
