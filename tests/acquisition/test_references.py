"""References of a lit frame: the ambient frame before the dark one, and the longest exposure."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from acquisition import CapturePlan, Session, record, resume
from acquisition.engine.rejection import References
from acquisition.pixels import FrameQuality
from acquisition.plan import PlannedShot
from acquisition.session import CameraRecord
from acquisition.session import writer as _session_writer
from rig import CameraError, Rig, RigError
from rig.arrays import UInt16
from tests.acquisition.fake_bench import LABELS, Bench, seen
from tests.acquisition.test_judging_order import spoil

CAMERA = CameraRecord(width=10, height=7, bit_depth=12, black_level_dn=64)
# The lens is covered for dark frames; the room is never completely dark for the others.
PLAN = CapturePlan(
    repeat=False, leds=(3, 0, 5), exposures_us=(200.0,), dark=True, ambient=True, retakes=1
)
CAPPED_FRAMES = 1
ROOM = 2.0


def figures(level_dn: int) -> FrameQuality:
    """Return the figures of a uniform frame."""
    percentiles = dict.fromkeys(("0", "1", "50", "99", "99.9", "100"), level_dn)
    return FrameQuality(0.0, percentiles, 0.0, float(level_dn))


def shot(role: str, led: int | None = None, exposure_us: float = 500.0) -> PlannedShot:
    return PlannedShot(role, led, 0, 0, exposure_us)  # type: ignore[arg-type]


@pytest.mark.parametrize("order", [("dark", "ambient"), ("ambient", "dark")], ids="-".join)
def test_the_ambient_frame_counts_whichever_was_taken_last(order: tuple[str, str]) -> None:
    references = References(CAMERA)
    levels = {"dark": 64, "ambient": 900}
    for role in order:
        assert references.note(shot(role), figures(levels[role]))
    assert references.dark(shot("light", 1)) == figures(900)
    # A frame no brighter than the room shows no light of the LED.
    assert not references.note(shot("light", 1), figures(900))
    assert references.dark(shot("light", 1, 50.0)) is None


def test_the_longest_exposure_is_the_reference_of_an_led() -> None:
    references = References(CAMERA)
    for exposure_us in (100.0, 400.0, 200.0):
        references.note(shot("dark", None, exposure_us), figures(64))
    for exposure_us, level_dn in ((100.0, 164), (400.0, 464), (200.0, 264)):
        assert references.note(shot("light", 1, exposure_us), figures(level_dn))
    light = references.light(shot("light", 1))
    assert light is not None
    assert (light.exposure_us, light.rise_dn["50"]) == (400.0, 400)
    # The first repeat is the reference: a later one may lack light that the first one had.
    assert references.note(shot("light", 1, 400.0), figures(300))
    assert references.light(shot("light", 1)) == light
    assert references.light(shot("light", 2)) is None
    assert references.light(shot("flat", 1)) is None


def test_what_cannot_be_compared_is_not_judged() -> None:
    references = References(CAMERA)
    unknown = PlannedShot("light", 1, 0, 0, None)
    assert references.note(shot("light", 1), figures(64))
    assert references.note(unknown, figures(64))
    assert references.light(shot("light", 1)) is None
    assert references.note(shot("dark"), figures(64))
    assert references.note(unknown, figures(64))
    assert references.dark(unknown) is None
    assert references.light(shot("dark")) is None


def test_an_led_without_light_is_known_when_it_gives_light() -> None:
    references = References(CAMERA)
    assert references.range_dn == 4095 - 64
    references.note(shot("dark"), figures(64))
    assert not references.note(shot("light", 1), figures(64))
    assert references.light(shot("light", 1)) is None
    assert references.note(shot("light", 1), figures(164))
    light = references.light(shot("light", 1))
    assert light is not None
    assert light.rise_dn["50"] == 100


def test_the_references_of_a_session() -> None:
    """Lines are those of the plan, whose exposures count; unlit frames may be later ones."""
    plan = CapturePlan(repeat=False, leds=(1,), exposures_us=(500.0,))
    dark, lit = figures(64), figures(164)
    rows = [("light", 1, 0, lit), ("dark", None, 0, dark), ("dark", None, 5, lit)]
    frames = [
        SimpleNamespace(
            line=SimpleNamespace(key=(role, led, bracket, 0), exposure_us=7.0, **vars(quality))
        )
        for role, led, bracket, quality in rows
    ]
    for planned, count in ((plan, 1), (None, 0)):
        manifest = SimpleNamespace(camera=CAMERA, plan=planned)
        session = cast(Session, SimpleNamespace(manifest=manifest, frames=frames))
        references = References.of(session)
        assert references.dark(shot("light", 1)) == (dark if count else None)
        assert (references.light(shot("light", 1)) is not None) == bool(count)
        assert references.range_dn == 4095 - 64


def cap(bench: Bench, number: int) -> None:
    """Uncover the lens after the dark frames."""
    bench.room = 0.0 if number <= CAPPED_FRAMES else ROOM


def interrupted(rig: Rig, bench: Bench, folder: Path, at: int) -> None:
    def trigger(number: int) -> None:
        cap(bench, number)
        if number == at:
            raise CameraError("the camera was unplugged")

    bench.on_trigger = trigger
    with pytest.raises(CameraError):
        record(rig, PLAN.changed(retakes=0), folder, LABELS)
    bench.on_trigger = lambda number: cap(bench, number)


@pytest.mark.parametrize("at", [3, 4, 5], ids=["no light yet", "one light", "two lights"])
def test_room_light_is_not_mistaken_for_an_led_after_a_resume(
    rig: Rig, bench: Bench, tmp_path: Path, at: int
) -> None:
    interrupted(rig, bench, tmp_path / "s", at)
    bench.dead = {5}
    with pytest.raises(RigError, match="LED 5 gave no light"):
        resume(rig, tmp_path / "s")
    assert not Session.open(tmp_path / "s").complete


def test_the_difference_from_the_room_light_is_the_same_after_a_resume(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    interrupted(rig, bench, tmp_path / "s", 4)
    session = resume(rig, tmp_path / "s")
    above = {frame.led: frame.line.above_dark for frame in session.frames if frame.led is not None}
    for led in PLAN.leds:
        rise = seen(led, 200.0, room=ROOM).mean() - seen(None, 200.0, room=ROOM).mean()
        assert above[led] == pytest.approx(rise / 4095, abs=1e-6)


def test_a_dark_frame_that_is_taken_again_does_not_replace_the_ambient_one(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is rejected only after it is written, and the ambient frame has been taken by then."""
    real, ambient_is_taken = _session_writer.store_frame, threading.Event()
    journal = tmp_path / "s" / "journal.jsonl"

    def slow(path: Path, pixels: UInt16) -> Any:
        assert ambient_is_taken.wait(30)
        return real(path, pixels)

    monkeypatch.setattr(_session_writer, "store_frame", slow)

    def trigger(number: int) -> None:
        # The lens is covered for dark frames, including the retake.
        bench.room = 0.0 if bench.led is None and number != 2 else ROOM
        if number == 2:
            ambient_is_taken.set()
        # The first LED waits for the disk, so that the dark frame is written before the last one.
        while number == 3 and "D_200us.tif" not in journal.read_text(encoding="utf-8"):
            time.sleep(0.01)

    bench.on_trigger = trigger
    spoil(bench, 1)
    bench.dead = {5}
    plan = PLAN.changed(leds=(3, 0, 1, 2, 5), max_clipped_fraction=0.5)
    with pytest.raises(RigError, match="LED 5 gave no light"):
        record(rig, plan, tmp_path / "s", LABELS)
    names = [frame.path.name for frame in Session.open(tmp_path / "s").recorded]
    assert names[:2] == ["D_200us.tif", "A_200us.tif"]
    assert names.index("D_200us_R1.tif") < names.index("L05_E0.tif")
