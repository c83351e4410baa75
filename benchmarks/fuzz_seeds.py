"""Undamaged files for `fuzz_readers.py`: generated here, and real ones from SGP_DATA."""

from __future__ import annotations

import json
import os
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself
import scipy.io
import trimesh
import x3pio
from fuzz_mutators import (
    Mutator,
    mutated,
    within_glb,
    within_journal,
    within_mat,
    within_png,
)
from PIL import Image, PngImagePlugin

from acquisition import (
    Calibrations,
    CameraModel,
    CapturePlan,
    Flat,
    Labels,
    Lights,
    MeasuredSensor,
    write_camera,
    write_exr,
    write_lights,
    write_png,
)
from acquisition.exports import prepare_export
from acquisition.pixels import write_tiff
from acquisition.session import Manifest, SessionWriter
from acquisition.value_files import write_flat, write_sensor
from acquisition.values import Measured
from processing.relight import RelightableImage, write_ptm
from processing.surface import X3pOrigin, write_x3p
from simulator import scene_named, write_scene

# Larger real files would only make the runs slower.
_LARGEST = 800_000
_TEXTS = {
    ".toml", ".json", ".jsonl", ".lp", ".txt", ".csv", ".yml", ".yaml", ".xml", ".obj", ".off",
    ".xyz",
}  # fmt: skip
_BY_FORMAT: dict[str, Mutator] = {
    ".png": within_png,
    ".mat": within_mat,
    ".glb": within_glb,
    ".jsonl": within_journal,
}


@dataclass(frozen=True)
class Seed:
    """A file or folder for a reader.

    Parameters
    ----------
    name
        Name in reports.
    files
        Contents of the files by name inside the folder.
    targets
        Names of the files that may be damaged.
    entry
        Path for the reader inside the folder; empty for the folder itself.
    """

    name: str
    files: dict[str, bytes]
    targets: tuple[str, ...]
    entry: str = ""


def is_text(name: str, data: bytes) -> bool:
    """Return whether a file should be damaged as text."""
    if Path(name).suffix in _TEXTS or Path(name).name == "COMPLETE":
        return True
    return data[:4] in (b"ply\n", b"soli") and b"format binary" not in data[:60]


def format_mutator(name: str) -> Mutator | None:
    """Return the mutator for a file format, if there is one."""
    return _BY_FORMAT.get(Path(name).suffix)


def single(path: Path) -> Seed:
    """Return a seed of one file."""
    return Seed(path.name, {path.name: path.read_bytes()}, (path.name,), path.name)


def folder(path: Path, *targets: str, entry: str = "") -> Seed:
    """Return a seed of a folder."""
    files = {
        str(file.relative_to(path)): file.read_bytes()
        for file in sorted(path.rglob("*")) if file.is_file()
    }  # fmt: skip
    named = [name for name in files if any(Path(name).match(target) for target in targets)]
    return Seed(path.name, files, tuple(named), entry)


def seeds() -> dict[str, list[Seed]]:
    """Return all seeds by the kind of reader."""
    with tempfile.TemporaryDirectory(prefix="sgp-seeds-") as name:
        root = Path(name)
        by_kind: dict[str, list[Seed]] = {}
        for kind, maker in _MAKERS.items():
            place = root / kind
            place.mkdir()
            made = maker(place)
            files = map(single, sorted(place.iterdir())) if made is None else made
            by_kind[kind] = [*files, *_real(kind)]
        return by_kind


def _real(kind: str) -> Iterator[Seed]:
    """Yield seeds of real files."""
    data = os.environ.get("SGP_DATA")
    patterns = {
        "image": ("uw/cat/cat.0.tga", "diligent/bearPNG/001.png", "reliefs/160.jpg"),
        "mask": ("uw/cat/cat.mask.tga", "diligent/bearPNG/mask.png"),
        "raw": ("raw/*.KDC",),
        "normals": ("normals/diligent/bear/normal_map.png", "reliefs/188.jpg"),
        "mesh": ("meshes/decimated-max.obj",),
        "camera": ("normals/diligent/bear/K.txt",),
        "lights": ("diligent/bearPNG/light_directions.txt",),
    }
    for pattern in patterns.get(kind, ()) if data else ():
        for path in sorted(Path(data or "").glob(pattern)):
            if path.stat().st_size <= _LARGEST:
                yield single(path)


def _pixels(dtype: type = np.uint16, channels: int = 1, side: int = 24) -> np.ndarray:
    values = np.random.default_rng(1).integers(0, 60_000, (side, side + 8, channels))
    values = (values // 256 if dtype == np.uint8 else values).astype(dtype)
    return np.ascontiguousarray(values[..., 0] if channels == 1 else values)


def _oiio(path: Path, pixels: np.ndarray, compression: str = "", **more: object) -> Path:
    kinds = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float32": oiio.FLOAT}
    array = np.atleast_3d(pixels)
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], array.shape[2], kinds[array.dtype.name])
    if compression:
        spec.attribute("compression", compression)
    for key, value in more.items():
        spec.attribute(key, value)
    file = oiio.ImageOutput.create(str(path))
    if file is None or not file.open(str(path), spec) or not file.write_image(array):
        raise RuntimeError(f"{path}: {oiio.geterror()}")
    file.close()
    return path


def _images(root: Path) -> None:
    grey, rgb = _pixels(), _pixels(channels=3)
    rgb8, rgba8 = _pixels(np.uint8, 3), _pixels(np.uint8, 4)
    floats = (rgb / 60_000).astype(np.float32)
    write_png(root / "grey.png", grey)
    write_png(root / "rgb.png", rgb)
    _oiio(root / "rgba.png", rgba8)
    write_tiff(root / "grey.tif", grey)
    for name in ("lzw", "zip", "packbits", "none"):
        _oiio(root / f"{name}.tif", rgb, name, Make="Acme", ExposureTime=0.01)
    _oiio(root / "tiled.tif", rgb, "zip", planarconfig="separate")
    for name in ("none", "rle", "zip", "zips", "piz", "pxr24", "b44", "dwaa", "dwab"):
        _oiio(root / f"{name}.exr", floats, name)
    _oiio(root / "alpha.exr", (_pixels(channels=4) / 60_000).astype(np.float32), "zip")
    for suffix in ("tga", "jpg", "bmp", "dpx", "webp", "jxl", "ppm"):
        _oiio(root / f"a.{suffix}", rgb8)
    _oiio(root / "a.jp2", _pixels(np.uint8, 3, 64))
    _oiio(root / "rle.tga", rgba8, "rle")
    _oiio(root / "grey.pgm", _pixels(np.uint8))
    _oiio(root / "a.hdr", floats)
    done, encoded = cv2.imencode(".jpg", rgb8, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    if done:
        (root / "progressive.jpg").write_bytes(encoded.tobytes())
    _with_metadata(root, Image.fromarray(rgb8))


def _with_metadata(root: Path, image: Image.Image) -> None:
    """Write images whose metadata state a transfer curve."""
    tags = Image.Exif()
    tags.get_ifd(0x8769).update({0xA001: 2, 0x829A: 1 / 60, 0x9201: 6.0, 0x8827: 200})
    for suffix in ("jpg", "png", "webp"):
        image.save(root / f"exif.{suffix}", exif=tags.tobytes())
    image.save(root / "pages.tif", save_all=True, append_images=[image.reduce(2)])
    for suffix in ("jpg", "png", "tif", "webp"):
        image.save(root / f"profile.{suffix}", icc_profile=_profile(_FUNCTION))
    chunks = PngImagePlugin.PngInfo()
    for kind, data in ((b"cICP", bytes([1, 1, 0, 1])), (b"gAMA", struct.pack(">I", 55_556))):
        chunks.add(kind, data)
    image.save(root / "chunks.png", pnginfo=chunks)


# sRGB as a function of type 3, and a table.
_FUNCTION = b"para\0\0\0\0\0\3\0\0" + struct.pack(">5i", 157286, 62119, 3417, 5072, 2651)
_TABLE = b"curv\0\0\0\0" + struct.pack(">I64H", 64, *(k * k * 16 for k in range(64)))


def _profile(curve: bytes) -> bytes:
    """Build an ICC profile of RGB whose three channels have one curve."""
    names = (b"rTRC", b"gTRC", b"bTRC")
    begin = 128 + 4 + 12 * len(names)
    table = struct.pack(">I", len(names)) + b"".join(
        struct.pack(">4sII", name, begin, len(curve)) for name in names
    )
    size = struct.pack(">I", begin + len(curve) + 100)
    head = (size + bytes(8) + b"mntrRGB XYZ " + bytes(12) + b"acsp").ljust(128, b"\0")
    return head + table + curve + bytes(range(100))


def _profiles(root: Path) -> None:
    (root / "function.icc").write_bytes(_profile(_FUNCTION))
    (root / "table.icc").write_bytes(_profile(_TABLE))
    (root / "gamma.icc").write_bytes(_profile(b"curv\0\0\0\0\0\0\0\1\2\x33"))


def _curves(root: Path) -> None:
    (root / "curve.csv").write_text("sample,light\n0,0\n64,4.2\n128,20.9\n255,100\n")
    (root / "curve.txt").write_text("# measured\n0 0\n0.5 0.2\n1 1\n")


def _texture_maps(root: Path) -> None:
    random = np.random.default_rng(1)
    shared = random.normal(size=(12, 16, 6)).astype(np.float32)
    colour = random.random((12, 16, 3)).astype(np.float32)
    write_ptm(root / "lrgb.ptm", RelightableImage("ptm", shared, colour))
    write_ptm(root / "rgb.ptm", RelightableImage("ptm", np.stack([shared] * 3, axis=-1)))
    older = (root / "lrgb.ptm").read_bytes().replace(b"1.2", b"1.1", 1)
    (root / "older.ptm").write_bytes(older)


def _x3ps(root: Path) -> None:
    height = np.random.default_rng(1).normal(size=(12, 16)).astype(np.float32)
    write_x3p(root / "a.x3p", height, 0.05, origin=X3pOrigin(creator="A", comment="owl"))
    # Of other programs: text, and integers with a validity file.
    height[3, :4] = np.nan
    metres = height / 1e3
    steps = {"x_scale": 5e-5, "y_scale": 5e-5}
    x3pio.write(root / "text.x3p", metres, **steps, storage=x3pio.DataStorage.XML)
    x3pio.write(root / "integers.x3p", metres, **steps, z_type=x3pio.DataType.INT16)


def _masks(root: Path) -> None:
    disc = np.zeros((24, 32), np.uint8)
    cv2.circle(disc, (16, 12), 9, 255, -1)
    write_png(root / "mask.png", disc)
    _oiio(root / "alpha.png", np.dstack([disc, disc, disc, disc]))
    _oiio(root / "mask.tga", disc)


def _raws(root: Path) -> None:
    (root / "a.dng").write_bytes(dng(_pixels(side=40) // 16))
    (root / "big.dng").write_bytes(dng(_pixels(side=40) // 16, order=">"))


def dng(pixels: np.ndarray, order: str = "<") -> bytes:
    """Build an uncompressed DNG file (Adobe's specification 1.4)."""
    height, width = pixels.shape
    samples = pixels.astype(order + "u2").tobytes()
    kinds = {1: "B", 2: "s", 3: "H", 4: "I", 5: "I", 10: "i"}
    matrix = [number for i in range(9) for number in (int(i % 4 == 0), 1)]

    def tags(exif_at: int, samples_at: int) -> list[tuple[int, int, list[int] | bytes]]:
        return [
            (254, 4, [0]), (256, 4, [width]), (257, 4, [height]), (258, 3, [16]), (259, 3, [1]),
            (262, 3, [32803]), (271, 2, b"Acme\0"), (272, 2, b"Acme One\0"), (273, 4, [samples_at]),
            (274, 3, [1]), (277, 3, [1]), (278, 4, [height]), (279, 4, [len(samples)]),
            (284, 3, [1]), (33421, 3, [2, 2]), (33422, 1, [0, 1, 1, 2]), (34665, 4, [exif_at]),
            (50706, 1, [1, 4, 0, 0]), (50708, 2, b"Acme One\0"), (50713, 3, [2, 2]),
            (50714, 3, [64, 64, 64, 64]), (50717, 3, [4000]), (50721, 10, matrix),
            (50829, 4, [2, 2, height - 2, width - 2]),
        ]  # fmt: skip

    def directory(entries: list[tuple[int, int, list[int] | bytes]], at: int) -> bytes:
        head, extra, after = b"", b"", at + 6 + 12 * len(entries)
        for tag, kind, values in entries:
            count = len(values) // (2 if kind in (5, 10) else 1)
            content = (
                values if isinstance(values, bytes)
                else struct.pack(f"{order}{len(values)}{kinds[kind]}", *values)
            )  # fmt: skip
            inline = content.ljust(4, b"\0")
            if len(content) > 4:
                inline, extra = struct.pack(order + "I", after + len(extra)), extra + content
                extra += b"\0" * (len(extra) % 2)
            head += struct.pack(order + "HHI", tag, kind, count) + inline
        return struct.pack(order + "H", len(entries)) + head + bytes(4) + extra

    exif: list[tuple[int, int, list[int] | bytes]] = [
        (33434, 5, [1, 200]), (34855, 3, [400]), (36867, 2, b"2026:01:02 03:04:05\0"),
    ]  # fmt: skip
    exif_at = 8 + len(directory(tags(0, 0), 8))
    samples_at = exif_at + len(directory(exif, exif_at))
    head = directory(tags(exif_at, samples_at), 8) + directory(exif, exif_at)
    mark = b"II" if order == "<" else b"MM"
    return struct.pack(order + "2sHI", mark, 42, 8) + head + samples


def _lights(count: int = 6) -> Lights:
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    vectors = np.stack([np.cos(around), np.sin(around), np.full(count, 2.0)], axis=1)
    return Lights(positions_mm=300 * vectors, ids=tuple(f"L{i:02d}" for i in range(count)))


def _light_files(root: Path) -> None:
    write_lights(root / "near.json", _lights())
    write_lights(root / "distant.json", _lights().distant(), {"source": {"by": ["hand"]}})
    write_lights(root / "a.lp", _lights())
    (root / "table.txt").write_text("6\n" + "0.1 0.2 0.9\n" * 6)


def _sensors(root: Path) -> None:
    figure = Measured(2.5, 0.01)
    sensor = MeasuredSensor(
        12,
        0.0,
        electrons_per_dn=figure,
        read_noise_e=figure,
        black_level_dn=figure,
        dsnu_e=figure,
        prnu=Measured(0.01, 0.001),
        linearity_error=Measured(0.0, 0.0),
        full_well_e=Measured(9000.0, 10.0),
        full_well_limit="pixel",
    )
    write_sensor(root / "sensor.json", sensor, {"command": "by hand"})


def _flats(root: Path) -> Iterator[Seed]:
    smooth = np.linspace(0.7, 1, 24 * 32, dtype=np.float32).reshape(24, 32)
    pixel = np.random.default_rng(0).normal(1, 0.01, (24, 32)).astype(np.float32)
    flat = Flat(smooth, pixel, "RGGB", pixel_std=0.002, gradient_std=0.001, covered=0.9)
    write_flat(root / "flat", flat, provenance={"command": "by hand"})
    yield folder(root / "flat", "*.json", "*.exr")


def _camera() -> CameraModel:
    K = np.array([[1307.2, 0, 15.5], [0, 1307.2, 11.5], [0, 0, 1]])
    return CameraModel(K, 32, 24, 600.0, np.array([-0.1, 0.01, 1e-3, 0, 0]))


def _cameras(root: Path) -> None:
    write_camera(root / "camera.json", _camera())
    write_camera(root / "camera.yml", _camera())
    storage = cv2.FileStorage(str(root / "camera.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 32)
    storage.write("image_height", 24)
    storage.write("camera_matrix", _camera().K)
    storage.write("distortion_coefficients", _camera().distortion[None])
    storage.release()
    (root / "cameras.txt").write_text("# cameras\n1 OPENCV 32 24 1000 1001 16 12 0 0 0 0\n")
    (root / "K.txt").write_text("1000 0 16\n0 1000 12\n0 0 1\n")


def _plans(root: Path) -> None:
    (root / "plan.toml").write_text(
        "leds = [0, 1, 2, 3, 4, 5]\nexposures_us = [5000.0, 20000.0]\nrepeats = 2\ndark = true\n"
        "flats = 3\nretakes = 1\nmax_clipped_fraction = 0.01\n\n[exposures_by_led]\n"
        "3 = [8000.0, 30000.0]\n"
    )


def _rigs(root: Path) -> None:
    places = ", ".join(f"[{i}.5, {2 * i}, 300]" for i in range(4))
    (root / "rig.toml").write_text(
        'name = "bench"\ndriver = "bench"\nleds = 4\nsettle_ms = 3.5\ndead_leds = [2]\n'
        f"led_positions_mm = [{places}]\n\n[mounting]\nrotation_deg = 90\n\n[options]\n"
        'port = "/dev/ttyACM0"\ncti = ["a.cti"]\nsettings = {Gain = 1.5, Width = 640}\n'
    )


def _scenes(root: Path) -> Iterator[Seed]:
    for name in ("coin", "coin-with-spheres", "charuco"):
        write_scene(root / f"{name}.toml", scene_named(name))
    (root / "tetrahedron.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    (root / "mesh.toml").write_text(
        '[object]\nkind = "mesh"\nfile = "tetrahedron.obj"\nradius_mm = 20\n'
    )
    (root / "hand.toml").write_text(
        'seed = 3\nambient = 0.01\n[object]\nkind = "cap"\nradius_mm = 20\nheight_mm = 9\n'
        '[pattern]\nkind = "checker"\n[lights]\nkind = "ring"\ncount = 6\n'
        '[lens]\nkind = "perspective"\nwidth = 48\nheight = 40\n'
        "[[spheres]]\ncentre_mm = [30, 10, 6]\nradius_mm = 6\n[sensor]\nread_noise_e = 4.0\n"
    )
    for path in sorted(root.glob("*.toml")):
        files = {file.name: file.read_bytes() for file in root.iterdir()}
        yield Seed(path.name, files, (path.name,), path.name)


def _normal_maps(root: Path) -> None:
    rows, columns = np.mgrid[:24, :32]
    x, y = (columns - 15.5) / 20, (11.5 - rows) / 20
    normals = np.dstack([x, y, np.sqrt(1 - x**2 - y**2)]).astype(np.float32)
    encoded = np.rint((normals / 2 + 0.5) * 65535).astype(np.uint16)
    write_exr(root / "n.exr", normals)
    write_png(root / "n.png", encoded)
    write_tiff(root / "n.tif", encoded)
    np.save(root / "n.npy", normals)
    np.save(root / "double.npy", np.asfortranarray(normals.astype(">f8")))
    np.save(root / "whole.npy", encoded)


def _meshes(root: Path) -> None:
    ball = trimesh.creation.icosphere(1)
    for suffix in ("obj", "stl", "glb", "off"):
        ball.export(root / f"ball.{suffix}")
    (root / "text.stl").write_text(trimesh.exchange.stl.export_stl_ascii(ball))
    ball.export(root / "binary.ply")
    ball.export(root / "text.ply", encoding="ascii")
    two = trimesh.Scene([ball, trimesh.creation.box().apply_translation([3, 0, 0])])
    two.export(root / "two.glb")
    (root / "polygons.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
        "f 1/1/1 2/1/1 3/1/1 4/1/1\nf -4 -3 -2\n"
    )
    head = "ply\nformat {} 1.0\ncomment made\nelement vertex 4\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z")
    )
    strips = head + "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    (root / "strips.ply").write_text(
        strips.format("ascii") + "0 0 0\n1 0 0\n0 1 0\n1 1 1\n6 0 1 2 3 -1 2\n"
    )
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], ">f4")
    (root / "strips_be.ply").write_bytes(
        strips.format("binary_big_endian").encode() + points.tobytes()
        + struct.pack(">7i", 6, 0, 1, 2, 3, -1, 2)
    )  # fmt: skip
    faces = head + "element face 2\nproperty list uchar int vertex_index\nproperty uchar red\n"
    (root / "polygons.ply").write_bytes(
        (faces + "end_header\n").format("binary_little_endian").encode()
        + points.astype("<f4").tobytes()
        + struct.pack("<B4iB", 4, 0, 1, 3, 2, 9) + struct.pack("<B3iB", 3, 0, 1, 2, 9)
    )  # fmt: skip
    (root / "concave.off").write_text(
        "OFF\n5 1 0\n0 0 0\n4 0 0\n4 3 0\n2 1 0\n0 3 0\n5 0 1 2 3 4\n"
    )
    (root / "copies.glb").write_bytes(_copied_and_sparse())
    (root / "commas.xyz").write_text("".join(f"{i},5 {i % 3},25 1,0\n" for i in range(9)))
    (root / "cloud.xyz").write_text("".join(f"{i} {i % 3} 1 0 0 1\n" for i in range(9)))
    (root / "cloud.ply").write_text(
        (head + "property float nx\nproperty float ny\nproperty float nz\nend_header\n").format(
            "ascii"
        )
        + "0 0 0 0 0 1\n" * 4
    )


def _copied_and_sparse() -> bytes:
    """Return a GLB with sparse, normalised positions, normals, a strip, a morph and copies."""
    points = np.array([[0, 0, 0], [99, 0, 0], [0, 99, 0], [99, 99, 9]], "<i2")
    data = points.tobytes() + struct.pack("<2H", 1, 2) + points[:2].tobytes()
    data += np.array([[0, 0, 0], [9, 0, 0]], "<f4").tobytes()
    place = {"componentType": 5122, "count": 4, "type": "VEC3", "normalized": True}
    changed = {
        "count": 2,
        "indices": {"bufferView": 1, "componentType": 5123},
        "values": {"bufferView": 2},
    }
    part = {"attributes": {"POSITION": 0, "NORMAL": 1}, "mode": 5, "targets": [{"POSITION": 1}]}
    copies = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}
    lengths = (24, 4, 12, 24)
    content = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "extensions": copies}],
        "meshes": [{"primitives": [part], "weights": [0.5]}],
        "accessors": [
            {"bufferView": 0, "sparse": changed, **place},
            {"bufferView": 0, **place},
            {"bufferView": 3, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": sum(lengths[:i]), "byteLength": length}
            for i, length in enumerate(lengths)
        ],
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _stack(root: Path, count: int = 4) -> list[str]:
    root.mkdir(exist_ok=True)
    names = [f"{i:03d}.png" for i in range(1, count + 1)]
    for name in names:
        write_png(root / name, _pixels(side=16))
    write_png(root / "mask.png", np.full((16, 24), 255, np.uint8))
    return names


def _diligents(root: Path) -> Iterator[Seed]:
    names = _stack(root / "object")
    place = root / "object"
    (place / "filenames.txt").write_text("".join(f"{name}\n" for name in names))
    (place / "light_directions.txt").write_text("0.1 0.2 0.9\n" * 4)
    (place / "light_intensities.txt").write_text("1 1.1 0.9\n" * 4)
    normals = np.tile([0.0, 0.0, 1.0], (16, 24, 1))
    scipy.io.savemat(place / "Normal_gt.mat", {"Normal_gt": normals}, do_compression=True)
    yield folder(place, "*.txt", "*.mat", "*.mat", "001.png", "mask.png")
    scipy.io.savemat(place / "Normal_gt.mat", {"Normal_gt": normals})
    yield folder(place, "*.mat")


def _stacks(root: Path) -> Iterator[Seed]:
    names = _stack(root / "images")
    lights = Lights(directions=_lights(4).unit_directions, ids=tuple(names))
    write_lights(root / "images" / "a.lp", lights)
    yield folder(root / "images", "*.lp", "*.png")
    yield Seed("by lp", folder(root / "images").files, ("a.lp",), "a.lp")


def _sessions(root: Path) -> Iterator[Seed]:
    place = root / "session"
    camera = {"width": 24, "height": 16, "bit_depth": 12}
    plan = CapturePlan(leds=(0, 1, 2), exposures_us=(5000.0,))
    manifest = Manifest.begin(
        place,
        plan=plan,
        camera=camera,
        labels=Labels(operator="benchmark", object_name="noise", notes="two\nlines"),
        calibrations=Calibrations(lights=_lights(3)),
        transfer={"kind": "table", "points": [(0, 0), (0.5, 0.2), (1, 1)]},
    )
    with SessionWriter.create(place, manifest) as writer:
        for index, shot in enumerate(writer.missing):
            image = np.random.default_rng(index).integers(0, 4096, (16, 24)).astype(np.uint16)
            writer.write_frame(shot, image)
        writer.write_event(
            "checked", checks=[{"name": "disk", "state": "ok", "text": "enough room"}]
        )
        writer.complete()
    whole = folder(place, "session.toml", "journal.jsonl", "COMPLETE", "frames/*")
    yield whole
    files = {name: data for name, data in whole.files.items() if name != "COMPLETE"}
    yield Seed("incomplete", files, ("session.toml", "journal.jsonl"))


def _exports(root: Path) -> Iterator[Seed]:
    (root / "made").mkdir()
    list(_sessions(root / "made"))
    for layout in ("lp", "diligent", "exr"):
        out = root / layout
        out.mkdir()
        prepare_export(root / "made" / "session", layout=layout).write(out)
        yield folder(out, "*.json", "*.lp", "*.txt")


# Each writes files, which are the seeds, or yields seeds of folders.
_MAKERS: dict[str, Callable[[Path], Iterator[Seed] | None]] = {
    "image": _images,
    "icc": _profiles,
    "transfer": _curves,
    "mask": _masks,
    "raw": _raws,
    "lights": _light_files,
    "camera": _cameras,
    "sensor": _sensors,
    "flat": _flats,
    "plan": _plans,
    "rig": _rigs,
    "scene": _scenes,
    "normals": _normal_maps,
    "ptm": _texture_maps,
    "x3p": _x3ps,
    "mesh": _meshes,
    "diligent": _diligents,
    "stack": _stacks,
    "session": _sessions,
    "export": _exports,
}


def drawn(seed: Seed, dice: Random) -> tuple[str, bytes]:
    """Choose a file of a seed and damage it; return its name and its damaged content."""
    name = dice.choice(seed.targets)
    data = seed.files[name]
    mutator = format_mutator(name)
    if mutator is not None and dice.random() < 0.5:
        return name, mutator(data, dice)
    return name, mutated(data, dice, is_text(name, data))
