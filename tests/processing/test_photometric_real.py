"""Real captures, compared with published results of the same estimators and a ball's geometry."""

from functools import cache

import numpy as np
import pytest

from acquisition import Lights, read_source
from calibration import calibrate_spheres, linear_stack
from processing import angular_error, photometric_stereo
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data

pytestmark = needs_data


@cache
def _capture(name):
    source = read_source(DATA / name)
    return linear_stack(source), source


@pytest.mark.parametrize(
    ("name", "method", "lowest", "highest"),
    quick(
        [
            pytest.param("bearPNG", "ls", 8.34, 8.44, id="bear-ls"),
            pytest.param("catPNG", "ls", 8.36, 8.46, id="cat-ls"),
            pytest.param("bearPNG", "cauchy", 5.0, 6.2, id="bear-cauchy"),
            pytest.param("catPNG", "cauchy", 5.0, 7.0, id="cat-cauchy"),
            pytest.param("bearPNG", "trimmed", 6.0, 6.3, id="bear-trimmed"),
            pytest.param("catPNG", "trimmed", 6.9, 7.17, id="cat-trimmed"),
            pytest.param("bearPNG", "best", 3.5, 4.1, id="bear-best"),
            pytest.param("catPNG", "best", 3.5, 4.4, id="cat-best"),
        ],
        every=4,
    ),
)
def test_mean_angular_error_on_diligent(name, method, lowest, highest):
    stack, source = _capture(f"diligent/{name}")
    result = photometric_stereo(stack.values, stack.lights, source.mask, method=method)
    error = angular_error(result.normal_map, source.normals_truth, source.mask)
    assert lowest < error.mae_deg < highest
    assert error.coverage == 1


def _ball_normals(mask):
    rows, columns = np.nonzero(mask)
    middle = [(i.min() + i.max()) / 2 for i in (rows, columns)]
    radius = [(i.max() - i.min() + 1) / 2 for i in (rows, columns)]
    y, x = np.indices(mask.shape)
    y, x = -(y - middle[0]) / radius[0], (x - middle[1]) / radius[1]
    return np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, None))], axis=2)


@pytest.mark.slow
def test_a_glossy_ball_under_lights_from_a_chrome_ball():
    chrome, source = _capture("uw/chrome")
    lights = calibrate_spheres(chrome, masks=[source.mask]).lights
    stack, source = _capture("uw/gray")
    result = photometric_stereo(
        stack.values, Lights(lights.unit_directions), source.mask, method="cauchy"
    )
    truth = _ball_normals(source.mask)
    assert angular_error(result.normal_map, truth, source.mask).mae_deg < 6
    inner = source.mask & (truth[..., 2] > 0.3)
    assert angular_error(result.normal_map, truth, inner).mae_deg < 5
