"""Repeats of the first light during a recording: what they show is asked about at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import (
    CapturePlan,
    DataError,
    NotAcceptedError,
    RecordingHooks,
    Session,
    read_source,
    record,
    resume,
    verify_session,
)
from acquisition.engine import StopRequest, repeat_watch
from acquisition.plan import estimate_plan
from acquisition.session import FrameLine
from acquisition.session.comparisons import compared_repeats
from rig import CameraFrame, Notice, Rig, RigConfig
from rig.arrays import Float32
from rig.host import clock
from simulator import Rendering, render, scene_named, simulated_rig
from simulator.camera import ImageFormation
from simulator.scene import Lamps
from simulator.world import World
from tests.acquisition.fake_bench import LABELS, cut, flip, rig_on
from tests.acquisition.interruptions import make_older
from tests.acquisition.test_repeat import Scene, compared, covered, relief, swapped
from tests.cases import cases
from tests.quick_sample import quick

PLAN = CapturePlan(leds=(3, 0, 5), exposures_us=(200.0, 50.0), repeat_every=2)
FILES = [
    *("D_200us", "D_50us", "L03_E0", "L00_E0", "R_L03_E0", "L05_E0", "L03_E1", "R_L03_E0_R1"),
    *("L00_E1", "L05_E1", "R_L03_E0_R2"),
]


class Steady(Scene):
    """A scene whose frames take 0.1 s: those before are stored and compared by then."""

    def fetch(self, *request: Any) -> CameraFrame:
        clock.sleep(0.1)
        return super().fetch(*request)


@pytest.fixture
def scene(world: World) -> Scene:
    return Steady()


@pytest.fixture
def stand(scene: Scene) -> Any:
    with rig_on(scene) as rig:
        yield rig


def listening() -> tuple[list[Notice], RecordingHooks]:
    """Return hooks that accept every finding, and the list to which they add it."""
    asked: list[Notice] = []

    def accept(finding: Notice) -> bool:
        asked.append(finding)
        return True

    return asked, RecordingHooks(accept=accept)


PLANS = st.builds(
    CapturePlan,
    leds=st.lists(st.integers(0, 9), min_size=1, max_size=5, unique=True).map(tuple),
    exposures_us=st.lists(st.sampled_from([50.0, 200.0, 900.0]), min_size=1, unique=True).map(
        tuple
    ),
    repeats=st.integers(1, 3),
    ambient=st.booleans(),
    flats=st.integers(0, 2),
    repeat_every=st.integers(0, 12),
)


@given(PLANS)
def test_repeats_are_after_every_so_many_lights_and_after_the_last(plan: CapturePlan) -> None:
    shots = plan.shots()
    others = plan.changed(repeat=False, repeat_every=0).shots()
    assert tuple(shot for shot in shots if shot.role != "repeat") == others
    lights = [shot for shot in shots if shot.role == "light"]
    before, found = 0, []
    for shot in shots:
        before += shot.role == "light"
        if shot.role == "repeat":
            assert replace(shot, role="light", repeat=0) == lights[0]
            found.append(before)
    every = plan.repeat_every or len(lights)
    assert found == sorted({*range(every, len(lights), every), len(lights)})
    assert plan.lights_before_repeats == tuple(found)
    numbers = [shot.repeat for shot in shots if shot.role == "repeat"]
    assert numbers == list(range(len(found)))
    assert len({shot.file for shot in shots}) == len({shot.key for shot in shots}) == len(shots)
    assert estimate_plan(plan, width=10, height=10).shots == len(shots)


def test_repeats_every_so_many_lights_need_repeats() -> None:
    with pytest.raises(DataError, match="repeat_every needs repeat = true"):
        PLAN.changed(repeat=False)


def test_repeats_are_compared_and_are_no_lights(stand: Rig, tmp_path: Path) -> None:
    asked, hooks = listening()
    session = record(stand, PLAN, tmp_path / "s", LABELS, hooks=hooks)
    assert [frame.path.stem for frame in session.frames] == FILES
    found = {line.details["file"]: line.details["lights_before"] for line in compared(session)}
    assert found == {"R_L03_E0.tif": 2, "R_L03_E0_R1.tif": 4, "R_L03_E0_R2.tif": 6}
    assert {line.details["light"] for line in compared(session)} == {"L03_E0.tif"}
    assert (session.complete, session.warnings, asked) == (True, (), [])
    assert verify_session(session.folder).ok
    source = read_source(session.folder)
    assert [frame.path.stem for frame in source.frames] == [
        file for file in FILES if not file.startswith("R_")
    ]


def test_a_repeat_waits_until_the_one_before_is_compared(
    stand: Rig, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slowly(*words: Any) -> Any:
        clock.sleep(20)
        return compared_repeats(*words)

    monkeypatch.setattr(repeat_watch, "compared_repeats", slowly)
    scene.change = lambda number: moved(scene) if number == 6 else None
    with pytest.raises(NotAcceptedError):
        record(stand, PLAN.changed(repeats=2), tmp_path / "s", LABELS)
    files = {frame.path.stem for frame in Session.open(tmp_path / "s").frames}
    assert "R_L03_E0_R1" in files
    assert "R_L03_E0_R2" not in files


def moved(scene: Scene) -> None:
    scene.object = relief(1)


CHANGES = {
    "moved": (moved, "frame-shifted", "moved by 0.99 +- 0.01 px"),
    "swapped": (swapped, "object-changed", "does not fit L03_E0.tif"),
    "covered": (covered, "light-lost", "the light fell to 10.0%"),
}


@cases(("change", "code", "says"), CHANGES)
def test_what_makes_a_recording_useless_ends_it_unless_accepted(
    stand: Rig, scene: Scene, tmp_path: Path, change: Any, code: str, says: str
) -> None:
    scene.change = lambda number: change(scene) if number == 6 else None
    events: list[str] = []
    hooks = RecordingHooks(on_event=lambda name, details: events.append(name))
    plan = PLAN.changed(repeats=2)
    with pytest.raises(NotAcceptedError) as raised:
        record(stand, plan, tmp_path / "s", LABELS, hooks=hooks)
    finding = raised.value.finding
    assert (finding.code, finding.where) == (code, str(tmp_path / "s/frames/R_L03_E0_R1.tif"))
    assert says in finding.text
    assert "between the lights 2 and 4" in finding.text
    assert scene.led is None
    assert "compared" in events
    # The session says so, and can be completed.
    session = Session.open(tmp_path / "s")
    assert not session.complete
    assert code in {notice.code for notice in session.warnings}
    assert "accepted" not in events
    taken = len(session.frames)
    scene.shots.clear()
    session = resume(stand, tmp_path / "s")
    assert session.complete
    assert len(scene.shots) == 1 + len(plan.shots()) - taken
    # It is named once, not at each repeat.
    assert [notice.code for notice in session.warnings].count(code) == 1
    assert len(compared(session)) == len(plan.lights_before_repeats) + 1


def test_an_accepted_finding_is_asked_about_with_all_leds_off(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    scene.change = lambda number: moved(scene) if number == 6 else None
    asked: list[Notice] = []

    def accept(finding: Notice) -> bool:
        assert scene.led is None
        asked.append(finding)
        return True

    plan = PLAN.changed(repeats=2)
    session = record(stand, plan, tmp_path / "s", LABELS, hooks=RecordingHooks(accept=accept))
    assert session.complete
    assert [finding.code for finding in asked] == ["frame-shifted"]
    assert session.warnings == tuple(asked)
    assert [line.details for line in session.events if line.event == "accepted"] == [
        {"file": "R_L03_E0_R1.tif", "code": "frame-shifted"}
    ]


def test_a_stop_at_a_question_is_no_refusal(stand: Rig, scene: Scene, tmp_path: Path) -> None:
    scene.change = lambda number: moved(scene) if number == 6 else None
    stop = StopRequest()

    def accept(finding: Notice) -> bool:
        stop.ask("a button")
        return False

    plan = PLAN.changed(repeats=2)
    hooks = RecordingHooks(accept=accept)
    with pytest.raises(KeyboardInterrupt, match="stopped by a button"):
        record(stand, plan, tmp_path / "s", LABELS, hooks=hooks, stop=stop)
    assert Session.open(tmp_path / "s").events[-1].event == "interrupted"


def test_small_changes_are_named_and_do_not_stop(stand: Rig, scene: Scene, tmp_path: Path) -> None:
    def change(number: int) -> None:
        if number == 6:
            scene.object = 0.97 * relief(0.4)

    scene.change = change
    session = record(stand, PLAN.changed(repeats=2), tmp_path / "s", LABELS)
    assert session.complete
    assert [(one.code, Path(one.where).name) for one in session.warnings] == [
        ("frame-drifted", "R_L03_E0_R1.tif"),
        ("light-changed", "R_L03_E0_R1.tif"),
    ]


def test_a_gradual_change_is_named_whenever_it_has_grown_enough(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    def change(number: int) -> None:
        scene.object = relief(0.05 * number)

    scene.change = change
    asked, hooks = listening()
    session = record(stand, PLAN.changed(repeats=4), tmp_path / "s", LABELS, hooks=hooks)
    # 0.05 px per frame, from 0 to about 1.8 px.
    codes = [notice.code for notice in session.warnings]
    assert codes == ["frame-drifted", *["frame-shifted"] * 3]
    assert all("since L03_E0.tif, gradually: put it back" in one.text for one in session.warnings)
    assert asked == [*session.warnings][: len(asked)]


def test_a_light_that_is_damaged_meanwhile_ends_the_recording(stand: Rig, tmp_path: Path) -> None:
    def damage(line: FrameLine) -> None:
        if line.file == "frames/L00_E0.tif":
            flip(tmp_path / "s" / "frames" / "L03_E0.tif")

    with pytest.raises(DataError, match=r"L03_E0\.tif: its pixels differ from those recorded"):
        record(stand, PLAN, tmp_path / "s", LABELS, hooks=RecordingHooks(on_frame=damage))
    assert not Session.open(tmp_path / "s").complete
    assert resume(stand, tmp_path / "s", retake_damaged=True).complete


def test_a_rejected_repeat_is_taken_again_at_once(stand: Rig, scene: Scene, tmp_path: Path) -> None:
    """Frame 5, the first repeat, is clipped: it is taken again before the last one."""
    scene.change = lambda number: setattr(scene, "object", relief() * (9 if number == 5 else 1))
    plan = PLAN.changed(retakes=1, max_clipped_fraction=0.1, repeats=2)
    session = record(stand, plan, tmp_path / "s", LABELS)
    assert (session.complete, session.warnings) == (True, ())
    (rejected,) = (frame for frame in session.recorded if frame.line.status == "rejected")
    assert rejected.path.name == "R_L03_E0.tif"
    (again,) = (one for one in session.frames if one.line.key == rejected.line.key)
    assert again.path.name == f"R_L03_E0_R{len(plan.lights_before_repeats)}.tif"
    (second,) = (one for one in session.frames if one.path.name == "R_L03_E0_R1.tif")
    assert rejected.line.seq < again.line.seq < second.line.seq
    assert len(compared(session)) == len(plan.lights_before_repeats)


@pytest.mark.parametrize("at", quick(range(4, 12), every=2))
def test_a_resumed_recording_has_every_repeat_once(
    stand: Rig, scene: Scene, tmp_path: Path, at: int
) -> None:
    begun = Session.open(cut(stand, scene, tmp_path / "s", at, PLAN))
    missing = [shot.led for shot in begun.missing]
    session = resume(stand, tmp_path / "s", plan=PLAN)
    assert session.complete
    assert scene.shots[-len(missing) :] == missing
    assert len(scene.shots) <= len(missing) + 1
    assert sorted(frame.path.stem for frame in session.frames) == sorted(FILES)
    repeats = [str(line.details["file"]) for line in compared(session) if line.details["file"]]
    assert sorted(repeats) == ["R_L03_E0.tif", "R_L03_E0_R1.tif", "R_L03_E0_R2.tif"]
    assert verify_session(session.folder).ok


def test_a_session_of_version_5_has_no_repeats_between(
    stand: Rig, scene: Scene, tmp_path: Path
) -> None:
    plan = PLAN.changed(repeat_every=0)
    cut(stand, scene, tmp_path / "s", 6, plan)
    make_older(tmp_path / "s", 5)
    session = resume(stand, tmp_path / "s", plan=PLAN)
    assert (session.complete, session.format_version) == (True, 5)
    assert [frame.role for frame in session.frames].count("repeat") == 1


# The simulated stand: a coin under six lamps at 450 mm.

SIZE = 112, 144
LEDS = 6
WATCHED = CapturePlan(leds=tuple(range(LEDS)), exposures_us=(20_000.0,), repeats=4, repeat_every=6)
_EDGE = 8


class View:
    """What the camera sees; `change` is called with the number of each lit exposure, from 1."""

    def __init__(self, name: str) -> None:
        self.right_px = 0
        self.gain = 1.0
        self.blur_px = 0.0
        self.rendering = rendered(name)
        self.change: Callable[[View, int], None] = lambda view, number: None
        self.lit = 0

    def __call__(self, led: int | None) -> Float32:
        if led is not None:
            self.lit += 1
            self.change(self, self.lit)
        plane = np.asarray(self.rendering.plane(led))
        left = _EDGE - self.right_px
        crop = plane[_EDGE:-_EDGE, left : left + SIZE[1]]
        if self.blur_px:
            crop = np.asarray(cv2.GaussianBlur(crop, (0, 0), self.blur_px), np.float32)
        return np.ascontiguousarray(np.float32(self.gain) * crop)

    def rig(self, seed: int, lamps: Lamps, shake_px: float = 0.0, trigger: Any = "software") -> Rig:
        formation = ImageFormation(
            noise=self.rendering.scene.noise, seed=seed, lamps=lamps, shake_px=shake_px
        )
        config = RigConfig(name="stand", driver="simulated", leds=LEDS, trigger=trigger)
        return simulated_rig(
            self, config, size=SIZE, formation=formation, camera="inside", realtime=False
        )


_RENDERED: dict[tuple[str, float], Rendering] = {}


def rendered(name: str, bumped_mm: float = 0.0) -> Rendering:
    """Render a scene whose first lamp was moved, sideways and towards the object."""
    if (name, bumped_mm) not in _RENDERED:
        scene = scene_named(name, width=SIZE[1] + 2 * _EDGE, height=SIZE[0] + 2 * _EDGE, leds=LEDS)
        assert scene.lights.positions_mm is not None
        positions_mm = scene.lights.positions_mm.copy()
        positions_mm[0] += bumped_mm * np.array([0.6, 0.0, -0.8])
        lights = replace(scene.lights, positions_mm=positions_mm)
        _RENDERED[name, bumped_mm] = render(replace(scene, lights=lights))
    return _RENDERED[name, bumped_mm]


def shifted(px: int) -> Callable[[View], None]:
    return lambda view: setattr(view, "right_px", px)


def bumped(mm: float) -> Callable[[View], None]:
    return lambda view: setattr(view, "rendering", rendered("coin", mm))


def dimmed(view: View) -> None:
    view.gain = 0.985


def blurred(view: View) -> None:
    view.blur_px = 0.7


DISTURBED = {
    "1 px": (shifted(1), "frame-shifted", "moved by 1.00 +- 0.01 px (1.00 right, 0.00"),
    "3 px": (shifted(3), "frame-shifted", "moved by 3.00 +- 0.01 px (3.00 right, 0.00"),
    "a bumped lamp": (bumped(10), "light-changed", "its LED moved or the object turned"),
    "a lamp bumped hard": (bumped(60), "light-turned", "its LED moved or the object turned"),
    "out of focus": (blurred, "focus-changed", "of its contrast since L00_E0.tif"),
    "a dimmed light": (dimmed, "light-changed", "the light changed by -1.5% +- 0.1%"),
}


@pytest.mark.usefixtures("simulated_world")
@pytest.mark.parametrize(
    ("sequence", "name"),
    [*((False, name) for name in DISTURBED), *quick(((True, name) for name in DISTURBED), 6)],
)
def test_a_disturbance_in_the_simulator_is_named(tmp_path: Path, sequence: bool, name: str) -> None:
    change, code, says = DISTURBED[name]
    view = View("coin")
    # The first repeat is exposure 7, the second one 14.
    view.change = lambda view, number: change(view) if number == 10 else None
    asked: list[Notice] = []
    with view.rig(3, Lamps(), trigger="board" if sequence else "software") as rig:

        def accept(finding: Notice) -> bool:
            assert rig.board.status().led is None
            asked.append(finding)
            return True

        hooks = RecordingHooks(accept=accept)
        plan = WATCHED.changed(sequence=sequence)
        session = record(rig, plan, tmp_path / "s", LABELS, hooks=hooks)
    (notice,) = session.warnings
    assert (notice.code, Path(notice.where).name) == (code, "R_L00_E0_R1.tif")
    assert says in notice.text
    assert "since L00_E0.tif, between the lights 6 and 12" in notice.text
    assert asked == [notice]


@pytest.mark.usefixtures("simulated_world")
def test_a_drifting_exposure_is_named_as_gradual(tmp_path: Path) -> None:
    view = View("coin")
    view.change = lambda view, number: setattr(view, "gain", 1 - 0.0012 * number)
    with view.rig(1, Lamps()) as rig:
        session = record(rig, WATCHED, tmp_path / "s", LABELS)
    assert {notice.code for notice in session.warnings} == {"light-changed"}
    assert len(session.warnings) == 2
    assert all(", gradually: let the LEDs warm up" in one.text for one in session.warnings[1:])


SCENES = ("coin", "leather", "textile", "scales", "spheres")


@pytest.mark.usefixtures("simulated_world")
@pytest.mark.parametrize("name", quick(SCENES, every=2))
@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 11), marks=pytest.mark.slow)])
def test_undisturbed_recordings_have_no_notice(tmp_path: Path, name: str, seeds: range) -> None:
    """Lamps that flicker by 0.1 %, and a stand that shakes by 0.03 px."""
    for seed in seeds:
        with View(name).rig(seed, Lamps(flicker=0.001), shake_px=0.03) as rig:
            session = record(rig, WATCHED, tmp_path / f"{seed}", LABELS)
        assert len(compared(session)) == 4
        assert session.warnings == (), seed
