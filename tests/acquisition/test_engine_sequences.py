"""Sequences that the board runs, on the simulated rig."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, NoiseModel, RecordingHooks, record, verify_session
from rig import Rig as RealRig
from rig import RigConfig
from rig.arrays import Float32
from simulator.camera import ImageFormation
from tests.acquisition.fake_bench import LABELS, Gate, events_of


def _plane(led: int | None) -> Float32:
    base = np.arange(48, dtype=np.float32).reshape(6, 8)
    return np.zeros((6, 8), np.float32) if led is None else base * np.float32(0.01 * (led + 1))


def _sequenced_rig() -> RealRig:
    from simulator import simulated_rig

    config = RigConfig(name="sim", driver="simulated", leds=12, trigger="board", settle_ms=0.5)
    sensor = NoiseModel(1.0, 0.0, 0.0, 12)
    return simulated_rig(
        _plane, config, size=(6, 8), camera="inside", formation=ImageFormation(sensor, noisy=False)
    )


SEQUENCE = CapturePlan(
    repeat=False, leds=tuple(range(12)), exposures_us=(500.0, 300.0), sequence=True
)


@pytest.mark.usefixtures("simulated_world")
def test_a_sequence_is_recorded(tmp_path: Path) -> None:
    with _sequenced_rig() as rig:
        session = record(rig, SEQUENCE, tmp_path / "s", LABELS)
    files = [frame.path.name for frame in session.frames]
    assert files == [shot.file for shot in SEQUENCE.shots()]
    assert events_of(session) == []
    for frame in session.frames:
        expected = _plane(frame.led).astype(np.float64) * SEQUENCE.exposures_us[frame.bracket]
        assert np.abs(frame.read() - expected).max() <= 1.0
    assert verify_session(tmp_path / "s").ok


@pytest.mark.usefixtures("simulated_world")
def test_a_sequence_too_fast_for_the_disk_is_ended_and_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)

    def on_event(name: str, details: Any) -> None:
        if name == "paused":
            assert rig.board.status().led is None
            gate.open.set()

    with _sequenced_rig() as rig:
        session = record(
            rig, SEQUENCE, tmp_path / "s", LABELS, hooks=RecordingHooks(on_event=on_event)
        )
    assert session.complete
    assert [line.event for line in session.events][:2] == ["paused", "resumed"]
    files = [frame.path.name for frame in session.frames]
    assert files == [shot.file for shot in SEQUENCE.shots()]
    for frame in session.frames:
        expected = _plane(frame.led).astype(np.float64) * SEQUENCE.exposures_us[frame.bracket]
        assert np.abs(frame.read() - expected).max() <= 1.0
