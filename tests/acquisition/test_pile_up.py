"""Where samples pile up because they were clipped, and where they only look so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import ANY

import cv2
import numpy as np
import pytest

from acquisition import SRGB, DataError, Session, import_frames, read_source, write_png
from acquisition.pixels.pile_up import PileUp, find_pile_up
from rig.arrays import Floating, Generic, UInt8, UInt16

SIZE = 64
AROUND = np.linspace(0, 2 * np.pi, 8, endpoint=False)
RING = np.stack([0.6 * np.cos(AROUND), 0.6 * np.sin(AROUND), np.full(8, 0.8)], 1)
ABOVE = np.vstack([RING, [[0, 0, 1]]])
Y, X = (np.mgrid[:SIZE, :SIZE] - SIZE / 2) / (0.45 * SIZE)


def shaded(slope_x: Floating, slope_y: Floating, lights: Floating = RING) -> Floating:
    normals = np.stack([slope_x, slope_y, np.ones_like(slope_x)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return 0.8 * np.clip(np.einsum("hwc,nc->nhw", normals, lights), 0, None)


def waves() -> Floating:
    return shaded(0.8 * np.sin(3 * X + Y), 0.6 * np.cos(4 * Y))


def noisy(images: Floating, sigma: float = 0.002) -> Floating:
    return images + np.random.default_rng(4).normal(0, sigma, images.shape)


def found(images: Generic, side: int = 1) -> PileUp | None:
    white = np.inf if images.dtype.kind == "f" else np.iinfo(images.dtype).max
    return find_pile_up([lambda image=image: image for image in images], side, float(white))


def dn16(images: Floating) -> UInt16:
    return np.rint(np.clip(images, 0, 1) * 65535).astype(np.uint16)


def dn8(images: Floating) -> UInt8:
    return np.rint(np.clip(images, 0, 1) * 255).astype(np.uint8)


def test_a_pile_is_found_at_any_value_of_any_type() -> None:
    for images, level in (
        (dn16(noisy(waves())), 40_000),
        (dn8(noisy(waves())), 170),
        (noisy(waves()).astype(np.float32), 0.6),
    ):
        pile = found(np.minimum(images, images.dtype.type(level)))
        assert pile is not None
        assert pile.levels == (pytest.approx(level),)
        assert pile.samples == np.sum(images >= images.dtype.type(level))


def test_clipped_gloss_of_a_dark_object_is_found() -> None:
    height = np.sqrt(np.clip(1 - X**2 - Y**2, 0.01, None))
    ball = shaded(X / height, Y / height) / 0.8
    pile = found(np.minimum(dn8(noisy(0.04 * ball + 3 * ball**60)), 200))
    assert pile is not None
    assert pile.levels == (200,)


def test_a_pile_that_jpeg_spread_is_found() -> None:
    clipped = np.minimum(dn8(noisy(waves())), 170)
    pile = found(np.stack([cv2.imdecode(cv2.imencode(".jpg", each)[1], 0) for each in clipped]))
    assert pile is not None
    assert 168 <= pile.levels[0] <= 170
    assert abs(pile.samples / np.sum(clipped == 170) - 1) < 0.1


def test_hot_pixels_do_not_hide_a_pile() -> None:
    images = np.minimum(dn16(noisy(waves())), 40_000)
    images[:, 5, 7] = 65_535
    pile = found(images)
    assert pile is not None
    assert pile.levels == (40_000,)


def test_each_colour_has_a_level_of_its_own() -> None:
    images = dn16(noisy(waves()))
    images[:, ::2, ::2] = np.minimum(images[:, ::2, ::2], 30_000)
    images[:, 1::2, 1::2] = np.minimum(images[:, 1::2, 1::2], 35_000)
    pile = found(images, side=2)
    assert pile is not None
    np.testing.assert_equal(pile.levels, (30_000, np.nan, np.nan, 35_000))
    assert pile.brightest == images.max()


def plateau() -> Floating:
    """A flat top, the brightest under the light above it, with rounded edges."""
    far = np.clip(np.hypot(X, Y) - 0.5, 0, None) / np.maximum(np.hypot(X, Y), 1e-9)
    return shaded(X * far, Y * far, ABOVE)


def low_relief() -> Floating:
    """An area that nearly faces the light above it."""
    far = np.clip(np.hypot(X, Y) - 0.6, 0, None)
    return shaded(0.05 * np.sin(6 * X) + 3 * X * far, 0.05 * np.cos(5 * Y) + 3 * Y * far, ABOVE)


def facets() -> Floating:
    steepest = np.round(np.arctan2(Y, X) / (np.pi / 4)) * np.pi / 4
    return shaded(0.75 * np.cos(steepest), 0.75 * np.sin(steepest))


def label() -> Floating:
    images = noisy(waves() * 0.8)
    images[:, :12, :20] = 0.9
    return images


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(lambda: noisy(waves()), id="noise"),
        pytest.param(waves, id="no noise"),
        pytest.param(plateau, id="flat top"),
        pytest.param(low_relief, id="low relief"),
        pytest.param(lambda: noisy(low_relief(), 0.0003), id="low relief with noise"),
        pytest.param(facets, id="facets"),
        pytest.param(lambda: shaded(X, 0 * X), id="cylinder"),
        pytest.param(lambda: shaded(0 * X, 0 * X), id="card"),
        pytest.param(lambda: noisy(shaded(0 * X, 0 * X), 0.0005), id="card with noise"),
        pytest.param(label, id="label of one grey value"),
        pytest.param(lambda: np.where(X < 0, waves(), 0.95), id="background of one grey value"),
        pytest.param(lambda: np.floor(noisy(waves()) * 40) / 40, id="few grey values"),
    ],
)
def test_nothing_is_found_where_nothing_was_clipped(scene: Callable[[], Floating]) -> None:
    images = scene()
    jpeg = [cv2.imdecode(cv2.imencode(".jpg", each)[1], 0) for each in dn8(images)]
    for samples in (dn16(images), dn8(images), np.stack(jpeg), images.astype(np.float32)):
        assert found(samples) is None


def test_a_curve_keeps_its_white_and_clipped_samples_are_raised_to_it(tmp_path: Path) -> None:
    images = np.minimum(dn8(noisy(waves())), 170)
    for number, image in enumerate(images):
        write_png(tmp_path / f"a{number}.png", image)
    source = read_source(tmp_path, transfer=SRGB)
    (notice,) = [each for each in source.warnings if each.code == "clipped-below-white"]
    assert "170" in notice.text
    assert source.white_level == 255
    import_frames(source, tmp_path / "session")
    assert read_source(tmp_path / "session").warnings == (replace(notice, where=ANY),)
    stored = Session.open(tmp_path / "session").frames
    for frame, image, kept in zip(source.frames, images, stored, strict=True):
        np.testing.assert_array_equal(kept.read(), image)
        np.testing.assert_array_equal(frame.read(), np.where(image == 170, 255, image))


def test_an_unreadable_image_is_reported_where_it_is_used(tmp_path: Path) -> None:
    for number, image in enumerate(dn8(noisy(waves()))):
        write_png(tmp_path / f"a{number}.png", image)
    path = tmp_path / "a3.png"
    path.write_bytes(path.read_bytes()[:-400])
    source = read_source(tmp_path)
    with pytest.raises(DataError, match="a3"):
        source.frames[3].read()
