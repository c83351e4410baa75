from __future__ import annotations

import tomllib
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from acquisition import CapturePlan, DataError, MissingPathError, read_plan
from acquisition.files.text_files import to_toml
from acquisition.plan import PlannedShot


def test_order_and_file_names_of_shots() -> None:
    plan = CapturePlan(
        repeat=False, leds=(7, 2), exposures_us=(10000, 40), repeats=2, dark=True, ambient=True
    )
    names = [shot.file for shot in plan.shots()]
    assert names == [
        *("D_10000us.tif", "D_40us.tif", "A_10000us.tif", "A_40us.tif"),
        *("L07_E0.tif", "L02_E0.tif", "L07_E0_R1.tif", "L02_E0_R1.tif"),
        *("L07_E1.tif", "L02_E1.tif", "L07_E1_R1.tif", "L02_E1_R1.tif"),
    ]
    assert len(set(names)) == len(names)
    assert len({shot.key for shot in plan.shots()}) == len(names)


def test_unlit_frames_are_optional() -> None:
    plan = CapturePlan(repeat=False, leds=(0,), exposures_us=(10.0,), dark=False)
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
    plan = CapturePlan(repeat=False, leds=(0,), exposures_us=(1 / 3, 1 / 3 + 1e-16))
    assert len({shot.file for shot in plan.shots()}) == len(plan.shots())


INVALID_PLANS = {
    "zero-exposure": ("leds=[0]\nexposures_us=[0]", "exposures_us"),
    "negative-exposure": ("leds=[0]\nexposures_us=[-5.0]", "exposures_us"),
    "nan-exposure": ("leds=[0]\nexposures_us=[nan]", "exposures_us"),
    "infinite-exposure": ("leds=[0]\nexposures_us=[inf]", "exposures_us"),
    "no-exposure": ("leds=[0]\nexposures_us=[]", "exposures_us"),
    "same-exposure": ("leds=[0]\nexposures_us=[5,5.0]", "5 appears twice"),
    "no-led": ("leds=[]\nexposures_us=[5]", "leds"),
    "same-led": ("leds=[3,1,3]\nexposures_us=[5]", "3 appears twice"),
    "negative-led": ("leds=[-1]\nexposures_us=[5]", "leds"),
    "led-in-two-ranges": ("leds='3-1,2'\nexposures_us=[5]", "2 appears twice"),
    "range": ("leds='0-'\nexposures_us=[5]", "'0-' is neither an LED number"),
    "no-range": ("leds=''\nexposures_us=[5]", "'' is neither an LED number"),
    "no-such-led": ("leds='0-99999'\nexposures_us=[5]", "there is no LED 99999"),
    "too-many": ("leds='0-65535,0-5'\nexposures_us=[5]", "more than 65536 LEDs"),
    "led-as-text": ("leds=['1']\nexposures_us=[5]", "leds"),
    "no-repeat": ("leds=[0]\nexposures_us=[5]\nrepeats=0", "repeats"),
    "negative-gain": ("leds=[0]\nexposures_us=[5]\ngain_db=-1", "gain_db"),
    "key-missing": ("leds=[0]", "exposures_us"),
    "unknown": ("leds=[0]\nexposures_us=[5]\nled=3", "unknown key 'led'; known are leds"),
    "exposure-as-text": ("leds=[0]\nexposures_us=['5']", "exposures_us"),
    "flag-as-text": ("leds=[0]\nexposures_us=[5]\ndark='yes'", "dark"),
    "negative-flats": ("leds=[0]\nexposures_us=[5]\nflats=-1", "flats"),
    "half-a-retake": ("leds=[0]\nexposures_us=[5]\nretakes=1.5", "retakes"),
    "over-all": ("leds=[0]\nexposures_us=[5]\nmax_clipped_fraction=1.1", "max_clipped"),
    "exposure-of-another-led": (
        "leds=[0]\nexposures_us=[5]\n[exposures_by_led]\n1=[5]",
        "LED 1 is not one of leds",
    ),
    "too-many-exposures": (
        "leds=[0]\nexposures_us=[5]\n[exposures_by_led]\n0=[5,6]",
        "LED 0 has 2 exposures, exposures_us has 1",
    ),
    "same-exposure-of-an-led": (
        "leds=[0]\nexposures_us=[5,6]\n[exposures_by_led]\n0=[7,7]",
        "LED 0 has an exposure twice",
    ),
    "zero": ("leds=[0]\nexposures_us=[5]\n[exposures_by_led]\n0=[0]", "exposures_by_led.0"),
    "led-with-zeros": (
        "leds=[7]\nexposures_us=[5]\n[exposures_by_led]\n07=[6]",
        "'07' is not an LED: write its number",
    ),
    "led-by-its-id": (
        "leds=[7]\nexposures_us=[5]\n[exposures_by_led]\nL07=[6]",
        "'L07' is not an LED",
    ),
    "not-toml": ("leds=[0", "is not TOML"),
    "binary": ("\x00", "is not TOML"),
}


@pytest.mark.parametrize(("toml", "said"), INVALID_PLANS.values(), ids=INVALID_PLANS)
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
    assert [shot.role for shot in plan.shots()][-2:] == ["light", "repeat"]
    path.write_text(f"{path.read_text()}\nrepeat = false")
    assert read_plan(path) == plan.changed(repeat=False)
    assert "repeat" not in {shot.role for shot in read_plan(path).shots()}
    with pytest.raises(MissingPathError):
        read_plan(tmp_path / "other.toml")


def test_a_plan_does_not_change() -> None:
    plan = CapturePlan(repeat=False, leds=(0,), exposures_us=(1.0,))
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
    plan = CapturePlan(repeat=False, leds=leds, exposures_us=(1.0,))
    with nullcontext() if said is None else pytest.raises(DataError, match=said):
        plan.check(36, dead)


BY_LED = CapturePlan(
    repeat=False,
    leds=(4, 1, 7, 2),
    exposures_us=(1000.0, 50.0),
    exposures_by_led={1: (2000.0, 100.0), 2: (2000.0, 50.0)},
    ambient=True,
)


def test_leds_with_exposures_of_their_own() -> None:
    shots = BY_LED.shots()
    assert [(shot.file, shot.exposure_us) for shot in shots if shot.role == "light"] == [
        ("L04_E0.tif", 1000.0),
        ("L07_E0.tif", 1000.0),
        ("L01_E0.tif", 2000.0),
        ("L02_E0.tif", 2000.0),
        ("L04_E1.tif", 50.0),
        ("L07_E1.tif", 50.0),
        ("L02_E1.tif", 50.0),
        ("L01_E1.tif", 100.0),
    ]
    # One dark and one ambient frame for each exposure time in use.
    unlit = [shot.file for shot in shots if shot.led is None]
    assert unlit == [f"{role}_{us}us.tif" for role in "DA" for us in (1000, 2000, 50, 100)]
    assert len({shot.key for shot in shots}) == len(shots)


def test_an_exposure_that_no_led_uses_gets_no_dark_frame() -> None:
    plan = CapturePlan(
        repeat=False, leds=(3,), exposures_us=(1000.0,), exposures_by_led={3: (70.0,)}
    )
    assert [shot.file for shot in plan.shots()] == ["D_70us.tif", "L03_E0.tif"]


@pytest.mark.parametrize(
    ("flats", "lit"),
    [
        pytest.param(1, [4], id="one"),
        pytest.param(2, [4, 7], id="spread"),
        pytest.param(4, [4, 1, 7, 2], id="each-led"),
        pytest.param(6, [4, 4, 1, 7, 7, 2], id="more-than-leds"),
    ],
)
def test_flats_come_last_and_are_lit_by_leds_spread_over_all(flats: int, lit: list[int]) -> None:
    shots = BY_LED.changed(flats=flats).shots()
    assert [shot.role for shot in shots[-2 * flats - 1 :]] == ["light", *["flat"] * (2 * flats)]
    for bracket in (0, 1):
        found = [shot for shot in shots if shot.role == "flat" and shot.bracket == bracket]
        assert [shot.led for shot in found] == lit
        names = [f"F_E{bracket}.tif", *(f"F_E{bracket}_R{n}.tif" for n in range(1, flats))]
        assert [shot.file for shot in found] == names
        assert [shot.key[1] for shot in found] == [None] * flats
        assert [shot.exposure_us for shot in found] == [
            BY_LED.exposure_us(led, bracket) for led in lit
        ]
    assert len({shot.key for shot in shots}) == len({shot.file for shot in shots}) == len(shots)


def test_a_plan_is_the_same_after_writing_and_reading(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_bytes(to_toml(BY_LED.changed(flats=3, retakes=2, sequence=True)))
    assert tomllib.loads(path.read_text())["exposures_by_led"]["1"] == [2000.0, 100.0]
    assert read_plan(path) == BY_LED.changed(flats=3, retakes=2, sequence=True)


def test_dead_leds_are_left_out_and_returned() -> None:
    plan, left_out = BY_LED.without((7, 1, 30))
    assert left_out == (1, 7)
    assert plan.leds == (4, 2)
    assert plan.exposures_by_led == {2: (2000.0, 50.0)}
    plan.check(36, (7, 1, 30))
    assert BY_LED.without((0,)) == (BY_LED, ())
    with pytest.raises(DataError, match="every LED of leds is marked dead"):
        BY_LED.without((1, 2, 4, 7))


def test_a_changed_plan_is_checked() -> None:
    with pytest.raises(DataError, match="LED 9 is not one of leds"):
        BY_LED.changed(exposures_by_led={9: (1.0, 2.0)})


@given(st.data())
def test_every_plan_has_each_file_once_and_an_exposure_for_each(data: st.DataObject) -> None:
    leds = data.draw(st.lists(st.integers(0, 50), min_size=1, max_size=8, unique=True))
    some_us = st.sampled_from([10.0, 12.5, 20.0, 40.0, 1e6])
    brackets = data.draw(st.integers(1, 3))
    exposures = st.lists(some_us, min_size=brackets, max_size=brackets, unique=True).map(tuple)
    plan = CapturePlan(
        repeat=False,
        leds=tuple(leds),
        exposures_us=data.draw(exposures),
        exposures_by_led=data.draw(st.dictionaries(st.sampled_from(leds), exposures)),
        repeats=data.draw(st.integers(1, 3)),
        dark=data.draw(st.booleans()),
        ambient=data.draw(st.booleans()),
        flats=data.draw(st.integers(0, 5)),
    )
    shots = plan.shots()
    assert len({shot.key for shot in shots}) == len({shot.file for shot in shots}) == len(shots)
    lit = [shot for shot in shots if shot.role == "light"]
    assert len(lit) == len(leds) * brackets * plan.repeats
    dark = {shot.exposure_us for shot in shots if shot.role == "dark"}
    assert dark == ({shot.exposure_us for shot in lit} if plan.dark else set())
    # Each LED is taken from its longest to its shortest exposure, within that by repeat and LED;
    # the exposure changes no more often than necessary.
    ranks = [
        sum(plan.exposure_us(shot.led, other) > shot.exposure_us for other in range(brackets))
        for shot in lit
    ]
    assert ranks == sorted(ranks)
    changes = sum(a.exposure_us != b.exposure_us for a, b in pairwise(lit))
    groups = {(rank, shot.repeat, shot.exposure_us) for rank, shot in zip(ranks, lit, strict=True)}
    assert changes < len(groups)
