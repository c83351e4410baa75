"""The repeat of a light, at the end of a recording and before one is resumed."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    CapturePlan,
    DataError,
    NotAcceptedError,
    RecordingHooks,
    Session,
    StorageError,
    read_source,
    record,
    resume,
    verify_session,
)
from acquisition.engine import recording_loop
from acquisition.session import EventLine, SessionWriter, compact_session
from rig import CameraFrame, CameraInfo, Notice, Rig
from rig.arrays import Float64
from tests.acquisition.fake_bench import LABELS, Bench, cut, events_of, flip, rig_on
from tests.acquisition.interruptions import make_older
from tests.cases import cases

HEIGHT, WIDTH = 96, 128
PLAN = CapturePlan(leds=(3, 0, 5), exposures_us=(200.0, 50.0))
ROLES = ["dark"] * 2 + ["light"] * 6 + ["repeat"]


def relief(right: float = 0.0, seed: int = 1) -> Float64:
    """Return an albedo of waves, 0.2 to 1.8, whose content was moved to the right."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    waves = zip(rng.uniform(-0.5, 0.5, (12, 2)), rng.uniform(0, 6, 12), strict=True)
    return 1 + sum(np.sin(a * (x - right) + b * y + c) for (a, b), c in waves) / 15  # type: ignore[no-any-return]


class Scene(Bench):
    """A bench that sees a relief, which `change` replaces from a given frame on."""

    info = CameraInfo("Maker", "Eye", "42", WIDTH, HEIGHT, "Mono12", 12, None, 10.0, 1e6)

    def __init__(self) -> None:
        super().__init__()
        self.object = relief()
        self.change: Callable[[int], None] = lambda number: None

    def fetch(
        self, frame_id: int, timeout_s: float, waiting: Callable[[], None] | None = None
    ) -> CameraFrame:
        self.change(frame_id)
        light = 0 if self.led is None or self.led in self.dead else 1 + 0.2 * self.led
        mean = 64 + 3 * (self.exposure_us - 0.25) * light * self.object
        noise = np.random.default_rng(frame_id).normal(0, 1 + np.sqrt(mean) / 5)
        pixels = np.clip(np.rint(mean + noise), 0, 4095).astype(np.uint16)
        return CameraFrame(pixels, frame_id, 1000, self.exposure_us, self.gain_db, 41.5)


@pytest.fixture
def scene() -> Scene:
    return Scene()


@pytest.fixture
def stand(scene: Scene) -> Any:
    with rig_on(scene) as rig:
        yield rig


def compared(session: Session) -> list[EventLine]:
    return [line for line in session.events if line.event == "compared"]


def test_a_recording_ends_with_a_repeat_of_its_first_light(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    session = record(stand, PLAN, tmp_path / "s", LABELS)
    assert session.complete
    assert [frame.role for frame in session.frames] == ROLES
    assert scene.shots[-1] == 3
    assert scene.led is None
    repeat = session.frames[-1]
    assert (repeat.led, repeat.line.file) == (3, "frames/R_L03_E0.tif")
    assert repeat.line.above_dark is not None
    (event,) = compared(session)
    assert (event.details["file"], event.details["light"]) == ("R_L03_E0.tif", "L03_E0.tif")
    assert np.linalg.norm(np.array(event.details["shift_px"])) < 0.1
    assert event.details["gain"] == pytest.approx(1, abs=0.01)
    assert event.details["same_object"] is True
    assert session.warnings == ()
    found = verify_session(session.folder)
    assert (found.ok, found.warnings, found.frames) == (True, (), 9)


def test_no_reader_uses_the_repeat(stand: Rig, tmp_path: Path) -> None:
    session = record(stand, PLAN, tmp_path / "s", LABELS)
    source = read_source(session.folder)
    assert [frame.role for frame in source.frames] == ROLES[:-1]
    assert source.light_ids == ("L03", "L00", "L05")
    assert compact_session(session.folder).frames == 9
    assert verify_session(session.folder).ok
    assert [frame.role for frame in read_source(session.folder).frames] == ROLES[:-1]


def test_a_plan_can_turn_the_repeat_off(stand: Rig, tmp_path: Path) -> None:
    plan = PLAN.changed(repeat=False)
    session = record(stand, plan, tmp_path / "s", LABELS)
    assert [frame.role for frame in session.frames] == ROLES[:-1]
    assert compared(session) == []


def test_the_repeat_is_taken_before_the_card_covers_the_object(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    def cover() -> None:
        scene.object = np.ones((HEIGHT, WIDTH))

    hooks = RecordingHooks(before_flats=cover)
    session = record(stand, PLAN.changed(flats=1), tmp_path / "s", LABELS, hooks=hooks)
    assert [frame.role for frame in session.frames] == [*ROLES, "flat", "flat"]
    assert session.warnings == ()


def moved(scene: Scene) -> None:
    scene.object = relief(2.5)


def swapped(scene: Scene) -> None:
    scene.object = relief(seed=2)


def faded(scene: Scene) -> None:
    scene.object = 0.9 * relief()


def covered(scene: Scene) -> None:
    scene.object = 0.1 * relief()


def changed_in_part(scene: Scene) -> None:
    scene.object[32:64, 40:80] = 0.5


CHANGES = {
    "moved": (moved, "frame-shifted", "the camera or the object moved by 2."),
    "another object": (swapped, "object-changed", "of the image does not fit L03_E0.tif"),
    "a part changed": (changed_in_part, "object-changed", "(columns 40 to 79, rows 32 to 63)"),
    "faded": (faded, "light-changed", "the light changed by -10.0%"),
    "covered": (covered, "light-lost", "the light fell to 10.0%"),
}


@cases(("change", "code", "says"), CHANGES)
def test_a_change_during_a_recording_is_named_by_every_reader(
    stand: Rig, scene: Scene, tmp_path: Path, change: Any, code: str, says: str
) -> None:
    scene.change = lambda number: change(scene) if number == 9 else None
    session = record(stand, PLAN, tmp_path / "s", LABELS)
    assert session.complete
    (notice,) = session.warnings
    assert (notice.code, notice.severity) == (code, "warning")
    assert says in notice.text
    assert notice.where.endswith("frames/R_L03_E0.tif")
    assert notice in read_source(session.folder).warnings
    assert notice in verify_session(session.folder).warnings


def interrupted(stand: Rig, scene: Scene, folder: Path, at: int = 6) -> Session:
    """Record until the camera fails; the lights of LEDs 3, 0 and 5 are frames 3, 4 and 5."""
    return Session.open(cut(stand, scene, folder, at, PLAN))


def test_a_resumed_session_begins_with_a_repeat_of_its_last_light(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    interrupted(stand, scene, tmp_path / "s")
    session = resume(stand, tmp_path / "s")
    assert session.complete
    assert scene.shots == [5, 3, 0, 5, 3]
    before, after = compared(session)
    assert (before.details["file"], before.details["light"]) == (None, "L05_E0.tif")
    assert (after.details["file"], after.details["light"]) == ("R_L03_E0.tif", "L03_E0.tif")
    assert before.details["accepted"] == []
    assert session.warnings == ()
    assert len(session.recorded) == 9
    assert verify_session(tmp_path / "s").ok


def test_a_long_exposure_is_repeated_rather_than_a_later_short_one(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    interrupted(stand, scene, tmp_path / "s", 8)
    session = resume(stand, tmp_path / "s")
    assert compared(session)[0].details["light"] == "L05_E0.tif"
    assert scene.shots == [5, 5, 3]


REFUSED = {name: row for name, row in CHANGES.items() if row[1] != "light-changed"}


@cases(("change", "code", "says"), REFUSED)
def test_another_object_is_refused_before_anything_is_written(
    stand: Rig, scene: Scene, tmp_path: Path, change: Any, code: str, says: str
) -> None:
    interrupted(stand, scene, tmp_path / "s")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    change(scene)
    asked: list[str] = []

    def accept(finding: Notice) -> bool:
        asked.append(finding.code)
        return True

    with pytest.raises(NotAcceptedError) as raised:
        resume(stand, tmp_path / "s")
    assert raised.value.finding.code == code
    assert says.replace("L03", "L05") in str(raised.value)
    assert str(raised.value).startswith(f"{tmp_path / 's'}: ")
    assert scene.led is None
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    # Accepted, the session becomes complete, and says what was accepted.
    session = resume(stand, tmp_path / "s", hooks=RecordingHooks(accept=accept))
    assert session.complete
    assert asked == [code]
    assert compared(session)[0].details["accepted"] == [code]
    assert code in {notice.code for notice in session.warnings}


def test_a_light_that_faded_does_not_stop_a_session(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    interrupted(stand, scene, tmp_path / "s")
    faded(scene)
    session = resume(stand, tmp_path / "s")
    assert session.complete
    assert {notice.code for notice in session.warnings} == {"light-changed"}


def test_nothing_is_compared_without_repeat_or_for_flats(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    cut(stand, scene, tmp_path / "off", 6, PLAN.changed(repeat=False))
    swapped(scene)
    assert resume(stand, tmp_path / "off").complete
    assert scene.shots == [3, 0, 5]
    scene.frames, scene.object = 0, relief()
    cut(stand, scene, tmp_path / "flats", 10, PLAN.changed(flats=1))
    swapped(scene)
    assert resume(stand, tmp_path / "flats").complete
    assert scene.shots == [3, 3]


def test_a_damaged_frame_or_a_dead_led_is_passed_over(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    interrupted(stand, scene, tmp_path / "s")
    flip(tmp_path / "s" / "frames" / "L05_E0.tif")
    session = resume(stand, tmp_path / "s", retake_damaged=True)
    assert compared(session)[0].details["light"] == "L00_E0.tif"
    assert scene.shots[0] == 0
    scene.frames = 0
    interrupted(stand, scene, tmp_path / "dead")
    stand.close()
    with rig_on(scene, dead_leds=(4, 5)) as other:
        session = resume(other, tmp_path / "dead")
    assert session.complete
    assert compared(session)[0].details["light"] == "L00_E0.tif"


def test_the_repeat_of_an_led_that_died_is_not_required(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    interrupted(stand, scene, tmp_path / "s")
    stand.close()
    with rig_on(scene, dead_leds=(3, 4)) as other:
        session = resume(other, tmp_path / "s")
    assert session.complete
    assert [shot.file for shot in session.left_out] == ["L03_E1.tif", "R_L03_E0.tif"]
    assert [line.details["file"] for line in compared(session)] == [None]


def test_a_session_of_version_4_is_resumed_without_a_repeat(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    interrupted(stand, scene, tmp_path / "s")
    make_older(tmp_path / "s", 4)
    swapped(scene)
    session = resume(stand, tmp_path / "s", plan=PLAN)
    assert (session.complete, session.format_version) == (True, 4)
    assert [frame.role for frame in session.frames] == ROLES[:-1]
    assert compared(session) == []


def test_a_repeat_in_a_session_of_version_4_is_damage(stand: Rig, tmp_path: Path) -> None:
    record(stand, PLAN, tmp_path / "s", LABELS)
    make_older(tmp_path / "s", 4)
    with pytest.raises(DataError, match="version 4 has no role 'repeat'"):
        Session.open(tmp_path / "s")


def test_frames_too_small_to_compare_are_recorded_all_the_same(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    session = record(rig, PLAN, tmp_path / "s", LABELS)
    assert [frame.role for frame in session.frames] == ROLES
    assert events_of(session) == []


ENDS: dict[str, tuple[BaseException, type[BaseException]]] = {
    "Ctrl-C": (KeyboardInterrupt(), KeyboardInterrupt),
    "disk full": (StorageError(errno.ENOSPC, "full"), StorageError),
}


@cases(("error", "kind"), ENDS)
def test_an_end_before_the_comparison_is_written_is_made_up_for(
    stand: Rig, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Any, kind: Any
) -> None:
    def fail(*_: object) -> None:
        raise error

    with monkeypatch.context() as patched:
        patched.setattr(recording_loop, "compared_repeats", fail)
        with pytest.raises(kind):
            record(stand, PLAN, tmp_path / "s", LABELS)
    assert scene.led is None
    session = Session.open(tmp_path / "s")
    assert (session.complete, session.missing, compared(session)) == (False, (), [])
    scene.shots.clear()
    swapped(scene)  # this changes nothing: no frame is missing
    session = resume(stand, tmp_path / "s")
    assert (session.complete, scene.shots) == (True, [])
    assert [line.details["file"] for line in compared(session)] == ["R_L03_E0.tif"]


WRONG = {
    "text for a number": {"gain": "1"},
    "one shift": {"shift_px": [1.0]},
    "a path": {"light": "../L03_E0.tif"},
    "a share above 1": {"other_fraction": 1.5},
    "no place": {"same_object": False, "other_fraction": 0.5},
}


@cases("wrong", WRONG)
def test_wrong_details_of_a_comparison_are_refused(
    stand: Rig, tmp_path: Path, wrong: dict[str, Any]
) -> None:
    session = record(stand, PLAN, tmp_path / "s", LABELS)
    details = {**compared(session)[0].details, **wrong}
    with (
        SessionWriter.create(tmp_path / "t", session.manifest) as writer,
        pytest.raises(DataError, match="the event 'compared' is invalid"),
    ):
        writer.write_event("compared", **details)
