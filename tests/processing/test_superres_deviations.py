"""Deviations that networks predict, and their correction."""

from __future__ import annotations

import json
import math
import shutil

import numpy as np
import pytest

from processing import NormalMap, super_resolve
from processing.noise import UNIFORM_DEG
from processing.superres import Deviations, read_superres_model


def test_deviations_between_the_measured_ones_and_beyond():
    known = Deviations((0.1, 1, 10), (0.2, 1, 5))
    expected = {
        0.1: 0.2,
        1: 1,
        10: 5,
        math.sqrt(0.1): math.sqrt(0.2),  # halfway in logarithms
        0.01: 0.02,  # the ratio of the first values
        1e10: 5,  # the last value is the limit
    }
    corrected = known.corrected_deg(list(expected))
    assert corrected.dtype == np.float32
    np.testing.assert_allclose(corrected, list(expected.values()), rtol=1e-5)
    assert np.isfinite(known.corrected_deg(0))


BAD = {
    "one value": ((1,), (1,)),
    "none": ((), ()),
    "other counts": ((1, 2), (1, 2, 3)),
    "predictions not increasing": ((1, 1), (1, 2)),
    "errors decreasing": ((1, 2), (2, 1)),
    "zero": ((0, 1), (1, 2)),
    "negative": ((1, 2), (-1, 2)),
    "not a number": ((1, math.nan), (1, 2)),
    "infinite": ((1, 2), (1, math.inf)),
}


@pytest.mark.parametrize("case", BAD)
def test_deviations_that_do_not_fit(case):
    with pytest.raises(ValueError, match="predicted"):
        Deviations(*BAD[case])


def test_the_description_of_a_network_corrects_its_deviations(tmp_path):
    shipped = read_superres_model(None, 4)
    noise = np.random.default_rng(2).normal(scale=0.2, size=(16, 20, 2))
    low = NormalMap.from_vectors(np.dstack([noise, np.ones((16, 20))]))
    made = []
    for number, factor in enumerate((1, 3)):
        path = tmp_path / f"{number}.onnx"
        shutil.copy(shipped.path, path)
        about = json.loads(shipped.path.with_suffix(".json").read_text(encoding="utf-8"))
        about["deviations"] = {
            "predicted_deg": [1e-6, 1e6],
            "actual_deg": [1e-6 * factor, 1e6 * factor],
        }
        path.with_suffix(".json").write_text(json.dumps(about), encoding="utf-8")
        made.append(super_resolve(low, 4, model=path))
    plain, tripled = made
    expected = np.minimum(3 * plain.sigma_deg, UNIFORM_DEG)
    np.testing.assert_allclose(tripled.sigma_deg, expected, rtol=1e-4)
    np.testing.assert_array_equal(tripled.normal_map.normals, plain.normal_map.normals)
