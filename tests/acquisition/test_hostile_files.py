"""Files that demand too much, or whose damage was once not detected: one line of error each."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from acquisition import (
    DataError,
    read_camera,
    read_image,
    read_lights,
    read_mask,
    read_plan,
    read_source,
    write_exr,
    write_png,
)
from acquisition.pixels import image_facts
from acquisition.pixels.image_head import check_image_head, kind_of
from acquisition.value_files.mat5 import read_mat5
from rig import UnreadableError
from tests.acquisition.image_bytes import by_library, chunk
from tests.cases import cases

GREY = np.arange(48, dtype=np.uint16).reshape(6, 8)


def refused(path: Path, said: str, **options: object) -> None:
    with pytest.raises(DataError, match=said) as caught:
        read_image(path, **options)  # type: ignore[arg-type]
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def png(width: int, height: int, depth: int = 8, data: bytes = b"\0" * 100) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(data))
        + chunk(b"IEND", b"")
    )


def test_a_png_of_too_many_pixels_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png(20_000, 20_000))
    refused(path, "20000 x 20000 pixels, 200000000 are allowed")
    refused(path, "which .* bytes cannot hold", max_pixels=400_000_000)
    with pytest.raises(DataError, match="200000000 are allowed"):
        read_mask(path)


def test_the_limit_holds_for_every_image_of_a_source(tmp_path: Path) -> None:
    for i in range(3):
        write_png(tmp_path / f"a.{i}.png", GREY)
    assert len(read_source(tmp_path, max_pixels=48).frames) == 3
    with pytest.raises(DataError, match="8 x 6 pixels, 47 are allowed"):
        read_source(tmp_path, max_pixels=47)
    source = read_source(tmp_path, max_pixels=48)
    write_png(tmp_path / "a.2.png", np.zeros((9, 9), np.uint16))
    with pytest.raises(DataError, match="48 are allowed"):
        source.frames[2].read()


def test_a_large_mask_of_one_bit_is_not_refused(tmp_path: Path) -> None:
    """Pixels of one bit are packed eight times as densely as bytes."""
    path = tmp_path / "mask.png"
    path.write_bytes(png(8000, 6000, 1, (b"\0" + b"\xff" * 1000) * 6000))
    assert read_mask(path).all()


@pytest.mark.parametrize("suffix", ["tif", "exr", "tga", "jpg", "bmp", "webp", "jp2", "jxl", "ppm"])
def test_the_limit_holds_for_every_format(tmp_path: Path, suffix: str) -> None:
    """Some decoders unpack everything when they open a file, so the size is checked before."""
    pixels = np.random.default_rng(0).integers(0, 255, (72, 80, 3))
    pixels = pixels.astype(np.float16 if suffix == "exr" else np.uint8)
    path = by_library(tmp_path / f"a.{suffix}", pixels)
    assert read_image(path, max_pixels=72 * 80).shape == (72, 80, 3)
    refused(path, "80 x 72 pixels, 5759 are allowed", max_pixels=72 * 80 - 1)
    kind = kind_of(path.read_bytes()[:4096], path.suffix)
    assert kind is not None
    if suffix in ("webp", "jp2", "jxl"):
        with pytest.raises(UnreadableError, match="5759 are allowed"):
            check_image_head(path, 72 * 80 - 1)


def test_size_of_lossy_and_lossless_webp(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (33, 47, 4)).astype(np.uint8)
    for name, quality in (("lossy", 80), ("lossless", 101)):
        path = tmp_path / f"{name}.webp"
        cv2.imwrite(str(path), pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])
        with pytest.raises(UnreadableError, match="47 x 33 pixels"):
            check_image_head(path, 1)


@pytest.mark.parametrize(
    ("width", "height"),
    [
        (8, 8),
        (256, 256),
        (300, 200),
        (1024, 768),
        pytest.param(4000, 3000, marks=pytest.mark.slow),
        (333, 777),
    ],
)
def test_size_of_jpeg_xl(tmp_path: Path, width: int, height: int) -> None:
    """The header has special forms for small sides and for common ratios."""
    path = by_library(tmp_path / "a.jxl", np.zeros((height, width), np.uint8))
    with pytest.raises(UnreadableError, match=f"{width} x {height} pixels"):
        check_image_head(path, 1)


@pytest.mark.slow
def test_flipped_bits_in_the_header_of_an_exr(tmp_path: Path) -> None:
    """Flip every bit in turn; 4 in 100 make names that are no longer valid text."""
    path = tmp_path / "a.exr"
    write_exr(path, np.ones((4, 5, 3), np.float32))
    whole = path.read_bytes()
    seen = set()
    for place in range(8 * 340):
        changed = bytearray(whole)
        changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        try:
            read_image(path)
        except DataError as error:
            seen.add("utf-8" in str(error))
    assert seen == {False, True}


def test_an_image_with_text_in_another_encoding_is_read(tmp_path: Path) -> None:
    path = by_library(tmp_path / "a.tif", GREY, Make="Agfaphoto", Model="One")
    path.write_bytes(path.read_bytes().replace(b"Agfaphoto", b"Agfaph\xf6t\xf6"))
    np.testing.assert_array_equal(read_image(path), GREY)
    data = image_facts(path).shot
    assert (data.vendor, data.model) == ("Agfaphötö", "One")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFO")
@pytest.mark.parametrize("read", [read_image, read_lights, read_camera, read_plan, read_mask])
def test_no_reader_waits_for_a_pipe(tmp_path: Path, read: object) -> None:
    path = tmp_path / "a.png"
    os.mkfifo(path)
    with pytest.raises(DataError, match="not a regular file"):
        read(path)  # type: ignore[operator]


# --- numbers and nesting in text ---


@pytest.mark.timeout(60)
def test_a_plan_of_60000_leds(tmp_path: Path) -> None:
    """This once took two minutes because each LED was searched for in a list."""
    path = tmp_path / "plan.toml"
    leds = ", ".join(map(str, range(60_000)))
    own = "".join(f"{led} = [{led + 1}.0]\n" for led in range(0, 60_000, 100))
    path.write_text(f"leds = [{leds}]\nexposures_us = [5.5]\n[exposures_by_led]\n{own}")
    plan = read_plan(path)
    assert len(plan.shots()) == 60_001 + len(plan.distinct_exposures_us)


@pytest.mark.slow
@pytest.mark.timeout(60)
def test_an_lp_of_60000_rows(tmp_path: Path) -> None:
    path = tmp_path / "a.lp"
    rows = "".join(f"{i}.png 0.1 0.2 0.{i + 10_000}\n" for i in range(60_000))
    path.write_text(f"60000\n{rows}")
    lights = read_lights(path)
    assert len(lights) == 60_000
    assert lights.match(lights.ids)[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        pytest.param("leds = [" + "9" * 4301 + "]", "digits", id="digits"),
        pytest.param("leds = [70000]\nexposures_us = [1.0]", "leds", id="no such LED"),
        pytest.param("leds = " + "[" * 20_000, "nested", id="nested"),
        pytest.param(
            f"leds = {list(range(2000))}\nexposures_us = [1.0]\nrepeats = 1000",
            "2000000 shots: the limit is 1000000", id="shots",
        ),
        pytest.param(
            "leds = [0]\nexposures_us = [1.0]\n[exposures_by_led]\n" + "9" * 4400 + " = [1.0]",
            "no LED|digits", id="key",
        ),
    ],
)  # fmt: skip
def test_plans(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(DataError, match=said) as caught:
        read_plan(path)
    assert len(str(caught.value)) < 1000


@cases(
    ("name", "text", "said"),
    {
        "lp count": ("a.lp", "9" * 5000 + "\na 0 0 1\n", "light follows"),
        "lp digits": ("a.lp", "1\na 0 0 " + "9" * 5000 + "\n", "5006 characters"),
        "far": ("a.txt", "0 0 1\n0 0 1e200\n", "larger than 1e"),
        "lines": ("a.txt", "0 0 1\n" * 100_002, "at most"),
        "json nested": ("a.json", "[" * 50_000, "nested"),
        "json digits": ("a.json", '{"version": ' + "9" * 5000, "digits"),
    },
)
def test_lights(tmp_path: Path, name: str, text: str, said: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(DataError, match=said) as caught:
        read_lights(path)
    assert len(str(caught.value)) < 1000


HEAD = "%YAML:1.0\n---\nimage_width: 64\nimage_height: 48\n"
MATRIX = (
    "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    "   data: [ 9., 0., 1., 0., 9., 1., 0., 0., 1. ]\n"
)
XML = (
    "<?xml version='1.0'?>\n<opencv_storage>\n<image_width>64</image_width>"
    "<image_height>48</image_height>\n{}</opencv_storage>\n"
)
XML_MATRIX = (
    '<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>'
    "<data>9. 0. 1. 0. 9. 1. 0. 0. 1.</data></camera_matrix>"
)


@cases(
    ("name", "text"),
    {
        "yaml": ("c.yml", HEAD + MATRIX),
        "xml": ("c.xml", XML.format(XML_MATRIX)),
        "others": ("c.yml", HEAD + "more:\n   - { a: [1, 2] }\n   - x\n" + MATRIX),
        "two lines": ("c.yml", HEAD + MATRIX.replace("0., 9., 1.,", "0.,\n       9., 1.,")),
        "more": ("c.xml", XML.format(f"<more><a><b>1</b></a></more>{XML_MATRIX}")),
    },
)
def test_camera_files_of_opencv(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    # OpenCV itself reads the same values.
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    camera = read_camera(path)
    np.testing.assert_array_equal(camera.K, storage.getNode("camera_matrix").mat())
    assert camera.size == (48, 64)


@cases(
    ("name", "text", "said"),
    {
        "xml nested": ("c.xml", XML.format("<a>" * 30_000), "nested"),
        "xml not closed": ("c.xml", XML.format("<a>"), "not an OpenCV camera file"),
        "entities": ("c.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]>" + XML.format("&b;"), "document"),
        "yaml brackets": ("c.yml", HEAD + "a: " + "[" * 30_000, "camera_matrix"),
        "yaml dashes": ("c.yml", HEAD + "- " * 30_000, "not an OpenCV camera file"),
        "cut": ("c.yml", HEAD + MATRIX.replace(" ]", ""), "no closing bracket"),
        "eight": ("c.yml", HEAD + MATRIX.replace(", 1. ]", " ]"), "3 x 3"),
        "rows": ("c.yml", HEAD + MATRIX.replace("rows: 3", "rows: 1e9"), "numbers"),
        "words": ("c.yml", HEAD + MATRIX.replace("9.", "x"), "3 x 3 numbers"),
        "no matrix": ("c.yml", HEAD + "camera_matrix: 5\n", "not a matrix"),
        "width": ("c.yml", HEAD.replace("64", "9" * 400) + MATRIX, "no image size"),
    },
)
def test_damaged_camera_files_of_opencv(tmp_path: Path, name: str, text: str, said: str) -> None:
    """OpenCV's own reader crashes the process on deep nesting."""
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(DataError, match=said) as caught:
        read_camera(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value)) < 1000


# --- DiLiGenT folders ---


@pytest.fixture
def diligent(tmp_path: Path) -> Path:
    for i in range(3):
        write_png(tmp_path / f"{i}.png", GREY)
    (tmp_path / "filenames.txt").write_text("0.png\n1.png\n2.png\n")
    (tmp_path / "light_directions.txt").write_text("0 0 1\n" * 3)
    return tmp_path


@pytest.mark.parametrize("name", ["a" * 255 + ".png", "a" * 100_000, "0.png/below"])
def test_invalid_file_names(diligent: Path, name: str) -> None:
    (diligent / "filenames.txt").write_text(f"0.png\n1.png\n{name}\n")
    with pytest.raises(DataError, match="which does not exist") as caught:
        read_source(diligent)
    assert len(str(caught.value)) < 500


@pytest.mark.timeout(60)
def test_each_of_many_names_is_checked_only_once(diligent: Path) -> None:
    names = "".join(f"{i}.png\n" for i in range(200_000))
    (diligent / "filenames.txt").write_text(names)
    with pytest.raises(DataError, match=r"lists 3\.png, which does not exist"):
        read_source(diligent)


NORMALS = np.random.default_rng(0).normal(size=(6, 8, 3))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i2", "u1"])
def test_arrays_of_matlab(tmp_path: Path, packed: bool, kind: str) -> None:
    path = tmp_path / "a.mat"
    values = (NORMALS * 50).astype(kind)
    savemat(path, {"other": [1.0], "N": values, "text": "x"}, do_compression=packed)
    np.testing.assert_array_equal(read_mat5(path.read_bytes(), "N", 144), values)


def test_the_other_byte_order() -> None:
    flags = struct.pack(">IIII", 6, 8, 6, 0)
    shape = struct.pack(">II2i", 5, 8, 2, 1)
    name = struct.pack(">HH4s", 1, 1, b"N\0\0\0")
    # Integers are stored in the smallest type that fits; small elements are part of their header.
    body = flags + shape + name + struct.pack(">HHBBxx", 2, 2, 7, 9)
    data = (
        b" " * 124 + struct.pack(">H2s", 0x0100, b"MI") + struct.pack(">II", 14, len(body)) + body
    )
    np.testing.assert_array_equal(read_mat5(data, "N", 10), [[7], [9]])


@pytest.mark.parametrize("packed", [False, True])
def test_flipped_bits_in_an_array_of_matlab(tmp_path: Path, packed: bool) -> None:
    """Flip every bit of the headers in turn; readers that trust them crash."""
    path = tmp_path / "a.mat"
    savemat(path, {"N": NORMALS}, do_compression=packed)
    whole = path.read_bytes()
    for place in range(8 * 124, 8 * min(len(whole), 260)):
        changed = bytearray(whole)
        changed[place // 8] ^= 1 << place % 8
        try:
            array = read_mat5(bytes(changed), "N", 144)
        except UnreadableError:
            continue
        assert array.size <= 144


@pytest.mark.parametrize(
    ("data", "said"),
    [
        pytest.param(b"", "not a MAT-file", id="empty"),
        pytest.param(b"\x89HDF\r\n\x1a\n" + b"\0" * 600, "version 7.3", id="HDF5"),
        pytest.param(b"MATLAB 7.3 MAT-file".ljust(700), "version 7.3", id="7.3"),
        pytest.param(
            b" " * 124 + b"\0\1IM" + struct.pack("<II", 15, 4000 + 18)
            + zlib.compress(b"\0" * 10**7)[:4018],
            "element|far more|no variable|truncated", id="bomb",
        ),
    ],
)  # fmt: skip
def test_files_without_an_array_of_matlab(data: bytes, said: str) -> None:
    with pytest.raises(UnreadableError, match=said):
        read_mat5(data, "N", 100)


def test_a_compressed_array_is_not_unpacked_beyond_the_expected_size() -> None:
    packed = zlib.compress(struct.pack("<II", 14, 10**9) + b"\0" * 10**7)
    data = b" " * 124 + b"\0\1IM" + struct.pack("<II", 15, len(packed)) + packed
    with pytest.raises(UnreadableError, match="far more numbers"):
        read_mat5(data, "N", 100)


def test_complex_and_missing_arrays(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"N": NORMALS * 1j})
    with pytest.raises(UnreadableError, match="real numbers"):
        read_mat5(path.read_bytes(), "N", 144)
    with pytest.raises(UnreadableError, match="no variable M"):
        read_mat5(path.read_bytes(), "M", 144)


def test_normals_whose_squared_length_overflows_are_zero(diligent: Path) -> None:
    truth = np.tile([0.0, 0.0, 1.0], (6, 8, 1))
    truth[0, 0], truth[0, 1] = 1e300, np.nan
    savemat(diligent / "Normal_gt.mat", {"Normal_gt": truth})
    normals = read_source(diligent).normals_truth
    assert normals is not None
    assert not normals[0, :2].any()
    np.testing.assert_array_equal(normals[1:], truth[1:])
