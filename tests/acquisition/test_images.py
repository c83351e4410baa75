"""Image files that are read, against hand-made bytes."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import read_image
from acquisition.pixels import image_facts, read_image_with_alpha
from tests.acquisition.image_bytes import BIG, RGB, RGB16, by_library, chunk, png, tga
from tests.cases import cases
from tests.real_data import DATA, needs_data

GREY_ALPHA = np.stack([RGB[..., 0], np.full((4, 5), 7, np.uint8)], -1)


RGBA = np.concatenate([RGB, np.full((4, 5, 1), 7, np.uint8)], -1)


PALETTE = chunk(b"PLTE", bytes([255, 0, 0, 0, 255, 0, 1, 2, 3, 9, 9, 9]))


INDEXED = np.array([[255, 0, 0], [0, 255, 0], [1, 2, 3], [9, 9, 9]], np.uint8)


BGRA_UP = RGBA[::-1, :, [2, 1, 0, 3]]


@cases(
    ("name", "data", "expected"),
    {
        "png RGB 8": ("a.png", png(RGB.reshape(4, -1), 8, 2), RGB),
        "png RGB 16 is big-endian": ("a.png", png(BIG, 16, 2), RGB16),
        "png grey": ("a.png", png(RGB[..., 0], 8, 0), RGB[..., 0]),
        "png grey, alpha dropped": ("a.png", png(GREY_ALPHA.reshape(4, -1), 8, 4), RGB[..., 0]),
        "png RGB not multiplied by alpha": ("a.png", png(RGBA.reshape(4, -1), 8, 6), RGB),
        "png palette of 2 bits": (
            "a.png",
            png(np.array([[0b00011011]], np.uint8), 2, 3, PALETTE),
            INDEXED[None],
        ),
        "png of 1 bit": (
            "a.png",
            png(np.array([[0b10100000]], np.uint8), 1, 0),
            np.array([[255, 0, 255, 0, 0, 0, 0, 0]], np.uint8),
        ),
        "png gamma chunk is not applied": (
            "a.png",
            png(RGB.reshape(4, -1), 8, 2, chunk(b"gAMA", struct.pack(">I", 45455))),
            RGB,
        ),
        "png with bytes after it": ("a.png", png(RGB.reshape(4, -1), 8, 2) + b"trailing", RGB),
        "tga bottom up, BGR": ("a.tga", tga(RGB[::-1, :, ::-1], 0), RGB),
        "tga top down": ("a.tga", tga(RGB[:, :, ::-1], 0x20), RGB),
        "tga alpha dropped": ("a.tga", tga(BGRA_UP, 8), RGB),
        "tga grey": ("a.tga", tga(RGB[::-1, :, 1], 0), RGB[..., 1]),
        "ppm of 16 bits": ("a.ppm", b"P6 5 4 65535\n" + RGB16.astype(">u2").tobytes(), RGB16),
        "pgm": ("a.pgm", b"P5 5 4 255\n" + RGB[..., 2].tobytes(), RGB[..., 2]),
        "content wins over the name": ("a.jpg", png(RGB.reshape(4, -1), 8, 2), RGB),
    },
)
def test_hand_made_files(tmp_path: Path, name: str, data: bytes, expected: np.ndarray) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    pixels = read_image(path)
    assert pixels.dtype == expected.dtype
    assert pixels.flags.c_contiguous
    np.testing.assert_array_equal(pixels, expected)
    form = image_facts(path)
    assert (form.shape, form.dtype) == (expected.shape, expected.dtype)


@cases(
    ("data", "expected"),
    {
        "png RGB": (png(RGBA.reshape(4, -1), 8, 6), RGBA[..., 3]),
        "png grey": (png(GREY_ALPHA.reshape(4, -1), 8, 4), GREY_ALPHA[..., 1]),
        "none": (png(RGB.reshape(4, -1), 8, 2), None),
    },
)
def test_alpha_is_returned_with_the_colours(
    tmp_path: Path, data: bytes, expected: np.ndarray | None
) -> None:
    (tmp_path / "a.png").write_bytes(data)
    pixels, alpha = read_image_with_alpha(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, read_image(tmp_path / "a.png"))
    np.testing.assert_equal(alpha, expected)


@pytest.mark.parametrize(
    ("stored", "expected"), [(np.float16, 0.5), (np.float32, 1e-20), (np.float64, 1e-20)]
)
def test_floats_are_read_as_float32(tmp_path: Path, stored: type, expected: float) -> None:
    suffix = ".tif" if stored is np.float64 else ".exr"
    path = by_library(tmp_path / f"a{suffix}", np.full((3, 4), expected, stored))
    pixels = read_image(path)
    assert pixels.dtype == np.float32
    np.testing.assert_array_equal(pixels, np.full((3, 4), expected, np.float32))


def test_jpeg_is_rgb_and_not_rotated_by_its_orientation(tmp_path: Path) -> None:
    picture = np.zeros((16, 32, 3), np.uint8)
    picture[..., 0] = 250
    path = by_library(tmp_path / "a.jpg", picture)
    pixels = read_image(path)
    assert pixels.shape == (16, 32, 3)
    assert pixels[..., 0].min() > 240
    assert pixels[..., 1:].max() < 12
    by_library(path, picture, Orientation=6)
    assert read_image(path).shape == (16, 32, 3)


def test_exr_channels_are_chosen_by_name(tmp_path: Path) -> None:
    planes = np.stack([np.full((3, 4), value, np.float32) for value in (1, 2, 3, 4, 5)], -1)
    path = by_library(tmp_path / "a.exr", planes, ("Z", "B", "A", "R", "G"))
    np.testing.assert_array_equal(read_image(path)[0, 0], [4, 5, 2])


@needs_data
@pytest.mark.parametrize(
    ("name", "shape", "dtype"),
    [
        ("uw/chrome/chrome.0.tga", (340, 512, 3), np.uint8),
        ("diligent/bearPNG/001.png", (273, 230, 3), np.uint16),
        ("diligent/bearPNG/mask.png", (273, 230), np.uint8),
        ("reliefs/151.jpg", (1024, 1024, 3), np.uint8),
    ],
)
def test_real_images(name: str, shape: tuple[int, ...], dtype: type) -> None:
    pixels = read_image(DATA / name)
    assert pixels.shape == shape
    assert pixels.dtype == dtype
    assert pixels.max() > 100
    if name.endswith((".png", ".jpg")):
        # Another decoder that does not rotate either; JPEG decoders may differ by rounding.
        flags = cv2.IMREAD_UNCHANGED
        other = cv2.imread(str(DATA / name), flags)
        other = other[..., ::-1] if other.ndim == 3 else other
        assert np.abs(other.astype(int) - pixels).max() <= (3 if name.endswith("jpg") else 0)
