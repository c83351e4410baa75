"""Masks: what is inside, and how much of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from acquisition import DataError, read_mask, read_mask_shares, write_exr, write_png


@pytest.mark.parametrize(
    ("pixels", "shares"),
    [
        pytest.param(np.array([[0, 51, 255]], np.uint8), [[0, 0.2, 1]], id="8 bit"),
        pytest.param(np.array([[0, 13107, 65535]], np.uint16), [[0, 0.2, 1]], id="16 bit"),
        pytest.param(
            np.array([[[9, 51, 0], [0, 0, 255]]], np.uint8), [[0.2, 1]], id="the brightest colour"
        ),
        pytest.param(np.array([[-1, 0.2, 7, np.nan]], np.float32), [[0, 0.2, 1, 0]], id="floats"),
    ],
)
def test_shares(tmp_path: Path, pixels: npt.NDArray[np.generic], shares: list[object]) -> None:
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
