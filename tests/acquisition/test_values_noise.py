"""NoiseModel: EMVA 1288's photon transfer line, and refusals."""

import tomllib

import numpy as np
import pytest

from acquisition import DataError, NoiseModel
from acquisition.files.text_files import to_toml
from acquisition.session import SensorRecord


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
        pytest.param((float("inf"), 1.0, 0.0, 12), id="infinite gain"),
        pytest.param((1.0, float("inf"), 0.0, 12), id="infinite read noise"),
        pytest.param((1.0, 1.0, float("nan"), 12), id="no black level"),
    ],
)
def test_noise_model_refuses(values):
    with pytest.raises(DataError):
        NoiseModel(*values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        pytest.param({"quantum_efficiency": 0.0}, "quantum_efficiency", id="blind"),
        pytest.param({"quantum_efficiency": 1.1}, "quantum_efficiency", id="more than all"),
        pytest.param({"full_well_e": 10.0}, "black level below its white level", id="full at once"),
        pytest.param({"full_well_e": float("nan")}, "full_well_e is nan", id="full well nan"),
        pytest.param({"dark_current_e_per_s": -1.0}, "dark_current_e_per_s >= 0", id="dark"),
        pytest.param({"dsnu_e": -1.0}, "dsnu_e >= 0", id="dsnu"),
        pytest.param({"prnu": 0.3}, "prnu within", id="prnu"),
        pytest.param({"hot_pixel_fraction": 1.5}, "hot_pixel_fraction within", id="hot pixels"),
        pytest.param({"hot_pixel_e_per_s": float("inf")}, "hot_pixel_e_per_s is inf", id="heat"),
    ],
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


@pytest.mark.parametrize(
    ("sensor", "written"),
    [
        pytest.param(NoiseModel(2.5, 7.0, 64.0, 12), 4, id="plain"),
        pytest.param(
            NoiseModel(2.5, 7.0, 64.0, 12, 0.6, 9000.0, 5.0, 1.5, 0.01, 1e-4, 800.0), 11, id="all"
        ),
    ],
)
def test_a_sensor_record_writes_only_non_default_values_and_reads_back(sensor, written):
    record = SensorRecord.of(sensor)
    content = tomllib.loads(to_toml(record).decode())
    assert len(content) == written
    assert SensorRecord.model_validate(content).value() == sensor
