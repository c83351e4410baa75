"""What every synthesiser of sheets does, that of docs/extending.md included; Efros and Leung."""

import re
from pathlib import Path

import numpy as np
import pytest

from acquisition import DataError, angle_deg
from processing import NormalMap
from processing.synthesis import SYNTHESIZERS, efros_leung
from tests.processing.scenes import noise

EXTENDING = Path(__file__).parents[2] / "docs" / "extending.md"


def documented():
    """Return the synthesiser in the documentation."""
    text = EXTENDING.read_text(encoding="utf-8")
    names = {}
    exec(re.search(r"```python\n(.*?def shuffled.*?)```", text, re.DOTALL)[1], names)
    return names["shuffled"]


METHODS = {**SYNTHESIZERS, "documented": documented()}


@pytest.mark.parametrize("method", METHODS)
def test_a_synthesiser(method):
    synthesize, heard = METHODS[method], []
    made = synthesize(noise(32), (20, 27), patch=7, seed=1, on_progress=lambda *s: heard.append(s))
    assert made.detail.size == made.labels.shape == (20, 27)
    assert made.detail.mask.all()
    lengths = np.linalg.norm(made.detail.normals.astype(np.float64), axis=2)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)
    assert heard[-1][1] == heard[-1][2] > 0
    same, other = (synthesize(noise(32), (20, 27), patch=7, seed=s).detail.normals for s in (1, 2))
    np.testing.assert_array_equal(same, made.detail.normals)
    assert np.mean(angle_deg(other, same)) > 1
    mean = np.mean(angle_deg(made.detail.normals, [0, 0, 1]))
    assert mean == pytest.approx(np.mean(angle_deg(noise(32).normals, [0, 0, 1])), rel=0.2)
    for size, options in (((0, 9), {"patch": 7}), ((9, 9), {"patch": 1})):
        with pytest.raises(DataError):
            synthesize(noise(32), size, **options)


def test_a_periodic_pattern_is_continued_exactly():
    """A pixel of a pattern with a period has only neighbourhoods that agree exactly."""
    y, x = np.mgrid[:30, :30] % 5
    pattern = NormalMap.from_vectors(np.dstack([0.1 * x, 0.05 * y * x, np.ones_like(x)]))
    made = efros_leung(pattern, (23, 31), patch=5, seed=3).detail.normals
    np.testing.assert_array_equal(made[5:], made[:-5])
    np.testing.assert_array_equal(made[:, 5:], made[:, :-5])
    assert not np.array_equal(made[1:], made[:-1])


@pytest.mark.parametrize(
    ("size", "options", "message"),
    [
        ((20, 20), {"patch": 8}, "8 pixels is not odd"),
        ((20, 20), {"seed": -1}, "seed of -1"),
        ((20, 20), {"patch": 33}, "less than a patch of 33 x 33"),
        ((9000, 9000), {}, "take too long pixel by pixel"),
    ],
)
def test_bad_input(size, options, message):
    with pytest.raises(DataError, match=message):
        efros_leung(noise(32), size, **options)
