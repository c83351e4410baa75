"""Image files that are damaged, unsupported or missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition import DataError, MissingPathError, StorageError, read_image, write_png
from tests.acquisition.image_bytes import BIG, NOISE, RGB, by_library, png, tga
from tests.cases import cases

ENCODINGS = [
    ("a.tif", "none", np.uint16),
    ("a.tif", "zip", np.uint16),
    ("a.tif", "lzw", np.uint8),
    ("a.png", "zip", np.uint16),
    ("a.png", "zip", np.uint8),
    ("a.exr", "none", np.float32),
    ("a.exr", "zip", np.float32),
    ("a.exr", "piz", np.float16),
    ("a.jpg", "jpeg:90", np.uint8),
    ("a.bmp", "none", np.uint8),
    ("a.hdr", "none", np.float32),
    ("a.ppm", "none", np.uint8),
]


@pytest.mark.parametrize(("name", "compression", "dtype"), ENCODINGS)
def test_a_file_truncated_anywhere_is_refused_by_name(
    tmp_path: Path, name: str, compression: str, dtype: type
) -> None:
    whole = by_library(tmp_path / name, (NOISE >> 8).astype(dtype), compression=compression)
    data = whole.read_bytes()
    read_image(whole)
    cut = tmp_path / f"cut{whole.suffix}"
    lengths = {0, 1, 7, 8, 9, 50, *(len(data) - k for k in (1, 2, 4, 5, 11, 12, 13, 40, 400))}
    for length in sorted(lengths | {len(data) * k // 7 for k in range(1, 7)}):
        cut.write_bytes(data[:length])
        with pytest.raises(DataError, match=r"cut\.") as caught:
            read_image(cut)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rle", [False, True])
def test_a_truncated_targa_file_is_refused(tmp_path: Path, rle: bool) -> None:
    pixels = (NOISE >> 8).astype(np.uint8)
    data = tga(pixels[..., ::-1], 0x20)
    if rle:
        packets = b"".join(b"\0" + pixel.tobytes() for pixel in pixels[..., ::-1].reshape(-1, 3))
        data = data[:2] + b"\x0a" + data[3:18] + packets
    path = tmp_path / "cut.tga"
    path.write_bytes(data)
    np.testing.assert_array_equal(read_image(path), pixels)
    for length in (0, 10, 17, 18, 100, len(data) // 2, len(data) - 3, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(DataError, match=r"cut\.tga"):
            read_image(path)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(bit=st.integers(0, 8 * len(png(BIG, 16, 2)) - 1))
def test_any_flipped_bit_of_a_png_is_detected(tmp_path: Path, bit: int) -> None:
    data = bytearray(png(BIG, 16, 2))
    data[bit // 8] ^= 1 << bit % 8
    path = tmp_path / "flip.png"
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"flip\.png"):
        read_image(path)


def test_a_damaged_png_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(BIG, 16, 2)[:-30])
    with pytest.raises(DataError, match="cut short at byte"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


@cases(
    ("name", "content", "match"),
    {
        "empty": ("a.png", b"", "not a readable image"),
        "text": ("a.txt", b"0.1 0.2 0.3\n" * 50, "not a readable image"),
        "zeros": ("a.tif", b"\0" * 4000, "not a readable image"),
        "camera RAW": ("a.kdc", b"II*\0" + b"\0" * 100, "RAW"),
    },
)
def test_files_that_are_not_images_are_refused_by_name(
    tmp_path: Path, name: str, content: bytes, match: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=match) as caught:
        read_image(path)
    assert str(path) in str(caught.value)


@cases(
    ("suffix", "pixels", "names", "match"),
    {
        "signed": (".tif", np.ones((3, 4), np.int16), (), "int16"),
        "32 bit": (".tif", np.ones((3, 4), np.uint32), (), "uint"),
        "2 channels": (".exr", np.ones((3, 4, 2), np.float32), ("u", "v"), "channels u, v"),
        "5 channels": (".exr", np.ones((3, 4, 5), np.float32), tuple("abcde"), "channels"),
    },
)
def test_unsupported_samples_and_channels(
    tmp_path: Path, suffix: str, pixels: np.ndarray, names: tuple[str, ...], match: str
) -> None:
    path = by_library(tmp_path / f"a{suffix}", pixels, names)
    with pytest.raises(DataError, match=match):
        read_image(path)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match=r"none\.png"):
        read_image(tmp_path / "none.png")
    with pytest.raises(DataError, match="a folder"):
        read_image(tmp_path)
    with pytest.raises(StorageError, match=r"none/a\.png: cannot write: No such file"):
        write_png(tmp_path / "none" / "a.png", RGB)
    assert list(tmp_path.iterdir()) == []
