"""No shot is judged before its reference frames are known, even after retakes of these."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, NoiseModel, Session, record, resume
from acquisition.engine import engine as _engine
from acquisition.session import writer as _session_writer
from rig import CameraError, CameraFrame, Rig, RigConfig, RigError
from rig.arrays import Float32, UInt16
from rig.host import clock
from simulator.camera import ImageFormation
from tests.acquisition.fake_bench import LABELS, Bench, cut, events_of, seen

pytestmark = pytest.mark.usefixtures("simulated_world")


def spoil(camera: Any, number: int) -> None:
    """Make one frame saturated."""
    real, numbers = camera.fetch, count(1)

    def fetch(*words: Any) -> CameraFrame:
        frame: CameraFrame = real(*words)
        if next(numbers) != number:
            return frame
        return replace(frame, pixels=np.full_like(frame.pixels, 4095))

    camera.fetch = fetch


def sequenced_rig(light: dict[int, float]) -> Rig:
    """Return a rig with uniform LEDs of the given brightness, grey values per microsecond."""
    from simulator import simulated_rig

    def plane(led: int | None) -> Float32:
        return np.full((6, 8), 0.0 if led is None else light[led], np.float32)

    config = RigConfig(name="sim", driver="simulated", leds=3, trigger="board", settle_ms=0.5)
    sensor = NoiseModel(1.0, 0.0, 0.0, 12)
    return simulated_rig(
        plane, config, size=(6, 8), camera="inside", formation=ImageFormation(sensor, noisy=False)
    )


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    real = _session_writer.store_frame

    def slow(path: Path, pixels: UInt16) -> Any:
        clock.sleep(0.05)
        return real(path, pixels)

    monkeypatch.setattr(_session_writer, "store_frame", slow)


@pytest.mark.parametrize("role", ["dark", "ambient"])
@pytest.mark.usefixtures("slow_disk")
def test_a_rejected_dark_frame_is_not_a_reference(
    rig: Rig, bench: Bench, tmp_path: Path, role: str
) -> None:
    """The door was open during the first dark frame: only this frame is retaken, first of all."""
    plan = CapturePlan(
        repeat=False,
        leds=(3, 0),
        exposures_us=(200.0, 50.0),
        dark=role == "dark",
        ambient=role == "ambient",
        retakes=1,
        max_clipped_fraction=0.5,
    )
    spoil(bench, 1)
    session = record(rig, plan, tmp_path / "s", LABELS)
    assert bench.shots == [None, None, None, 3, 0, 3, 0]
    rejected = [frame.line for frame in session.recorded if frame.line.status == "rejected"]
    assert [line.role for line in rejected] == [role]
    for frame in session.frames:
        if frame.led is not None:
            planned = plan.exposures_us[frame.bracket]
            above = seen(frame.led, planned).mean() - seen(None, planned).mean()
            assert frame.line.above_dark == pytest.approx(above / 4095, abs=1e-6)


@pytest.mark.usefixtures("slow_disk")
def test_a_long_exposure_is_retaken_before_a_short_one_is_judged_by_it(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    bench.albedo = 0.02
    plan = CapturePlan(
        repeat=False, leds=(0, 3), exposures_us=(10.0, 200.0), retakes=1, max_clipped_fraction=0.5
    )
    spoil(bench, 3)  # the first shot of LED 0
    session = record(rig, plan, tmp_path / "s", LABELS)
    assert bench.shots == [None, None, 0, 3, 0, 0, 3]
    rejected = [frame.line for frame in session.recorded if frame.line.status == "rejected"]
    assert [(line.led, line.bracket) for line in rejected] == [(0, 1)]
    assert [line.event for line in events_of(session)] == ["retake", "no_light_seen"]


@pytest.mark.usefixtures("slow_disk")
def test_a_sequence_has_no_shot_that_cannot_be_judged_yet(tmp_path: Path) -> None:
    """50 us are too short for LED 0 and sufficient for LED 1: one exposure, two ranks."""
    plan = CapturePlan(
        repeat=False,
        leds=(0, 1, 2),
        exposures_us=(50.0, 40.0),
        exposures_by_led={0: (900.0, 50.0)},
        sequence=True,
    )
    with sequenced_rig({0: 0.009, 1: 1.0, 2: 1.0}) as sequenced:
        session = record(sequenced, plan, tmp_path / "s", LABELS)
    assert session.complete
    reported = [line.details for line in session.events if line.event == "no_light_seen"]
    assert reported == [{"led": 0, "exposure_us": 50.0}]


def test_a_sequence_ends_with_a_dark_frame_that_is_rejected(tmp_path: Path) -> None:
    plan = CapturePlan(
        repeat=False,
        leds=(0, 1, 2),
        exposures_us=(500.0,),
        sequence=True,
        retakes=1,
        max_clipped_fraction=0.5,
    )
    with sequenced_rig({0: 1.0, 1: 1.0, 2: 1.0}) as sequenced:
        spoil(sequenced.camera, 1)
        session = record(sequenced, plan, tmp_path / "s", LABELS)
    takes = [(frame.path.name, frame.line.status) for frame in session.recorded]
    lights = [(f"L{led:02d}_E0.tif", "ok") for led in plan.leds]
    assert takes == [("D_500us.tif", "rejected"), ("D_500us_R1.tif", "ok"), *lights]
    above = [frame.line.above_dark for frame in session.frames if frame.role == "light"]
    assert above == [pytest.approx(500 / 4095, abs=1e-3)] * 3


def test_frames_that_another_process_added_are_references_too(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its dark frames were added after the session was read and before it was locked."""
    cut(
        rig, bench, tmp_path / "s", 1, CapturePlan(repeat=False, leds=(3, 0), exposures_us=(200.0,))
    )
    real = _engine._fitting

    def looked_at_early(*words: Any, **more: Any) -> Any:
        found = real(*words, **more)
        monkeypatch.setattr(_engine, "_fitting", real)
        bench.unplug_at(3)
        with pytest.raises(CameraError):
            resume(rig, tmp_path / "s")
        bench.on_trigger = lambda number: None
        bench.dead = {0}
        return found

    monkeypatch.setattr(_engine, "_fitting", looked_at_early)
    with pytest.raises(RigError, match="LED 0 gave no light"):
        resume(rig, tmp_path / "s")
    assert not Session.open(tmp_path / "s").complete
