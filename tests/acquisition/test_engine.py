"""The engine on the real `Rig` with a board and a camera that do as the test says."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pytest

from acquisition._camera_model import CameraModel
from acquisition._engine import record
from acquisition._errors import DataError, StorageError
from acquisition._images import read_image
from acquisition._journal import FrameLine
from acquisition._lights import Lights
from acquisition._noise_model import NoiseModel
from acquisition._plan import CapturePlan
from acquisition._session import Session
from acquisition._session_writer import SessionWriter
from acquisition._verify import verify_session
from rig import (
    Board,
    BoardEcho,
    BoardError,
    BoardIdentity,
    CameraError,
    CameraFrame,
    CameraInfo,
    RigConfig,
    RigError,
)
from rig import Rig as RealRig

LEDS = 6
PLAN = CapturePlan(leds=(3, 0, 5), exposures_us=(200.0, 50.0), ambient=True, gain_db=2.0)
TOLD: dict[str, Any] = {"operator": "Ada", "object_name": "coin"}


def seen(led: int | None, exposure_us: float) -> npt.NDArray[np.uint16]:
    """What the camera sees: a ramp, brighter with LED number and exposure, clipped at 4095."""
    level = 0 if led is None else (led + 1) * exposure_us
    ramp = 64 + level * np.linspace(1, 4, 10)[None, :] * np.ones((7, 1))
    return np.minimum(ramp, 4095).astype(np.uint16)


class Bench:
    """Board and camera in one: what burns, what happened, and what goes wrong when."""

    port = "fake"
    identity = BoardIdentity("fake-board", 1, "1.2.3", LEDS, 10_000)
    info = CameraInfo("Maker", "Eye", "42", 10, 7, "Mono12", 12, None, 10.0, 1e6)

    def __init__(self) -> None:
        self.burning: int | None = None
        self.commands = 0
        self.frames = 0
        self.shots: list[int | None] = []
        self.on_trigger: Callable[[int], None] = lambda number: None
        self.off_fails = False
        self.exposure_us = 0.0
        self.gain_db = 0.0
        self.log: list[str] = []

    def on(self, led: int, hold_ms: float) -> BoardEcho:
        self.burning = led
        self.commands += 1
        return BoardEcho(self.commands, led)

    def off(self) -> BoardEcho:
        if self.off_fails:
            raise BoardError("fake: OFF is not answered")
        burned, self.burning = self.burning, None
        self.commands += 1
        self.log.append("off")
        return BoardEcho(self.commands, burned)

    def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> float:
        # As cameras do: the nearest step they have.
        self.exposure_us, self.gain_db = exposure_us + 0.25, gain_db
        return self.exposure_us

    def trigger(self) -> int:
        self.frames += 1
        self.shots.append(self.burning)
        self.on_trigger(self.frames)
        return self.frames

    def fetch(self, frame_id: int, timeout_s: float) -> CameraFrame:
        pixels = seen(self.burning, self.exposure_us - 0.25)
        return CameraFrame(pixels, frame_id, 1000, self.exposure_us, self.gain_db, 41.5)

    def arm(self) -> None: ...
    def disarm(self) -> None: ...
    def close(self) -> None: ...


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def rig(bench: Bench) -> Iterator[RealRig]:
    config = RigConfig(name="bench-1", driver="fake", leds=LEDS, settle_ms=0, dead_leds=(4,))
    rig = RealRig(cast(Board, bench), bench, config)
    yield rig
    bench.off_fails = False
    rig.close()


def test_a_recording(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    sensor = NoiseModel(2.0, 5.0, 64.0, 12)
    camera = CameraModel(np.array([[50.0, 0, 5], [0, 50, 3], [0, 0, 1]]), 10, 7, 300.0)
    lights = Lights(directions=np.eye(3)[[2, 2, 2, 2, 2, 2]])
    told: list[tuple[str, int, int]] = []

    def on_frame(line: FrameLine, done: int, total: int) -> None:
        assert (tmp_path / "s" / line.file).exists()
        told.append((line.file, done, total))

    session = record(
        rig,
        PLAN,
        tmp_path / "s",
        **TOLD,
        notes="rim scratched",
        camera_model=camera,
        sensor=sensor,
        lights=lights,
        on_frame=on_frame,
    )
    assert session.complete
    assert bench.shots == [None, None, None, None, 3, 0, 5, 3, 0, 5]
    assert bench.burning is None
    assert told == [(f"frames/{shot.file}", done, 10) for done, shot in enumerate(PLAN.shots(), 1)]
    for frame in session.frames:
        planned = PLAN.exposures_us[frame.bracket]
        np.testing.assert_array_equal(frame.read(), seen(frame.led, planned))
        assert frame.exposure_us == planned + 0.25
        assert frame.line.gain_db == 2.0
        assert frame.line.temperature_c == 41.5
        assert frame.line.echo is not None
        assert frame.line.echo.led == frame.led
    assert [frame.line.frame_id for frame in session.frames] == list(range(1, 11))
    manifest = session.manifest
    assert (manifest.operator, manifest.object, manifest.notes) == ("Ada", "coin", "rim scratched")
    assert manifest.plan == PLAN
    assert manifest.rig is not None
    assert (manifest.rig.name, manifest.rig.board, manifest.rig.protocol) == (
        *("bench-1", "fake-board", "1"),
    )
    assert (manifest.camera.model, manifest.camera.serial) == ("Eye", "42")
    assert (manifest.camera.black_level_dn, manifest.camera.white_dn) == (64.0, 4095.0)
    assert session.sensor == sensor
    assert session.camera_model is not None
    assert session.lights is not None
    assert verify_session(tmp_path / "s").ok


def test_quality_is_of_raw_values(rig: RealRig, tmp_path: Path) -> None:
    session = record(rig, PLAN, tmp_path / "s", **TOLD)
    line = next(f.line for f in session.frames if (f.led, f.bracket) == (5, 0))
    pixels = read_image(tmp_path / "s" / line.file)
    # LED 5 at 200 us: 64 + 1200 * (1 ... 4), above 4095 in the last columns.
    assert line.clipped_fraction == np.mean(64 + 1200 * np.linspace(1, 4, 10) >= 4095)
    assert line.percentiles_dn["100"] == 4095
    assert line.percentiles_dn["0"] == 64 + 1200
    assert line.percentiles_dn["50"] == np.sort(pixels.ravel())[34]


@pytest.mark.parametrize(
    ("error", "event"),
    [
        pytest.param(KeyboardInterrupt(), "interrupted", id="ctrl-c"),
        pytest.param(CameraError("frame 6 did not come"), "failed", id="camera"),
        pytest.param(BoardError("unplugged"), "failed", id="board"),
        pytest.param(ZeroDivisionError("a fault of ours"), "failed", id="fault"),
    ],
)
def test_an_error_amid_a_shot(
    rig: RealRig, bench: Bench, tmp_path: Path, error: BaseException, event: str
) -> None:
    def fail(number: int) -> None:
        if number == 6:
            raise error

    bench.on_trigger = fail
    with pytest.raises(type(error)):
        record(rig, PLAN, tmp_path / "s", **TOLD)
    assert bench.burning is None
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete, found.frames, len(found.missing)) == (True, False, 5, 5)
    session = Session.open(tmp_path / "s")
    assert [line.event for line in session.events] == [event]
    assert session.events[0].details["leds_confirmed_off"] is True
    assert session.events[0].details["reason"] in (str(error), type(error).__name__)
    # It can be brought to its end with exactly the missing shots.
    bench.on_trigger = lambda number: None
    with SessionWriter.reopen(tmp_path / "s") as writer:
        assert [shot.led for shot in writer.missing] == [0, 5, 3, 0, 5]


def test_an_error_in_the_callback_finds_the_leds_dark(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    def stop(line: FrameLine, done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(rig, PLAN, tmp_path / "s", **TOLD, on_frame=stop)
    assert bench.burning is None
    assert len(Session.open(tmp_path / "s").frames) == 1


def test_a_full_disk_turns_the_leds_off_before_anything_else(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write

    def full(descriptor: int, data: Any) -> int:
        if bench.frames >= 6:
            bench.log.append("write")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(descriptor, data)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match="No space left"):
        record(rig, PLAN, tmp_path / "s", **TOLD)
    assert bench.log[-2:] == ["write", "off"]
    monkeypatch.undo()
    found = verify_session(tmp_path / "s")
    assert (found.ok, found.complete, found.frames) == (True, False, 5)


def test_leds_that_cannot_be_turned_off_are_told_and_hide_nothing(
    rig: RealRig, bench: Bench, tmp_path: Path
) -> None:
    def fail(number: int) -> None:
        bench.off_fails = True
        raise CameraError("frame 1 did not come")

    bench.on_trigger = fail
    with pytest.raises(CameraError, match="frame 1 did not come") as caught:
        record(rig, PLAN, tmp_path / "s", **TOLD)
    assert caught.value.__notes__ == ["LEDs not confirmed off: fake: OFF is not answered"]
    assert Session.open(tmp_path / "s").events[0].details["leds_confirmed_off"] is False


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        pytest.param({"plan": CapturePlan(leds=(6,), exposures_us=(1,))}, "LED 6", id="no-led"),
        pytest.param({"plan": CapturePlan(leds=(4,), exposures_us=(1,))}, "dead", id="dead-led"),
        pytest.param({"camera_model": CameraModel(np.eye(3), 9, 7)}, "9 x 7 pixels", id="camera"),
        pytest.param({"sensor": NoiseModel(1.0, 1.0, 0.0, 10)}, "10 bits", id="sensor"),
        pytest.param({"operator": None}, "operator", id="no-operator"),
        pytest.param(
            {"lights": Lights(directions=np.eye(3), ids=("L00", "L03", "L04"))},
            r"lights do not fit the plan: .*L05 is not",
            id="light missing",
        ),
        pytest.param(
            {"lights": Lights(directions=np.eye(3)[:2])},
            "lights do not fit the plan: 3 images for 2 lights",
            id="too few lights",
        ),
        pytest.param(
            {"lights": Lights(directions=np.eye(3), ids=("a.0", "a.1", "a.2"))},
            "lights are called a.0 .* the plan lights L03",
            id="lights of something else",
        ),
        pytest.param({"object_name": "\udc80"}, "object", id="no-text"),
    ],
)
def test_what_cannot_be_recorded_is_refused_before_a_folder_is_made(
    rig: RealRig, bench: Bench, tmp_path: Path, changed: dict[str, Any], said: str
) -> None:
    arguments: dict[str, Any] = {"plan": PLAN, **TOLD, **changed}
    with pytest.raises(DataError, match=said):
        record(rig, arguments.pop("plan"), tmp_path / "s", **arguments)
    assert not (tmp_path / "s").exists()
    assert bench.frames == 0


def test_a_used_folder_is_refused_before_a_shot(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    record(rig, PLAN, tmp_path / "s", **TOLD)
    before = {path: path.read_bytes() for path in (tmp_path / "s").rglob("*") if path.is_file()}
    taken = bench.frames
    with pytest.raises(StorageError, match="not empty"):
        record(rig, PLAN, tmp_path / "s", **TOLD)
    assert bench.frames == taken
    assert {path: path.read_bytes() for path in before} == before


def test_a_camera_that_delivers_another_size(
    rig: RealRig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = CameraFrame(np.zeros((7, 9), np.uint16), 1, 0, 200.0, 2.0, None)
    monkeypatch.setattr(bench, "fetch", lambda frame_id, timeout_s: frame)
    with pytest.raises(DataError, match="this session holds"):
        record(rig, PLAN, tmp_path / "s", **TOLD)


def test_rig_errors_are_told_as_they_are(rig: RealRig, bench: Bench, tmp_path: Path) -> None:
    bench.on_trigger = lambda number: setattr(bench, "burning", None)
    with pytest.raises(RigError, match="LED 3 was wanted"):
        record(rig, PLAN, tmp_path / "s", **TOLD)
    assert [frame.led for frame in Session.open(tmp_path / "s").frames] == [None] * 4


def test_on_the_simulated_rig(tmp_path: Path) -> None:
    """Real serial bytes and the board's own process; without noise the frames can be foretold."""
    from simulator._simulated_rig import simulated_rig

    sensor = NoiseModel(1.0, 0.0, 0.0, 12)
    config = RigConfig(name="sim", driver="simulated", leds=4)
    base = np.arange(48, dtype=np.float32).reshape(6, 8)

    def plane(led: int | None) -> npt.NDArray[np.float32]:
        return np.zeros((6, 8), np.float32) if led is None else base * 0.02 * (led + 1)

    plan = CapturePlan(leds=(2, 0, 3), exposures_us=(500.0,))
    with simulated_rig(plane, config, size=(6, 8), noise=sensor, noisy=False) as rig:
        session = record(rig, plan, tmp_path / "s", **TOLD, sensor=sensor)
    assert [frame.led for frame in session.frames] == [None, 2, 0, 3]
    for frame in session.frames:
        expected = plane(frame.led).astype(np.float64) * 500.0
        assert np.abs(frame.read() - expected).max() <= 1.0
    assert verify_session(tmp_path / "s").ok
