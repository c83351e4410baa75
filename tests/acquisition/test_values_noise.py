"""NoiseModel: EMVA 1288's photon transfer line, and refusals."""

import tomllib

import numpy as np
import pytest

from acquisition import DataError, NoiseModel
from acquisition.files.text_files import to_toml
from acquisition.session import SensorRecord
from tests.cases import cases


def test_variance_is_a_line_of_slope_one_over_electrons_per_dn():
    sensor = NoiseModel(2.5, 4.0, 100.0, 12)
    grey = np.array([0.0, 100.0, 1100.0, 2100.0])
    variance = sensor.variance_dn(grey)
    dark = (4.0 / 2.5) ** 2 + 1 / 12
    np.testing.assert_allclose(variance, [dark, dark, dark + 400, dark + 800])
    assert sensor.white_level_dn == 4095


@cases(
    "values",
    {
        "gain": (0.0, 1.0, 0.0, 12),
        "read noise": (1.0, -1.0, 0.0, 12),
        "black above white": (1.0, 1.0, 5000.0, 12),
        "bits": (1.0, 1.0, 0.0, 17),
        "nan": (float("nan"), 1.0, 0.0, 12),
        "infinite gain": (float("inf"), 1.0, 0.0, 12),
        "infinite read noise": (1.0, float("inf"), 0.0, 12),
        "no black level": (1.0, 1.0, float("nan"), 12),
    },
)
def test_noise_model_refuses(values):
    with pytest.raises(DataError):
        NoiseModel(*values)


@cases(
    ("values", "message"),
    {
        "blind": ({"quantum_efficiency": 0.0}, "quantum_efficiency"),
        "more than all": ({"quantum_efficiency": 1.1}, "quantum_efficiency"),
        "full at once": ({"full_well_e": 10.0}, "black level below its white level"),
        "full well nan": ({"full_well_e": float("nan")}, "full_well_e is nan"),
        "dark": ({"dark_current_e_per_s": -1.0}, "dark_current_e_per_s >= 0"),
        "dsnu": ({"dsnu_e": -1.0}, "dsnu_e >= 0"),
        "prnu": ({"prnu": 0.3}, "prnu within"),
        "hot pixels": ({"hot_pixel_fraction": 1.5}, "hot_pixel_fraction within"),
        "heat": ({"hot_pixel_e_per_s": float("inf")}, "hot_pixel_e_per_s is inf"),
    },
)
def test_noise_model_refuses_by_name(values, message):
    with pytest.raises(DataError, match=message) as caught:
        NoiseModel(2.5, 4.0, 100.0, 12, **values)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("full_well_e", "white"),
    [
        pytest.param(None, 4095, id="no limit"),
        pytest.param(20_000.0, 4095, id="beyond the converter"),
        # 100 + (6000 - 4 * 5) / 2 with sqrt(3^2 + 4^2) = 5.
        pytest.param(6000.0, 3090, id="before the converter"),
    ],
)
def test_white_level_of_a_full_well(full_well_e, white):
    sensor = NoiseModel(2.0, 3.0, 100.0, 12, full_well_e=full_well_e, dsnu_e=4.0)
    assert sensor.white_level_dn == white
    assert sensor.converter_end_dn == 4095


@cases(
    ("sensor", "written"),
    {
        "plain": (NoiseModel(2.5, 7.0, 64.0, 12), 4),
        "all": (NoiseModel(2.5, 7.0, 64.0, 12, 0.6, 9000.0, 5.0, 1.5, 0.01, 1e-4, 800.0), 11),
    },
)
def test_a_sensor_record_writes_only_non_default_values_and_reads_back(sensor, written):
    record = SensorRecord.of(sensor)
    content = tomllib.loads(to_toml(record).decode())
    assert len(content) == written
    assert SensorRecord.model_validate(content).value() == sensor
