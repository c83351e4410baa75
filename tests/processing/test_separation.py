from __future__ import annotations

from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from acquisition import DataError, angle_deg
from processing import NormalMap, ShapeFilter, combine, read_normals, separate, ssim, write_normals
from processing.detail import FilterKind
from rig.arrays import Float64
from tests.processing.scenes import real_map
from tests.quick_sample import quick
from tests.real_data import needs_data

ROUND_TRIP_DEG = 5e-5


def random_map(seed: int, size: tuple[int, int] = (30, 40), holes: float = 0.1) -> NormalMap:
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.normal(size=(*size, 3)), (0, 0), 3) * 8
    vectors = smooth + 0.4 * rng.normal(size=(*size, 3)) + (0, 0, 0.5)
    return NormalMap.from_vectors(vectors, rng.random(size) >= holes)


def direct_shape(normal_map: NormalMap, kernel: Float64) -> Float64:
    """Return the masked convolution, computed pixel by pixel."""
    radius = len(kernel) // 2
    normals = np.pad(
        normal_map.normals.astype(np.float64), ((radius,) * 2,) * 2 + ((0, 0),), "reflect"
    )
    mask = np.pad(normal_map.mask, radius, "reflect")
    window = np.outer(kernel, kernel)
    out = np.zeros(normal_map.normals.shape)
    for r, c in np.argwhere(normal_map.mask):
        rows, columns = slice(r, r + 2 * radius + 1), slice(c, c + 2 * radius + 1)
        weight = window * mask[rows, columns]
        mean = np.einsum("ij,ijk->k", weight, normals[rows, columns])
        out[r, c] = mean / np.linalg.norm(mean)
    return out


kinds = st.sampled_from(get_args(FilterKind))


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=kinds,
    order=st.integers(1, 9),
    w=st.integers(1, 9),
    holes=st.floats(0, 0.9),
)
def test_combine_restores_the_map(
    seed: int, kind: FilterKind, order: int, w: int, holes: float
) -> None:
    normal_map = random_map(seed, holes=holes)
    parts = separate(normal_map, shape_filter=ShapeFilter(kind=kind, order=order, w=w))
    back = combine(parts.shape, parts.detail)
    np.testing.assert_array_equal(back.mask, normal_map.mask)
    assert angle_deg(back.normals, normal_map.normals)[back.mask].max() <= ROUND_TRIP_DEG


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=kinds,
    order=st.sampled_from([1, 8]),
    spread=st.floats(-44, 0),
    holes=st.floats(0, 0.9),
)
def test_combine_is_exact_around_the_lower_pole(
    seed: int, kind: FilterKind, order: int, spread: float, holes: float
) -> None:
    # Half of the map is exactly (0, 0, -1), so shapes are at the pole and at all distances from it.
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(30, 40, 3)) * 10.0**spread
    vectors[:, 20:] = 0
    vectors[..., 2] -= 1
    normal_map = NormalMap.from_vectors(vectors, rng.random((30, 40)) >= holes)
    parts = separate(normal_map, shape_filter=ShapeFilter(kind=kind, order=order, w=3))
    back = combine(parts.shape, parts.detail)
    assert angle_deg(back.normals, normal_map.normals)[back.mask].max() <= ROUND_TRIP_DEG


def test_the_lower_pole_remains_the_lower_pole() -> None:
    parts = separate(NormalMap.from_vectors(np.broadcast_to((0, 0, -1.0), (20, 20, 3))))
    assert (parts.shape.normals == (0, 0, -1)).all()
    assert (parts.detail.normals == (0, 0, 1)).all()


@pytest.mark.parametrize("kind", get_args(FilterKind))
def test_combine_from_files(kind: FilterKind, tmp_path: Path) -> None:
    normal_map = random_map(4)
    parts = separate(normal_map, shape_filter=ShapeFilter(kind=kind))
    write_normals(tmp_path, parts.shape, "shape")
    write_normals(tmp_path, parts.detail, "detail")

    def error_deg(shape: str, detail: str) -> Float64:
        back = combine(*(read_normals(tmp_path / name).normal_map for name in (shape, detail)))
        np.testing.assert_array_equal(back.mask, normal_map.mask)
        return angle_deg(back.normals, normal_map.normals)[back.mask]

    assert error_deg("shape.exr", "detail.exr").max() <= ROUND_TRIP_DEG
    # A 16-bit step is 3e-5: half a step in each component rotates a normal by up to 0.0015 degree.
    assert error_deg("shape.exr", "detail.png").max() <= 1.6e-3
    # The rounding of a shape is multiplied by at most 2 / (1 + z), here by at most 20.
    shape_z = parts.shape.normals[..., 2][normal_map.mask]
    assert error_deg("shape.png", "detail.png")[shape_z > -0.9].max() <= 0.03


@pytest.mark.parametrize("holes", [0.0, 0.4])
def test_order_one_is_the_masked_convolution(holes: float) -> None:
    normal_map = random_map(1, holes=holes)
    offsets = np.arange(-3, 4)
    gauss = np.exp(-(offsets**2) / (2 * 1.5**2))
    for kind, kernel in (("gaussian", gauss / gauss.sum()), ("box", np.full(7, 1 / 7))):
        shape = ShapeFilter(kind, 1, 3).shape(normal_map).normals  # type: ignore[arg-type]
        np.testing.assert_allclose(shape, direct_shape(normal_map, kernel), atol=2e-6)


@pytest.mark.parametrize("size", [(11, 12), (140, 530), (270, 33)])
@pytest.mark.parametrize(("order", "w"), [(1, 5), (2, 3), (7, 4), (8, 5)])
def test_higher_orders_filter_the_rest_again(size: tuple[int, int], order: int, w: int) -> None:
    # Sizes larger than one tile of the loops, and smaller than the widest kernel.
    normal_map = random_map(5, size, holes=0.2)
    by = ShapeFilter("gaussian", order, w)
    radius = w if order == 1 else int(np.ceil(3 * by.sigma_px))
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / by.sigma_px) ** 2)

    def blur(image: Float64) -> Float64:
        for axis in (0, 1):
            image = ndimage.correlate1d(image, kernel / kernel.sum(), axis, mode="mirror")
        return image

    mask = normal_map.mask.astype(np.float64)[..., None]
    normals = rest = normal_map.normals.astype(np.float64)
    for _ in range(order):
        rest = (rest - blur(rest) / np.maximum(blur(mask), 1e-9)) * mask
    shape = by.shape(normal_map)
    assert angle_deg(shape.normals, normals - rest)[normal_map.mask].max() < 2e-3
    assert angle_deg(shape.normals, normals - rest)[normal_map.mask].mean() < 2e-5


@pytest.mark.parametrize("order", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("w", [5, 7])
def test_every_order_halves_the_same_frequency(order: int, w: int) -> None:
    # A weak sinusoidal ripple; the Gaussian of sigma w/2 passes half of it.
    k = np.sqrt(2 * np.log(2)) / (w / 2)
    x = np.arange(400)
    ripple = np.broadcast_to(1e-3 * np.cos(k * (x - 200)), (40, 400))
    vectors = np.stack([ripple, np.zeros_like(ripple), np.ones_like(ripple)], axis=2)
    shape = ShapeFilter("gaussian", order, w).shape(NormalMap.from_vectors(vectors)).normals
    middle = slice(100, 300)
    gain = (shape[20, middle, 0] @ ripple[20, middle]) / (ripple[20, middle] @ ripple[20, middle])
    if order > 1:
        assert gain == pytest.approx(0.5, abs=0.01)
    else:
        # The paper truncates its Gaussian at 2 sigma, which passes slightly more.
        offsets = np.arange(-w, w + 1)
        kernel = np.exp(-0.5 * (offsets / (w / 2)) ** 2)
        assert gain == pytest.approx((kernel * np.cos(k * offsets)).sum() / kernel.sum(), abs=1e-3)


def test_higher_orders_are_steeper() -> None:
    def gain(order: int, frequency: float) -> float:
        x = np.arange(600)
        ripple = np.broadcast_to(1e-3 * np.cos(frequency * (x - 300)), (40, 600))
        vectors = np.stack([ripple, np.zeros_like(ripple), np.ones_like(ripple)], axis=2)
        shape = ShapeFilter("gaussian", order, 5).shape(NormalMap.from_vectors(vectors)).normals
        inner = slice(100, 500)
        return float((shape[20, inner, 0] @ ripple[20, inner]) / (ripple[20, inner] ** 2).sum())

    half = np.sqrt(2 * np.log(2)) / 2.5
    assert gain(8, half / 2) > gain(1, half / 2) + 0.05 > 0.85
    assert gain(8, half * 2) < gain(1, half * 2) - 0.02
    # The closed form 1 - (1 - g)^n on either side of the cut-off.
    sigma = 2.5 * np.sqrt(np.log(1 - 0.5 ** (1 / 8)) / np.log(0.5))
    for frequency in (half / 2, half * 1.5):
        g = np.exp(-((sigma * frequency) ** 2) / 2)
        assert gain(8, frequency) == pytest.approx(1 - (1 - g) ** 8, abs=0.01)


def test_the_default_filter() -> None:
    """The default is that of `sgp detail separate` and docs/detail.md: Gaussian, order 8, w 5."""
    normal_map = random_map(4)
    parts = separate(normal_map)
    explicit = separate(normal_map, shape_filter=ShapeFilter("gaussian", 8, 5))
    np.testing.assert_array_equal(parts.shape.normals, explicit.shape.normals)
    for other in (ShapeFilter(order=7), ShapeFilter(w=6), ShapeFilter("box")):
        assert (other.shape(normal_map).normals != parts.shape.normals).any()


def test_a_plane_has_no_detail() -> None:
    normal_map = NormalMap.from_vectors(np.broadcast_to((0.48, -0.6, 0.64), (20, 30, 3)))
    parts = separate(normal_map)
    assert angle_deg(parts.shape.normals, normal_map.normals).max() < 1e-4
    assert angle_deg(parts.detail.normals, (0, 0, 1)).max() < 1e-4
    assert parts.separability_deg < 1e-4


def test_the_surroundings_of_an_object_do_not_matter() -> None:
    small = random_map(3, (40, 50))
    parts = separate(small, shape_filter=ShapeFilter(order=1, w=3))
    vectors = np.zeros((120, 150, 3), np.float32)
    vectors[50:90, 60:110] = small.normals
    mask = np.zeros((120, 150), bool)
    mask[50:90, 60:110] = small.mask
    big = separate(NormalMap(vectors, mask), shape_filter=ShapeFilter(order=1, w=3))
    inner = (slice(53, 87), slice(63, 107))
    part = (slice(3, 37), slice(3, 47))
    np.testing.assert_allclose(big.shape.normals[inner], parts.shape.normals[part], atol=1e-6)
    assert not big.shape.normals[~mask].any()
    assert not big.detail.normals[~mask].any()


def test_normals_that_cancel_keep_themselves() -> None:
    vectors = np.zeros((12, 12, 3))
    vectors[..., 0] = np.where(np.indices((12, 12)).sum(axis=0) % 2, 1.0, -1.0)
    mask = np.zeros((12, 12), bool)
    mask[5, 5:7] = True
    normal_map = NormalMap.from_vectors(vectors, mask)
    # Two opposite normals under a wide box: the mean is 0 and has no direction.
    parts = separate(normal_map, shape_filter=ShapeFilter(kind="box", w=5))
    np.testing.assert_array_equal(parts.shape.normals, normal_map.normals)
    np.testing.assert_allclose(parts.detail.normals[mask], [[0, 0, 1]] * 2, atol=1e-7)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        pytest.param({"w": 15}, "window of 31 pixels, larger", id="w larger than the map"),
        pytest.param({"w": 0}, "w must be a whole number above 0", id="w zero"),
        pytest.param({"order": 0}, "order must be a whole number above 0", id="order zero"),
        pytest.param({"order": 1.5}, "order must be a whole number", id="order broken"),
        pytest.param({"kind": "median"}, "unknown shape filter 'median'", id="unknown filter"),
    ],
)
def test_separate_refuses(options: dict[str, object], text: str) -> None:
    with pytest.raises(DataError, match=text):
        separate(random_map(0), shape_filter=ShapeFilter(**options))  # type: ignore[arg-type]


def test_combine_refuses_components_that_do_not_fit() -> None:
    with pytest.raises(DataError, match="40 x 30 pixels and a detail of 41 x 30"):
        combine(random_map(0), random_map(0, (30, 41)))
    left, right = np.zeros((2, 30, 40), bool)
    left[:, :20] = right[:, 20:] = True
    normals = random_map(0, holes=0).normals
    a, b = (NormalMap.from_vectors(normals, mask) for mask in (left, right))
    with pytest.raises(DataError, match="do not overlap"):
        combine(a, b)


@needs_data
@pytest.mark.parametrize(
    ("name", "bars"),
    quick([("owl", (0.9996, 0.9993, 0.9990)), ("plant", (0.9992, 0.9985, 0.9979))], every=2),
)
def test_the_detail_of_a_detail_is_the_detail(name: str, bars: tuple[float, ...]) -> None:
    detail = first = separate(real_map(name)).detail
    for bar in bars:
        detail = separate(detail).detail
        assert ssim(detail, first, protocol="paper") >= bar


@needs_data
@pytest.mark.parametrize(("name", "bar"), [("owl", 0.68), ("plant", 1.82)])
def test_separability_of_real_maps(name: str, bar: float) -> None:
    normal_map = real_map(name)
    parts = separate(normal_map)
    assert parts.separability_deg == pytest.approx(bar, abs=0.02)
    back = combine(parts.shape, parts.detail)
    assert angle_deg(back.normals, normal_map.normals)[back.mask].max() <= ROUND_TRIP_DEG
    # The detail contains less shape than with the paper's filter.
    assert (
        parts.separability_deg
        < 0.75 * separate(normal_map, shape_filter=ShapeFilter(order=1)).separability_deg
    )
