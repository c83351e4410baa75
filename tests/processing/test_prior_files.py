"""Files of known heights: tables and maps, and those that are refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import DataError, MissingPathError, write_exr, write_png
from processing.surface import read_prior

SIZE = (8, 12)
HEAD = "x_px,y_px,height_mm\n"


@pytest.mark.parametrize(
    ("text", "heights", "sigmas"),
    [
        (HEAD + "3,1,0.25\n4,2,0.5\n", (0.25, 0.5), (0.1, 0.1)),
        (
            "x_px;y_px;height_mm;sigma_mm\r\n3;1;0,25;0.2\r\n4;2;0,5;0,3\r\n",
            (0.25, 0.5),
            (0.2, 0.3),
        ),
        ("\ufeffx_px y_px height_mm\n\n 3.4  0.6 0.25\n4 2 0.5", (0.25, 0.5), (0.1, 0.1)),
        # Twice in a pixel: the mean, weighted by the reciprocal variances.
        (HEAD.strip() + ",sigma_mm\n3,1,0,1\n3,1,5,2\n4,2,0.5,1\n", (1, 0.5), (0.8**0.5, 1)),
    ],
    ids=["commas", "semicolons and deviations", "spaces", "twice"],
)
def test_tables(
    tmp_path: Path, text: str, heights: tuple[float, ...], sigmas: tuple[float, ...]
) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(text.encode())
    prior = read_prior(path, SIZE, unit="mm", sigma=0.1)
    assert prior.count == 2
    for place, height, sigma in zip([(1, 3), (2, 4)], heights, sigmas, strict=True):
        assert prior.height[place] == pytest.approx(height)
        assert prior.sigma[place] == pytest.approx(sigma)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the first line names the columns"),
        ("1,2,3\n", "the first line names the columns: x_px,y_px,height_mm"),
        ("x_px,y_px,height_px\n1,2,3\n", "heights are in px, but those of the surface are in mm"),
        (HEAD, "contains no point"),
        (HEAD + "1,2\n", "line 2: 1,2 is not 3 numbers"),
        (HEAD + "1,2,3\n1,2,nan\n", "line 3: 1,2,nan is not 3 numbers"),
        (HEAD + "1,2,x\n", "line 2: 1,2,x is not 3 numbers"),
        (HEAD + "50,2,3\n", "none of 1 points of the prior is inside the image of 12 x 8"),
        (HEAD.strip() + ",sigma_mm\n1,2,3,0\n", "not valid numbers"),
        ("\x00\xff", "not a readable table|the first line"),
    ],
)
def test_tables_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError, match=message) as caught:
        read_prior(path, SIZE, unit="mm", sigma=0.1)
    assert str(caught.value).startswith(str(path))
    assert str(caught.value).count(str(path)) == 1
    assert "\n" not in str(caught.value)


def test_maps(tmp_path: Path) -> None:
    heights = np.full(SIZE, 2.5, np.float32)
    heights[0] = np.nan
    write_exr(tmp_path / "h.exr", heights)
    cv2.imwrite(str(tmp_path / "h.tif"), heights)
    np.save(tmp_path / "h.npy", heights.astype(np.float64))
    for name in ("h.exr", "h.tif", "h.npy"):
        prior = read_prior(tmp_path / name, SIZE, unit="px", sigma=0.1)
        np.testing.assert_array_equal(prior.height, heights)
    write_png(tmp_path / "h.png", np.ones(SIZE, np.uint16))
    np.save(tmp_path / "i.npy", np.ones(SIZE, np.int32))
    write_exr(tmp_path / "rgb.exr", np.ones((*SIZE, 3), np.float32))
    (tmp_path / "cut.exr").write_bytes((tmp_path / "h.exr").read_bytes()[:200])
    for name, message in (
        ("h.png", "a prior is a table"),
        ("i.npy", "floats with a unit"),
        ("rgb.exr", "has one channel"),
        ("cut.exr", "cut.exr"),
    ):
        with pytest.raises(DataError, match=message):
            read_prior(tmp_path / name, SIZE, unit="px", sigma=0.1)
    for name in ("none.csv", "none.exr", "none.npy"):
        with pytest.raises(MissingPathError, match=name):
            read_prior(tmp_path / name, SIZE, unit="px", sigma=0.1)
    with pytest.raises(DataError, match="same area"):
        read_prior(tmp_path / "h.npy", (8, 9), unit="px", sigma=0.1)
