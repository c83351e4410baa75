"""Transfer curves as values and as files: the formula of sRGB, inverses, and refusals."""

from __future__ import annotations

from decimal import Decimal, getcontext
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import LINEAR, SRGB, DataError, MissingPathError, TransferCurve
from acquisition.value_files import read_transfer


def srgb_light(sample: int) -> float:
    """Return the light of an 8-bit sample by IEC 61966-2-1, computed with 40 digits."""
    getcontext().prec = 40
    value = Decimal(sample) / 255
    if value <= Decimal("0.04045"):
        return float(value / Decimal("12.92"))
    return float(((value + Decimal("0.055")) / Decimal("1.055")) ** Decimal("2.4"))


def test_every_8_bit_sample_has_the_light_of_the_standard() -> None:
    light = SRGB.light(np.arange(256) / 255)
    np.testing.assert_allclose(light, [srgb_light(k) for k in range(256)], rtol=1e-13)
    assert light[0] == 0
    assert light[255] == 1


CURVES = {
    "linear": LINEAR,
    "sRGB": SRGB,
    "gamma 2.2": TransferCurve.power(2.2),
    "gamma 0.5": TransferCurve.power(0.5),
    "a table of 3 points": TransferCurve.table([[0, 0], [100, 3], [255, 20]]),
}


@pytest.mark.parametrize("name", CURVES)
@given(light=st.floats(0, 1))
def test_samples_are_the_inverse_of_light(name: str, light: float) -> None:
    curve = CURVES[name]
    assert curve.light(curve.samples(light)) == pytest.approx(light, abs=1e-6)


@pytest.mark.parametrize("name", CURVES)
def test_curves_keep_black_white_and_order(name: str) -> None:
    curve = CURVES[name]
    assert curve.name == name
    assert (curve.light(0.0), curve.light(1.0)) == (0, 1)
    grid = np.linspace(0, 1.5, 2000)
    assert (np.diff(curve.light(grid)) > 0).all()
    assert (np.diff(curve.samples(grid)) > 0).all()
    assert curve.light(-0.1) == (-0.1 if curve == LINEAR else 0)


@given(st.lists(st.tuples(st.integers(1, 500), st.integers(1, 500)), min_size=1, max_size=40))
def test_tables_pass_through_their_points(steps: list[tuple[int, int]]) -> None:
    points = np.cumsum([(0, 0), *steps], axis=0)
    curve = TransferCurve.table(points)
    white = points[-1]
    np.testing.assert_allclose(curve.light(points[:, 0] / white[0]), points[:, 1] / white[1])


def test_a_power_of_1_is_linear() -> None:
    assert TransferCurve.power(1) == LINEAR


@pytest.mark.parametrize(
    ("make", "said"),
    [
        pytest.param(lambda: TransferCurve.power(0.0), "give 0.1 to 10", id="power 0"),
        pytest.param(lambda: TransferCurve.power(float("nan")), "give 0.1 to 10", id="power nan"),
        pytest.param(lambda: TransferCurve.power(11), "give 0.1 to 10", id="power 11"),
        pytest.param(lambda: TransferCurve("power"), "only a power", id="no exponent"),
        pytest.param(lambda: TransferCurve("srgb", 2.2), "only a power", id="sRGB power"),
        pytest.param(lambda: TransferCurve("table"), "only a table", id="no points"),
        pytest.param(lambda: TransferCurve("pq"), "linear, srgb, power", id="kind"),  # type: ignore[arg-type]
        pytest.param(lambda: TransferCurve.table([]), "2 to 4096 pairs", id="empty table"),
        pytest.param(lambda: TransferCurve.table([[0, 0]]), "2 to 4096 pairs", id="one point"),
        pytest.param(lambda: TransferCurve.table(["a"]), "pairs of numbers", id="text"),
        pytest.param(
            lambda: TransferCurve.table(np.zeros((5000, 2))), "2 to 4096 pairs", id="too long"
        ),
        pytest.param(lambda: TransferCurve.table([[0, 1], [1, 2]]), "begins with 0", id="black"),
        pytest.param(
            lambda: TransferCurve.table([[0, 0], [1, 1], [1, 2]]), "increases in both", id="flat"
        ),
        pytest.param(
            lambda: TransferCurve.table([[0, 0], [1, 3], [2, 2]]), "increases in both", id="falls"
        ),
        pytest.param(
            lambda: TransferCurve.table([[0, 0], [1, np.nan], [2, 2]]), "finite", id="NaN"
        ),
        pytest.param(lambda: TransferCurve.table([[0, 0], [-1, -1]]), "above 0", id="negative"),
    ],
)
def test_curves_that_are_refused(make, said: str) -> None:
    with pytest.raises(DataError, match=said):
        make()


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("0,0\n100,1\n255,10\n", id="commas"),
        pytest.param("0;0\n100 ; 1\n255;10", id="semicolons"),
        pytest.param("sample;light\n0,0;0\n100;1,0\n255;10", id="decimal commas"),
        pytest.param("0 0\n100\t1\n255   10\n", id="spaces"),
        pytest.param("sample,light\n# measured\n0,0\n\n100,1\n255,10\n", id="header and comment"),
        pytest.param("﻿0,0\r\n1e2,1\r\n255,1e1\r\n", id="of another system"),
    ],
)
def test_tables_in_files(tmp_path: Path, text: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text, encoding="utf-8", newline="")
    assert read_transfer(path) == TransferCurve.table([[0, 0], [100, 1], [255, 10]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        pytest.param("", "2 to 4096 pairs", id="empty"),
        pytest.param("0,0\nx,1\n", "line 2: x,1 is not a sample and its light", id="word"),
        pytest.param("0,0,0\n1,1,1\n", "line 1: 0,0,0 is not", id="three columns"),
        pytest.param("sample,light\nlight,sample\n", "line 2", id="two headers"),
        pytest.param("0,0\n1,1\n0.5,2\n", "increases in both columns", id="order"),
        pytest.param("0,0\n1,inf\n", "finite", id="infinite"),
        pytest.param("0,0\n" + "1,1\n" * 5000, "more than 4096 points", id="long"),
    ],
)
def test_files_without_a_table(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=said) as caught:
        read_transfer(path)
    assert str(caught.value).startswith(str(path))
    with pytest.raises(MissingPathError):
        read_transfer(tmp_path / "nowhere.csv")
