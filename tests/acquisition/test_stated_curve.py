"""The transfer curve that the metadata of a file state: every kind of metadata, and damage."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageCms

from acquisition import LINEAR, SRGB, TransferCurve, write_exr, write_png
from acquisition.pixels import image_facts, write_tiff
from acquisition.pixels.icc_curve import icc_curve
from acquisition.source.series_facts import transfer_notices
from rig import UnreadableError
from tests.acquisition.image_bytes import by_library, chunk
from tests.cases import cases

RGB = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
ADOBE = 563 / 256


def png(*chunks: bytes, bits: int = 8) -> bytes:
    """Build a PNG of RGB pixels with chunks before the pixels."""
    samples = RGB.astype(">u2").tobytes() if bits == 16 else RGB.tobytes()
    rows = np.frombuffer(samples, np.uint8).reshape(4, -1)
    body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    head = struct.pack(">IIBBBBB", 5, 4, bits, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + b"".join(chunks)
        + chunk(b"IDAT", body) + chunk(b"IEND", b"")
    )  # fmt: skip


def gamma(value: int) -> bytes:
    return chunk(b"gAMA", struct.pack(">I", value))


def iccp(profile: bytes) -> bytes:
    return chunk(b"iCCP", b"a profile\0\0" + zlib.compress(profile))


def profile(*tags: bytes, names: tuple[bytes, ...] = (b"rTRC", b"gTRC", b"bTRC")) -> bytes:
    """Build an ICC profile of RGB whose curves are the tags, one for all or one for each."""
    each = [tags[min(i, len(tags) - 1)] for i in range(len(names))]
    each = [tag + bytes(-len(tag) % 4) for tag in each]
    begin = 128 + 4 + 12 * len(each)
    table, body = struct.pack(">I", len(each)), b""
    for name, tag in zip(names, each, strict=True):
        table += struct.pack(">4sII", name, begin + len(body), len(tag))
        body += tag
    # libpng refuses chunks of fewer than 81 bytes, compressed.
    body += bytes(range(100))
    head = bytearray(128)
    head[:4] = struct.pack(">I", begin + len(body))
    head[12:24] = b"mntrRGB XYZ "
    head[36:40] = b"acsp"
    return bytes(head) + table + body


def curv(*values: int) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(f">I{len(values)}H", len(values), *values)


def para(function: int, *numbers: float) -> bytes:
    fixed = [round(number * 65536) for number in numbers]
    return b"para\0\0\0\0" + struct.pack(f">HH{len(fixed)}i", function, 0, *fixed)


SRGB_PARA = para(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
SRGB_TABLE = curv(*np.rint(65535 * SRGB.light(np.linspace(0, 1, 1024))).astype(int).tolist())
# 0.6 x^2.2 + 0.4 x, a little above black at the start, as scanners write it.
_MIXED = 0.6 * np.linspace(0, 1, 1024) ** 2.2 + 0.4 * np.linspace(0, 1, 1024)
MIXED_TABLE = curv(33, *np.rint(65535 * _MIXED[1:]).astype(int).tolist())
REAL = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


@cases(
    ("data", "curve"),
    {
        "Little CMS": (REAL, SRGB),
        "sRGB as a function": (profile(SRGB_PARA), SRGB),
        "sRGB as a table": (profile(SRGB_TABLE), SRGB),
        "no numbers: linear": (profile(curv()), LINEAR),
        "gamma 1": (profile(curv(256)), LINEAR),
        "two points": (profile(curv(0, 65535)), LINEAR),
        "Adobe RGB": (profile(curv(563)), TransferCurve.power(ADOBE)),
        "gamma 1.8": (profile(para(0, 1.8)), TransferCurve.power(1.8)),
        "grey": (profile(curv(461), names=(b"kTRC",)), TransferCurve.power(461 / 256)),
        "0 up to a fifth": (
            profile(para(1, 2.0, 1.25, -0.25)),
            TransferCurve.table([[0, 0], [1, 1]]),
        ),
    },
)
def test_curves_of_profiles(data: bytes, curve: TransferCurve) -> None:
    found = icc_curve(data)
    if curve.kind == "table":
        light = found.light([0.1, 0.2, 0.6, 1.0])
        np.testing.assert_allclose(light, [0, 0, 0.25, 1], atol=2e-3)
        return
    assert found.kind == curve.kind
    assert found.light(0.5) == pytest.approx(float(curve.light(0.5)), abs=1e-4)


@cases(
    ("data", "said"),
    {
        "empty": (b"", "is not one"),
        "zeros": (bytes(200), "is not one"),
        "no curves": (profile(names=()), "has no transfer curves"),
        "three": (profile(curv(512), curv(461), curv(512)), "red, green and blue"),
        "cut short": (profile(curv(512))[:170], "is damaged"),
        "endless table": (profile(b"curv\0\0\0\0\xff\xff\xff\xff"), "is damaged"),
        "another type": (profile(b"text\0\0\0\0abcd"), "is damaged"),
        "unknown function": (profile(para(9, 2.0)), "is damaged"),
        "division by 0": (profile(para(1, 2.0, 0.0, 0.0)), "is damaged"),
        "infinite": (profile(para(0, -3.0)), "is damaged"),
        "ends below white": (profile(curv(0, 9000, 5000)), "does not increase"),
        "begins above black": (profile(curv(9000, 65535)), "does not increase"),
    },
)
def test_profiles_without_a_curve(data: bytes, said: str) -> None:
    with pytest.raises(UnreadableError, match=said):
        icc_curve(data)


@given(st.binary(max_size=300))
def test_any_bytes_are_a_curve_or_refused(data: bytes) -> None:
    for damaged in (data, REAL[:200] + data, REAL[:132] + data + REAL[132:]):
        with contextlib.suppress(UnreadableError):
            assert icc_curve(damaged).light(1.0) == pytest.approx(1)


def pillow(kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(RGB).save(file, kind, **options)
    return file.getvalue()


def exif(colour_space: int) -> bytes:
    tags = Image.Exif()
    tags.get_ifd(0x8769)[0xA001] = colour_space
    return tags.tobytes()


CASES: dict[str, tuple[str, Callable[[], bytes], TransferCurve, str]] = {
    "JPEG": ("a.jpg", lambda: pillow("JPEG"), SRGB, "8-bit JPEG without colour metadata"),
    "JPEG, Exif sRGB": ("a.jpg", lambda: pillow("JPEG", exif=exif(1)), SRGB, "Exif colour space"),
    "JPEG, Exif Adobe RGB": (
        "a.jpg", lambda: pillow("JPEG", exif=exif(2)), TransferCurve.power(ADOBE),
        "Exif colour space",
    ),
    "JPEG, Exif not calibrated": (
        "a.jpg", lambda: pillow("JPEG", exif=exif(65535)), SRGB,
        "8-bit JPEG without colour metadata",
    ),
    "JPEG, profile": ("a.jpg", lambda: pillow("JPEG", icc_profile=REAL), SRGB, "ICC profile"),
    "JPEG, profile before Exif": (
        "a.jpg", lambda: pillow("JPEG", icc_profile=profile(curv()), exif=exif(1)), LINEAR,
        "ICC profile",
    ),
    "JPEG, damaged profile": (
        "a.jpg", lambda: pillow("JPEG", icc_profile=profile(b"curv")), SRGB,
        "8-bit JPEG, whose ICC profile is damaged: ",
    ),
    "WebP": ("a.webp", lambda: pillow("WEBP"), SRGB, "8-bit WebP without colour metadata"),
    "PNG": ("a.png", png, LINEAR, "8-bit PNG without colour metadata"),
    "PNG of 16 bits": ("a.png", lambda: png(bits=16), LINEAR, "16-bit PNG without colour metadata"),
    "PNG, sRGB": ("a.png", lambda: png(chunk(b"sRGB", b"\0")), SRGB, "PNG sRGB chunk"),
    "PNG, sRGB before gAMA": (
        "a.png", lambda: png(gamma(100_000), chunk(b"sRGB", b"\0"), bits=16), SRGB,
        "PNG sRGB chunk",
    ),
    "PNG, gAMA 2.2": (
        "a.png", lambda: png(gamma(45455)), TransferCurve.power(2.2), "PNG gAMA chunk",
    ),
    "PNG, gAMA 1": ("a.png", lambda: png(gamma(100_000)), LINEAR, "PNG gAMA chunk"),
    "PNG, gAMA 0": ("a.png", lambda: png(gamma(0)), LINEAR, "8-bit PNG without colour metadata"),
    "PNG, absurd gAMA": (
        "a.png", lambda: png(gamma(1)), LINEAR, "8-bit PNG without colour metadata",
    ),
    "PNG, profile": (
        "a.png", lambda: png(iccp(profile(curv(461)))), TransferCurve.power(461 / 256),
        "ICC profile",
    ),
    "PNG, profile before gAMA": (
        "a.png", lambda: png(gamma(100_000), iccp(profile(SRGB_PARA))), SRGB, "ICC profile",
    ),
    "PNG, cICP sRGB": (
        "a.png", lambda: png(chunk(b"cICP", bytes([1, 13, 0, 1]))), SRGB, "PNG cICP chunk",
    ),
    "PNG, cICP linear before sRGB": (
        "a.png", lambda: png(chunk(b"cICP", bytes([1, 8, 0, 1])), chunk(b"sRGB", b"\0")), LINEAR,
        "PNG cICP chunk",
    ),
    "PNG, cICP of film": (
        "a.png", lambda: png(chunk(b"cICP", bytes([9, 16, 0, 1]))), LINEAR,
        "8-bit PNG, whose cICP chunk names the unknown transfer 16",
    ),
    "PNG, cICP without a transfer": (
        "a.png", lambda: png(chunk(b"cICP", bytes([2, 2, 0, 1]))), LINEAR,
        "8-bit PNG without colour metadata",
    ),
    "PNG, damaged profile": (
        "a.png", lambda: png(iccp(b"nothing")), LINEAR,
        "8-bit PNG",
    ),
    "TIFF": ("a.tif", lambda: pillow("TIFF"), LINEAR, "8-bit TIFF without colour metadata"),
    "TIFF, profile": ("a.tif", lambda: pillow("TIFF", icc_profile=REAL), SRGB, "ICC profile"),
    "BMP": ("a.bmp", lambda: pillow("BMP"), LINEAR, "8-bit BMP without colour metadata"),
    "TGA": ("a.tga", lambda: pillow("TGA"), LINEAR, "8-bit TGA without colour metadata"),
    "PNM": ("a.ppm", lambda: pillow("PPM"), LINEAR, "8-bit PNM without colour metadata"),
    "JPEG 2000": (
        "a.jp2", lambda: pillow("JPEG2000"), LINEAR, "8-bit JPEG 2000 without colour metadata",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_metadata_of_every_kind(tmp_path: Path, case: str) -> None:
    name, data, curve, origin = CASES[case]
    path = tmp_path / name
    path.write_bytes(data())
    found = image_facts(path).transfer
    assert found.curve.kind == curve.kind
    assert found.curve.light(0.5) == pytest.approx(float(curve.light(0.5)), abs=1e-4)
    assert found.origin.startswith(origin)
    assert found.stated == (not origin[0].isdigit())


def test_a_table_that_starts_just_above_black_is_a_table() -> None:
    found = icc_curve(profile(MIXED_TABLE))
    assert found.kind == "table"
    assert found.light(0.5) == pytest.approx(0.6 * 0.5**2.2 + 0.2, abs=1e-3)
    assert found.light(0.0) == 0


@pytest.mark.parametrize(
    ("origin", "white", "reported"),
    [
        ("16-bit TIFF without colour metadata", 65535, False),
        (
            "16-bit TIFF, whose ICC profile has different curves for red, green and blue",
            65535,
            True,
        ),
        ("8-bit PNG without colour metadata", 255, True),
    ],
)
def test_a_profile_that_cannot_be_used_is_reported(origin, white, reported) -> None:
    assert bool(transfer_notices(LINEAR, origin, white, "a.tif")) == reported


def test_our_own_files_state_no_display_curve(tmp_path: Path) -> None:
    """By default OpenImageIO marks every PNG as sRGB."""
    write_png(tmp_path / "a.png", RGB)
    write_png(tmp_path / "b.png", RGB.astype(np.uint16))
    write_tiff(tmp_path / "c.tif", RGB.astype(np.uint16))
    write_exr(tmp_path / "d.exr", RGB.astype(np.float32))
    for path in tmp_path.iterdir():
        assert image_facts(path).transfer.curve == LINEAR
        assert not image_facts(path).transfer.stated


def test_floats_with_the_metadata_of_a_camera_are_linear(tmp_path: Path) -> None:
    """A converter copies the Exif data of the photograph into the EXR file."""
    by_library(tmp_path / "a.exr", RGB.astype(np.float32), **{"Exif:ColorSpace": 1})
    assert image_facts(tmp_path / "a.exr").transfer.curve == LINEAR


def test_jpegs_of_opencv(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), RGB)
    assert image_facts(tmp_path / "a.jpg").transfer.curve == SRGB
