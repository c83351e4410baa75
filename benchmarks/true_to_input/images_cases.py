"""Facts that image files state: exposure, gain, orientation, pages, windows, photometry, codecs."""

# ruff: noqa: E501 - rows of the tables of cases

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import imagecodecs
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself
import tifffile
from PIL import Image
from true_to_input.case import Answer, Kind, Outcome, Row, cases, judge, sgp
from true_to_input.relief import MASK, H, W, directions, error_of, images, write_lp

Array = Any
Write = Callable[[Path, Array, int], None]

COUNT = 12
LIGHTS = directions(COUNT)
APPLIED = ("exposure-times-applied",)


def u16(image: Array) -> Array:
    return np.round(np.clip(image, 0, 1) * 65535).astype(np.uint16)


def srgb8(image: Array) -> Array:
    light = np.clip(image, 0, 1)
    bent = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.round(bent * 255).astype(np.uint8)


def series(
    folder: Path,
    suffix: str,
    write: Write,
    *,
    lights: Array = LIGHTS,
    gains: Array | None = None,
    mask: Array | None = MASK,
    scale: float = 0.9,
) -> Path:
    """Write images of the relief with an .lp file; `write` gets path, linear image, number."""
    source = folder / "src"
    source.mkdir()
    names = [f"IMG_{i + 1:04d}.{suffix}" for i in range(len(lights))]
    for i, (name, image) in enumerate(zip(names, images(lights, scale=scale), strict=True)):
        write(source / name, image * (1 if gains is None else gains[i]), i)
    write_lp(source / "l.lp", names, lights)
    if mask is not None:
        cv2.imwrite(str(source / "mask.png"), mask)
    return source


def automatic(count: int = COUNT, lights: Array = LIGHTS) -> Array:
    """Return relative exposure times in thirds of a stop that make all images equally bright."""
    bright = images(lights)[:, MASK > 0].mean(1)
    times = 2 ** (np.round(3 * np.log2(bright.min() / bright)) / 3)
    times[0] *= 0.5
    return times


def rational(value: float, limit: int = 4000) -> tuple[int, int]:
    part = Fraction(float(value)).limit_denominator(limit)
    return part.numerator, part.denominator


def tif(path: Path, image: Array, *tags: tuple[Any, ...], **options: Any) -> None:
    tifffile.imwrite(path, u16(image), extratags=[(*tag, True) for tag in tags], **options)


def exposure_tag(seconds: float) -> tuple[Any, ...]:
    return 33434, "2I", 1, rational(seconds)


def exif_block(tags: dict[int, Any], first: dict[int, Any] | None = None) -> bytes:
    """Return a TIFF structure with an Exif directory; floats are rationals, as cameras write."""

    def entries(values: dict[int, Any], at: int) -> bytes:
        head, body = b"", b""
        begin = at + 2 + 12 * len(values) + 4
        for tag, value in sorted(values.items()):
            if isinstance(value, Fraction):
                kind = 10 if value < 0 or tag == 0x9201 else 5
                data = struct.pack("<ii", value.numerator, value.denominator)
                head += struct.pack("<HHII", tag, kind, 1, begin + len(body))
                body += data
            else:
                head += struct.pack("<HHII", tag, 4 if tag == 0x8769 else 3, 1, value)
        return struct.pack("<H", len(values)) + head + b"\0\0\0\0" + body

    main = {**(first or {}), 0x8769: 0}
    size = len(entries(main, 8))
    main[0x8769] = 8 + size
    return b"II*\0\x08\0\0\0" + entries(main, 8) + entries(tags, 8 + size)


def jpeg(path: Path, image: Array, exif: bytes) -> None:
    Image.fromarray(srgb8(image)).save(path, quality=98, exif=b"Exif\0\0" + exif)


def png(path: Path, samples: Array, chunks: Sequence[tuple[bytes, bytes]], *, late: bool) -> None:
    """Write a PNG with more chunks after its header, or before its end."""
    data = cv2.imencode(".png", samples)[1].tobytes()
    more = b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
    at = len(data) - 12 if late else 33
    path.write_bytes(data[:at] + more + data[at:])


def exr(
    path: Path,
    image: Array,
    window: tuple[int, int, int, int] | None = None,
    attributes: dict[str, Any] | None = None,
) -> None:
    """Write a grey EXR whose data window is (x, y, width, height) of the display window."""
    x, y, width, height = window or (0, 0, W, H)
    spec = oiio.ImageSpec(width, height, 1, oiio.FLOAT)
    spec.channelnames = ("Y",)
    spec.x, spec.y, spec.full_width, spec.full_height = x, y, W, H
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)
    file = oiio.ImageOutput.create("file.exr")
    file.open(str(path), spec)
    part = np.ascontiguousarray(image[y : y + height, x : x + width, None], np.float32)
    file.write_image(part)
    file.close()


def dng(
    path: Path,
    image: Array,
    i: int,
    *,
    black: Callable[[int], int] = lambda i: 256,
    white: Callable[[int], int] = lambda i: 4095,
    pattern: Callable[[int], str] = lambda i: "RGGB",
    seconds: Callable[[int], float] = lambda i: 1 / 60,
    iso: Callable[[int], int] = lambda i: 100,
    extra: Sequence[tuple[Any, ...]] = (),
) -> None:
    y, x = np.mgrid[:H, :W]
    names = np.array(list(pattern(i))).reshape(2, 2)[y % 2, x % 2]
    gain = np.select([names == "R", names == "B"], [0.6, 0.5], 1.0)
    dark, full = black(i), white(i)
    data = np.clip(np.round(image * gain * (full - dark) + dark), 0, full).astype(np.uint16)
    unit = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (50706, "B", 4, b"\1\4\0\0"), (50708, "s", 0, "Test Cam"), (271, "s", 0, "Test"),
        (272, "s", 0, "Cam"), (50721, "2i", 9, unit), (50728, "2I", 3, (1, 1, 1, 1, 1, 1)),
        (50778, "H", 1, 21), (274, "H", 1, 1), (50717, "I", 1, full), (50714, "2I", 1, (dark, 1)),
        exposure_tag(seconds(i)), (34855, "H", 1, iso(i)), (33421, "H", 2, (2, 2)),
        (33422, "B", 4, bytes("RGB".index(c) for c in pattern(i))), (50711, "H", 1, 1), *extra,
    ]  # fmt: skip
    tifffile.imwrite(
        path,
        data,
        photometric="cfa",
        extratags=[(*tag, True) for tag in tags],
        subfiletype=0,
        metadata=None,
    )


def judged(source: Path, *options: object, **rules: Any) -> Outcome:
    answer, error = error_of(source, *options)
    return judge(answer, error, **rules)


def refused_or_right(source: Path, *names: str, codes: Sequence[str] = ()) -> Outcome:
    """Judge a case that is right if the command refuses it by name or gives the right result."""
    answer, error = error_of(source)
    if answer.code or codes:
        return judge(answer, error, names=names, codes=codes)
    return judge(answer, error)


def imported(folder: Path, source: Path, **rules: Any) -> Outcome:
    """Import a folder and judge the normals of the session."""
    session = folder / "session"
    answer = sgp_capture("import", source, "--out", session)
    if answer.code:
        return judge(answer, **rules)
    return judged(session, **{**rules, "codes": ()})


def sgp_capture(*words: object) -> Answer:
    from contextlib import redirect_stderr, redirect_stdout

    from sgp.app import build, run

    tokens = ["capture", *map(str, words)]
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run(build(tokens), tokens)
    return Answer(code, out.getvalue(), err.getvalue())


# Exposure times


def exposures_in_tags(folder: Path, count: int = COUNT) -> Outcome:
    if count < COUNT:
        around, up = np.arange(count) * 2 * np.pi / count + 0.3, np.deg2rad(45.0)
        up = up + np.deg2rad(15) * (np.arange(count) % 2)
        lights = np.stack(
            [np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], -1
        )
    else:
        lights = LIGHTS
    times = automatic(count, lights)
    source = series(
        folder,
        "tif",
        lambda path, image, i: tif(path, image, exposure_tag(times[i] / 60)),
        lights=lights,
        gains=times,
    )
    return judged(source, codes=APPLIED)


def exposures_in_exif(folder: Path, suffix: str, times: Array, **options: Any) -> Outcome:
    """Exposure times in the Exif block of a JPEG, a PNG or a WebP."""

    def write(path: Path, image: Array, i: int) -> None:
        block = exif_block({0x829A: Fraction(*rational(times[i] / 60)), 0x8827: 100})
        if suffix == "jpg":
            jpeg(path, image, block)
        elif suffix == "png":
            png(path, u16(image), [(b"eXIf", block)], **options)
        else:
            Image.fromarray(srgb8(image)).convert("RGB").save(
                path, lossless=True, exif=b"Exif\0\0" + block
            )

    source = series(folder, suffix, write, gains=times)
    limit = 0.3 if suffix == "png" else 0.4  # 8 bits
    return judged(source, codes=APPLIED if np.ptp(times) else (), limit=limit)


def exposures_as_doubles(folder: Path) -> Outcome:
    """Pillow writes a Python float as a double, not as a rational."""
    times = automatic()

    def write(path: Path, image: Array, i: int) -> None:
        exif = Image.Exif()
        exif[0x8769] = {0x829A: float(times[i] / 60), 0x8827: 100}
        Image.fromarray(srgb8(image)).save(path, quality=98, exif=exif)

    return judged(series(folder, "jpg", write, gains=times), codes=APPLIED, limit=0.4)


def but(value: float, *places: int) -> Array:
    times = np.ones(COUNT)
    times[list(places)] = value
    return times


def exposures_by_apex(folder: Path) -> Outcome:
    """The camera writes 1/60 for 1/64 and 1/15 for 1/16; ShutterSpeedValue is exact."""
    stops = np.array([6, 6, 5, 4, 6, 5, 4, 6, 5, 6, 4, 5])
    stated = {6: 60, 5: 30, 4: 15}

    def write(path: Path, image: Array, i: int) -> None:
        exact, rounded = Fraction(int(stops[i])), Fraction(1, stated[stops[i]])
        jpeg(path, image, exif_block({0x829A: rounded, 0x9201: exact}))

    source = series(folder, "jpg", write, gains=2.0 ** (4 - stops))
    return judged(source, codes=APPLIED, limit=0.4)


def exposure_absent_in_one(folder: Path) -> Outcome:
    times = automatic()

    def write(path: Path, image: Array, i: int) -> None:
        tif(path, image, *([] if i == 4 else [exposure_tag(times[i] / 60)]))

    source = series(folder, "tif", write, gains=times)
    return judged(source, names=("IMG_0005", "exposure time"), codes=("none",))


def exposures_in_spheres(folder: Path) -> Outcome:
    """A chrome sphere under lights; exposure times differ between its images."""
    y, x = np.mgrid[:160, :160]
    u, v = (x - 80) / 60, -(y - 80) / 60
    inside = u**2 + v**2 < 1
    normal = np.stack([u, v, np.sqrt(np.clip(1 - u**2 - v**2, 0, 1))], -1)
    mirrored = 2 * normal[..., 2:] * normal - np.array([0, 0, 1.0])
    source = folder / "src"
    source.mkdir()
    times = np.where(np.arange(COUNT) % 2, 1.0, 0.25)
    for i, light in enumerate(LIGHTS):
        glint = np.exp(((mirrored * light).sum(-1) - 1) / 0.0008) * inside
        image = np.clip((glint * 3 + np.where(inside, 0.01, 0.2)) * times[i], 0, 1)
        tif(source / f"ball_{i:02d}.tif", image, exposure_tag(times[i] / 60))
    cv2.imwrite(str(source / "mask.png"), inside.astype(np.uint8) * 255)
    answer = sgp("calibrate", "spheres", source, "--out", folder / "lights.json")
    if answer.code:
        return judge(answer)
    from acquisition import read_lights

    found = read_lights(folder / "lights.json").unit_directions
    error = np.rad2deg(np.linalg.norm(np.cross(found, LIGHTS), axis=1)).mean()
    return judge(answer, float(error), limit=1.0, codes=APPLIED)


def exposures_elsewhere(folder: Path, form: str, places: str) -> Outcome:
    """Exposure times where Photoshop, Lightroom, darktable, ImageMagick or renderers write them."""
    times = automatic()

    def write(path: Path, image: Array, i: int) -> None:
        time = Fraction(*rational(times[i] / 60))
        block = exif_block({0x829A: time})
        packet = (
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/'
            '22-rdf-syntax-ns#"><rdf:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" '
            f'exif:ExposureTime="{time}"/></rdf:RDF></x:xmpmeta>'
        ).encode()
        if form == "jpg":
            Image.fromarray(srgb8(image)).save(path, quality=98, xmp=packet)
        elif form == "tif":
            tif(path, image, (700, "B", len(packet), packet))
        elif form == "jp2":
            data = b"JpgTiffExif->JP2" + block
            coded = imagecodecs.jpeg2k_encode(u16(image), level=0, reversible=True)
            path.write_bytes(coded + struct.pack(">I", len(data) + 8) + b"uuid" + data)
        elif form == "exr":
            attributes = {"Exif:ExposureTime": str(time)}
            exr(path, image, attributes=attributes)
        elif places == "xmp":
            png(path, u16(image), [(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + packet)], late=False)
        else:
            text = f"\n{places}\n{len(block) + 6:8d}\n{(b'Exif' + bytes(2) + block).hex()}\n"
            keyword = "APP1" if places == "generic profile" else places
            body = f"Raw profile type {keyword}\0\0".encode() + zlib.compress(text.encode())
            png(path, u16(image), [(b"zTXt", body)], late=False)

    source = series(folder, form, write, gains=times)
    return judged(source, codes=APPLIED, limit=0.4 if form == "jpg" else 0.3)


def exr_setting(folder: Path, name: str) -> Outcome:
    gains = np.where(np.arange(COUNT) % 2, 1.0, 0.5)
    source = series(
        folder,
        "exr",
        lambda path, image, i: exr(path, image, attributes={name: 100.0 if i % 2 else 50.0}),
        gains=gains,
    )
    return judged(source, names=("IMG_0002", "ISO"))


def portable_floats(folder: Path) -> Outcome:
    def write(path: Path, image: Array, i: int) -> None:
        head = f"Pf\n{W} {H}\n-1.0\n".encode()
        path.write_bytes(head + image[::-1].astype("<f4").tobytes())

    return judged(series(folder, "pfm", write), names=("PFM", "IMG_0001.pfm"))


# Gain, aperture


def setting(folder: Path, tag: int, name: str, low: Any, high: Any, form: str = "jpg") -> Outcome:
    gains = np.where(np.arange(COUNT) % 2, 1.0, 0.5)

    def write(path: Path, image: Array, i: int) -> None:
        value = high if i % 2 else low
        if form == "tif":
            tif(path, image, (tag, "H", 1, value))
        elif form == "png":
            png(path, u16(image), [(b"eXIf", exif_block({tag: value}))], late=True)
        else:
            jpeg(path, image, exif_block({tag: value}))

    source = series(folder, form, write, gains=gains)
    return judged(source, names=("IMG_000", name))


# Orientation


def oriented(
    folder: Path,
    tags: Sequence[int],
    form: str = "tif",
    mask: Callable[[Path], None] | None = None,
    **rules: Any,
) -> Outcome:
    def write(path: Path, image: Array, i: int) -> None:
        tag = tags[i % len(tags)]
        if form == "tif":
            tif(path, image, (274, "H", 1, tag))
        elif form == "png":
            png(path, u16(image), [(b"eXIf", exif_block({0x8827: 100}, {274: tag}))], late=False)
        elif form == "dng":
            dng(path, image, i)
            with tifffile.TiffFile(path, mode="r+b") as file:
                file.pages[0].tags[274].overwrite(tag)
        else:
            jpeg(path, image, exif_block({0x8827: 100}, {274: tag}))

    source = series(folder, form, write, mask=MASK if mask is None else None)
    if mask is not None:
        mask(source)
    return judged(source, **rules)


def turned_mask(source: Path, tag: int | None = None) -> None:
    """Write a mask of the upper left part of the relief as a viewer shows it: turned by 180."""
    part = np.zeros_like(MASK)
    part[5:50, 10:70] = 255
    tags = [] if tag is None else [(274, "H", 1, tag, True)]
    tifffile.imwrite(source / "mask.tif", (part & MASK)[::-1, ::-1], extratags=tags)


# Photometric interpretation


def inverted_mask(source: Path) -> None:
    samples = 65535 - np.uint16(257) * MASK
    tifffile.imwrite(source / "mask.tif", samples, photometric="miniswhite")


def miniswhite(folder: Path, bits: int) -> Outcome:
    top = 2**bits - 1

    def write(path: Path, image: Array, i: int) -> None:
        samples = np.round(np.clip(image, 0, 1) * top).astype(np.uint16 if bits > 8 else np.uint8)
        more = {"bitspersample": bits} if bits == 12 else {}
        tifffile.imwrite(path, top - samples, photometric="miniswhite", **more)

    return judged(series(folder, "tif", write), limit=0.3 if bits > 8 else 0.6)


def miniswhite_float(folder: Path) -> Outcome:
    source = series(
        folder,
        "tif",
        lambda path, image, i: tifffile.imwrite(
            path, (1 - image).astype(np.float32), photometric="miniswhite"
        ),
    )
    return refused_or_right(source, "IMG_0001", "MinIsWhite")


def with_mask(folder: Path, mask: Callable[[Path], None], **rules: Any) -> Outcome:
    source = series(folder, "tif", lambda path, image, i: tif(path, image), mask=None)
    mask(source)
    return judged(source, **rules)


def photometric(folder: Path, form: str) -> Outcome:
    """L*a*b*, CMYK and bare mosaics in TIFF and JPEG."""

    def write(path: Path, image: Array, i: int) -> None:
        grey, zero = u16(image) >> 8, np.zeros((H, W), np.uint8)
        full = np.full((H, W), 255, np.uint8)
        ink = 255 - (srgb8(image) if form == "cmyk_jpg" else grey.astype(np.uint8))
        if form == "lab":
            planes = np.dstack([grey.astype(np.uint8), zero, zero])
            tifffile.imwrite(path, planes, photometric="cielab")
        elif form == "cmyk_tif":
            tifffile.imwrite(path, np.dstack([zero, zero, zero, ink]), photometric="separated")
        elif form == "cmyk_jpg":
            Image.fromarray(np.dstack([zero, zero, zero, ink]), "CMYK").save(path, quality=98)
        elif form == "cfa":
            y, x = np.mgrid[:H, :W]
            gain = np.where((y + x) % 2, 1.0, np.where(y % 2, 0.3, 0.6))
            tifffile.imwrite(path, u16(image * gain), photometric="cfa")
        elif form == "ycbcr":
            half = full // 2 + 1
            planes = np.dstack([grey.astype(np.uint8), half, half])
            tifffile.imwrite(path, planes, photometric="ycbcr")

    suffix = "jpg" if form == "cmyk_jpg" else "tif"
    name = {"lab": "L*a*b*", "cfa": "colour filter", "ycbcr": "YCbCr"}.get(form, "CMYK")
    return refused_or_right(series(folder, suffix, write), "IMG_0001", name)


# Pages, windows


def paged(folder: Path, form: str) -> Outcome:
    def write(path: Path, image: Array, i: int) -> None:
        full = u16(image)
        small, half = (full[::8, ::8] >> 8).astype(np.uint8), full[::2, ::2].copy()
        if form == "colour":
            planes = np.stack([full // 10, full, full // 4])
            tifffile.imwrite(path, planes, photometric="minisblack", metadata={"axes": "CYX"})
            return
        pages: dict[str, list[tuple[Array, dict[str, Any]]]] = {
            "thumb": [(small, {"subfiletype": 1}), (full, {})],
            "thumb_unmarked": [(small, {}), (full, {})],
            "two_exposures": [(full // 50, {}), (full, {})],
            "pyramid": [(full, {}), (half, {"subfiletype": 1}), (small, {"subfiletype": 1})],
            "mask_page": [(full, {}), (MASK, {"subfiletype": 1})],
        }
        with tifffile.TiffWriter(path) as file:
            for samples, options in pages[form]:
                file.write(samples, **options)
        if form == "mask_page":
            with tifffile.TiffFile(path, mode="r+b") as file:
                file.pages[1].tags[254].overwrite(4)

    source = series(folder, "tif", write)
    codes = ("pages-not-read",) if form in ("colour", "two_exposures") else ()
    return refused_or_right(source, "IMG_0001", "pages", codes=codes)


def page_mask(source: Path) -> None:
    """A mask whose first page is its thumbnail."""
    with tifffile.TiffWriter(source / "mask.tif") as file:
        file.write(MASK[::8, ::8].copy(), subfiletype=1)
        file.write(MASK)


def windowed(folder: Path, *, display: bool) -> Outcome:
    """EXR files of which each holds the smallest window around what is lit."""

    def write(path: Path, image: Array, i: int) -> None:
        image = np.where(MASK > 0, image, 0)
        shift = i % 4
        exr(path, image, (6 + shift, 10, 104, 78) if display else (4 + i % 3, 6, 108 - i, 84))

    return refused_or_right(series(folder, "exr", write), "IMG_0002", "window")


def positioned(folder: Path) -> Outcome:
    """TIFF files cropped by a panorama program, with their positions."""

    def write(path: Path, image: Array, i: int) -> None:
        x = 6 + i % 4
        part = np.ascontiguousarray(image[10:88, x : x + 104])
        tif(path, part, (286, "2I", 1, (x, 1)), (287, "2I", 1, (10, 1)), resolution=(1, 1))

    return refused_or_right(series(folder, "tif", write), "IMG_0002", "window")


def offset_png(folder: Path) -> Outcome:
    def write(path: Path, image: Array, i: int) -> None:
        x = 6 + i % 4
        part = np.ascontiguousarray(u16(image)[10:88, x : x + 104])
        png(path, part, [(b"oFFs", struct.pack(">iiB", x, 10, 0))], late=False)

    return refused_or_right(series(folder, "png", write), "IMG_0002", "window")


# Colour metadata, codecs


def cicp(folder: Path, transfer: int) -> Outcome:
    def write(path: Path, image: Array, i: int) -> None:
        png(path, u16(image), [(b"cICP", bytes([9, transfer, 0, 1]))], late=False)

    answer, error = error_of(series(folder, "png", write))
    if answer.code:
        return judge(answer, error, names=("cICP", str(transfer)))
    named = [text for code, text in answer.notices if code == "transfer-curve" and "cICP" in text]
    kind: Kind = "applied and stated" if named else "wrong"
    return Outcome(kind, named[0] if named else "no notice of the cICP chunk")


def codec(folder: Path, name: str) -> Outcome:
    def write(path: Path, image: Array, i: int) -> None:
        if name == "12-bit JPEG":
            path.write_bytes(imagecodecs.jpeg8_encode(u16(image) >> 4, bitspersample=12))
        elif name == "lossless JPEG":
            path.write_bytes(imagecodecs.ljpeg_encode(u16(image)))
        else:
            tifffile.imwrite(path, u16(image), compression=name)

    source = series(folder, "jpg" if "JPEG" in name else "tif", write)
    known = {"12-bit JPEG": "12", "lossless JPEG": "lossless", "lzma": "LZMA", "lerc": "LERC"}
    outcome = judged(source, names=("IMG_0001", known.get(name, "ZSTD")))
    return Outcome("vague", outcome.text) if "cut short" in outcome.text else outcome


# RAW series


def raw_series(folder: Path, *names: str, importing: bool = False, **options: Any) -> Outcome:
    gains = options.pop("gains", None)
    codes = options.pop("codes", ())
    source = series(folder, "dng", partial(dng, **options), gains=gains)
    if importing:
        return imported(folder, source, names=names)
    answer, error = error_of(source)
    return judge(answer, error, names=names, codes=() if answer.code else codes)


def two(one: Any, other: Any, *places: int) -> Callable[[int], Any]:
    return lambda i: other if i in places else one


def imported_exposures(folder: Path) -> Outcome:
    times = automatic()
    source = series(
        folder,
        "tif",
        lambda path, image, i: tif(path, image, exposure_tag(times[i] / 60)),
        gains=times,
    )
    return imported(folder, source)


def imported_setting(folder: Path) -> Outcome:
    gains = np.where(np.arange(COUNT) % 2, 1.0, 0.5)
    source = series(
        folder,
        "tif",
        lambda path, image, i: tif(path, image, (34855, "H", 1, 100 if i % 2 else 50)),
        gains=gains,
    )
    return imported(folder, source, names=("IMG_000", "ISO"))


ORIENTED = ("orientation-tag",)
_HALVES = but(0.5, 1, 6, 8)
_RAW_HALF = {"seconds": two(1 / 60, 1 / 120, 1, 6, 8), "gains": _HALVES}

_LISTED: tuple[Row, ...] = (
    *(
        (f"auto{n}", "exposure times applied", partial(exposures_in_tags, count=n))
        for n in (4, 5, 6, 8, 12)
    ),
    ("auto_jpg", "exposure times applied", partial(exposures_in_exif, suffix="jpg", times=automatic())),
    ("auto_jpg_double", "exposure times applied", exposures_as_doubles),
    ("one_jpg", "exposure time applied", partial(exposures_in_exif, suffix="jpg", times=but(0.5, 4))),
    ("third_jpg", "exposure times applied", partial(exposures_in_exif, suffix="jpg", times=but(2 ** (-1 / 3), 3, 8, 9))),
    ("same_jpg", "unchanged", partial(exposures_in_exif, suffix="jpg", times=but(1))),
    ("iso_jpg", "refused by name", partial(setting, tag=0x8827, name="ISO", low=50, high=100)),
    ("import_exposures", "exposure times applied", imported_exposures),
    ("import_iso", "refused by name", imported_setting),
    ("raw_same", "unchanged", raw_series),
    ("raw_black", "levels of each file", partial(raw_series, black=two(256, 512, 4, 9))),
    ("raw_blackall", "levels of each file", partial(raw_series, black=lambda i: 200 + 40 * i)),
    ("raw_white", "levels of each file", partial(raw_series, white=two(4095, 16383, 2, 7), black=two(256, 1024, 2, 7))),
    ("raw_pattern", "refused by name", lambda folder: raw_series(folder, "IMG_0003", "GRBG", pattern=two("RGGB", "GRBG", 2, 7))),
    ("raw_shutter", "exposure times applied", partial(raw_series, codes=APPLIED, **_RAW_HALF)),
    ("raw_iso", "refused by name", lambda folder: raw_series(folder, "IMG_0002", "ISO", iso=two(100, 50, 1, 6, 8), gains=_HALVES)),
    ("import_raw_black", "refused by name", lambda folder: raw_series(folder, "IMG_0005", "black level", black=two(256, 512, 4, 9), importing=True)),
    ("miw16", "right", partial(miniswhite, bits=16)),
    ("miw12", "right", partial(miniswhite, bits=12)),
    ("miw_mask", "right", partial(with_mask, mask=inverted_mask)),
    ("or3", "stated", partial(oriented, tags=(3,), mask=lambda source: None, codes=ORIENTED)),
    ("or6", "stated", partial(oriented, tags=(6,), codes=ORIENTED)),
    ("or_mixed", "refused by name", partial(oriented, tags=(1, 3), names=("IMG_0002", "rientation"), codes=("none",))),
    ("or3m", "refused by name", partial(oriented, tags=(3,), mask=turned_mask, names=("mask", "rientation"), codes=("none",))),
    ("exr_windows", "right, or refused by name", partial(windowed, display=True)),
    ("thumb", "right", partial(paged, form="thumb")),
    ("pages", "right, or refused by name", partial(paged, form="colour")),
    ("twoexp", "refused by name", partial(paged, form="two_exposures")),
    ("lab", "right, or refused by name", partial(photometric, form="lab")),
    ("cmyk_tif", "right, or refused by name", partial(photometric, form="cmyk_tif")),
    ("ycbcr_tif", "right, or refused by name", partial(photometric, form="ycbcr")),
    ("cicp_unknown", "the chunk is named", partial(cicp, transfer=16)),
    ("zstd", "codec named", partial(codec, name="zstd")),
    ("jpeg12", "codec named", partial(codec, name="12-bit JPEG")),
)  # fmt: skip

_UNLISTED: tuple[Row, ...] = (
    ("apex", "ShutterSpeedValue used", exposures_by_apex),
    ("exif_png16", "exposure times applied", partial(exposures_in_exif, suffix="png", times=automatic(), late=False)),
    ("exif_png16_late", "exposure times applied", partial(exposures_in_exif, suffix="png", times=automatic(), late=True)),
    ("exif_webp", "exposure times applied", partial(exposures_in_exif, suffix="webp", times=automatic())),
    *(
        (name, "exposure times applied", partial(exposures_elsewhere, form=form, places=places))
        for name, form, places in (
            ("xmp_jpg", "jpg", "xmp"),
            ("xmp_png16", "png", "xmp"),
            ("xmp_tif", "tif", "xmp"),
            ("exiv2_png16", "png", "exif"),
            ("imagemagick_png16", "png", "generic profile"),
            ("exif_jp2", "jp2", "exif"),
            ("exif_exr", "exr", "exif"),
        )
    ),
    ("iso_exr", "refused by name", partial(exr_setting, name="isoSpeed")),
    ("iso_exr_exif", "refused by name", partial(exr_setting, name="Exif:ISOSpeedRatings")),
    ("pfm", "kind of file named", portable_floats),
    ("one_without_time", "refused by name", exposure_absent_in_one),
    ("sphere_exposures", "exposure times applied", exposures_in_spheres),
    ("aperture_jpg", "refused by name", partial(setting, tag=0x829D, name="aperture", low=Fraction(11), high=Fraction(8))),
    ("iso_png16", "refused by name", partial(setting, tag=0x8827, name="ISO", low=50, high=100, form="png")),
    ("or8_png", "stated", partial(oriented, tags=(8,), form="png", codes=ORIENTED)),
    ("or3_dng", "stated", partial(oriented, tags=(3,), form="dng", codes=ORIENTED)),
    ("or_mixed_jpg", "refused by name", partial(oriented, tags=(1, 1, 6), form="jpg", names=("IMG_0003", "rientation"), codes=("none",))),
    ("mask_or3", "turned, or refused by name", partial(with_mask, mask=partial(turned_mask, tag=3), names=("mask", "rientation"), codes=("none",))),
    ("miw8", "right", partial(miniswhite, bits=8)),
    ("miw_float", "refused by name", miniswhite_float),
    ("thumb_unmarked", "right", partial(paged, form="thumb_unmarked")),
    ("pyramid", "right", partial(paged, form="pyramid")),
    ("mask_page", "right", partial(paged, form="mask_page")),
    ("mask_thumb", "right", partial(with_mask, mask=page_mask)),
    ("exr_autocrop", "right, or refused by name", partial(windowed, display=False)),
    ("tiff_positions", "right, or refused by name", positioned),
    ("png_offsets", "right, or refused by name", offset_png),
    ("cmyk_jpg", "right, or refused by name", partial(photometric, form="cmyk_jpg")),
    ("cfa_tif", "refused by name", partial(photometric, form="cfa")),
    ("cicp_hlg", "the chunk is named", partial(cicp, transfer=18)),
    ("lzma", "codec named", partial(codec, name="lzma")),
    ("lerc", "codec named", partial(codec, name="lerc")),
    ("jpeg_lossless", "codec named", partial(codec, name="lossless JPEG")),
    ("import_or_mixed", "refused by name", lambda folder: imported(folder, series(folder, "tif", lambda path, image, i: tif(path, image, (274, "H", 1, 3 if i == 5 else 1))), names=("IMG_0006", "rientation"))),
)  # fmt: skip


CASES = cases(1, _LISTED, _UNLISTED)
