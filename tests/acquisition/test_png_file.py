"""PNG files of our own encoder, compared with two other decoders."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import StorageError, write_png
from acquisition.pixels import png_file, read_image_with_alpha

RNG = np.random.default_rng(5)
# Several bands of rows, the last of which is not full; and a single pixel.
SIZES = [(301, 1700), (1, 1), (7, 1)]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("with_alpha", [False, True])
def test_two_decoders_return_the_pixels(
    tmp_path: Path, size: tuple[int, int], dtype: type, channels: int, with_alpha: bool
) -> None:
    pixels = RNG.integers(0, np.iinfo(dtype).max + 1, (*size, channels)).astype(dtype)
    pixels[: size[0] // 2] = pixels[0, 0]  # long runs
    image = pixels if channels == 3 else pixels[..., 0]
    opaque = RNG.random(size) > 0.5 if with_alpha else None
    path = tmp_path / "a.png"
    write_png(path, image, alpha=opaque)
    stored, alpha = read_image_with_alpha(path)
    np.testing.assert_array_equal(stored, image)
    other = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if opaque is None:
        assert alpha is None
        np.testing.assert_array_equal(other[..., ::-1] if channels == 3 else other, image)
    else:
        expected = np.where(opaque, np.iinfo(dtype).max, 0)
        np.testing.assert_array_equal(alpha, expected)
        np.testing.assert_array_equal(other[..., -1], expected)
        np.testing.assert_array_equal(other[..., channels - 1 :: -1][..., -channels:], pixels)


def test_the_curve_and_the_description_are_stated(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((4, 5, 3), np.uint8), srgb=True, description="0.5 µm")
    data = (tmp_path / "a.png").read_bytes()
    assert b"sRGB\1" in data
    assert b"tEXtDescription\0" + "0.5 µm".encode("latin-1") in data
    write_png(tmp_path / "b.png", np.zeros((4, 5, 3), np.uint8))
    assert b"sRGB" not in (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("change", ["bit", "cut", "longer"])
def test_bytes_that_the_disk_changed_are_noticed(
    tmp_path: Path, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.png"
    write_png(path, np.zeros((4, 5), np.uint8))
    before = path.read_bytes()
    whole = png_file.write_whole

    def wrong(descriptor: int, data: bytes) -> None:
        whole(descriptor, data)
        if change == "bit" and b"IDAT" in data:
            os.pwrite(descriptor, b"\xff", 50)
        if change == "cut" and b"IEND" in data:
            os.ftruncate(descriptor, 60)
        if change == "longer" and b"IEND" in data:
            os.write(descriptor, b"x")

    monkeypatch.setattr(png_file, "write_whole", wrong)
    with pytest.raises(StorageError, match=r"a\.png: does not read back as written"):
        write_png(path, RNG.integers(0, 255, (40, 50)).astype(np.uint8))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
