"""A cause is named only if the size that its text states is significant."""

import numpy as np
import pytest

from acquisition import Lights
from processing.checks.causes import Hypothesis
from processing.checks.contest import Contest
from processing.checks.evidence import Fitted

SIDEWAYS = [0.0, 0.05, 0.0]


@pytest.mark.parametrize(
    ("name", "size", "known"),
    [
        pytest.param("ambient-light", [0.04, 0.0, 0.0], True, id="room light"),
        # Before, this was "room light of 1.5 +- 1 %".
        pytest.param("ambient-light", [0.015, 0.05, 0.0], False, id="more at one side only"),
        pytest.param("lights-tilted", SIDEWAYS, True, id="a turn about one axis"),
        pytest.param("light-brightness", [0.0, 0.0, 0.0, 0.05], True, id="one strength"),
        pytest.param("light-brightness", [0.01, -0.01, 0.01, -0.01], False, id="all strengths"),
    ],
)
def test_the_stated_size_is_significant(name, size, known):
    contest = object.__new__(Contest)
    contest._lights = Lights(directions=np.eye(3)[[0, 1, 2, 2]] + [0, 0, 1])
    size = np.array(size)
    fitted = Fitted(size, np.full(len(size), 0.01), size, size, 100.0, 0.5)
    row = Hypothesis(name, np.zeros((1, len(size))), np.ones(len(size))), fitted
    assert contest._is_known(row) == known
