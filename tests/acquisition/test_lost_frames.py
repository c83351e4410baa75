"""Frames that are lost between trigger and disk: each shot is taken again, under its own LED."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CapturePlan,
    NoiseModel,
    RecordingHooks,
    Session,
    record,
    resume,
    verify_session,
)
from acquisition.engine import recording_loop
from acquisition.engine import recording_run as _carry_out
from rig import Board, FrameLostError, Rig, RigConfig, RigError
from rig.genicam import open_genicam
from simulator.bench import BenchState
from simulator.camera import GentlCamera
from simulator.gentl import CompilerError
from simulator.led_board import BoardFault, VirtualBoard
from tests.acquisition.fake_bench import LABELS
from tests.cases import cases
from tests.quick_sample import quick
from tests.rig.camera_benches import AwaitedTime
from tests.simulator.camera_options import grouped

LEDS = 8
SIZE = (4, 6)
# A dark frame, then the lights, in one sequence.
PLAN = CapturePlan(repeat=False, leds=tuple(range(LEDS)), exposures_us=(1000.0,), sequence=True)


def _plane(led: int | None) -> np.ndarray:
    """Return a frame with 100 grey values per LED number at 1000 us, black without an LED."""
    return np.full(SIZE, 0.0 if led is None else (led + 1) / 10, np.float32)


def _led_seen(pixels: np.ndarray) -> int | None:
    assert len(np.unique(pixels)) == 1
    code, rest = divmod(int(pixels[0, 0]), 100)
    assert rest == 0
    return code - 1 if code else None


class _Bench:
    """A virtual board, a virtual GenICam camera, and rigs on them."""

    def __init__(self, opened: ExitStack, board: VirtualBoard) -> None:
        self._opened = opened
        self.board = board
        self.state = opened.enter_context(BenchState(self.board.bench_state_path))

    def rig(self, trigger: str = "board", **options: Any) -> Rig:
        try:
            self.camera = self._opened.enter_context(
                GentlCamera(
                    _plane,
                    **grouped(
                        size=SIZE,
                        leds=LEDS,
                        noise=NoiseModel(1.0, 0.0, 0.0, 12),
                        noisy=False,
                        bench_state_path=self.board.bench_state_path,
                        frame_rate_hz=1000.0,
                        **options,
                    ),
                )
            )
        except CompilerError as error:
            pytest.skip(str(error))
        config = RigConfig.model_validate(
            {"name": "lossy", "driver": "bench", "leds": LEDS, "trigger": trigger}
            | {"settle_ms": 0.5, "frame_timeout_s": 0.25, "frame_period_ms": 10}
        )
        rig = Rig(Board(self.board.port), open_genicam(self.camera.cti), config)
        self._opened.callback(rig.close)
        return rig


@pytest.fixture(scope="module")
def board() -> Iterator[VirtualBoard]:
    with VirtualBoard(LEDS) as board:
        yield board


@pytest.fixture
def bench(board: VirtualBoard, monkeypatch: pytest.MonkeyPatch) -> Iterator[_Bench]:
    # A slow disk would end the sequence before the fault occurs.
    monkeypatch.setattr(_carry_out, "ROOM", 99)
    # Frames that do not come are waited for.
    AwaitedTime(monkeypatch, 2)
    board.set_faults()
    with ExitStack() as opened:
        yield _Bench(opened, board)


def _events(session: Session, name: str) -> list[Any]:
    return [line.details for line in session.events if line.event == name]


def _check(session: Session, plan: CapturePlan = PLAN) -> None:
    """Check that every shot of the plan exists once and shows its own LED."""
    assert session.complete
    assert verify_session(session.folder).ok
    assert sorted(frame.path.name for frame in session.frames) == sorted(
        shot.file for shot in plan.shots()
    )
    for frame in session.frames:
        assert _led_seen(frame.read()) == frame.led


_LOSSES: list[Any] = [
    *((kind, (at,), 256) for kind in ("underrun", "lost", "missed") for at in (0, 1, 4, 8)),
    ("incomplete", (0,), 256),
    ("incomplete", (4,), 256),
    ("doubled", (4,), 256),
    ("doubled", (8,), 256),
    ("underrun", (3, 4, 5), 256),
    ("lost", (2, 12), 256),
    ("underrun", (4,), 3),
    ("incomplete", (4,), 3),
    ("lost", (3, 4, 5), 3),
]


@pytest.mark.parametrize(("kind", "at", "most_buffers"), quick(_LOSSES, every=3), ids=str)
def test_a_sequence_is_recorded_completely_despite_lost_frames(
    bench: _Bench, tmp_path: Path, kind: Any, at: tuple[int, ...], most_buffers: int
) -> None:
    rig = bench.rig(most_buffers=most_buffers)
    for frame in at:
        bench.camera.set_fault(frame, kind)
    session = record(rig, PLAN, tmp_path / "s", LABELS)
    _check(session)
    lost = _events(session, "frames_lost")
    assert kind == "doubled" or lost


def test_a_loss_is_journalled_with_the_counters(bench: _Bench, tmp_path: Path) -> None:
    rig = bench.rig(first_block_id=1)
    bench.camera.set_fault(3, "underrun")
    reported: list[tuple[str, Any]] = []
    session = record(
        rig,
        PLAN,
        tmp_path / "s",
        LABELS,
        hooks=RecordingHooks(on_event=lambda *event: reported.append(event)),
    )
    (lost,) = _events(session, "frames_lost")
    started = lost.pop("started")
    assert 3 <= started == lost.pop("delivered") <= 8
    assert lost == {"file": "L02_E0.tif", "led": 2, "underrun": 1, "buffers": 11}
    (retake,) = _events(session, "retake")
    assert "1 frame found none of the 11 buffers free" in retake["reason"]
    assert "too busy" in retake["reason"]
    assert "wire" not in retake["reason"]
    assert (retake["file"], retake["failures"]) == ("L02_E0.tif", 1)
    assert [name for name, _ in reported] == ["camera_settings", "frames_lost", "retake"]


@pytest.mark.parametrize(
    ("kind", "trigger"),
    quick(
        product(("underrun", "lost", "incomplete", "missed"), ("board", "software")),
        every=5,
    ),
)
def test_single_shots_are_taken_again_too(
    bench: _Bench, tmp_path: Path, trigger: str, kind: Any
) -> None:
    plan = PLAN.changed(sequence=False)
    rig = bench.rig(trigger)
    for at in (2, 5):
        bench.camera.set_fault(at, kind)
    session = record(rig, plan, tmp_path / "s", LABELS)
    _check(session, plan)
    assert len(_events(session, "frames_lost")) == 2


@pytest.mark.parametrize("sequence", quick([True, False], every=2))
def test_a_shot_is_not_taken_again_for_ever(
    bench: _Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sequence: bool
) -> None:
    monkeypatch.setattr(recording_loop, "LOST_RETAKES", 1)
    plan = PLAN.changed(sequence=sequence)
    rig = bench.rig()
    for at in range(5, 80):
        bench.camera.set_fault(at, "lost")
    with pytest.raises(RigError) as error:
        record(rig, plan, tmp_path / "s", LABELS)
    assert isinstance(error.value, FrameLostError)
    assert any("was taken 2 times" in note for note in error.value.__notes__)
    session = Session.open(tmp_path / "s")
    assert verify_session(tmp_path / "s").ok
    assert not session.complete
    assert len(_events(session, "frames_lost")) == 2
    assert len(_events(session, "retake")) == 1
    assert session.events[-1].event == "failed"
    assert all(period.end_ns < time.monotonic_ns() for period in bench.state.periods())
    # The camera works again.
    rig.close()
    again = bench.rig()
    _check(resume(again, tmp_path / "s"), plan)


@pytest.mark.parametrize("sequence", [True, False])
def test_a_missing_wire_is_reported_at_once(bench: _Bench, tmp_path: Path, sequence: bool) -> None:
    rig = bench.rig()
    bench.board.set_faults(BoardFault(kind="lose-trigger", times=10_000))
    with pytest.raises(RigError, match="check the wire"):
        record(rig, PLAN.changed(sequence=sequence), tmp_path / "s", LABELS)
    session = Session.open(tmp_path / "s")
    assert len(_events(session, "frames_lost")) == 1
    assert _events(session, "retake") == []


@cases(
    "faults",
    {
        "lost": [BoardFault(kind="lose-trigger", skip=4)],
        "too many": [BoardFault(kind="double-trigger", skip=4, value=5500)],
        "one lost and one extra: the count is right": [
            BoardFault(kind="lose-trigger", skip=2),
            BoardFault(kind="double-trigger", skip=4, value=5500),
        ],
    },
)
def test_no_led_loses_its_frame_if_triggers_do_not_match_frames(
    bench: _Bench, tmp_path: Path, faults: list[BoardFault]
) -> None:
    rig = bench.rig()
    bench.board.set_faults(*faults)
    session = record(rig, PLAN, tmp_path / "s", LABELS)
    _check(session)
    assert _events(session, "frames_lost")


def test_rejected_frames_stay_with_the_plan(
    bench: _Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = bench.rig()
    bench.camera.set_fault(3, "lost")
    fetch = rig.camera.fetch

    def without_led_3(*words: Any) -> Any:
        frame = fetch(*words)
        dim = _led_seen(frame.pixels) == 3
        return replace(frame, pixels=np.zeros(SIZE, np.uint16)) if dim else frame

    monkeypatch.setattr(rig.camera, "fetch", without_led_3)
    with pytest.raises(RigError, match="LED 3 gave no light"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    # The lost shot was taken again, the one without light was not.
    session = Session.open(tmp_path / "s")
    assert [details["file"] for details in _events(session, "retake")] == ["L02_E0.tif"]
