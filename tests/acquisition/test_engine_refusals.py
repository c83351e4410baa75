"""Arguments, plans, folders and cameras that a recording refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    Calibrations,
    CameraModel,
    CapturePlan,
    DataError,
    Labels,
    Lights,
    NoiseModel,
    Session,
    StorageError,
    record,
)
from rig import CameraError, CameraFrame, RigError
from rig import Rig as RealRig
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, events_of

INVALID_ARGUMENTS = {
    "no-led": ({"plan": CapturePlan(repeat=False, leds=(6,), exposures_us=(1,))}, "LED 6"),
    "dead-led": ({"plan": CapturePlan(repeat=False, leds=(4,), exposures_us=(1,))}, "dead"),
    "camera": (
        {"calibrations": Calibrations(camera_model=CameraModel(np.eye(3), 9, 7))},
        "9 x 7 pixels",
    ),
    "sensor": ({"calibrations": Calibrations(sensor=NoiseModel(1.0, 1.0, 0.0, 10))}, "10 bits"),
    "no-operator": ({"labels": replace(LABELS, operator=None)}, "operator"),
    "light missing": (
        {
            "calibrations": Calibrations(
                lights=Lights(directions=np.eye(3), ids=("L00", "L03", "L04"))
            )
        },
        r"lights do not fit the plan: .*L05 does not",
    ),
    "too few lights": (
        {"calibrations": Calibrations(lights=Lights(directions=np.eye(3)[:2]))},
        "lights do not fit the plan: 3 images for 2 lights",
    ),
    "lights of something else": (
        {
            "calibrations": Calibrations(
                lights=Lights(directions=np.eye(3), ids=("a.0", "a.1", "a.2"))
            )
        },
        "lights do not fit the plan: by order, the light a.1 would belong to the image L00",
    ),
    "no-text": ({"labels": Labels("Ada", "\udc80")}, "object"),
}


@pytest.mark.parametrize(("changed", "said"), INVALID_ARGUMENTS.values(), ids=INVALID_ARGUMENTS)
def test_invalid_arguments_are_refused_before_a_folder_is_created(
    rig: RealRig, bench: Bench, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    arguments: dict[str, Any] = {"plan": PLAN, "labels": LABELS, **changed}
    with pytest.raises(DataError, match=said):
        record(rig, folder=tmp_path / "s", **arguments)
    assert not (tmp_path / "s").exists()
    assert bench.frames == 0


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        pytest.param({"gain_db": 500.0}, "Gain: 500 dB", id="gain"),
        pytest.param({"exposures_us": (5.0,)}, "exposes for 10 to", id="camera's exposures"),
        pytest.param({"exposures_us": (9.99e5, 50.0)}, "LED board on fake", id="board's hold"),
    ],
)
def test_plans_that_the_rig_cannot_run_are_refused_before_a_folder_is_created(
    rig: RealRig,
    bench: Bench,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    changed: dict[str, Any],
    said: str,
) -> None:
    configure = bench.configure

    def limited(*, exposure_us: float, gain_db: float = 0.0) -> float:
        if gain_db > 24:
            raise CameraError(f"camera Eye 42, Gain: {gain_db:g} dB is not 0 to 24")
        return configure(exposure_us=exposure_us, gain_db=gain_db)

    monkeypatch.setattr(bench, "configure", limited)
    monkeypatch.setattr(bench, "identity", replace(bench.identity, max_hold_ms=900))
    with pytest.raises(RigError, match=said):
        record(rig, PLAN.changed(**changed), tmp_path / "s", LABELS)
    assert not (tmp_path / "s").exists()
    assert bench.frames == 0


def test_a_used_folder_is_refused_before_a_shot(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    record(rig, PLAN, tmp_path / "s", LABELS)
    before = {path: path.read_bytes() for path in (tmp_path / "s").rglob("*") if path.is_file()}
    taken = bench.frames
    with pytest.raises(StorageError, match="not empty"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert bench.frames == taken
    assert {path: path.read_bytes() for path in before} == before


def test_a_camera_that_delivers_frames_of_another_size(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = CameraFrame(np.zeros((7, 9), np.uint16), 1, 0, 200.0, 2.0, None)
    monkeypatch.setattr(bench, "fetch", lambda *_: frame)
    with pytest.raises(DataError, match="this session requires"):
        record(rig, PLAN, tmp_path / "s", LABELS)


def test_rig_errors_are_raised_unchanged(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    bench.on_trigger = lambda number: setattr(bench, "led", None)
    with pytest.raises(RigError, match="LED 3 was requested"):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert [frame.led for frame in Session.open(tmp_path / "s").frames] == [None] * 4


def test_too_much_clipping_is_refused(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    plan = PLAN.changed(max_clipped_fraction=0.1)
    with pytest.raises(DataError, match=r"L05_E0\.tif: .* clipped at 200 us, the plan allows 10"):
        record(rig, plan, tmp_path / "s", LABELS)
    assert bench.led is None
    assert ("light", 5, 0, 0) in [shot.key for shot in Session.open(tmp_path / "s").missing]


def test_a_sequence_that_the_rig_cannot_run_is_reported(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    session = record(rig, PLAN.changed(sequence=True), tmp_path / "s", LABELS)
    assert [line.event for line in events_of(session)] == ["not_sequenced"]
    assert "trigger = 'software'" in str(events_of(session)[0].details["reason"])
