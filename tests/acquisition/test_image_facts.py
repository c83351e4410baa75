"""Facts that image files state: tags, pages, windows, photometric interpretation."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
import tifffile
from PIL import Image

from acquisition import DataError, read_image, read_mask
from acquisition.pixels import ImageFacts, ImageRows, ShotFacts, image_facts, read_image_with_alpha
from acquisition.pixels.camera_raw import RawLevels, read_levelled
from acquisition.pixels.exif_block import tiff_tags
from acquisition.pixels.mask_files import read_mask_of
from acquisition.pixels.stated_facts import shot_facts
from tests.acquisition.dng_file import dng
from tests.acquisition.image_bytes import chunk
from tests.cases import cases

GREY = np.arange(48, dtype=np.uint16).reshape(6, 8) * 1000
TAGS = [(33434, "2I", 1, (1, 50), True), (34855, "H", 1, 200, True), (274, "H", 1, 6, True)]
STATED = ShotFacts(exposure_us=20_000, iso=200, orientation=6)


def exif(**first: int) -> bytes:
    """Return a block with ExposureTime 1/50 and ISO 200 in its Exif directory."""
    inner = struct.pack("<HHHII", 2, 33434, 5, 1, 68) + struct.pack("<HHII", 34855, 3, 1, 200)
    main = struct.pack("<HHHII", 2, 274, 3, 1, first.get("orientation", 6))
    main += struct.pack("<HHII", 34665, 4, 1, 38) + bytes(4)
    return b"II*\0\x08\0\0\0" + main + inner + bytes(4) + struct.pack("<II", 1, 50)


def png(block: bytes, *, late: bool) -> bytes:
    out = io.BytesIO()
    Image.fromarray(GREY).save(out, "png")
    data = out.getvalue()
    at = len(data) - 12 if late else 33
    return data[:at] + chunk(b"eXIf", block) + data[at:]


def tiff(path: Path, **options: Any) -> None:
    tifffile.imwrite(path, GREY, extratags=TAGS, **options)


def library(path: Path) -> None:
    Image.fromarray(GREY.astype(np.uint8)).convert("RGB").save(path, exif=b"Exif\0\0" + exif())


def text_chunk(path: Path, name: str) -> None:
    """Write a PNG with its block as Exiv2 and ImageMagick do."""
    block = b"Exif\0\0" + exif()
    text = f"\n{name}\n{len(block):8d}\n{block.hex()}\n".encode()
    data = png(b"", late=True)
    more = chunk(b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(text))
    path.write_bytes(data[:33] + more + data[33:])


FILES: dict[str, Callable[[Path], object]] = {
    "classic.tif": tiff,
    "big_endian.tif": lambda path: tiff(path, byteorder=">"),
    "bigtiff.tif": lambda path: tiff(path, bigtiff=True),
    "early.png": lambda path: path.write_bytes(png(exif(), late=False)),
    "late.png": lambda path: path.write_bytes(png(exif(), late=True)),
    "exif.jpg": library,
    "exif.webp": library,
    "exiv2.png": lambda path: text_chunk(path, "exif"),
    "imagemagick.png": lambda path: text_chunk(path, "generic profile"),
}


@pytest.mark.parametrize("name", FILES)
def test_shots_of_every_format(tmp_path: Path, name: str) -> None:
    FILES[name](tmp_path / name)
    assert image_facts(tmp_path / name).shot == STATED


@cases(
    ("properties", "expected"),
    {
        "attributes": (
            'exif:ExposureTime="1/50" exif:FNumber="8"',
            ShotFacts(exposure_us=20_000, f_number=8, orientation=1),
        ),
        "elements": (
            "><exif:ExposureTime>0.02</exif:ExposureTime><exif:ISOSpeedRatings>\n<rdf:Seq>"
            "<rdf:li>200</rdf:li></rdf:Seq></exif:ISOSpeedRatings",
            ShotFacts(exposure_us=20_000, iso=200, orientation=1),
        ),
        "no numbers": (
            'exif:ExposureTime="0/0" exif:FNumber="1e999999999"',
            ShotFacts(orientation=1),
        ),
    },
)
def test_properties_in_xmp(tmp_path: Path, properties: str, expected: ShotFacts) -> None:
    packet = f"<x:xmpmeta><rdf:Description {properties}/></x:xmpmeta>"
    Image.fromarray(GREY.astype(np.uint8)).save(tmp_path / "a.jpg", xmp=packet.encode())
    assert image_facts(tmp_path / "a.jpg").shot == expected


def test_tags_of_exif_precede_those_of_xmp(tmp_path: Path) -> None:
    packet = b'<x:xmpmeta exif:ExposureTime="3"></x:xmpmeta>'
    image = Image.fromarray(GREY.astype(np.uint8))
    image.save(tmp_path / "a.jpg", xmp=packet, exif=b"Exif\0\0" + exif())
    assert image_facts(tmp_path / "a.jpg").shot == STATED


def test_attributes_of_exr(tmp_path: Path) -> None:
    spec = oiio.ImageSpec(8, 6, 1, oiio.FLOAT)
    for name, value in (("ExposureTime", 0.02), ("FNumber", 8.0)):
        spec.attribute(name, value)
    spec.x = 3
    file = oiio.ImageOutput.create("a.exr")
    assert file is not None
    assert file.open(str(tmp_path / "a.exr"), spec)
    assert file.write_image(GREY[..., None].astype(np.float32))
    assert file.close()
    facts = image_facts(tmp_path / "a.exr")
    assert facts.shot == ShotFacts(exposure_us=20_000, f_number=8, orientation=1)
    assert facts.window is not None
    assert facts.window[:2] == (3, 0)


def test_exposure_of_radiance_files(tmp_path: Path) -> None:
    path = tmp_path / "a.hdr"
    cv2.imwrite(str(path), np.full((6, 8, 3), 0.5, np.float32))
    first, _, rest = path.read_bytes().partition(b"\n")
    path.write_bytes(first + b"\nEXPOSURE=2.0\n" + rest)
    assert image_facts(path).shot.time_us == 2e6


@cases(
    "block",
    {
        "empty": b"",
        "cut": b"II*\0",
        "far away": b"II*\0\xff\xff\xff\xff",
        "too many entries": b"II*\0\x08\0\0\0" + b"\xff" * 80,
        "a circle": exif()[:30] + struct.pack("<I", 8) + exif()[34:],
        "divided by zero": exif()[:-4] + bytes(4),
    },
)
def test_damaged_tags_state_nothing(block: bytes) -> None:
    assert 33434 not in tiff_tags(io.BytesIO(block), {33434})


@cases(
    ("tags", "expected"),
    {
        "finer": ({33434: 1 / 60, 37377: 6.0}, {"time_us": 15_625}),
        "contradicts": ({33434: 1 / 60, 37377: 3.0}, {"shutter_us": None}),
        "markers": ({37377: 1e9, 33434: 0.0}, {"time_us": None}),
        "ISO elsewhere": ({34855: 65535.0, 34866: 102_400.0}, {"iso": 102_400}),
        "aperture in stops": ({37378: 6.0}, {"f_number": 8}),
        "no orientation": ({274: 9.0}, {"orientation": 1}),
    },
)
def test_meaning_of_tags(tags: dict[int, float | str], expected: dict[str, object]) -> None:
    shot = shot_facts(tags)
    assert {name: getattr(shot, name) for name in expected} == expected


@cases(
    ("change", "said"),
    {
        "iso": ({"iso": 400}, "ISO 400 .*Sensitivity.* a.tif has ISO 200"),
        "aperture": ({"f_number": 8}, "f/8 .*FNumber.* has f/11"),
        "orientation": ({"orientation": 8}, "Orientation tag 8, but a.tif has 6"),
        "window": ({"window": (3, 0, 0, 0, 9, 9)}, r"at \(3, 0\), .* at \(0, 0\)"),
        "size": ({"shape": (6, 9)}, "9 x 6 grey uint16, .* 8 x 6 grey"),
        "unknown": ({"iso": None, "f_number": None, "orientation": None}, None),
        "rounded": ({"f_number": 11.1}, None),
    },
)
def test_what_a_series_cannot_differ_in(change: dict[str, Any], said: str | None) -> None:
    first = ImageFacts(Path("a.tif"), replace(STATED, f_number=11), (6, 8), np.dtype(np.uint16))
    of_shot = {name: value for name, value in change.items() if hasattr(first.shot, name)}
    others = {name: value for name, value in change.items() if name not in of_shot}
    other = replace(first, path=Path("b.tif"), shot=replace(first.shot, **of_shot), **others)
    with nullcontext() if said is None else pytest.raises(DataError, match=rf"b\.tif: .*{said}"):
        other.check_alike(first)


def pages(path: Path, *images: tuple[Any, int]) -> None:
    with tifffile.TiffWriter(path) as file:
        for samples, kind in images:
            file.write(samples, subfiletype=kind, metadata=None)


def test_the_page_that_is_the_image_is_read(tmp_path: Path) -> None:
    path, small = tmp_path / "a.tif", GREY[::2, ::2].copy()
    for order in (((small, 1), (GREY, 0)), ((small, 0), (GREY, 0)), ((GREY, 0), (GREY, 1))):
        pages(path, *order)
        np.testing.assert_array_equal(read_image(path), GREY)
        assert image_facts(path).shape == (6, 8)
        with ImageRows(path) as rows:
            np.testing.assert_array_equal(rows[2:4], GREY[2:4])
    pages(path, (GREY, 0), (GREY, 0))
    with pytest.raises(DataError, match=r"a\.tif: has 2 pages of 8 x 6 pixels"):
        read_image(path)


def test_the_largest_sample_is_black_where_the_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, 65535 - GREY, photometric="miniswhite")
    np.testing.assert_array_equal(read_image(path), GREY)
    with ImageRows(path) as rows:
        np.testing.assert_array_equal(rows[1:3], GREY[1:3])
    samples = np.dstack([65535 - GREY, GREY])
    tifffile.imwrite(path, samples, photometric="miniswhite", extrasamples=["unassalpha"])
    colours, alpha = read_image_with_alpha(path)
    np.testing.assert_array_equal(colours, GREY)
    np.testing.assert_array_equal(alpha, GREY)
    tifffile.imwrite(path, GREY.astype(np.float32), photometric="miniswhite")
    with pytest.raises(DataError, match="MinIsWhite"):
        read_image(path)


@cases(
    ("options", "said"),
    {
        "lab": ({"photometric": "cielab"}, r"CIE L\*a\*b\*"),
        "cmyk": ({"photometric": "separated", "extrasamples": []}, "CMYK"),
        "mosaic": ({"photometric": "cfa"}, "colour filter mosaic"),
        "zstd": ({"compression": "zstd"}, "compressed as ZSTD"),
        "lerc": ({"compression": "lerc"}, "compressed as LERC"),
    },
)
def test_what_cannot_be_read_is_named(tmp_path: Path, options: dict[str, Any], said: str) -> None:
    count = {"cielab": 3, "separated": 4}.get(options.get("photometric", ""), 1)
    samples = GREY if count == 1 else np.dstack([GREY] * count)
    tifffile.imwrite(tmp_path / "a.tif", samples, **options)
    with pytest.raises(DataError, match=rf"a\.tif: .*{said}"):
        read_image(tmp_path / "a.tif")


@cases(
    ("images", "mask", "size", "fits"),
    {
        "none": (1, 1, (6, 8), True),
        "alike": (3, 3, (6, 8), True),
        "images turned": (3, 1, (6, 8), False),
        "mask turned": (1, 3, (6, 8), False),
        "the size shows that it is not turned": (6, 1, (6, 8), True),
        "the size does not show it": (6, 1, (8, 8), False),
    },
)
def test_masks_of_turned_images(
    tmp_path: Path, images: int, mask: int, size: tuple[int, int], fits: bool
) -> None:
    path = tmp_path / "mask.tif"
    inside = np.full(size, 255, np.uint8)
    tifffile.imwrite(path, inside, extratags=[(274, "H", 1, mask, True)])
    facts = ImageFacts(Path("a.tif"), ShotFacts(orientation=images))
    if fits:
        np.testing.assert_array_equal(read_mask_of(path, facts, size), read_mask(path))
        return
    with pytest.raises(DataError, match=rf"Orientation tag {mask}, but the images have {images}"):
        read_mask_of(path, facts, size)


def test_levels_of_a_raw_file_become_those_of_the_first(tmp_path: Path) -> None:
    path, sensor = tmp_path / "a.dng", np.full((40, 60), 512, np.uint16)
    sensor[0, :3] = 100, 1023, 60
    path.write_bytes(dng(sensor, black=(100,) * 4, white=1023))
    levels = RawLevels("b.dng", "RGGB", 50.0, 4095.0)
    scaled = read_levelled(path, levels=levels, max_pixels=10_000)
    expected = (sensor - 100.0) / 923 * 4045 + 50
    np.testing.assert_allclose(scaled, expected, rtol=1e-6)
    assert scaled[0, 1] == 4095
    same = RawLevels("b.dng", "RGGB", 100.0, 1023.0)
    assert read_levelled(path, levels=same, max_pixels=10_000).dtype == np.uint16
    with pytest.raises(DataError, match=r"pattern RGGB, but b\.dng has BGGR"):
        read_levelled(path, levels=levels._replace(cfa="BGGR"), max_pixels=10_000)
