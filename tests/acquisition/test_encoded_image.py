"""Images are encoded and checked in bands of rows, with the bytes of the whole image."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from acquisition._pixels.encoded_image import encoded_image, holds, store_image
from acquisition._pixels.images import read_image_with_alpha, write_exr, write_png, write_tiff

RNG = np.random.default_rng(5)
# Each has three bands of rows, and a last one that is not full.
HEIGHT, WIDTH = 301, 700
TYPES = {"uint16": oiio.UINT16, "float32": oiio.FLOAT}


def samples(kind: str, channels: int) -> np.ndarray:
    values = RNG.integers(0, 65536, (HEIGHT, WIDTH, channels))
    return values.astype(kind)


@pytest.mark.parametrize(("kind", "dtype"), [("png", "uint16"), ("openexr", "float32")])
@pytest.mark.parametrize("with_alpha", [False, True])
def test_bands_give_the_bytes_of_the_whole_image(
    tmp_path: Path, kind: str, dtype: str, with_alpha: bool
) -> None:
    pixels, alpha = samples(dtype, 3), samples(dtype, 1)[..., 0]
    whole = np.dstack([pixels, alpha]) if with_alpha else pixels
    spec = oiio.ImageSpec(WIDTH, HEIGHT, whole.shape[2], TYPES[dtype])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("DateTime", "")
    file = oiio.ImageOutput.create(kind)
    place = tmp_path / f"whole.{kind}"
    assert file.open(str(place), spec)
    assert file.write_image(whole)
    assert file.close()
    with encoded_image(place, kind, spec, pixels, alpha if with_alpha else None) as data:
        assert data.read() == place.read_bytes()


@pytest.mark.parametrize("row", [0, HEIGHT - 1])
def test_a_changed_sample_anywhere_is_noticed(tmp_path: Path, row: int) -> None:
    pixels, alpha = samples("uint16", 3), samples("uint16", 1)[..., 0] > 9
    opacity = alpha.astype(np.uint16) * np.uint16(65535)
    path = tmp_path / "a.png"
    write_png(path, pixels, alpha=alpha)
    assert holds(path, pixels, opacity)
    assert holds(path, pixels)
    other = pixels.copy()
    other[row, -1, 2] ^= 1
    assert not holds(path, other, opacity)
    other = opacity.copy()
    other[row, 0] ^= 1
    assert not holds(path, pixels, other)
    assert not holds(path, pixels[:-1])
    assert not holds(path, pixels[..., 0])
    assert not holds(path, pixels.astype(np.uint8))
    write_png(path, pixels)
    assert not holds(path, pixels, opacity)


def test_gray_images_of_several_bands(tmp_path: Path) -> None:
    tall = RNG.integers(0, 256, (5000, 301)).astype(np.uint8)
    alpha = tall > 99
    write_png(tmp_path / "a.png", tall, alpha=alpha)
    pixels, opacity = read_image_with_alpha(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, tall)
    np.testing.assert_array_equal(opacity, alpha * np.uint8(255))
    write_tiff(tmp_path / "a.tif", tall)
    assert holds(tmp_path / "a.tif", tall)
    signal = tall.astype(np.float32)
    signal[::7] = np.nan
    write_exr(tmp_path / "a.exr", signal)
    assert holds(tmp_path / "a.exr", signal)


@pytest.mark.parametrize("kept", [0.5, 0.999])
def test_a_file_cut_short_is_noticed(tmp_path: Path, kept: float) -> None:
    pixels = samples("float32", 3)
    for name, write in (("a.exr", write_exr), ("a.tif", write_tiff), ("a.png", write_png)):
        stored = pixels if name == "a.exr" else pixels.astype(np.uint16)
        path = tmp_path / name
        write(path, stored)
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * kept)])
        assert not holds(path, stored)


def test_bytes_can_be_stored_too(tmp_path: Path) -> None:
    pixels = samples("uint16", 3)
    write_tiff(tmp_path / "a.tif", pixels)
    store_image(tmp_path / "b.tif", (tmp_path / "a.tif").read_bytes(), pixels)
    assert (tmp_path / "b.tif").read_bytes() == (tmp_path / "a.tif").read_bytes()
