"""Images are encoded and checked in bands of rows, with the bytes of the whole image."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from acquisition import write_exr
from acquisition.pixels import write_tiff
from acquisition.pixels.encoded_image import holds, store_image

RNG = np.random.default_rng(5)
# Each has three bands of rows, and a last one that is not full.
HEIGHT, WIDTH = 301, 700
TYPES = {"uint16": oiio.UINT16, "float32": oiio.FLOAT}


def samples(kind: str, channels: int) -> np.ndarray:
    values = RNG.integers(0, 65536, (HEIGHT, WIDTH, channels))
    return values.astype(kind)


@pytest.mark.parametrize(("kind", "dtype"), [("tiff", "uint16"), ("openexr", "float32")])
def test_bands_give_the_bytes_of_the_whole_image(tmp_path: Path, kind: str, dtype: str) -> None:
    pixels = samples(dtype, 3)
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 3, TYPES[dtype])
    spec.attribute("DateTime", "")
    file = oiio.ImageOutput.create(kind)
    place = tmp_path / f"whole.{kind}"
    assert file.open(str(place), spec)
    assert file.write_image(pixels)
    assert file.close()
    store_image(tmp_path / "banded", kind, spec, pixels)
    assert (tmp_path / "banded").read_bytes() == place.read_bytes()


@pytest.mark.parametrize("row", [0, HEIGHT - 1])
def test_a_changed_sample_anywhere_is_noticed(tmp_path: Path, row: int) -> None:
    pixels = samples("uint16", 3)
    path = tmp_path / "a.tif"
    write_tiff(path, pixels)
    assert holds(path, pixels)
    other = pixels.copy()
    other[row, -1, 2] ^= 1
    assert not holds(path, other)
    assert not holds(path, pixels[:-1])
    assert not holds(path, pixels[..., 0])
    assert not holds(path, pixels.astype(np.uint8))


def test_gray_images_of_several_bands(tmp_path: Path) -> None:
    tall = RNG.integers(0, 256, (5000, 301)).astype(np.uint8)
    write_tiff(tmp_path / "a.tif", tall)
    assert holds(tmp_path / "a.tif", tall)
    signal = tall.astype(np.float32)
    signal[::7] = np.nan
    write_exr(tmp_path / "a.exr", signal)
    assert holds(tmp_path / "a.exr", signal)


@pytest.mark.parametrize("kept", [0.5, 0.999])
def test_a_file_cut_short_is_noticed(tmp_path: Path, kept: float) -> None:
    pixels = samples("float32", 3)
    for name, write in (("a.exr", write_exr), ("a.tif", write_tiff)):
        stored = pixels if name == "a.exr" else pixels.astype(np.uint16)
        path = tmp_path / name
        write(path, stored)
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * kept)])
        assert not holds(path, stored)
