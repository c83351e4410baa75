"""Numbers in messages have no exponent."""

import re
from pathlib import Path

import numpy as np
import pytest

import rig
from rig import figure


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (218.4, 2, "220"),
        (0.1234, 2, "0.12"),
        (0.000051, 2, "0.000051"),
        (99.6, 2, "100"),
        (np.float32(12345.6), 3, "12300"),
        (-1234.0, 2, "-1200"),
        (0.0, 2, "0"),
        (float("nan"), 2, "nan"),
        (float("inf"), 2, "inf"),
    ],
)
def test_a_figure_has_its_digits_and_no_exponent(value, digits, text):
    assert figure(value, digits) == text


def test_lengths_in_messages_are_written_by_it():
    pattern = re.compile(r"\{[^{}]*:\.[123]g\} ?(mm|px|µm|\{unit\})")
    root = Path(rig.__file__).parents[1]
    folders = ("rig", "acquisition", "calibration", "processing", "sgp")
    paths = [path for folder in folders for path in (root / folder).rglob("*.py")]
    assert len(paths) > 500
    found = [str(path) for path in paths if pattern.search(path.read_text(encoding="utf-8"))]
    # The units of a sensor are no lengths.
    assert [one for one in found if not one.endswith("calibrate_sensor.py")] == []
