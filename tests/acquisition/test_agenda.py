"""The order of the remaining shots, also after some are taken again."""

from __future__ import annotations

from collections import deque
from typing import Any

import pytest

from acquisition import CapturePlan
from acquisition.engine.shot_order import Agenda
from acquisition.plan import PlannedShot


def test_a_rejected_shot_is_added_before_those_judged_by_it_otherwise_last() -> None:
    plan = CapturePlan(repeat=False, leds=(0, 1), exposures_us=(200.0, 50.0), flats=1)
    shots = plan.shots()
    by_name = {shot.file: shot for shot in shots}

    def order_with(again: str, behind: int) -> list[str]:
        agenda = Agenda(shots[behind:])
        agenda.again(by_name[again])
        return [shot.file for shot in agenda.take(lambda shot: True)]

    assert [shot.file for shot in shots] == [
        *("D_200us.tif", "D_50us.tif"),
        *("L00_E0.tif", "L01_E0.tif", "L00_E1.tif", "L01_E1.tif"),
        *("F_E0.tif", "F_E1.tif"),
    ]
    assert order_with("D_200us.tif", 2)[0] == "D_200us.tif"
    assert order_with("D_50us.tif", 2)[1:4] == ["L01_E0.tif", "D_50us.tif", "L00_E1.tif"]
    assert order_with("L00_E0.tif", 3)[:3] == ["L01_E0.tif", "L00_E0.tif", "L00_E1.tif"]
    assert order_with("L00_E1.tif", 5)[:3] == ["L01_E1.tif", "L00_E1.tif", "F_E0.tif"]
    assert order_with("F_E0.tif", 7) == ["F_E0.tif", "F_E1.tif"]
    assert order_with("F_E1.tif", 8) == ["F_E1.tif"]


# Shots as role, LED and exposure time.
DARK, AMBIENT = ("dark", None, 200.0), ("ambient", None, 200.0)
LONG, SHORT, OTHER = ("light", 0, 200.0), ("light", 0, 50.0), ("light", 1, 50.0)
REPEAT = ("repeat", 0, 200.0)
FLAT, FLAT_OF_1 = ("flat", 0, 200.0), ("flat", 1, 200.0)
UNKNOWN = ("light", 0, None)


@pytest.mark.parametrize(
    ("again", "left", "place"),
    [
        pytest.param(DARK, [AMBIENT, LONG], 1, id="dark, after an ambient frame"),
        pytest.param(DARK, [SHORT, LONG], 1, id="dark, before the first of its exposure"),
        pytest.param(DARK, [SHORT, OTHER], 2, id="dark, of no other exposure"),
        pytest.param(DARK, [SHORT, FLAT], 1, id="dark, before the flat of its exposure"),
        pytest.param(LONG, [LONG, SHORT], 1, id="before a shorter one, after an equal one"),
        pytest.param(LONG, [OTHER, SHORT], 1, id="after another LED"),
        pytest.param(SHORT, [LONG, OTHER], 2, id="after a longer one"),
        pytest.param(LONG, [OTHER, FLAT], 1, id="before the flats"),
        pytest.param(FLAT, [FLAT_OF_1, FLAT], 2, id="flat at the end"),
        pytest.param(OTHER, [REPEAT, LONG, REPEAT, FLAT], 2, id="before the last repeat"),
        pytest.param(REPEAT, [OTHER, REPEAT, FLAT], 0, id="repeat, with another to come"),
        pytest.param(REPEAT, [OTHER, FLAT], 1, id="last repeat, before the flats"),
        pytest.param(LONG, [UNKNOWN, OTHER], 2, id="exposure of the other unknown"),
        pytest.param(UNKNOWN, [SHORT, LONG], 2, id="its exposure unknown"),
    ],
)
def test_where_a_rejected_shot_is_added(again: Any, left: list[Any], place: int) -> None:
    shots = [PlannedShot(role, led, 0, 0, exposure_us) for role, led, exposure_us in left]
    agenda = Agenda(shots)
    rejected = PlannedShot(again[0], again[1], 0, 1, again[2])
    agenda.again(rejected)
    assert len(agenda) == len(left) + 1
    assert list(agenda.take(lambda shot: True)) == [*shots[:place], rejected, *shots[place:]]


def test_shots_are_taken_and_put_back() -> None:
    shots = CapturePlan(repeat=False, leds=(0, 1), exposures_us=(200.0,)).shots()
    agenda = Agenda(shots)
    assert (len(agenda), agenda.first) == (3, shots[0])
    assert list(agenda.take()) == [shots[0]]
    assert list(agenda.take(lambda shot: shot.led == 0)) == [shots[1]]
    agenda.put_back(deque(shots[:2]))
    assert agenda.lights_left
    assert list(agenda.take(lambda shot: shot.led == 0)) == list(shots[:2])
    assert list(agenda.take(lambda shot: True)) == [shots[2]]
    assert (len(agenda), agenda.lights_left) == (0, False)
