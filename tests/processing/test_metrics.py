import math

import numpy as np
import pytest
from scipy import ndimage

from acquisition import DataError, angle_deg
from processing import NormalMap, angular_error, ssim
from processing.maps.metrics import angle_map_deg


def _bumpy(seed, height=40, width=50, slope=0.5):
    rng = np.random.default_rng(seed)
    z = ndimage.gaussian_filter(rng.normal(size=(height, width)), 2)
    gy, gx = np.gradient(z / z.std())
    return NormalMap.from_vectors(np.stack([-slope * gx, slope * gy, np.ones_like(z)], axis=2))


def _masked(normal_map, mask):
    return NormalMap(normal_map.normals * mask[..., None], mask)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.02, 45.0, 90.0, 179.9999, 180.0])
def test_angle_of_two_vectors(angle):
    turned = (math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle)))
    assert angle_deg((0, 0, 3.0), turned) == pytest.approx(angle, rel=1e-9, abs=1e-14)


def test_angles_broadcast_and_survive_float32():
    normals = _bumpy(0).normals
    assert angle_deg(normals, normals).max() == 0
    assert angle_deg(normals, (0, 0, 1)).shape == normals.shape[:2]
    expected = np.degrees(np.arctan2(np.hypot(normals[..., 0], normals[..., 1]), normals[..., 2]))
    np.testing.assert_allclose(angle_deg(normals, (0, 0, 1)), expected, atol=1e-5)


def test_every_pixel_of_the_mask_counts():
    truth = NormalMap.from_vectors(np.broadcast_to((0.0, 0.0, 1.0), (2, 4, 3)))
    tilted = np.broadcast_to((math.sin(0.1), 0.0, math.cos(0.1)), (2, 4, 3))
    estimate = NormalMap.from_vectors(tilted, np.array([[1, 1, 1, 0], [0, 1, 1, 1]], bool))
    mask = np.array([[1, 1, 1, 1], [1, 1, 1, 0]], bool)
    error = angular_error(estimate, truth, mask)
    assert error.mae_deg == pytest.approx((5 * math.degrees(0.1) + 2 * 90) / 7, abs=1e-4)
    assert error.median_deg == pytest.approx(math.degrees(0.1), abs=1e-4)
    assert error.coverage == pytest.approx(5 / 7)
    assert np.isnan(error.map_deg[1, 3])
    assert error.map_deg[1, 0] == 90


def test_the_truth_may_be_an_array_and_its_holes_do_not_count():
    truth = np.zeros((2, 2, 3))
    truth[0] = (0, 0, 1)
    estimate = NormalMap.from_vectors(np.broadcast_to((1.0, 0.0, 0.0), (2, 2, 3)))
    assert angular_error(estimate, truth).mae_deg == pytest.approx(90)
    assert angular_error(estimate, truth, np.ones((2, 2), bool)).coverage == 1
    with pytest.raises(DataError, match="no pixel"):
        angular_error(estimate, truth, np.array([[False, False], [True, True]]))


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda a, b: angular_error(a, b), id="angular-error"),
        pytest.param(lambda a, b: ssim(a, b), id="ssim"),
        pytest.param(lambda a, b: ssim(a, b, protocol="paper"), id="ssim-paper"),
    ],
)
def test_maps_of_different_sizes_are_refused(call):
    with pytest.raises(DataError, match="50 x 40 and 50 x 41"):
        call(_bumpy(0), _bumpy(0, height=41))


def test_a_mask_of_another_size_is_refused():
    for measure in (angular_error, ssim):
        with pytest.raises(DataError, match="mask must be bool of shape"):
            measure(_bumpy(0), _bumpy(1), np.ones((3, 3), bool))
    with pytest.raises(DataError, match="empty"):
        ssim(_bumpy(0), _bumpy(1), np.zeros((40, 50), bool))


def _reference_ssim(a, b, c1, c2):
    """Independent implementation of Wang's formula with other filters."""

    def mean(image):
        return ndimage.gaussian_filter(image, 1.5, radius=5, mode="mirror", axes=(0, 1))

    x, y = a / 2 + 0.5, b / 2 + 0.5
    mx, my = mean(x), mean(y)
    vx, vy, vxy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    luminance = (2 * mx * my + c1) / (mx * mx + my * my + c1)
    return (luminance * (2 * vxy + c2) / (vx + vy + c2)).mean()


# The second size has several tiles and bands, none of which is full.
@pytest.mark.parametrize("size", [(40, 50), (141, 401)])
def test_ssim_of_full_frames_is_wangs_formula(size):
    a, b = _bumpy(1, *size), _bumpy(2, *size)
    x, y = a.normals.astype(float), b.normals.astype(float)
    assert ssim(a, b) == pytest.approx(_reference_ssim(x, y, 1e-4, 9e-4), abs=1e-9)
    assert ssim(a, b, protocol="paper") == pytest.approx(_reference_ssim(x, y, 0.01, 0.03))
    assert ssim(a, b) < 0.5


def test_the_papers_protocol_counts_the_background_as_z():
    a, b = _bumpy(1), _bumpy(2)
    mask = np.zeros(a.size, bool)
    mask[10:30, 12:40] = True
    z = (0.0, 0.0, 1.0)
    x, y = (np.where(mask[..., None], m.normals.astype(float), z) for m in (a, b))
    figure = ssim(_masked(a, mask), _masked(b, mask), protocol="paper")
    assert figure == pytest.approx(_reference_ssim(x, y, 0.01, 0.03))


def test_an_unknown_protocol_is_refused():
    with pytest.raises(DataError, match="'Paper' is not a protocol: use masked or paper"):
        ssim(_bumpy(0), _bumpy(1), protocol="Paper")


@pytest.mark.parametrize("protocol", ["masked", "paper"])
def test_equal_maps_are_fully_similar_even_when_tiny(protocol):
    for size in ((40, 50), (1, 1), (3, 2)):
        normal_map = NormalMap.from_vectors(np.random.default_rng(1).normal(size=(*size, 3)))
        assert ssim(normal_map, normal_map, protocol=protocol) == pytest.approx(1, abs=1e-9)


def test_masked_ssim_ignores_pixels_outside_the_mask():
    a, b, c = _bumpy(1), _bumpy(2), _bumpy(3)
    mask = np.zeros(a.size, bool)
    mask[8:33, 5:31] = True
    other = np.where(mask[..., None], b.normals, c.normals)
    full = ssim(a, b, mask)
    assert ssim(a, NormalMap(other, np.ones(a.size, bool)), mask) == pytest.approx(full, abs=1e-12)
    assert ssim(_masked(a, mask), _masked(b, mask)) == pytest.approx(full, abs=1e-12)


def test_a_missing_normal_lowers_masked_ssim():
    a = _bumpy(1)
    holes = np.random.default_rng(0).uniform(size=a.size) > 0.1
    assert ssim(_masked(a, holes), a) < 0.8


def test_the_map_of_angles_is_that_of_angle_deg() -> None:
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(2, 30, 41, 3)).astype(np.float32)
    b[3], b[4, 5:] = a[3], -a[4, 5:]
    mask = rng.random((30, 41)) < 0.7
    for second in (b, (0.0, 0.0, 1.0), b[:1]):
        first, inside = (a[:1], mask[:1]) if len(second) == 1 else (a, mask)
        found = angle_map_deg(first, second, inside)
        assert np.isnan(found[~inside]).all()
        expected = np.asarray(angle_deg(first, np.asarray(second)), np.float32)
        np.testing.assert_allclose(found[inside], expected[inside], rtol=2e-7, atol=1e-12)
