"""Stacks of recordings with a flat field: their values, and the law of their noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import Flat, Lights, Source, crop, downscale
from acquisition.source import apply_flat
from calibration import linear_stack, open_stack, raw_stack
from calibration.radiance import linear_images
from tests.calibration.noisy_recordings import SENSOR, THREE, frame, recording

pytestmark = pytest.mark.usefixtures("paths_exist")

SHAPE = (64, 160)


def flat(shape=SHAPE, cfa=None):
    """Return a flat with corners at .6 and a PRNU of 2 %."""
    rows, columns = np.indices(shape)
    far = np.hypot(rows / shape[0] - 0.5, columns / shape[1] - 0.5)
    pixel = np.random.default_rng(4).normal(1, 0.02, shape)
    return Flat(1 - 0.4 * far / far.max(), pixel, cfa=cfa)


CASES = {
    "one exposure": {},
    "repeats": {"repeats": 3},
    "three brackets": {"shares": THREE},
    "sites of a mosaic": {"cfa": "RGGB", "channel": "mosaic"},
    "demosaiced": {"cfa": "RGGB"},
    "colours": {"cfa": "RGGB", "channel": "rgb"},
    "averaged blocks": {"factor": 2},
    "sensor estimated from repeats": {"repeats": 2, "model": False},
}


@pytest.mark.parametrize("name", CASES)
def test_the_predicted_noise_is_the_actual_one_with_a_flat(name):
    """In every decile of a ramp, under a light of intensity 1.5."""
    options = dict(CASES[name])
    channel, factor = options.pop("channel", "gray"), options.pop("factor", 1)
    made = flat(cfa=options.get("cfa"))
    top = 0.8 / min(options.get("shares", (1.0,)))
    radiance = np.tile(np.geomspace(0.01, top, SHAPE[1]), (SHAPE[0], 1))
    lights = Lights([[0, 0, 1]], intensities=[1.5], ids=("L00",))
    stacks = []
    for seed in range(16):
        source = recording(SENSOR, radiance * made.response, seed=seed, **options)
        source = downscale(apply_flat(replace(source, lights=lights), made), factor)
        stacks.append(linear_stack(source, channel=channel))
    values = np.stack([stack.values[0] for stack in stacks]).astype(float)
    mean = values.mean(axis=0)
    assert np.isfinite(values).all()
    actual = values.var(axis=0, ddof=1)
    predicted = np.mean([stack.noise.variance(0, mean) for stack in stacks], axis=0)
    deciles = np.array_split(np.arange(mean.shape[1]), 10)
    ratio = [(predicted[:, s].mean() / actual[:, s].mean()) ** 0.5 for s in deciles]
    assert min(ratio) > 0.95
    assert max(ratio) < 1.05
    # A part of the rows has the same law.
    part = stacks[0].noise.variance(0, mean[6:10], first_row=6)
    np.testing.assert_allclose(part, stacks[0].noise.variance(0, mean)[6:10])


@pytest.mark.parametrize("shares", [(1.0,), THREE], ids=["one exposure", "three brackets"])
def test_a_flat_undoes_the_response(shares):
    made = flat()
    radiance = np.full(SHAPE, 0.5)
    source = recording(SENSOR, radiance * made.response, shares=shares)
    plain, divided = linear_stack(source), linear_stack(apply_flat(source, made))
    np.testing.assert_allclose(divided.values[0], plain.values[0] / made.response, rtol=1e-5)
    assert divided.values[0].mean() == pytest.approx(0.5, abs=1e-3)


def test_a_region_has_its_part_of_the_flat():
    made = flat()
    source = apply_flat(recording(SENSOR, np.full(SHAPE, 0.5) * made.response), made)
    whole, part = linear_stack(source), linear_stack(crop(source, 11, 7, 40, 30))
    np.testing.assert_array_equal(part.values[0], whole.values[0][7:37, 11:51])


def test_saturation_is_judged_before_the_division():
    made = flat()
    radiance = np.full(SHAPE, 0.9)
    radiance[10:20, 10:20] = 4.0
    stack = linear_stack(apply_flat(recording(SENSOR, radiance * made.response), made))
    assert np.isnan(stack.values[0][10:20, 10:20]).all()
    assert np.isfinite(stack.values[0]).sum() == 64 * 160 - 100


def test_all_ways_to_read_a_source_use_its_flat():
    made = flat()
    source = apply_flat(recording(SENSOR, np.full(SHAPE, 0.5) * made.response), made)
    values = linear_stack(source).values
    np.testing.assert_array_equal(raw_stack(source).values[:, 3:40, 5:90], values[:, 3:40, 5:90])
    np.testing.assert_array_equal(next(iter(linear_images(source))), values[0])
    two = apply_flat(recording(SENSOR, np.full(SHAPE, 0.5) * made.response, repeats=2), made)
    np.testing.assert_array_equal(raw_stack(two).values[0], linear_stack(two).values[0])


@pytest.mark.parametrize("shares", [(1.0,), THREE], ids=["one exposure", "three brackets"])
@pytest.mark.parametrize("cfa", [None, "RGGB"], ids=["mono", "mosaic"])
def test_bands_of_rows_have_their_part_of_the_flat(shares, cfa):
    made = flat(cfa=cfa)
    ramp = np.tile(np.linspace(0.1, 2, SHAPE[1]), (SHAPE[0], 1))
    source = recording(SENSOR, ramp * made.response, shares=shares, cfa=cfa)
    whole = crop(apply_flat(source, made), 4, 3, 90, 50)
    stack = linear_stack(whole)
    with open_stack(whole) as banded:
        for rows, band in banded.bands(17):
            np.testing.assert_array_equal(band.values, stack.values[:, rows])
            expected = stack.noise.variance(0, stack.values[0])[rows]
            np.testing.assert_allclose(band.noise.variance(0, band.values[0]), expected)


def test_colour_frames_have_a_flat_in_colour():
    shape = (20, 30, 3)
    made = Flat(np.full(shape, 0.8), np.broadcast_to([1.0, 0.9, 1.1], shape))
    pixels = np.full(shape, 2000, np.uint16)
    source = Source(
        Path("/nowhere"), "images", (frame(pixels, "light", 1.0, 0),), white_level=4000.0
    )
    stack = linear_stack(apply_flat(source, made), channel="rgb")
    np.testing.assert_allclose(
        stack.values[0, 0, 0], 0.5 / 0.8 / np.array([1, 0.9, 1.1]), rtol=1e-6
    )
