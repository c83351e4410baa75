"""What is done about images that the others contradict."""

import numpy as np
import pytest

from processing.recording.repairs import Repairs, repairs_of
from tests.cases import cases

IDS = ("a", "b", "c", "d", "e")


@cases(
    ("disagreeing", "factors", "left_out"),
    {
        "nothing": ({}, {}, ()),
        "brightness": ({"b": 1.25, "e": 0.5}, {"b": 1.25, "e": 0.5}, ()),
        "another moment": ({"c": None}, {}, ("c",)),
        "both": ({"b": 1.25, "c": None}, {"b": 1.25}, ("c",)),
    },
)
def test_only_brightness_is_repaired(disagreeing, factors, left_out):
    repairs = repairs_of(disagreeing, "torn")
    assert (repairs.factors, repairs.left_out) == (factors, left_out)


def test_factors_and_images_of_a_recording():
    repairs = Repairs({"b": 1.25, "e": 0.5}, ("c",), "torn")
    assert repairs.scales(IDS) == pytest.approx(np.array([1, 1.25, 1, 1, 0.5]))
    assert repairs.kept(IDS) == [0, 1, 3, 4]
    scaled, excluded = repairs.notices()
    assert (scaled.code, excluded.code) == ("images-rescaled", "images-excluded")
    assert scaled.text.endswith("divided by a factor: b (1.25 times), e (0.50 times)")
    assert excluded.text == "1 image is left out because the others contradict them: c (torn)"


def test_nothing_to_repair_is_no_notice():
    assert Repairs().notices() == []
