"""Brackets so short that they show no light, and LEDs that die between brackets."""

from __future__ import annotations

from pathlib import Path

import pytest

from acquisition import CapturePlan, RecordingHooks, Session, record, resume
from rig import Rig, RigError
from tests.acquisition.fake_bench import LABELS, Bench, cut, events_of


@pytest.mark.parametrize("exposures_us", [(200.0, 10.0), (10.0, 200.0)], ids=["E1", "E0"])
@pytest.mark.parametrize("leds", [(0,), (5, 0, 3)], ids=str)
def test_a_bracket_too_short_to_show_its_light_is_kept_and_reported(
    rig: Rig, bench: Bench, tmp_path: Path, exposures_us: tuple[float, ...], leds: tuple[int, ...]
) -> None:
    bench.albedo = 0.02
    reported: list[str] = []
    session = record(
        rig,
        CapturePlan(repeat=False, leds=leds, exposures_us=exposures_us),
        tmp_path / "s",
        LABELS,
        hooks=RecordingHooks(on_event=lambda event, details: reported.append(event)),
    )
    assert session.complete
    short = exposures_us.index(10.0)
    unseen = next(f.line for f in session.frames if (f.led, f.bracket) == (0, short))
    assert (unseen.above_dark, unseen.status) == (0.0, "ok")
    events = [(line.event, line.details) for line in events_of(session)]
    assert events == [("no_light_seen", {"led": 0, "exposure_us": 10.0})]
    assert reported.count("no_light_seen") == 1


@pytest.mark.parametrize("leds", [(0,), (5, 0, 3)], ids=str)
def test_an_led_that_dies_between_brackets_is_detected(
    rig: Rig, bench: Bench, tmp_path: Path, leds: tuple[int, ...]
) -> None:
    plan = CapturePlan(repeat=False, leds=leds, exposures_us=(200.0, 50.0))

    def die(number: int) -> None:
        if number > 2 + len(leds):
            bench.dead = {0}

    bench.on_trigger = die
    with pytest.raises(RigError, match=r"L00_E1\.tif: LED 0 gave no light at 50 us"):
        record(rig, plan, tmp_path / "s", LABELS)
    assert not Session.open(tmp_path / "s").complete


def test_the_light_of_an_led_is_known_after_a_resume(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    bench.albedo = 0.02
    cut(
        rig,
        bench,
        tmp_path / "s",
        4,
        CapturePlan(repeat=False, leds=(0,), exposures_us=(200.0, 10.0)),
    )
    assert resume(rig, tmp_path / "s").complete
