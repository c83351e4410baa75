"""Normals of a Bayer mosaic, site by site, against a mono sensor behind each of the filters."""

from pathlib import Path

import numpy as np
import pytest

from acquisition import DataError, Lights, Source, angle_deg, crop, downscale
from calibration import linear_stack
from calibration.radiance import demosaic
from processing import reconstruct
from processing.images.mosaic import albedo_of_sites
from simulator.camera import sensor_image
from tests.processing.test_colours import LIGHTS, SENSOR, source_of
from tests.quick_sample import quick

SIZE = (72, 96)


@pytest.fixture(autouse=True)
def paths_exist(monkeypatch):
    """The frames are arrays without files."""
    monkeypatch.setattr(Path, "exists", lambda self: True)


def scene():
    """Return normals of waves, and an albedo of coloured patches with sharp edges."""
    y, x = np.indices(SIZE, dtype=float)
    slopes = 0.4 * np.sin(x / 7), 0.4 * np.cos(y / 9)
    normals = np.dstack([*slopes, np.ones(SIZE)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    patch = (x // 12 + y // 9).astype(int) % 4
    colours = np.array([[0.8, 0.2, 0.15], [0.15, 0.7, 0.2], [0.2, 0.25, 0.8], [0.7, 0.7, 0.65]])
    edge = np.zeros(SIZE, bool)
    edge[:, 1:] |= patch[:, 1:] != patch[:, :-1]
    edge[1:] |= patch[1:] != patch[:-1]
    return normals, colours[patch], edge


def sites(pattern):
    """Return the channel of each pixel."""
    y, x = np.indices(SIZE)
    return np.array(["RGB".index(name) for name in pattern])[2 * (y % 2) + x % 2]


def recording(channel, cfa, seed=5):
    """Record the scene through the filters ``channel (H, W)``."""
    normals, albedo, _ = scene()
    frames = []
    for i, (vector, intensity) in enumerate(
        zip(LIGHTS.directions, LIGHTS.intensities, strict=True)
    ):
        shade = np.clip(normals @ vector, 0, None)
        signal = np.take_along_axis(albedo * intensity, channel[..., None], axis=2)[..., 0] * shade
        electrons = (0.9 * 4031 * SENSOR.electrons_per_dn * signal).astype(np.float32)
        pixels = sensor_image(electrons, SENSOR, key=(seed, i))
        frames.append(pixels)
    return source_of(frames, normals, cfa=cfa, noise=SENSOR)


def errors(result):
    return angle_deg(result.normals.normals, scene()[0])


@pytest.mark.parametrize("pattern", quick(["RGGB", "GBRG"], every=2))
@pytest.mark.parametrize("method", quick(["cauchy", "ls"], every=2))
def test_a_mosaic_is_as_good_as_a_mono_sensor_behind_each_filter(pattern, method):
    mosaic = errors(
        reconstruct(recording(sites(pattern), pattern), method=method, channel="mosaic")
    )
    mono = np.zeros(SIZE)
    for k in range(3):
        mono = np.where(sites(pattern) == k, errors(_behind(k, method)), mono)
    edge = np.zeros(SIZE, bool)
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            edge |= np.roll(scene()[2], (dy, dx), (0, 1))
    assert mosaic.mean() < 1.1 * mono.mean()
    assert mosaic[edge].mean() < 1.1 * mono[edge].mean()


def test_errors_are_as_large_as_predicted():
    result = reconstruct(recording(sites("RGGB"), "RGGB", seed=8), channel="mosaic")
    error, found = errors(result), result.uncertainty
    # The sites have different signals, so their errors differ by a factor of 2.
    for part in np.array_split(np.argsort(found.sigma_deg.ravel()), 5):
        actual, predicted = error.ravel()[part], found.sigma_deg.ravel()[part].astype(float)
        assert 0.85 < np.sqrt(np.mean(actual**2) / np.mean(predicted**2)) < 1.2


def _behind(k, method):
    """Return the result of a mono sensor behind filter k, with its own noise."""
    made = recording(np.full(SIZE, k), None, seed=9)
    intensities = np.repeat(LIGHTS.intensities[:, k : k + 1], 3, axis=1)
    lights = Lights(directions=LIGHTS.directions, intensities=intensities)
    return reconstruct(Source(**{**vars(made), "lights": lights}), method=method)


def test_the_albedo_in_colour():
    result = reconstruct(recording(sites("RGGB"), "RGGB"), channel="mosaic")
    _, albedo, edge = scene()
    away = ~edge
    for shift in (1, -1, 2, -2):
        away &= ~np.roll(edge, shift, 0) & ~np.roll(edge, shift, 1)
    scale = 0.9
    assert np.abs(result.albedo[away] / scale - albedo[away]).mean() < 0.01
    # At every site, its own colour is the measured one, also on edges.
    own = np.take_along_axis(result.albedo, sites("RGGB")[..., None], axis=2)
    true = np.take_along_axis(albedo, sites("RGGB")[..., None], axis=2)
    assert np.abs(own / scale - true).mean() < 0.01


def test_a_region_keeps_its_filters():
    made = recording(sites("RGGB"), "RGGB")
    whole = linear_stack(made, channel="mosaic")
    part = linear_stack(crop(made, 7, 4, 40, 30), channel="mosaic")
    np.testing.assert_array_equal(part.values, whole.values[:, 4:34, 7:47])
    assert (whole.pattern, part.pattern) == ("RGGB", "GRBG")
    variance = whole.noise.variance(3, whole.values[3])
    np.testing.assert_array_equal(part.noise.variance(3, part.values[3]), variance[4:34, 7:47])


def test_the_noise_of_sites():
    made = recording(sites("RGGB"), "RGGB")
    stack = linear_stack(made, channel="mosaic")
    stacks = (
        linear_stack(recording(sites("RGGB"), "RGGB", k), channel="mosaic") for k in range(40)
    )
    values = [one.values[0] for one in stacks]
    actual = np.var(values, axis=0, ddof=1)
    predicted = stack.noise.variance(0, np.mean(values, axis=0))
    for k in range(3):
        at = sites("RGGB") == k
        assert (predicted[at].mean() / actual[at].mean()) ** 0.5 == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    ("made", "text"),
    [
        (lambda: recording(np.zeros(SIZE, int), None), "the image has no colour mosaic: use gray"),
        (
            lambda: downscale(recording(sites("RGGB"), "RGGB"), 2),
            "averages of pixels have no single",
        ),
        (
            lambda: recording(sites("RGGB"), "RGBW"),
            "the colour filter pattern RGBW is not supported",
        ),
    ],
)
def test_what_has_no_mosaic_is_refused(made, text):
    with pytest.raises(DataError, match=text):
        linear_stack(made(), channel="mosaic")


def test_a_pixel_without_a_colour_around_it_is_gray():
    mask = np.zeros((8, 8), bool)
    mask[4, 4] = True
    albedo = np.full((8, 8), 0.3, np.float32)
    colours = albedo_of_sites(albedo, mask, "RGGB")
    np.testing.assert_allclose(colours[4, 4], 0.3)
    assert not colours[~mask].any()


def test_the_upsampled_albedo_is_sharper_than_the_bilinear_one():
    """A gray edge: all colours step at the same place."""
    step = np.where(np.arange(40) < 20, 0.2, 0.8)[None].repeat(30, axis=0).astype(np.float32)
    found = albedo_of_sites(step, np.ones(step.shape, bool), "RGGB")
    bilinear = demosaic(step, "RGGB")
    inner = np.s_[4:-4, 4:-4]
    assert (
        np.abs(found - step[..., None])[inner].sum()
        < 0.6 * np.abs(bilinear - step[..., None])[inner].sum()
    )
