"""Super-resolution: closed forms, symmetries, tiles, masks, and networks that do not fit."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import processing
from acquisition import DataError, MissingPathError, angle_deg
from processing import NormalMap, angular_error, super_resolve
from processing.superres import SuperResolutionStage, low_resolution, read_superres_model
from processing.superres import higher_resolution as memory_module
from processing.superres.enlarge import (
    bicubic,
    blend,
    filled_outwards,
    smoothly,
    units,
    without_averaging,
)
from processing.superres.network import Network, turned

MODELS = Path(processing.__file__).parent / "superres" / "models"
KINDS = {scale: read_superres_model(None, scale) for scale in (2, 4)}


def rough(height: int = 40, width: int = 52, seed: int = 0) -> NormalMap:
    """Return a relief with steep and with smooth parts."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    down, right = np.gradient(cv2.GaussianBlur(noise, (0, 0), 1.5) * 3)
    return NormalMap.from_vectors(np.dstack([-right, down, np.ones((height, width))]))


def disc(height: int, width: int) -> np.ndarray:
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return x**2 + y**2 < 0.7


def masked(normal_map: NormalMap, mask: np.ndarray) -> NormalMap:
    return NormalMap(np.where(mask[..., None], normal_map.normals, 0), mask)


def ball(size: int) -> NormalMap:
    """Return a part of a sphere, from closed forms at the centres of the pixels."""
    along = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(along, -along)
    return NormalMap.from_vectors(np.dstack([x, y, np.sqrt(4 - x**2 - y**2)]))


@pytest.fixture(scope="module")
def whole() -> processing.SuperResolution:
    """Return a relief inside a disc, in one tile."""
    return super_resolve(masked(rough(), disc(40, 52)), 4)


# What the sensor makes.


def test_a_plane_and_a_sphere_at_low_resolution():
    plane = NormalMap.from_vectors(np.tile([0.3, -0.2, 1.0], (21, 34, 1)))
    low = low_resolution(plane, 4, blur_px=1.5)
    assert low.size == (5, 8)
    np.testing.assert_allclose(low.normals, plane.normals[:5, :8], atol=1e-6)
    # The mean of a square is the normal at its centre, but for curvature.
    assert angular_error(low_resolution(ball(64), 4), ball(16)).mae_deg < 0.02


def test_unknown_pixels_have_no_effect_and_noise_has_its_size():
    truth = rough()
    mask = np.ones(truth.size, np.bool_)
    mask[:4, :2] = mask[4:8, :4] = False
    mask[3, 1] = True
    low = low_resolution(masked(truth, mask), 4)
    assert low.mask[0, 0]
    assert not low.mask[1, 0]
    sums = truth.normals[:4, :4][mask[:4, :4]].sum(axis=0)
    np.testing.assert_allclose(low.normals[0, 0], sums / np.linalg.norm(sums), atol=1e-6)
    flat = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (200, 200, 1)))
    noisy = low_resolution(flat, 1, noise_deg=2, seed=1)
    angles = angle_deg(noisy.normals, flat.normals)
    assert np.sqrt(np.mean(angles**2)) == pytest.approx(2, rel=0.02)
    np.testing.assert_array_equal(
        noisy.normals, low_resolution(flat, 1, noise_deg=2, seed=1).normals
    )


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"scale": 0}, "a scale of 0 is out of range"),
        ({"scale": 41}, "from 1 to 40"),
        ({"scale": 2, "blur_px": -1}, "a blur of -1"),
        ({"scale": 2, "blur_px": float("nan")}, "a blur of nan"),
        ({"scale": 2, "noise_deg": float("nan")}, "a noise of nan"),
        ({"scale": 2, "noise_deg": 46}, "a noise of 46"),
        ({"scale": 2, "seed": -1}, "a seed of -1"),
    ],
)
def test_numbers_out_of_range_are_refused(options, text):
    with pytest.raises(DataError, match=text):
        low_resolution(rough(), **options)


# What is interpolated.


@pytest.mark.parametrize("scale", [2, 4])
def test_a_plane_stays_a_plane_and_a_sphere_a_sphere(scale):
    plane = NormalMap.from_vectors(np.tile([0.3, -0.2, 1.0], (13, 9, 1)))
    for method in ("bicubic", None):
        made = super_resolve(plane, scale, method=method)
        assert made.normal_map.size == (13 * scale, 9 * scale)
        assert made.normal_map.mask.all()
        assert angle_deg(made.normal_map.normals, plane.normals[0, 0]).max() < 1e-3
        assert made.added_deg.max() < 1e-3
    # Away from the border, where the continuation is flat.
    truth, inner = ball(32 * scale), (slice(4 * scale, -4 * scale),) * 2
    low = low_resolution(truth, scale)
    made, plain = (super_resolve(low, scale, method=method) for method in (None, "bicubic"))
    assert angle_deg(made.normal_map.normals[inner], truth.normals[inner]).max() < 0.01
    error = angular_error(plain.normal_map, truth).mae_deg
    assert angular_error(made.normal_map, truth).mae_deg < error / 2


def test_bicubic_interpolation_is_that_of_the_normals():
    low = rough(17, 19)
    made = super_resolve(low, 2, method="bicubic")
    np.testing.assert_allclose(made.normal_map.normals, units(bicubic(low.normals, 2)), atol=1e-6)
    assert made.sigma_deg is None
    assert made.stage.model is None
    assert made.invented_share == 0
    assert not made.invented.any()


@pytest.mark.parametrize("scale", [2, 4])
def test_means_of_a_cubic_are_interpolated_exactly(scale):
    """The means over small pixels follow from the means over large ones."""
    edges = np.linspace(-1, 1, 12 * scale + 1)
    a, b = edges[:-1], edges[1:]
    mean, cubes = ((b**k - a**k) / (b - a) / k for k in (3, 4))
    small = (mean[:, None] + 2 * mean - 0.4 * cubes + (a + b) / 2 - 0.7)[..., None]
    small = small.repeat(3, axis=2).astype(np.float32)
    large = cv2.resize(small, (12, 12), interpolation=cv2.INTER_AREA)
    made = smoothly(without_averaging(large, scale), scale)
    inner = (slice(4 * scale, -4 * scale),) * 2
    np.testing.assert_allclose(made[inner], small[inner], atol=2e-6)


@pytest.mark.parametrize("scale", [2, 4])
def test_steep_waves_are_interpolated(scale):
    """They are smooth, although their second differences are large: a network only adds errors."""
    y, x = np.mgrid[1:-1:160j, -1:1:160j] * 16 / scale
    p, q = 0.7 * np.sin(x + 0.4 * y), 0.4 * np.cos(0.8 * y)
    truth = NormalMap.from_vectors(np.dstack([-p, -q, np.ones_like(p)]))
    low, inner = low_resolution(truth, scale), (slice(16, -16),) * 2
    errors = [
        angle_deg(made.normal_map.normals[inner], truth.normals[inner])
        for made in (super_resolve(low, scale), super_resolve(low, scale, method="bicubic"))
    ]
    assert errors[0].mean() < 0.1 * errors[1].mean()


@settings(max_examples=25)
@given(
    arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))).filter(np.any),
    st.integers(0, 6),
)
def test_vectors_are_continued_inside_the_cone_of_the_known_ones(mask, rings):
    """No background enters: all continued vectors are means of known ones."""
    height, width = mask.shape
    known = units(rough(9, 9, seed=2).normals[:height, :width] + np.array([1, 0, 0], np.float32))
    filled = filled_outwards(np.where(mask[..., None], known, np.float32(0)), mask, rings)
    np.testing.assert_array_equal(filled[mask], known[mask])
    np.testing.assert_allclose(np.linalg.norm(filled, axis=2), 1, atol=1e-5)
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_C, 3)
    reached = distance <= rings
    least = known[mask][:, 0].min()
    assert (filled[reached][:, 0] >= least - 1e-4).all()
    np.testing.assert_array_equal(filled[~reached], np.tile([0, 0, 1], ((~reached).sum(), 1)))


def test_what_is_outside_the_mask_has_no_effect(whole):
    other = rough(seed=9)
    truth, mask = rough(), disc(40, 52)
    # The file of a map may contain anything outside; the map itself is 0 there.
    mixed = NormalMap.from_vectors(np.where(mask[..., None], truth.normals, other.normals), mask)
    again = super_resolve(mixed, 4)
    np.testing.assert_allclose(again.normal_map.normals, whole.normal_map.normals, atol=1e-5)


# The result.


def test_the_result_is_a_normal_map_with_its_figures(whole):
    high = whole.normal_map
    NormalMap(high.normals, high.mask)  # unit length inside, 0 outside
    assert abs(high.mask.sum() / (16 * disc(40, 52).sum()) - 1) < 0.02
    assert np.isnan(whole.sigma_deg[~high.mask]).all()
    assert (whole.sigma_deg[high.mask] > 0).all()
    assert not whole.invented[~high.mask].any()
    assert ((whole.invented >= 0) & (whole.invented <= 1)).all()
    assert 0 < whole.invented_share < 1
    assert whole.median_sigma_deg == np.median(whole.sigma_deg[high.mask])
    assert whole.mean_added_deg > 0
    assert repr(whole) == f"SuperResolution({high!r}, {KINDS[4].domain}, x4)"


@pytest.mark.parametrize(
    ("scale", "self_ensemble"), [pytest.param(2, True, marks=pytest.mark.slow), (4, False)]
)
def test_tiles_equal_the_whole(scale, self_ensemble, monkeypatch):
    low = masked(rough(45, 70, seed=4), disc(45, 70))
    made = super_resolve(low, scale, self_ensemble=self_ensemble)
    steps = []
    monkeypatch.setattr(memory_module, "TILE_PX", 16)
    monkeypatch.setattr(memory_module, "_HALOS", 0)
    tiled = super_resolve(
        low, scale, self_ensemble=self_ensemble, on_progress=lambda *step: steps.append(step)
    )
    assert steps[-1][1] == steps[-1][2] > 8
    np.testing.assert_array_equal(tiled.normal_map.mask, made.normal_map.mask)
    inside = made.normal_map.mask
    off = angle_deg(tiled.normal_map.normals[inside], made.normal_map.normals[inside])
    assert off.max() < 1e-3
    np.testing.assert_allclose(tiled.sigma_deg[inside], made.sigma_deg[inside], rtol=1e-3)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 3), (12, 11)])
def test_maps_smaller_than_a_window_or_a_tile(size):
    made = super_resolve(rough(20, 20), 2, mask=None)
    assert made.normal_map.size == (40, 40)
    low = NormalMap.from_vectors(rough(20, 20).normals[: size[0], : size[1]])
    for method in (None, "bicubic"):
        made = super_resolve(low, 4, method=method)
        assert made.normal_map.size == (4 * size[0], 4 * size[1])
        assert made.normal_map.mask.all()


@pytest.mark.slow
@settings(max_examples=8)
@given(st.integers(0, 7), st.integers(0, 1000))
def test_a_turned_map_gives_the_turned_result(symmetry, seed):
    low = masked(rough(19, 23, seed), disc(19, 23))
    other = NormalMap.from_vectors(turned(low.normals, symmetry))
    made = super_resolve(low, 2, self_ensemble=True)
    again = super_resolve(other, 2, self_ensemble=True)
    expected = turned(made.normal_map.normals, symmetry)
    np.testing.assert_allclose(again.normal_map.normals, expected, atol=1e-4)


def test_turned_copies_are_averaged_at_scale_4_unless_refused():
    low = rough(12, 16, seed=5)
    for scale, default in ((4, True), (2, False)):
        made = super_resolve(low, scale)
        same = super_resolve(low, scale, self_ensemble=default)
        other = super_resolve(low, scale, self_ensemble=not default)
        np.testing.assert_array_equal(made.normal_map.normals, same.normal_map.normals)
        np.testing.assert_array_equal(made.sigma_deg, same.sigma_deg)
        assert (made.stage.self_ensemble, other.stage.self_ensemble) == (default, not default)
        assert np.abs(made.normal_map.normals - other.normal_map.normals).max() > 1e-4


def test_a_mask_of_the_higher_resolution_is_used_near_the_map():
    low = masked(rough(), disc(40, 52))
    wanted = np.ones((160, 208), np.bool_)
    wanted[:, 100:110] = False
    made = super_resolve(low, 4, mask=wanted).normal_map
    near = cv2.dilate(low.mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    np.testing.assert_array_equal(made.mask, wanted & near.repeat(4, 0).repeat(4, 1))
    with pytest.raises(DataError, match=r"mask must be bool of shape \(160, 208\), not bool of"):
        super_resolve(low, 4, mask=wanted[1:])
    with pytest.raises(DataError, match="has no pixel near"):
        super_resolve(low, 4, mask=np.zeros((160, 208), np.bool_))


def test_the_mean_square_error_of_a_blend_is_predicted():
    """With known errors of both results, the error of any blend of them follows."""
    random = np.random.default_rng(5)
    facing = np.tile(np.array([0, 0, 1], np.float32), (200, 200, 1))
    residual, rest = random.normal(scale=0.01, size=(2, 200, 200, 3))
    residual[..., 2] = rest[..., 2] = 0
    # The network finds half of the error, and adds an error of its own.
    sharp, truth = (
        units((facing + one).astype(np.float32)) for one in (residual / 2 + rest, residual)
    )
    ours, theirs = (float(((truth - one) ** 2).sum(2).mean()) for one in (sharp, facing))
    assert theirs < ours
    errors = np.broadcast_to(np.array([ours, theirs], np.float32), (200, 200, 2))
    square = ((sharp - facing) ** 2).sum(axis=2)
    for limit in (0, 0.4, 1):
        normals, variance = blend(
            facing, sharp, square, errors, np.full((200, 200), limit, np.float32)
        )
        actual = ((truth - normals) ** 2).sum(2).mean()
        assert variance.mean() == pytest.approx(actual, rel=0.03)
        weight = limit * theirs / ours
        np.testing.assert_allclose(
            normals, units(facing + np.float32(weight) * (sharp - facing)), atol=1e-6
        )


# Networks.


def copied(folder: Path, **changed) -> Path:
    """Copy the network of scale 4, with changes to its description; None removes a key."""
    path = folder / "n.onnx"
    shutil.copy(KINDS[4].path, path)
    described = json.loads(KINDS[4].path.with_suffix(".json").read_text(encoding="utf-8"))
    described = {key: value for key, value in (described | changed).items() if value is not None}
    path.with_suffix(".json").write_text(json.dumps(described), encoding="utf-8")
    return path


OTHER = {"detail": "normals", "normals": "detail"}


def test_a_network_of_the_other_domain_works_in_that_domain(tmp_path):
    low, other = rough(20, 24), OTHER[KINDS[4].domain]
    path = copied(tmp_path, domain=other)
    made = super_resolve(low, 4, model=path)
    assert made.stage.method == other
    plain = super_resolve(low, 4, method="bicubic")
    assert angular_error(made.normal_map, plain.normal_map).mae_deg < 45
    with pytest.raises(DataError, match=f"the method {KINDS[4].domain} needs one"):
        super_resolve(low, 4, model=path, method=KINDS[4].domain)
    given_model = read_superres_model(path, 4)
    with pytest.raises(DataError, match="is for scale 4, not 2"):
        super_resolve(low, 2, model=given_model)
    assert repr(given_model) == f"SuperResolutionModel('{KINDS[4].name}', x4, {other})"


DESCRIPTIONS = {
    "version": ({"format": 2}, "key 'format'"),
    "no hash": ({"sha256": None}, "key 'sha256'"),
    "scale 3": ({"scale": 3}, "key 'scale'"),
    "architecture": ({"architecture": "unet"}, "key 'architecture'"),
    "halo": ({"halo_px": 0}, "key 'halo_px'"),
    "deviations": ({"deviations": {"predicted_deg": [1], "actual_deg": [1]}}, "key 'deviations'"),
    "unknown key": ({"halo": 3}, "key 'halo'"),
    "another file": ({"sha256": 64 * "0"}, "not the network that n.json describes, or altered"),
}


@pytest.mark.parametrize("case", DESCRIPTIONS)
def test_descriptions_that_do_not_fit(case, tmp_path):
    changed, text = DESCRIPTIONS[case]
    with pytest.raises(DataError, match=text) as caught:
        super_resolve(rough(), 4, model=copied(tmp_path, **changed))
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_networks(tmp_path):
    low = rough(12, 12)
    data = KINDS[4].data
    for name, damaged in {
        "cut short": data[: len(data) // 2],
        "altered": data[:-1] + bytes([data[-1] ^ 1]),
        "empty": b"",
        "text": b"no network",
    }.items():
        path = copied(tmp_path)
        path.write_bytes(damaged)
        with pytest.raises(DataError, match="or altered: restore both files"):
            super_resolve(low, 4, model=path)
        copied(tmp_path, sha256=hashlib.sha256(damaged).hexdigest())
        path.write_bytes(damaged)
        if name != "altered":  # one bit of a weight is no reason to refuse a network
            with pytest.raises(
                DataError, match=r"n\.onnx: not a network .* OpenCV cannot"
            ) as caught:
                super_resolve(low, 4, model=path)
            assert "\n" not in str(caught.value)
    # The file of scale 2, described as one of scale 4.
    path = copied(tmp_path, sha256=KINDS[2].sha256)
    path.write_bytes(KINDS[2].data)
    with pytest.raises(DataError, match="its output is float32 of shape"):
        super_resolve(low, 4, model=path)
    path.with_suffix(".json").write_text("{", encoding="utf-8")
    with pytest.raises(DataError, match="not a description of a network"):
        super_resolve(low, 4, model=path)
    path.with_suffix(".json").unlink()
    with pytest.raises(MissingPathError, match=r"n\.json: no such file: a network needs"):
        super_resolve(low, 4, model=path)
    with pytest.raises(MissingPathError, match=r"lost\.onnx: no such file"):
        super_resolve(low, 4, model=tmp_path / "lost.onnx")


def test_scales_sizes_and_names_that_do_not_exist(monkeypatch):
    low = rough(12, 12)
    with pytest.raises(DataError, match="a scale of 3 is not available: use 2 or 4"):
        super_resolve(low, 3, method="bicubic")
    with pytest.raises(DataError, match="a scale of 3 is not available"):
        read_superres_model(None, 3)
    with pytest.raises(DataError, match=r"12 x 12 pixels into 48 x 48, 2303 are allowed"):
        super_resolve(low, 4, max_pixels=2303)
    with pytest.raises(
        DataError, match=r"there is no network 'big': give a \.onnx file, or one of"
    ):
        super_resolve(low, 4, model="big")
    with pytest.raises(DataError, match=r"there is no network '\.\./models/superres-x4'"):
        super_resolve(low, 4, model="../models/superres-x4")
    with pytest.raises(DataError, match="bicubic interpolation uses no network"):
        super_resolve(low, 4, model="superres-x4", method="bicubic")
    with pytest.raises(TypeError, match="normal_map must be a NormalMap"):
        super_resolve(low.normals, 4)

    def full(way, size):
        raise MemoryError

    monkeypatch.setattr(SuperResolutionStage, "forms", full)
    with pytest.raises(DataError, match="48 x 48 pixels does not fit into the memory"):
        super_resolve(low, 4)


def test_a_network_whose_output_is_not_finite(monkeypatch):
    network = Network(KINDS[4])

    class Broken:
        def setInput(self, blob):  # noqa: N802
            self.shape = blob.shape

        def forward(self):
            return np.full((1, 5, 4 * self.shape[2], 4 * self.shape[3]), np.nan, np.float32)

    monkeypatch.setattr(network, "_net", Broken())
    with pytest.raises(DataError, match="its output is not finite"):
        network.run(rough(12, 12).normals)
