from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from acquisition._errors import DataError, MissingPathError
from acquisition._plan import CapturePlan, PlannedShot, read_plan


def test_shots_come_in_order_and_with_the_names_of_the_format() -> None:
    plan = CapturePlan(leds=(7, 2), exposures_us=(10000, 40), repeats=2, dark=True, ambient=True)
    names = [shot.file for shot in plan.shots()]
    assert names == [
        *("D_10000us.tif", "D_40us.tif", "A_10000us.tif", "A_40us.tif"),
        *("L07_E0.tif", "L02_E0.tif", "L07_E0_R1.tif", "L02_E0_R1.tif"),
        *("L07_E1.tif", "L02_E1.tif", "L07_E1_R1.tif", "L02_E1_R1.tif"),
    ]
    assert len(set(names)) == len(names)
    assert len({shot.key for shot in plan.shots()}) == len(names)


def test_unlit_frames_are_optional() -> None:
    plan = CapturePlan(leds=(0,), exposures_us=(10.0,), dark=False)
    assert plan.shots() == (PlannedShot("light", 0, 0, 0, 10.0),)


@pytest.mark.parametrize(
    ("shot", "number", "file"),
    [
        pytest.param(PlannedShot("dark", None, 0, 0, 12.5), 0, "D_12.5us.tif", id="fraction"),
        pytest.param(PlannedShot("dark", None, 0, 0, 2e6), 0, "D_2000000us.tif", id="seconds"),
        pytest.param(PlannedShot("ambient", None, 1, 0, 40.0), 2, "A_40us_R2.tif", id="retake"),
        pytest.param(PlannedShot("flat", None, 1, 0, None), 0, "F_E1.tif", id="flat"),
        pytest.param(PlannedShot("light", 123, 0, 0, None), 1, "L123_E0_R1.tif", id="big-led"),
    ],
)
def test_file_names(shot: PlannedShot, number: int, file: str) -> None:
    assert shot.take_file(number) == file


def test_exposures_that_differ_in_the_last_digit_have_different_names() -> None:
    plan = CapturePlan(leds=(0,), exposures_us=(1 / 3, 1 / 3 + 1e-16))
    assert len({shot.file for shot in plan.shots()}) == len(plan.shots())


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        pytest.param("leds=[0]\nexposures_us=[0]", "exposures_us", id="zero-exposure"),
        pytest.param("leds=[0]\nexposures_us=[-5.0]", "exposures_us", id="negative-exposure"),
        pytest.param("leds=[0]\nexposures_us=[nan]", "exposures_us", id="nan-exposure"),
        pytest.param("leds=[0]\nexposures_us=[inf]", "exposures_us", id="infinite-exposure"),
        pytest.param("leds=[0]\nexposures_us=[]", "exposures_us", id="no-exposure"),
        pytest.param("leds=[0]\nexposures_us=[5,5.0]", "5 is there twice", id="same-exposure"),
        pytest.param("leds=[]\nexposures_us=[5]", "leds", id="no-led"),
        pytest.param("leds=[3,1,3]\nexposures_us=[5]", "3 is there twice", id="same-led"),
        pytest.param("leds=[-1]\nexposures_us=[5]", "leds", id="negative-led"),
        pytest.param("leds=['1']\nexposures_us=[5]", "leds", id="led-as-text"),
        pytest.param("leds=[0]\nexposures_us=[5]\nrepeats=0", "repeats", id="no-repeat"),
        pytest.param("leds=[0]\nexposures_us=[5]\ngain_db=-1", "gain_db", id="negative-gain"),
        pytest.param("leds=[0]", "exposures_us", id="key-missing"),
        pytest.param(
            "leds=[0]\nexposures_us=[5]\nled=3", "unknown key 'led'; known are leds", id="unknown"
        ),
        pytest.param("leds=[0", "is not TOML", id="not-toml"),
        pytest.param("\x00", "is not TOML", id="binary"),
    ],
)
def test_plan_file_that_is_refused(tmp_path: Path, toml: str, said: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(toml)
    with pytest.raises(DataError) as caught:
        read_plan(path)
    assert str(path) in str(caught.value)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_plan_file(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("leds = [2, 0]\nexposures_us = [20000]\nambient = true\ngain_db = 6")
    plan = CapturePlan(leds=(2, 0), exposures_us=(20000.0,), ambient=True, gain_db=6.0)
    assert read_plan(path) == plan
    with pytest.raises(MissingPathError):
        read_plan(tmp_path / "other.toml")


def test_a_plan_does_not_change() -> None:
    plan = CapturePlan(leds=(0,), exposures_us=(1.0,))
    with pytest.raises(ValidationError):
        plan.repeats = 2


@pytest.mark.parametrize(
    ("leds", "dead", "said"),
    [
        pytest.param((0, 36), (), "LED 36 does not exist, the board has 0 to 35", id="beyond"),
        pytest.param((0, 4), (4,), "LED 4 is marked dead", id="dead"),
        pytest.param((0, 35), (4,), None, id="fits"),
    ],
)
def test_plan_against_board(leds: tuple[int, ...], dead: tuple[int, ...], said: Any) -> None:
    plan = CapturePlan(leds=leds, exposures_us=(1.0,))
    if said is None:
        plan.check(36, dead)
        return
    with pytest.raises(DataError, match=said):
        plan.check(36, dead)
