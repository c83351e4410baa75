"""NoiseModel: EMVA 1288's photon transfer line, and what it refuses."""

import numpy as np
import pytest

from acquisition import DataError, NoiseModel


def test_variance_is_a_line_of_slope_one_over_electrons_per_dn():
    sensor = NoiseModel(2.5, 4.0, 100.0, 12)
    grey = np.array([0.0, 100.0, 1100.0, 2100.0])
    variance = sensor.variance_dn(grey)
    dark = (4.0 / 2.5) ** 2 + 1 / 12
    np.testing.assert_allclose(variance, [dark, dark, dark + 400, dark + 800])
    assert sensor.white_level_dn == 4095


@pytest.mark.parametrize(
    "values",
    [
        pytest.param((0.0, 1.0, 0.0, 12), id="gain"),
        pytest.param((1.0, -1.0, 0.0, 12), id="read noise"),
        pytest.param((1.0, 1.0, 5000.0, 12), id="black above white"),
        pytest.param((1.0, 1.0, 0.0, 17), id="bits"),
        pytest.param((float("nan"), 1.0, 0.0, 12), id="nan"),
    ],
)
def test_noise_model_refuses(values):
    with pytest.raises(DataError):
        NoiseModel(*values)
