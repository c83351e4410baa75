"""What is done about images that the others contradict."""

import numpy as np

from processing.checks.scheme_check import Disagreement, SchemeCheck
from processing.recording.repairs import Repairs, repairs_of
from tests.cases import cases

BRIGHT = Disagreement(1, "brightness", 1.25, "1.25 times as bright as expected")
DARK = Disagreement(4, "brightness", 0.5, "0.50 times as bright as expected")
STRANGE = Disagreement(2, "foreign", 0.3, "deviates by 30% of the signal under any light")
IDS = ("a", "b", "c", "d", "e")


@cases(
    ("found", "undecided", "factors", "left_out"),
    {
        "nothing": ((), False, {}, {}),
        "brightness": ((BRIGHT, DARK), False, {1: 1.25, 4: 0.5}, {}),
        "another moment": ((STRANGE,), False, {}, {2: STRANGE.text}),
        "both": ((BRIGHT, STRANGE), False, {1: 1.25}, {2: STRANGE.text}),
        "not known": ((BRIGHT, STRANGE), True, {}, {}),
    },
)
def test_only_brightness_is_repaired(found, undecided, factors, left_out):
    repairs = repairs_of(SchemeCheck(found, undecided, True))
    assert (repairs.factors, repairs.left_out) == (factors, left_out)


def test_factors_and_images_of_a_recording():
    repairs = Repairs({4: 0.5, 1: 1.25}, {2: "torn"})
    assert np.array_equal(repairs.scales(5), [1, 1.25, 1, 1, 0.5])
    assert repairs.kept(5) == [0, 1, 3, 4]
    scaled, excluded = repairs.notices(IDS)
    assert (scaled.code, excluded.code) == ("images-rescaled", "images-excluded")
    assert scaled.text.endswith("divided by a factor: b (1.25 times), e (0.50 times)")
    assert excluded.text == "1 image is left out because the others contradict them: c (torn)"


def test_nothing_to_repair_is_no_notice():
    assert Repairs().notices(IDS) == []
