"""Image files against hand-made bytes and another decoder, and with failing disks."""

from __future__ import annotations

import os
import resource
import struct
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._pixels.images import (
    image_form,
    read_image,
    read_image_with_alpha,
    write_exr,
    write_png,
    write_tiff,
)

DATA = os.environ.get("SGP_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="SGP_DATA names no folder of real data")

RGB = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3) * 4
RGB16 = RGB.astype(np.uint16) * 257 + 13


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(rows: np.ndarray, depth: int, colour: int, *extra: bytes) -> bytes:
    """Build a PNG file from rows that are already packed into bytes."""
    height = len(rows)
    per_pixel = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour] * depth
    width = rows.shape[1] * 8 // per_pixel
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    body = b"".join(b"\0" + row.tobytes() for row in rows)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + b"".join(extra)
        + chunk(b"IDAT", zlib.compress(body))
        + chunk(b"IEND", b"")
    )


def tga(pixels: np.ndarray, descriptor: int) -> bytes:
    height, width = pixels.shape[:2]
    bits = 8 * (pixels.shape[2] if pixels.ndim == 3 else 1)
    kind = 3 if bits == 8 else 2
    return struct.pack(
        "<BBBHHBHHHHBB", 0, 0, kind, 0, 0, 0, 0, 0, width, height, bits, descriptor
    ) + (pixels.tobytes())


def by_library(path: Path, pixels: np.ndarray, names: tuple[str, ...] = (), **hints: str) -> Path:
    """Write a file with OpenImageIO directly, for images that our writers refuse."""
    pixels = np.ascontiguousarray(pixels.reshape(*pixels.shape[:2], -1))
    kinds = {
        "uint8": oiio.UINT8,
        "int16": oiio.INT16,
        "uint16": oiio.UINT16,
        "uint32": oiio.UINT32,
        "float16": oiio.HALF,
        "float32": oiio.FLOAT,
        "float64": oiio.DOUBLE,
    }
    spec = oiio.ImageSpec(*pixels.shape[1::-1], pixels.shape[2], kinds[pixels.dtype.name])
    if names:
        spec.channelnames = names
    for key, value in hints.items():
        spec.attribute(key, value)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec)
    assert file.write_image(pixels)
    assert file.close()
    return path


BIG = RGB16.astype(">u2").view(np.uint8).reshape(4, -1)
GREY_ALPHA = np.stack([RGB[..., 0], np.full((4, 5), 7, np.uint8)], -1)
RGBA = np.concatenate([RGB, np.full((4, 5, 1), 7, np.uint8)], -1)
PALETTE = chunk(b"PLTE", bytes([255, 0, 0, 0, 255, 0, 1, 2, 3, 9, 9, 9]))
INDEXED = np.array([[255, 0, 0], [0, 255, 0], [1, 2, 3], [9, 9, 9]], np.uint8)
BGRA_UP = RGBA[::-1, :, [2, 1, 0, 3]]


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        pytest.param("a.png", png(RGB.reshape(4, -1), 8, 2), RGB, id="png RGB 8"),
        pytest.param("a.png", png(BIG, 16, 2), RGB16, id="png RGB 16 is big-endian"),
        pytest.param("a.png", png(RGB[..., 0], 8, 0), RGB[..., 0], id="png grey"),
        pytest.param(
            "a.png", png(GREY_ALPHA.reshape(4, -1), 8, 4), RGB[..., 0], id="png grey, alpha dropped"
        ),
        pytest.param(
            "a.png", png(RGBA.reshape(4, -1), 8, 6), RGB, id="png RGB not multiplied by alpha"
        ),
        pytest.param(
            "a.png",
            png(np.array([[0b00011011]], np.uint8), 2, 3, PALETTE),
            INDEXED[None],
            id="png palette of 2 bits",
        ),
        pytest.param(
            "a.png",
            png(np.array([[0b10100000]], np.uint8), 1, 0),
            np.array([[255, 0, 255, 0, 0, 0, 0, 0]], np.uint8),
            id="png of 1 bit",
        ),
        pytest.param(
            "a.png",
            png(RGB.reshape(4, -1), 8, 2, chunk(b"gAMA", struct.pack(">I", 45455))),
            RGB,
            id="png gamma chunk is not applied",
        ),
        pytest.param(
            "a.png", png(RGB.reshape(4, -1), 8, 2) + b"trailing", RGB, id="png with bytes after it"
        ),
        pytest.param("a.tga", tga(RGB[::-1, :, ::-1], 0), RGB, id="tga bottom up, BGR"),
        pytest.param("a.tga", tga(RGB[:, :, ::-1], 0x20), RGB, id="tga top down"),
        pytest.param("a.tga", tga(BGRA_UP, 8), RGB, id="tga alpha dropped"),
        pytest.param("a.tga", tga(RGB[::-1, :, 1], 0), RGB[..., 1], id="tga grey"),
        pytest.param(
            "a.ppm",
            b"P6 5 4 65535\n" + RGB16.astype(">u2").tobytes(),
            RGB16,
            id="ppm of 16 bits",
        ),
        pytest.param("a.pgm", b"P5 5 4 255\n" + RGB[..., 2].tobytes(), RGB[..., 2], id="pgm"),
        pytest.param("a.jpg", png(RGB.reshape(4, -1), 8, 2), RGB, id="content wins over the name"),
    ],
)
def test_hand_made_files(tmp_path: Path, name: str, data: bytes, expected: np.ndarray) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    pixels = read_image(path)
    assert pixels.dtype == expected.dtype
    assert pixels.flags.c_contiguous
    np.testing.assert_array_equal(pixels, expected)
    form = image_form(path)
    assert (form.shape, form.dtype) == (expected.shape, expected.dtype)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        pytest.param(png(RGBA.reshape(4, -1), 8, 6), RGBA[..., 3], id="png RGB"),
        pytest.param(png(GREY_ALPHA.reshape(4, -1), 8, 4), GREY_ALPHA[..., 1], id="png grey"),
        pytest.param(png(RGB.reshape(4, -1), 8, 2), None, id="none"),
    ],
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
    turned = oiio.ImageSpec(32, 16, 3, oiio.UINT8)
    turned.attribute("Orientation", 6)
    file = oiio.ImageOutput.create("jpeg")
    assert file.open(str(path), turned)
    assert file.write_image(picture)
    assert file.close()
    assert read_image(path).shape == (16, 32, 3)


def test_exr_channels_are_chosen_by_name(tmp_path: Path) -> None:
    planes = np.stack([np.full((3, 4), value, np.float32) for value in (1, 2, 3, 4, 5)], -1)
    path = by_library(tmp_path / "a.exr", planes, ("Z", "B", "A", "R", "G"))
    np.testing.assert_array_equal(read_image(path)[0, 0], [4, 5, 2])


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 3), (1, 1), (1, 7, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff_holds_the_unchanged_samples(
    tmp_path: Path, shape: tuple[int, ...], dtype: type
) -> None:
    pixels = np.random.default_rng(3).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    path = tmp_path / "a.tif"
    write_tiff(path, pixels)
    data = path.read_bytes()
    assert data[:2] == b"II"
    assert pixels.tobytes() in data
    other = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(other[..., ::-1] if len(shape) == 3 else other, pixels)
    np.testing.assert_array_equal(read_image(path), pixels)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 3)])
def test_png_agrees_with_another_decoder(
    tmp_path: Path, shape: tuple[int, ...], dtype: type
) -> None:
    pixels = np.random.default_rng(4).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    path = tmp_path / "a.png"
    write_png(path, pixels)
    other = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(other[..., ::-1] if len(shape) == 3 else other, pixels)
    np.testing.assert_array_equal(read_image(path), pixels)


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    pixels=hnp.arrays(
        np.float32,
        st.sampled_from([(3, 4), (2, 3, 3)]),
        elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
    )
)
def test_exr_keeps_every_float(tmp_path: Path, pixels: np.ndarray) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, pixels)
    np.testing.assert_array_equal(read_image(path), pixels)


def test_exr_is_compressed_where_pixels_are_zero(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).random((64, 80), np.float32)
    write_exr(tmp_path / "noise.exr", noise)
    assert oiio.ImageInput.open(str(tmp_path / "noise.exr")).spec()["compression"] == "none"
    noise[:, :40] = 0
    write_exr(tmp_path / "half.exr", noise)
    assert (tmp_path / "half.exr").stat().st_size < 0.65 * noise.nbytes
    np.testing.assert_array_equal(read_image(tmp_path / "half.exr"), noise)


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(lambda a: a[:, ::2], id="strided"),
        pytest.param(lambda a: a.T, id="transposed"),
        pytest.param(lambda a: a[::-1], id="reversed"),
        pytest.param(lambda a: np.asfortranarray(a), id="fortran"),
        pytest.param(lambda a: a.astype(">u2"), id="big-endian"),
    ],
)
def test_arrays_in_any_memory_layout(tmp_path: Path, view: object) -> None:
    pixels = view(np.arange(42, dtype=np.uint16).reshape(6, 7) * 1000)  # type: ignore[operator]
    for name, write in (("a.tif", write_tiff), ("a.png", write_png)):
        write(tmp_path / name, pixels)
        np.testing.assert_array_equal(read_image(tmp_path / name), pixels)


def test_equal_pixels_give_equal_bytes_at_any_time(tmp_path: Path) -> None:
    def write(folder: Path) -> list[bytes]:
        folder.mkdir()
        write_tiff(folder / "a.tif", RGB16)
        write_png(folder / "a.png", RGB16)
        write_exr(folder / "a.exr", RGB16.astype(np.float32))
        return [path.read_bytes() for path in sorted(folder.iterdir())]

    first = write(tmp_path / "first")
    time.sleep(1.1)
    assert write(tmp_path / "second") == first


def test_two_dimensional_arrays_are_written_wrong_by_the_library_alone(tmp_path: Path) -> None:
    # If OpenImageIO fixes this bug, the reshape in the writer can be removed.
    pixels = np.arange(20, dtype=np.uint16).reshape(4, 5)
    spec = oiio.ImageSpec(5, 4, 1, oiio.UINT16)
    file = oiio.ImageOutput.create("tiff")
    assert file.open(str(tmp_path / "a.tif"), spec)
    file.write_image(pixels)
    file.close()
    try:
        wrong = not np.array_equal(read_image(tmp_path / "a.tif"), pixels)
    except DataError:
        wrong = True
    assert wrong
    write_tiff(tmp_path / "b.tif", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "b.tif"), pixels)


NOISE = np.random.default_rng(5).integers(0, 65535, (40, 30, 3)).astype(np.uint16)
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


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
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


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        pytest.param("a.png", b"", "not a readable image", id="empty"),
        pytest.param("a.txt", b"0.1 0.2 0.3\n" * 50, "not a readable image", id="text"),
        pytest.param("a.tif", b"\0" * 4000, "not a readable image", id="zeros"),
        pytest.param("a.kdc", b"II*\0" + b"\0" * 100, "RAW", id="camera RAW"),
    ],
)
def test_files_that_are_not_images_are_refused_by_name(
    tmp_path: Path, name: str, content: bytes, match: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=match) as caught:
        read_image(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("suffix", "pixels", "names", "match"),
    [
        pytest.param(".tif", np.ones((3, 4), np.int16), (), "int16", id="signed"),
        pytest.param(".tif", np.ones((3, 4), np.uint32), (), "uint", id="32 bit"),
        pytest.param(
            ".exr", np.ones((3, 4, 2), np.float32), ("u", "v"), "channels u, v", id="2 channels"
        ),
        pytest.param(
            ".exr", np.ones((3, 4, 5), np.float32), tuple("abcde"), "channels", id="5 channels"
        ),
    ],
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


@pytest.mark.parametrize(
    ("write", "pixels"),
    [
        pytest.param(write_tiff, np.ones((3, 4), np.int32), id="int32 would be rescaled"),
        pytest.param(write_tiff, np.ones((3, 4), np.float32), id="float tiff"),
        pytest.param(write_png, np.ones((3, 4), bool), id="bool"),
        pytest.param(write_exr, np.ones((3, 4), np.uint16), id="uint16 exr would become half"),
        pytest.param(write_exr, np.ones((3, 4), np.float64), id="double exr"),
        pytest.param(write_png, np.ones((3, 4, 4), np.uint8), id="4 channels"),
        pytest.param(write_png, np.ones((3, 4, 1), np.uint8), id="an axis of length 1"),
        pytest.param(write_png, np.ones(3, np.uint8), id="1-D"),
        pytest.param(write_png, np.ones((0, 4), np.uint8), id="no pixels"),
    ],
)
def test_arrays_that_are_refused(tmp_path: Path, write: object, pixels: np.ndarray) -> None:
    with pytest.raises(DataError, match="a file"):
        write(tmp_path / "a file", pixels)  # type: ignore[operator]
    assert list(tmp_path.iterdir()) == []


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("write", "pixels"),
    [
        pytest.param(write_tiff, RGB16, id="tiff"),
        pytest.param(write_png, RGB16, id="png"),
        pytest.param(write_exr, NOISE.astype(np.float32), id="exr"),
    ],
)
def test_a_disk_that_fills_up_at_any_byte(
    tmp_path: Path, write: object, pixels: np.ndarray
) -> None:
    path = tmp_path / "a"
    write(path, np.zeros_like(pixels))  # type: ignore[operator]
    before = path.read_bytes()
    write(tmp_path / "whole", pixels)  # type: ignore[operator]
    size = (tmp_path / "whole").stat().st_size
    refused = 0
    for limit in range(1, size, max(1, size // 150)):
        with file_size_limit(limit):
            message = ""
            try:
                write(path, pixels)  # type: ignore[operator]
            except StorageError as error:
                message = str(error)
        if message:
            refused += 1
            assert str(path) in message
            assert path.read_bytes() == before
        else:
            # Only metadata may be missing.
            np.testing.assert_array_equal(read_image(path), pixels)
            write(path, np.zeros_like(pixels))  # type: ignore[operator]
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "whole"]
    assert refused > 50


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
    pixels = read_image(Path(DATA or "") / name)
    assert pixels.shape == shape
    assert pixels.dtype == dtype
    assert pixels.max() > 100
    if name.endswith((".png", ".jpg")):
        # Another decoder that does not rotate either; JPEG decoders may differ by rounding.
        flags = cv2.IMREAD_UNCHANGED
        other = cv2.imread(str(Path(DATA or "") / name), flags)
        other = other[..., ::-1] if other.ndim == 3 else other
        assert np.abs(other.astype(int) - pixels).max() <= (3 if name.endswith("jpg") else 0)


def test_png_is_compressed_fast(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((4, 6), np.uint16))
    data = (tmp_path / "a.png").read_bytes()
    # Two bits in the header of a zlib stream give the compression effort: 0 is the fastest.
    assert data[data.index(b"IDAT") + 5] >> 6 == 0
