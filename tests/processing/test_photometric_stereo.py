import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import DataError, Lights, angle_deg
from calibration import EstimateError
from processing import angular_error, photometric_stereo
from processing.stereo import METHODS
from tests.processing.scenes import dome, one_thread

every_method = pytest.mark.parametrize("method", METHODS)


def _dome(count, *, lowest_deg=45.0):
    return dome(count, lowest=np.sin(np.radians(lowest_deg)))


def _ball(size=70, n_z_min=0.0):
    """Return the normals of a ball that fills the frame, and the mask of n_z above a bound."""
    x, y = np.meshgrid(*[(np.arange(size) - (size - 1) / 2) / (size / 2)] * 2)
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    mask = z > max(n_z_min, 1e-9)
    return np.where(mask[..., None], np.stack([x, -y, z], axis=2), 0.0), mask


def _albedo(mask):
    return 0.3 + 0.5 * np.random.default_rng(11).uniform(size=mask.shape)


def _shade(normals, directions, albedo):
    shading = np.einsum("ni,hwi->nhw", directions, normals)
    return np.maximum(shading, 0) * albedo


def _worst_deg(result, normals, mask):
    assert np.array_equal(result.normal_map.mask, mask)
    return angle_deg(result.normal_map.normals[mask], normals[mask]).max()


@every_method
@pytest.mark.parametrize("width", [1, 63, 64, 65, 130], ids=lambda w: f"width-{w}")
def test_lambertian_surface_without_shadows_is_exact(method, width):
    normals, mask = _ball(140, n_z_min=0.75)
    normals, mask = normals[60:70, 70 - width // 2 :][:, :width], mask[60:70, 70 - width // 2 :]
    mask = mask[:, :width]
    albedo, directions = _albedo(mask), _dome(36)
    result = photometric_stereo(
        _shade(normals, directions, albedo), Lights(directions), mask, method=method
    )
    assert _worst_deg(result, normals, mask) < 1e-4
    np.testing.assert_allclose(result.albedo[mask], albedo[mask], rtol=1e-6)
    assert result.residual.max() < 1e-6
    assert (result.used[mask] == 36).all()
    assert not result.used[~mask].any()
    assert result.warnings == ()


def test_least_squares_agrees_with_lstsq_over_shadows_and_noise():
    normals, mask = _ball()
    directions = _dome(12, lowest_deg=15)
    values = _shade(normals, directions, _albedo(mask))
    values += np.random.default_rng(1).normal(scale=0.02, size=values.shape)
    result = photometric_stereo(values, Lights(directions), mask, method="ls")
    m, *_ = np.linalg.lstsq(directions, values[:, mask].astype(np.float32), rcond=None)
    assert angle_deg(result.normal_map.normals[mask], m.T).max() < 1e-4
    np.testing.assert_allclose(result.albedo[mask], np.linalg.norm(m, axis=0), rtol=1e-5)
    rms = np.sqrt(np.mean((values[:, mask] - directions @ m) ** 2, axis=0))
    np.testing.assert_allclose(result.residual[mask], rms, atol=1e-6)


@pytest.mark.parametrize("missing", [np.nan, np.inf, -np.inf, "masked"])
def test_samples_that_are_not_measured_are_left_out(missing):
    normals, mask = _ball(33)
    directions = _dome(9, lowest_deg=30)
    rng = np.random.default_rng(2)
    values = (_shade(normals, directions, _albedo(mask)) + rng.normal(0, 0.01, (9, 33, 33))).astype(
        np.float32
    )
    usable = rng.uniform(size=values.shape) > 0.2
    usable[:5] = True
    if missing == "masked":
        given = np.ma.array(np.where(usable, values, 9), mask=~usable)
    else:
        given = np.where(usable, values, missing)
    result = photometric_stereo(given, Lights(directions), mask, method="ls")
    assert np.array_equal(result.normal_map.mask, mask)
    np.testing.assert_array_equal(result.used[mask], usable.sum(axis=0)[mask])
    for row, column in np.argwhere(mask)[::7]:
        kept = usable[:, row, column]
        m, *_ = np.linalg.lstsq(directions[kept], values[kept, row, column], rcond=None)
        assert angle_deg(result.normal_map.normals[row, column], m) < 1e-3
        assert result.albedo[row, column] == pytest.approx(np.linalg.norm(m), rel=1e-5)
        rms = np.sqrt(np.mean((values[kept, row, column] - directions[kept] @ m) ** 2))
        assert result.residual[row, column] == pytest.approx(rms, rel=1e-3, abs=1e-7)


def test_cauchy_survives_a_third_of_outliers():
    normals, mask = _ball(64, n_z_min=0.75)
    directions = _dome(36)
    values = _shade(normals, directions, np.full(mask.shape, 0.6))
    rng = np.random.default_rng(5)
    struck = np.argsort(rng.uniform(size=values.shape), axis=0) < 11
    values = np.where(struck, rng.uniform(0, 2, values.shape), values)
    values += rng.normal(0, 0.001, values.shape)
    error = {
        method: angle_deg(
            photometric_stereo(values, Lights(directions), mask, method=method).normal_map.normals,
            normals,
        )[mask]
        for method in ("ls", "cauchy")
    }
    assert error["ls"].mean() > 8
    assert error["cauchy"].mean() < 0.15
    assert np.percentile(error["cauchy"], 99) < 0.5


def test_attached_shadows_do_not_affect_cauchy():
    normals, mask = _ball(64, n_z_min=0.3)
    directions = _dome(36, lowest_deg=20)
    values = _shade(normals, directions, _albedo(mask))
    robust = photometric_stereo(values, Lights(directions), mask, method="cauchy")
    assert angular_error(robust.normal_map, normals, mask).mae_deg < 0.01
    plain = photometric_stereo(values, Lights(directions), mask, method="ls")
    assert angular_error(plain.normal_map, normals, mask).mae_deg > 1


def test_pixels_without_enough_samples_have_no_normal_and_are_reported():
    normals, mask = _ball(20, n_z_min=0.75)
    directions = _dome(6)
    values = _shade(normals, directions, _albedo(mask))
    values[2:, 10, 10] = np.nan
    values[:, 10, 11] = 0
    directions[2] = directions[0] + directions[1]
    values[3:, 9, 9] = np.nan
    result = photometric_stereo(values, Lights(directions), mask, method="ls")
    lost = mask & ~result.normal_map.mask
    assert sorted(map(tuple, np.argwhere(lost))) == [(9, 9), (10, 10), (10, 11)]
    assert (result.used[10, 10], result.used[10, 11], result.used[9, 9]) == (2, 6, 3)
    assert not result.albedo[lost].any()
    assert not result.residual[lost].any()
    assert str(result.warnings[0]).startswith(f"3 of {mask.sum()} pixels")


def _turn(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


@every_method
@given(seed=st.integers(0, 10_000), scale=st.floats(1e-3, 1e3))
@settings(max_examples=15)
def test_normals_rotate_with_the_scene_and_ignore_brightness(method, seed, scale):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(10, 3))
    values = rng.uniform(0, 1, (10, 3, 4))
    mask = np.ones((3, 4), bool)
    first = photometric_stereo(values, Lights(directions), mask, method=method)
    turn, order = _turn(seed), rng.permutation(10)
    second = photometric_stereo(
        scale * values[order], Lights(directions[order] @ turn.T), mask, method=method
    )
    turned = first.normal_map.normals @ turn.T
    # Rounding can change the median of |r| by one step of the bisection, 1 part in 64.
    tolerance = 1e-3 if method == "ls" else 0.1
    assert angle_deg(second.normal_map.normals, turned).max() < tolerance
    if method == "ls":
        np.testing.assert_allclose(second.albedo, first.albedo * scale, rtol=1e-5)


@every_method
@pytest.mark.parametrize("scale", [1e-42, 1e-30, 1e37, 2e38])
def test_extreme_units_terminate_and_give_normals(method, scale):
    normals, mask = _ball(20, n_z_min=0.75)
    values = scale * _shade(normals, _dome(9), np.ones(mask.shape))
    result = photometric_stereo(values, Lights(_dome(9)), mask, method=method)
    assert _worst_deg(result, normals, mask) < (0.01 if scale > 1e-40 else 2)


def test_vectors_beyond_float32_terminate():
    # Differences of infinities are NaN: the search for the median must still end.
    directions = _dome(9, lowest_deg=60)
    directions[:, 0] += 1
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    vector = np.array([4e38, 0, -4e38])
    values = np.broadcast_to((directions @ vector)[:, None, None], (9, 4, 5))
    mask = np.ones((4, 5), bool)
    result = photometric_stereo(values, Lights(directions), mask, method="cauchy")
    assert np.isinf(result.albedo).all()
    assert angle_deg(result.normal_map.normals, vector).max() < 1e-3


@every_method
def test_bytes_do_not_depend_on_the_number_of_threads(method):
    rng = np.random.default_rng(9)
    values = rng.uniform(0, 1, (14, 97, 83))
    values[rng.uniform(size=values.shape) < 0.05] = np.nan
    lights, mask = Lights(_dome(14)), rng.uniform(size=(97, 83)) > 0.1
    results = [photometric_stereo(values, lights, mask, method=method)]
    with one_thread():
        results.append(photometric_stereo(values, lights, mask, method=method))
    for name in ("albedo", "residual", "used"):
        assert getattr(results[0], name).tobytes() == getattr(results[1], name).tobytes()
    assert results[0].normal_map.normals.tobytes() == results[1].normal_map.normals.tobytes()


def test_strided_and_float64_stacks_give_the_same():
    normals, mask = _ball(30)
    values = _shade(normals, _dome(5), _albedo(mask)).astype(np.float32)
    expected = photometric_stereo(values, Lights(_dome(5)), mask).albedo
    strided = np.ascontiguousarray(values.transpose(1, 2, 0)).transpose(2, 0, 1)
    for same in (strided, values.astype(np.float64)):
        np.testing.assert_array_equal(
            photometric_stereo(same, Lights(_dome(5)), mask).albedo, expected
        )


def test_progress_counts_pixels_and_may_stop_the_work():
    values, mask = np.ones((4, 400, 100)), np.ones((400, 100), bool)
    reports = []
    photometric_stereo(
        values, Lights(_dome(4)), mask, on_progress=lambda *report: reports.append(report)
    )
    assert reports == [("normals", done, 40000) for done in (16384, 32768, 40000)]

    def stop(_stage, done, _total):
        if done > 16384:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        photometric_stereo(values, Lights(_dome(4)), mask, on_progress=stop)


def _in_one_plane(count, wobble_deg=0.0):
    angle = np.linspace(-1, 1, count)
    wobble = np.radians(wobble_deg) * np.where(np.arange(count) % 2, 1, -1)
    return np.stack([np.sin(angle), wobble, np.cos(angle)], axis=1)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        pytest.param(_dome(2), "2 lights do not determine", id="two"),
        pytest.param(_in_one_plane(9), "close to one plane .*condition", id="coplanar"),
        pytest.param(
            _in_one_plane(9, wobble_deg=1), "condition number [345]", id="coplanar-to-one-degree"
        ),
        pytest.param(np.tile([[0, 0, 1.0]], (4, 1)), "close to one plane", id="equal"),
    ],
)
def test_lights_that_do_not_determine_the_normal_are_refused(directions, message):
    values = np.ones((len(directions), 5, 5))
    with pytest.raises(EstimateError, match=message):
        photometric_stereo(values, Lights(directions), np.ones((5, 5), bool))


def _cone(count, angle_deg):
    turn, tilt = 2 * np.pi * np.arange(count) / count, np.radians(angle_deg)
    z = np.full(count, np.cos(tilt))
    return np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), z], axis=1)


def test_a_narrow_cone_of_lights_is_accepted_everywhere():
    directions = _cone(12, 3.5)
    normals, mask = _ball(40, n_z_min=0.4)
    values = _shade(normals, directions, _albedo(mask))
    values[5, ::2] = np.nan
    result = photometric_stereo(values, Lights(directions), mask, method="ls")
    assert _worst_deg(result, normals, mask) < 0.02


def test_a_pixel_whose_remaining_lights_are_almost_in_one_plane_is_left_out():
    directions = np.vstack([_in_one_plane(5, wobble_deg=0.3), _dome(4)])
    normals, mask = _ball(20, n_z_min=0.75)
    values = _shade(normals, directions, _albedo(mask))
    values[5:, 10, 10] = np.nan
    result = photometric_stereo(values, Lights(directions), mask, method="ls")
    assert np.argwhere(mask & ~result.normal_map.mask).tolist() == [[10, 10]]
    assert result.used[10, 10] == 5


@pytest.mark.parametrize(
    ("value", "message"),
    [
        pytest.param(0.0, "black inside the mask", id="black"),
        pytest.param(np.nan, "not saturated", id="saturated"),
    ],
)
def test_stacks_without_usable_samples_are_refused(value, message):
    with pytest.raises(EstimateError, match=message):
        photometric_stereo(np.full((5, 6, 7), value), Lights(_dome(5)), np.ones((6, 7), bool))


@pytest.mark.parametrize(
    ("values", "mask", "message"),
    [
        pytest.param(np.ones((4, 5, 6)), np.ones((5, 6), bool), "4 images for 5", id="count"),
        pytest.param(np.ones((5, 5, 6, 3)), np.ones((5, 6), bool), "one channel", id="colour"),
        pytest.param(np.ones((5, 5, 6)), np.ones((6, 5), bool), "not bool of", id="mask-size"),
        pytest.param(np.ones((5, 5, 6)), np.ones((5, 6)), "not float64 of", id="mask-type"),
        pytest.param(np.ones((5, 5, 6)), np.zeros((5, 6), bool), "empty", id="mask-empty"),
    ],
)
def test_inconsistent_inputs_are_refused(values, mask, message):
    with pytest.raises(DataError, match=message):
        photometric_stereo(values, Lights(_dome(5)), mask)


def test_an_unknown_method_is_refused():
    with pytest.raises(DataError, match="'l2' is not a method"):
        photometric_stereo(np.ones((5, 2, 2)), Lights(_dome(5)), np.ones((2, 2), bool), method="l2")


def test_one_light_with_weight_determines_nothing():
    """Noise around black: all lights but one seem to be behind the surface in some iteration."""
    turn, tilt = np.radians(np.arange(12) * 30.0), np.radians(np.resize([20.0, 40.0], 12))
    lights = Lights(
        directions=np.stack(
            [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1
        )
    )
    values = np.random.default_rng(4).normal(0, 4e-4, (12, 60, 80)).astype(np.float32)
    for method in METHODS:
        result = photometric_stereo(values, lights, np.ones((60, 80), bool), method=method)
        assert result.albedo.max() < 0.1
