"""The LED of a frame, from the rig to every reader: plan, rig and board must agree."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import CapturePlan, DataError, Session, read_source, record, resume, verify_session
from acquisition.exports import prepare_export
from acquisition.plan import PlannedShot
from acquisition.session import Echo, Manifest, SessionWriter, compact_session
from acquisition.session.light_proof import BOARD, wrong_light
from rig import Rig, RigError, Shot
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, cut
from tests.acquisition.mutants import rows_of, seal

LIGHT = PlannedShot("light", 3, 0, 0, 10.0)
DARK = PlannedShot("dark", None, 0, 0, 10.0)
AMBIENT = PlannedShot("ambient", None, 0, 0, 10.0)
FLAT = PlannedShot("flat", 3, 0, 0, 10.0)
SOME_FLAT = PlannedShot("flat", None, 0, 0, 10.0)


REPORTS = {
    "no report": (LIGHT, {}, None),
    "light": (LIGHT, {"rig": 3, "board": 3}, None),
    "other": (LIGHT, {"rig": 3, "board": 7}, "with LED 3, but board reports LED 7"),
    "rig": (LIGHT, {"rig": 7, "board": 3}, "with LED 3, but rig reports LED 7"),
    "unlit": (LIGHT, {"board": None}, "but board reports all LEDs off"),
    "dark": (DARK, {"board": None}, None),
    "lit dark": (DARK, {"board": 0}, "with all LEDs off, but board reports LED 0"),
    "ambient": (AMBIENT, {"board": None}, None),
    "lit ambient": (AMBIENT, {"board": 1}, "with all LEDs off"),
    "flat": (FLAT, {"board": 3}, None),
    "other flat": (FLAT, {"board": 0}, "with LED 3, but board reports LED 0"),
    "flat of no plan": (SOME_FLAT, {"board": 0}, None),
    "flat without light": (SOME_FLAT, {"board": None}, "with an LED, but board"),
}


@pytest.mark.parametrize(("shot", "lit", "said"), REPORTS.values(), ids=REPORTS)
def test_reports_are_compared_with_the_plan(
    shot: PlannedShot, lit: dict[str, int | None], said: str | None
) -> None:
    found = wrong_light(shot, lit)
    assert found is None if said is None else said in (found or "")


def test_a_board_that_confirms_every_frame_must_report() -> None:
    for shot in (LIGHT, DARK, AMBIENT, FLAT):
        assert "has no echo" in (wrong_light(shot, {}, echoes=True) or "")
        assert wrong_light(shot, {BOARD: shot.led}, echoes=True) is None


def lying(rig: Rig, monkeypatch: pytest.MonkeyPatch, at: int, change: dict[str, Any]) -> None:
    """Make the rig deliver one shot of another LED, like a fault between rig and engine."""
    real = rig.shoot
    shots = [0]

    def shoot(*arguments: Any, **more: Any) -> Shot:
        shots[0] += 1
        shot = real(*arguments, **more)
        if shots[0] != at:
            return shot
        assert shot.echo is not None
        echo = replace(shot.echo, led=change.get("echo", shot.echo.led))
        return replace(shot, led=change.get("led", shot.led), echo=echo)

    monkeypatch.setattr(rig, "shoot", shoot)


# Shots 1 to 4 of the plan are dark and ambient frames, shot 5 is LED 3.
OTHER_LEDS = {
    "shot": (5, {"led": 0}, "L03_E0.tif: was planned with LED 3, but the rig reports LED 0"),
    "echo": (5, {"echo": 0}, "but the LED board reports LED 0"),
    "no light": (5, {"echo": None}, "but the LED board reports all LEDs off"),
    "dark": (1, {"led": 2}, "was planned with all LEDs off, but the rig reports LED 2"),
}


@pytest.mark.parametrize(("at", "change", "said"), OTHER_LEDS.values(), ids=OTHER_LEDS)
def test_a_frame_of_another_led_is_not_kept(
    rig: Rig,
    bench: Bench,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    at: int,
    change: dict[str, Any],
    said: str,
) -> None:
    lying(rig, monkeypatch, at, change)
    with pytest.raises(RigError, match=said):
        record(rig, PLAN, tmp_path / "s", LABELS)
    assert len(Session.open(tmp_path / "s").recorded) == at - 1
    assert bench.led is None
    assert resume(rig, tmp_path / "s").complete


def test_it_is_taken_again_if_the_plan_allows(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lying(rig, monkeypatch, 5, {"led": 0})
    session = record(rig, PLAN.changed(retakes=1), tmp_path / "s", LABELS)
    assert session.complete
    assert bench.shots.count(3) == 3  # one per bracket, and a retake in the first
    assert [line.details["led"] for line in session.events if line.event == "retake"] == [3]
    assert verify_session(tmp_path / "s").ok


def test_a_sequence_ends_at_a_frame_of_another_led(
    rig: Rig, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its later frames may be shifted by one LED, too."""
    real = rig.shoot
    runs: list[list[int | None]] = []

    def sequence(leds: list[int | None], exposure_us: float, gain_db: float) -> Iterator[Shot]:
        runs.append(list(leds))
        for number, led in enumerate(leds):
            shot = real(led, exposure_us, gain_db, trigger="software")
            yield replace(shot, led=0) if (len(runs), number) == (1, 2) else shot

    monkeypatch.setattr(rig, "sequence", sequence)
    rig.config = rig.config.model_copy(update={"trigger": "board"})
    plan = CapturePlan(
        repeat=False, leds=(3, 1, 5, 2), exposures_us=(200.0,), sequence=True, retakes=1
    )
    monkeypatch.setattr(rig, "_arm", lambda trigger: None)
    monkeypatch.setattr(rig, "prepare", lambda *words: None)
    session = record(rig, plan, tmp_path / "s", LABELS)
    assert session.complete
    # The dark frame and that of LED 3 are kept, the next is not; the others are taken again.
    assert (runs[0], runs[1]) == ([None, 3, 1, 5, 2], [1, 5, 2])
    assert verify_session(tmp_path / "s").ok


def test_the_writer_stores_no_frame_of_another_led(tmp_path: Path) -> None:
    camera = {"width": 8, "height": 6, "bit_depth": 12}
    plan = CapturePlan(repeat=False, leds=(3, 7), exposures_us=(100.0,), flats=1)
    manifest = Manifest.begin(tmp_path, plan=plan, camera=camera)
    pixels = np.zeros((6, 8), np.uint16)
    with SessionWriter.create(tmp_path / "s", manifest) as writer:
        dark, light, _, flat = writer.missing
        for shot, led in ((dark, 3), (light, 7), (light, None), (flat, 7), (flat, None)):
            with pytest.raises(DataError, match=rf"{shot.file} was planned with .* board reports"):
                writer.write_frame(shot, pixels, echo=Echo(seq=1, led=led))
        # The LED of a flat is taken from the plan, not from the caller.
        with pytest.raises(DataError, match="was planned with LED 3"):
            writer.write_frame(replace(flat, led=7), pixels, echo=Echo(seq=1, led=7))
        assert list((tmp_path / "s" / "frames").iterdir()) == []
        for shot in writer.missing:
            writer.write_frame(shot, pixels, echo=Echo(seq=1, led=shot.led))
        writer.complete()
    assert verify_session(tmp_path / "s").ok


READERS: dict[str, Callable[[Path], object]] = {
    "open": Session.open,
    "source": read_source,
    "export": lambda folder: prepare_export(folder, "exr"),
    "compact": compact_session,
    "reopen": SessionWriter.reopen,
}


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize(
    ("role", "echo_led", "said"),
    [
        ("light", 0, r"frames/L03_E0\.tif was planned with LED 3, but the LED board reports LED 0"),
        (
            "dark",
            3,
            r"frames/D_200us\.tif was planned with all LEDs off, but the LED board .* LED 3",
        ),
        ("light", None, r"frames/L\d\d_E\d\.tif has no echo"),
        ("dark", None, r"frames/D_\d+us\.tif has no echo"),
        ("ambient", 0, r"frames/A_200us\.tif was planned with all LEDs off"),
        ("flat", 0, r"frames/F_E0\.tif was planned with LED 3, but the LED board reports LED 0"),
    ],
)
def test_every_reader_names_the_line(
    rig: Rig,
    bench: Bench,
    tmp_path: Path,
    role: str,
    echo_led: int | None,
    said: str,
    complete: bool,
) -> None:
    """And `resume` can repair it: the frame is set aside and taken again."""
    folder, plan = tmp_path / "s", PLAN.changed(flats=1)
    if complete:
        record(rig, plan, folder, LABELS)
    else:
        cut(rig, bench, folder, 12, plan)
    rows = rows_of(folder)
    row = next(row for row in rows if row.get("role") == role)
    row["echo"] = None if echo_led is None else row["echo"] | {"led": echo_led}
    seal(folder, rows)
    found = verify_session(folder)
    assert [f"line {row['seq'] + 1}: " in problem for problem in found.problems] == [True]
    assert found.damaged == (row["file"].removeprefix("frames/"),)
    for reader in READERS.values():
        with pytest.raises(DataError, match=rf"journal\.jsonl: line {row['seq'] + 1}: {said}"):
            reader(folder)
    bench.shots.clear()
    with pytest.raises(DataError, match=said):
        resume(rig, folder)
    assert bench.shots == []
    session = resume(rig, folder, retake_damaged=True)
    assert session.complete
    assert len(bench.shots) == (1 if complete else 2)
    assert verify_session(folder).problems == ()


def test_imported_sessions_and_old_ones_have_no_echo(tmp_path: Path) -> None:
    camera = {"width": 8, "height": 6, "bit_depth": 12}
    manifest = Manifest.begin(tmp_path, camera=camera)
    with SessionWriter.create(tmp_path / "s", manifest) as writer:
        for shot in (LIGHT, DARK, SOME_FLAT):
            writer.write_frame(shot, np.zeros((6, 8), np.uint16))
        writer.complete()
    assert verify_session(tmp_path / "s").ok
