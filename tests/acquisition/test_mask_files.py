"""Masks from image files: which pixels are inside, and by which share."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import DataError, read_mask, write_exr, write_png
from acquisition.pixels import read_mask_shares
from rig.arrays import Generic
from tests.cases import cases


@cases(
    ("pixels", "shares"),
    {
        "8 bit": (np.array([[0, 51, 255]], np.uint8), [[0, 0.2, 1]]),
        "16 bit": (np.array([[0, 13107, 65535]], np.uint16), [[0, 0.2, 1]]),
        "the brightest colour": (np.array([[[9, 51, 0], [0, 0, 255]]], np.uint8), [[0.2, 1]]),
        "floats": (np.array([[-1, 0.2, 7, np.nan]], np.float32), [[0, 0.2, 1, 0]]),
    },
)
def test_shares(tmp_path: Path, pixels: Generic, shares: list[object]) -> None:
    path = tmp_path / ("m.exr" if pixels.dtype == np.float32 else "m.png")
    (write_exr if pixels.dtype == np.float32 else write_png)(path, pixels)  # type: ignore[operator]
    np.testing.assert_allclose(read_mask_shares(path), shares, rtol=1e-6)
    np.testing.assert_array_equal(read_mask(path), np.array(shares, float) > 0.5)


def test_half_is_outside(tmp_path: Path) -> None:
    write_png(tmp_path / "m.png", np.array([[127, 128, 0]], np.uint8))
    assert read_mask(tmp_path / "m.png").tolist() == [[False, True, False]]
    write_png(tmp_path / "m.png", np.array([[127, 127, 0]], np.uint8))
    for read in (read_mask, read_mask_shares):
        with pytest.raises(DataError, match="nothing inside"):
            read(tmp_path / "m.png")


def test_another_size(tmp_path: Path) -> None:
    write_png(tmp_path / "m.png", np.full((4, 6), 255, np.uint8))
    assert read_mask_shares(tmp_path / "m.png", (4, 6)).shape == (4, 6)
    with pytest.raises(DataError, match=r"6 x 4 pixels, but the images have 4 x 6"):
        read_mask_shares(tmp_path / "m.png", (6, 4))


WHITE, BLACK, RED = (255, 255, 255), (0, 0, 0), (0, 0, 255)


def write_rgba(path: Path, colours: list[tuple[int, ...]], alpha: list[int]) -> None:
    pixels = [[(*colour, share) for colour, share in zip(colours, alpha, strict=True)]]
    assert cv2.imwrite(str(path), np.array(pixels, np.uint8))


@cases(
    ("colours", "alpha", "shares"),
    {
        "opaque": ([WHITE, BLACK, RED], [255, 255, 255], [1, 0, 1]),
        "over white": ([WHITE, WHITE, WHITE], [255, 51, 0], [1, 0.2, 0]),
        "over black": ([BLACK, BLACK, BLACK], [255, 51, 0], [1, 0.2, 0]),
        "invisible colour": ([RED, RED, BLACK], [255, 51, 0], [1, 0.2, 0]),
        "multiplied": ([WHITE, (51, 51, 51), BLACK], [255, 51, 0], [1, 0.2, 0]),
    },
)
def test_transparency(
    tmp_path: Path, colours: list[tuple[int, ...]], alpha: list[int], shares: list[float]
) -> None:
    write_rgba(tmp_path / "m.png", colours, alpha)
    np.testing.assert_allclose(read_mask_shares(tmp_path / "m.png"), [shares], rtol=1e-6)
    assert read_mask(tmp_path / "m.png").tolist() == [[share > 0.5 for share in shares]]


@cases(
    ("colours", "alpha", "said"),
    {
        "two masks": ([WHITE, BLACK, BLACK], [255, 255, 0], "two different masks"),
        "all transparent": ([WHITE, WHITE, BLACK], [0, 0, 0], "nothing inside"),
    },
)
def test_transparency_that_gives_no_mask(
    tmp_path: Path, colours: list[tuple[int, ...]], alpha: list[int], said: str
) -> None:
    write_rgba(tmp_path / "m.png", colours, alpha)
    with pytest.raises(DataError, match=said):
        read_mask(tmp_path / "m.png")
