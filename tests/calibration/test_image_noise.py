"""Blocks of JPEG compression are seen in images, wherever they begin, and nothing else is."""

import cv2
import numpy as np
import pytest

from calibration import EstimateError, calibrate_spheres
from calibration.spheres.outline.outline import image_noise, shows_blocks
from tests.quick_sample import quick

from .uneven_balls import uneven_ball


def balls(quality, start=0):
    """Return images of a ball, compressed with a quality of JPEG, and its circle."""
    values, (x, y, radius), _ = uneven_ball(4)
    if quality is not None:
        samples = np.rint(255 * np.clip(np.nan_to_num(values, nan=1), 0, 1) ** (1 / 2.2))
        flags = [cv2.IMWRITE_JPEG_QUALITY, quality]
        coded = [cv2.imencode(".jpg", one, flags)[1] for one in samples.astype(np.uint8)]
        read = [cv2.imdecode(one, cv2.IMREAD_GRAYSCALE) for one in coded]
        values = ((np.array(read) / 255) ** 2.2).astype(np.float32)
        values[values > 0.98] = np.nan
    return values[:, start:, start:], (x - start, y - start, radius)


@pytest.mark.parametrize(
    ("quality", "start", "seen"),
    [
        pytest.param(None, 0, False, id="not compressed"),
        pytest.param(97, 0, False, id="hardly compressed"),
        pytest.param(60, 0, True, id="blocks from the first pixel"),
        pytest.param(60, 3, True, id="blocks in a part of the images"),
        pytest.param(30, 7, True, id="strongly compressed"),
    ],
)
def test_blocks_are_seen(quality, start, seen):
    assert shows_blocks(balls(quality, start)[0]) == seen


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(np.full((64, 64), 0.3), id="even"),
        pytest.param(np.random.default_rng(1).uniform(0, 1, (256, 256)), id="noise"),
        pytest.param(np.indices((256, 256)).sum(axis=0) // 16 % 2, id="diagonal bars"),
        pytest.param(np.indices((256, 256))[0] // 8 % 2, id="bars along the rows only"),
        pytest.param(np.full((20, 300), np.nan), id="too small, and saturated"),
    ],
)
def test_other_images_show_no_blocks(image):
    assert not shows_blocks(image[None].astype(np.float32))


@pytest.mark.parametrize(("quality", "named"), quick([(60, True), (None, False)], every=2))
def test_what_is_found_in_compressed_images_has_a_notice(quality, named):
    values, (x, y, radius) = balls(quality)
    rows, columns = np.mgrid[: values.shape[1], : values.shape[2]]
    calibration = calibrate_spheres(values, masks=[np.hypot(columns - x, rows - y) < radius])
    assert ("images-compressed" in {one.code for one in calibration.warnings}) == named


def test_a_refusal_names_the_compression():
    values, _ = balls(20)
    with pytest.raises(EstimateError, match="8 px blocks of JPEG compression"):
        calibrate_spheres(values, circles=[(60.0, 60.0, 30.0)])


def test_no_mask_is_advised_if_one_was_given():
    values, _ = balls(20)
    rows, columns = np.mgrid[: values.shape[1], : values.shape[2]]
    with pytest.raises(EstimateError, match=r"or of a quality of 95$"):
        calibrate_spheres(values, masks=[(rows == 5) & (columns < 9)])


def test_compression_is_no_cause_of_black_images():
    values, circle = balls(60)
    values[:3] = 0
    with pytest.raises(EstimateError, match=r"record them again, or leave them out$"):
        calibrate_spheres(values, circles=[circle])


def test_noise_of_an_even_image():
    image = np.random.default_rng(3).normal(0.3, 0.01, (300, 300)).astype(np.float32)
    assert image_noise(image) == pytest.approx(0.01, rel=0.05)
