"""Meshes and point clouds that `sgp project` draws: counts, polygons, edges, clouds, GLB."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO
from true_to_input.case import Answer, Case, Outcome, judge, sgp

from rig.arrays import AnyArray

PX = 0.25
WIDE, HIGH = 40, 30
# A message never contains this: the file is good, and to refuse it is a fault.
GOOD_FILE = ("(a good file)",)


def relief(x: AnyArray, y: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return heights and normals of the relief over 40 x 30 mm."""
    z = 3 * np.sin(x / 6 + 0.4) * np.cos(y / 7) + 0.05 * x + 0.0015 * x * y
    gx = 0.5 * np.cos(x / 6 + 0.4) * np.cos(y / 7) + 0.05 + 0.0015 * y
    gy = -3 / 7 * np.sin(x / 6 + 0.4) * np.sin(y / 7) + 0.0015 * x
    n = np.stack([-gx, -gy, np.ones_like(gx)], -1)
    return z, n / np.linalg.norm(n, axis=-1, keepdims=True)


def grid(step: float = 1.0) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Return vertices, faces and normals of a mesh of the relief."""
    y, x = np.meshgrid(np.arange(0, HIGH + step / 2, step), np.arange(0, WIDE + step / 2, step),
                       indexing="ij")  # fmt: skip
    z, normals = relief(x, y)
    places = np.arange(x.size).reshape(x.shape)
    a, b, c, d = places[:-1, :-1], places[:-1, 1:], places[1:, 1:], places[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return np.stack([x, y, z], -1).reshape(-1, 3), faces, normals.reshape(-1, 3)


def cloud(count: int = 6000, seed: int = 0) -> tuple[AnyArray, AnyArray]:
    """Return random points on the relief, and their normals."""
    x, y = (np.random.default_rng(seed).random((count, 2)) * [WIDE, HIGH]).T
    z, normals = relief(x, y)
    return np.stack([x, y, z], -1), normals


def drawn(path: Path, *options: object) -> tuple[Answer, AnyArray | None, AnyArray | None]:
    """Run `sgp project`; return its answer, the normals and the mask."""
    out = path.with_name("out")
    size = () if {"--pixel-mm", "--size"} & set(options) else ("--pixel-mm", PX)
    unit = ("--unit", "mm") if path.suffix == ".glb" else ()
    answer = sgp("project", path, "--out", out, "--force", *unit, *size, *options)
    if answer.code:
        return answer, None, None
    normals = OpenImageIO.ImageBuf(str(out / "normals.exr")).get_pixels(OpenImageIO.FLOAT)[..., :3]
    return answer, normals, cv2.imread(str(out / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0


def angles(a: AnyArray, b: AnyArray) -> AnyArray:
    crossed = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(crossed, (a * b).sum(-1)))


def error_on_relief(path: Path, *options: object) -> tuple[Answer, float | None]:
    """Return the mean angle to the relief's normals; a pixel that is not drawn counts 90 deg."""
    answer, normals, mask = drawn(path, *options)
    if normals is None or mask is None:
        return answer, None
    h, w = mask.shape
    y, x = np.mgrid[:h, :w]
    x, y = (x - (w - 1) / 2) * PX + WIDE / 2, ((h - 1) / 2 - y) * PX + HIGH / 2
    inside = (abs(x - WIDE / 2) < WIDE / 2 - 1) & (abs(y - HIGH / 2) < HIGH / 2 - 1)
    off = np.where(mask, angles(normals, relief(x, y)[1]), 90.0)[inside]
    # The image of half of the object, or of far more, is wrong however good its middle is.
    if abs(w - WIDE / PX) > 16 or abs(h - HIGH / PX) > 16:
        return answer, 90.0
    return answer, float(off.mean())


def obj(vertices: AnyArray, lines: Sequence[str], normals: AnyArray | None = None) -> str:
    rows = [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in vertices]
    rows += [] if normals is None else [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals]
    return "\n".join([*rows, *lines]) + "\n"


def corners(faces: AnyArray, form: str = "{0}", begin: int = 1) -> list[str]:
    return ["f " + " ".join(form.format(v + begin) for v in face) for face in faces]


def ply(
    count: int, body: str | bytes, names: str = "x y z", more: str = "", kind: str = ""
) -> bytes:
    words = [
        f"property {'double' if 'double' in kind else 'float'} {name}" for name in names.split()
    ]
    form = "ascii" if isinstance(body, str) else "binary_little_endian"
    head = f"ply\nformat {form} 1.0\nelement vertex {count}\n" + "\n".join(words) + "\n" + more
    return f"{head}end_header\n".encode() + (body.encode() if isinstance(body, str) else body)


FACES = "element face {}\nproperty list uchar int vertex_indices\n"


def rows(table: AnyArray, form: str = "%.6f", between: str = " ") -> str:
    return "".join(between.join(form % v for v in row) + "\n" for row in table)


def stl(
    vertices: AnyArray, faces: AnyArray, stated: int | None = None, head: bytes = b"cad"
) -> bytes:
    facets = np.zeros(len(faces), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facets["v"] = vertices[faces]
    count = len(faces) if stated is None else stated
    return head.ljust(80) + struct.pack("<I", count) + facets.tobytes()


def stl_text(vertices: AnyArray, faces: AnyArray, name: str) -> str:
    lines = [f"solid {name}"]
    for face in vertices[faces]:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in face),
                  "endloop", "endfacet"]  # fmt: skip
    return "\n".join([*lines, f"endsolid {name}"]) + "\n"


def halves(faces: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the faces of the lower and the upper half of the relief."""
    upper = (faces // (WIDE + 1)).min(axis=1) >= HIGH // 2
    return faces[~upper], faces[upper]


class Glb:
    """A GLB file, built from arrays."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, values: AnyArray, stride: int = 0) -> int:
        raw = np.ascontiguousarray(values).tobytes()
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw)})
        if stride:
            self.views[-1]["byteStride"] = stride
        self.data += raw + b"\0" * (-len(raw) % 4)
        return len(self.views) - 1

    def add(self, values: AnyArray, form: str, **more: Any) -> int:
        kind = {"f4": 5126, "i2": 5122, "u4": 5125, "u1": 5121}[values.dtype.str[1:]]
        self.accessors.append({
            "bufferView": self.view(values), "componentType": kind, "count": len(values),
            "type": form, **more,
        })  # fmt: skip
        return len(self.accessors) - 1

    def relief(self, step: float = 1.0) -> dict[str, Any]:
        vertices, faces, _ = grid(step)
        place = self.add(vertices.astype("<f4"), "VEC3")
        return {"attributes": {"POSITION": place},
                "indices": self.add(faces.astype("<u4").ravel(), "SCALAR")}  # fmt: skip

    def write(self, path: Path, content: dict[str, Any]) -> Path:
        whole = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}], "accessors": self.accessors, "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.data)}], **content,
        }  # fmt: skip
        text = json.dumps(whole).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(self.data), 0x004E4942) + self.data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def _write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def _judged(
    name: str, content: Callable[[], str | bytes], *options: object, **known: Any
) -> Callable[[Path], Outcome]:
    """Return a case's run: a file with the relief, judged by the error of the normals."""
    return lambda folder: judge(
        *error_on_relief(_write(folder, name, content()), *options), **known
    )


# -- OBJ ------------------------------------------------------------------------------------------


def _two_blocks() -> str:
    vertices, _, _ = grid()
    width = WIDE + 1
    texts = []
    for first, last in ((0, HIGH // 2), (HIGH // 2, HIGH)):
        block = vertices[first * width : (last + 1) * width]
        _, faces, _ = grid()
        faces = faces[(faces // width < last - first + 1).all(axis=1)]
        texts.append(obj(block, corners(faces, begin=-len(block))))
    return "".join(texts)


def _negative_mixed() -> str:
    """A first block with positive, a second with negative indices and texture coordinates."""
    vertices, faces, _ = grid()
    low, high = halves(faces)
    text = obj(vertices, ["vt 0 0", *corners(low, "{0}/1")])
    return text + obj(vertices, ["vt 0 0", *corners(high, "{0}/-1", -len(vertices))])


def _vn(turn_deg: float = 0.0, step: float = 5.0) -> str:
    vertices, faces, normals = grid(step)
    t = np.deg2rad(turn_deg)
    normals = normals @ np.array([[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]])
    return obj(vertices, corners(faces, "{0}//{0}"), normals)


def _double_sided(step: float = 1.0) -> str:
    vertices, faces, _ = grid(step)
    return obj(vertices, corners(np.concatenate([faces, faces[:, ::-1]])))


# -- hard edges -----------------------------------------------------------------------------------


def box(chamfer: float = 0.0) -> tuple[AnyArray, AnyArray]:
    """Return a box of 20 x 20 x 20 mm, the edges along Z cut at 45 degrees."""
    h, c = 10.0, 10.0 - chamfer
    ring = [(h, -h), (h, h), (-h, h), (-h, -h)]
    if chamfer:
        ring = [(h, -c), (h, c), (c, h), (-c, h), (-h, c), (-h, -c), (-c, -h), (c, -h)]
    return _prism(np.array(ring))


def _prism(ring: AnyArray, half: float = 10.0) -> tuple[AnyArray, AnyArray]:
    n = len(ring)
    vertices = np.concatenate([np.insert(ring, 2, side * half, axis=1) for side in (-1.0, 1.0)])
    sides = [(i, (i + 1) % n, n + (i + 1) % n) for i in range(n)]
    sides += [(i, n + (i + 1) % n, n + i) for i in range(n)]
    caps = [(n, n + i, n + i + 1) for i in range(1, n - 1)]
    caps += [(0, i + 1, i) for i in range(1, n - 1)]
    return vertices, np.array(sides + caps)


def cylinder(count: int) -> tuple[AnyArray, AnyArray]:
    angle = np.arange(count) / count * 2 * np.pi
    return _prism(10 * np.stack([np.cos(angle), np.sin(angle)], -1))


def _against_faces(path: Path, codes: Sequence[str] = ("creases-kept",)) -> Outcome:
    """Compare the default shading with that of flat faces, on a part whose faces are flat."""
    turned = ("--rotate-deg", "25,35,0", "--pixel-mm", 0.2)
    _, flat, _ = drawn(path, *turned, "--shading", "flat")
    answer, smooth, mask = drawn(path, *turned)
    if smooth is None or flat is None or mask is None:
        return judge(answer)
    return judge(answer, float(angles(smooth, flat)[mask].mean()), codes=codes)


def _cylinder(folder: Path) -> Outcome:
    """A cylinder of 48 segments: its mantle is smooth, its rim is sharp."""
    vertices, faces = cylinder(48)
    path = _write(folder, "cylinder.stl", stl(vertices, faces))
    turn = np.deg2rad(30)
    answer, normals, mask = drawn(path, "--rotate-deg", "30,0,0", "--pixel-mm", 0.2)
    if normals is None or mask is None:
        return judge(answer)
    # In the axes of the file the normal is the cap's, or radial.
    c, s = np.cos(turn), np.sin(turn)
    back = normals @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    cap = angles(back, np.array([0, 0, 1.0]))
    mantle = np.degrees(np.arcsin(np.clip(abs(back[..., 2]), 0, 1)))
    return judge(answer, float(np.minimum(cap, mantle)[mask].mean()), codes=("creases-kept",))


# -- polygons -------------------------------------------------------------------------------------

CONCAVE = np.array([[0, 0, 0], [40, 0, 0], [40, 30, 0], [20, 5, 0], [0, 30, 0]], float)


def _area(path: Path, right: float) -> Outcome:
    answer, _, mask = drawn(path)
    error = None if mask is None else abs(float(mask.sum()) * PX * PX - right)
    return judge(answer, error, limit=5, unit="mm2")


def _comb(folder: Path) -> Outcome:
    """One polygon with five teeth and a slot, clockwise, in an OFF file."""
    teeth = [(x + d, y) for x in range(0, 40, 8) for d, y in ((0, 30), (4, 30), (4, 5), (8, 5))]
    ring = np.array([(0, 0), *teeth, (40, 0)], float)
    text = f"OFF\n{len(ring)} 1 0\n" + rows(np.insert(ring, 2, 0, axis=1))
    text += f"{len(ring)} {' '.join(map(str, range(len(ring))))}\n"
    return _area(_write(folder, "comb.off", text), 40 * 5 + 5 * 4 * 25)


# -- clouds ---------------------------------------------------------------------------------------


def scan_lines(step: float = 0.1, gap: float = 1.0, turn_deg: float = 0.0) -> AnyArray:
    """Return the points of a line scanner, with a jitter of 2 % of the step."""
    x, y = np.meshgrid(np.arange(-60, 60, step), np.arange(-60, 60, gap))
    t = np.deg2rad(turn_deg)
    jitter = np.random.default_rng(0).normal(0, 0.02 * step, (2, x.size))
    a, b = np.stack([x.ravel(), y.ravel()]) + jitter
    x, y = np.cos(t) * a - np.sin(t) * b, np.sin(t) * a + np.cos(t) * b
    kept = (x >= 0) & (x <= WIDE) & (y >= 0) & (y <= HIGH)
    x, y = x[kept], y[kept]
    return np.stack([x, y, relief(x, y)[0]], -1)


def _outliers(scale: float, zeros: bool = False) -> str:
    points, _ = cloud()
    dice = np.random.default_rng(1)
    far = (dice.random((60, 3)) - 0.5) * scale * 40 + [20, 15, 0]
    if zeros:
        far = np.full((60, 3), -400.0)
    return rows(np.concatenate([points, far]))


def _clutter() -> str:
    """One point in a hundred is anywhere in the room above the relief."""
    points, _ = cloud()
    points[:60] = np.random.default_rng(1).random((60, 3)) * [WIDE, HIGH, 200]
    return rows(points)


def _rounded_normals(folder: Path) -> Outcome:
    """Normals of two decimals, some of them longer than 1."""
    path = _write(folder, "a.xyz", rows(np.concatenate(cloud(), axis=1), "%.2f"))
    command = [sys.executable, "-m", "sgp", "project", str(path), "--out", str(folder / "out")]
    try:
        subprocess.run([*command, "--pixel-mm", str(PX)], timeout=30, check=False,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip
    except subprocess.TimeoutExpired:
        return Outcome("wrong", "no end after 30 s")
    return judge(*error_on_relief(path), limit=0.5)


def _comma(between: str, decimals: str = ",") -> str:
    return rows(cloud()[0], "%.5f", between).replace(".", decimals)


def _with_colours(colour: Sequence[float]) -> str:
    points, _ = cloud()
    return rows(np.concatenate([points, np.tile(np.asarray(colour, float), (len(points), 1))], 1))


def _nine_columns() -> str:
    points, normals = cloud(1500)
    tint = np.random.default_rng(2).integers(0, 256, (len(points), 3))
    return rows(np.concatenate([points, tint, normals], 1))


def _in_map_coordinates(kind: str) -> bytes:
    points = cloud()[0] + [4_500_000.0, 5_300_000.0, 400.0]
    if kind == "xyz":
        return rows(points, "%.4f").encode()
    return ply(len(points), points.astype(kind).tobytes(), kind="double" if "8" in kind else "")


# -- GLB ------------------------------------------------------------------------------------------


def _quantized(folder: Path, kind: str = "<i2") -> Outcome:
    vertices, faces, _ = grid()
    middle = np.array([20.0, 15.0, 3.0])
    most = 32767 if kind == "<i2" else 255
    unit = (vertices - middle) / 20
    values = np.round(unit * most) if kind == "<i2" else np.round((unit / 2 + 0.5) * most)
    build = Glb()
    scale = [20.0] * 3 if kind == "<i2" else [40.0] * 3
    moved = middle if kind == "<i2" else middle - 20
    padded = np.pad(values, ((0, 0), (0, 1))).astype(kind)
    build.accessors.append({
        "bufferView": build.view(padded, padded.itemsize * 4), "count": len(vertices),
        "componentType": 5122 if kind == "<i2" else 5121, "type": "VEC3", "normalized": True,
    })  # fmt: skip
    part = {
        "attributes": {"POSITION": 0},
        "indices": build.add(faces.astype("<u4").ravel(), "SCALAR"),
    }
    path = build.write(folder / "quantized.glb", {
        "nodes": [{"mesh": 0, "scale": scale, "translation": moved.tolist()}],
        "meshes": [{"primitives": [part]}],
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
    })  # fmt: skip
    # A wrong scale would need an image of 10^11 pixels: the height range shows the scale.
    answer = sgp("project", path, "--out", folder / "out", "--unit", "mm", "--size", "160x120")
    if answer.code:
        return judge(answer)
    error = abs(answer.values["metrics"]["height_range_mm"] - np.ptp(vertices[:, 2]))
    return judge(answer, error, limit=0.1, unit="mm")


def _instancing(folder: Path) -> Outcome:
    build = Glb()
    part = build.relief()
    moves = build.add(np.array([[0, 0, 0], [50, 0, 0]], "<f4"), "VEC3")
    name = "EXT_mesh_gpu_instancing"
    path = build.write(folder / "instancing.glb", {
        "nodes": [{"mesh": 0, "extensions": {name: {"attributes": {"TRANSLATION": moves}}}}],
        "meshes": [{"primitives": [part]}], "extensionsUsed": [name], "extensionsRequired": [name],
    })  # fmt: skip
    answer, _, mask = drawn(path)
    error = None if mask is None else abs(mask.sum() * PX * PX - 2 * WIDE * HIGH)
    return judge(answer, error, limit=30, unit="mm2", names=[name])


def _glb(
    change: Callable[[Glb, dict[str, Any]], dict[str, Any]], must_refuse: bool = False, **known: Any
) -> Callable[[Path], Outcome]:
    """Return the run of a GLB of the relief with a change to its content."""

    def run(folder: Path) -> Outcome:
        build = Glb()
        part = build.relief()
        content = {"meshes": [{"primitives": [part]}], **change(build, part)}
        answer, error = error_on_relief(build.write(folder / "a.glb", content))
        # Data that only an extension could decode are not the relief.
        return judge(answer, 90.0 if must_refuse and not answer.code else error, **known)

    return run


def _morphed(build: Glb, part: dict[str, Any]) -> dict[str, Any]:
    """The target moves all heights to those of the relief; the base is flat."""
    vertices, _, _ = grid()
    flat = np.where([True, True, False], vertices, 0).astype("<f4")
    part["attributes"]["POSITION"] = build.add(flat, "VEC3")
    part["targets"] = [{"POSITION": build.add((vertices - flat).astype("<f4"), "VEC3")}]
    return {"meshes": [{"primitives": [part], "weights": [1.0]}]}


def _sparse(build: Glb, part: dict[str, Any]) -> dict[str, Any]:
    """The first 600 vertices are flat, and right in the sparse values."""
    vertices, _, _ = grid()
    vertices = vertices.astype("<f4")
    base = vertices.copy()
    base[:600, 2] = 0
    which, values = build.view(np.arange(600, dtype="<u4")), build.view(vertices[:600])
    changed = {
        "count": 600,
        "indices": {"bufferView": which, "componentType": 5125},
        "values": {"bufferView": values},
    }
    part["attributes"]["POSITION"] = build.add(base, "VEC3", sparse=changed)
    return {}


def _draco(build: Glb, part: dict[str, Any]) -> dict[str, Any]:
    name = "KHR_draco_mesh_compression"
    part["extensions"] = {name: {"bufferView": 0, "attributes": {"POSITION": 0}}}
    return {"extensionsUsed": [name], "extensionsRequired": [name]}


def _meshopt(build: Glb, part: dict[str, Any]) -> dict[str, Any]:
    name = "EXT_meshopt_compression"
    build.views[0]["extensions"] = {name: {"buffer": 0, "byteLength": 9, "byteStride": 12,
                                           "mode": "ATTRIBUTES", "count": 9}}  # fmt: skip
    return {"extensionsUsed": [name], "extensionsRequired": [name]}


def _unknown(build: Glb, part: dict[str, Any]) -> dict[str, Any]:
    name = "VENDOR_displaced_surface"
    return {"extensionsUsed": [name], "extensionsRequired": [name]}


def _skinned(build: Glb, part: dict[str, Any]) -> dict[str, Any]:
    joints = np.zeros((len(grid()[0]), 4), "<u1")
    weights = np.tile(np.array([1, 0, 0, 0], "<f4"), (len(joints), 1))
    part["attributes"] |= {
        "JOINTS_0": build.add(joints, "VEC4"),
        "WEIGHTS_0": build.add(weights, "VEC4"),
    }
    # The joint turns the relief by 90 degrees.
    return {"nodes": [{"mesh": 0, "skin": 0}, {"rotation": [0.7071068, 0, 0, 0.7071068]}],
            "scenes": [{"nodes": [0, 1]}], "skins": [{"joints": [1]}]}  # fmt: skip


def _fan(folder: Path) -> Outcome:
    build = Glb()
    ring = np.array([[0, 0, 0], [40, 0, 0], [40, 30, 0], [0, 30, 0]], "<f4")
    part = {"attributes": {"POSITION": build.add(ring, "VEC3")}, "mode": 6}
    path = build.write(folder / "fan.glb", {"meshes": [{"primitives": [part]}]})
    return _area(path, 1200)


def _million(folder: Path) -> Outcome:
    """A million primitives of one triangle each."""
    build = Glb()
    place = build.add(np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]], "<f4"), "VEC3")
    part = {"attributes": {"POSITION": place}}
    path = build.write(folder / "million.glb", {"meshes": [{"primitives": [part] * 1_000_000}]})
    begin = time.monotonic()
    answer = sgp("project", path, "--out", folder / "out", "--unit", "mm", "--pixel-mm", PX)
    took = time.monotonic() - begin
    if took > 20:
        return Outcome("wrong", f"{took:.0f} s, exit code {answer.code}")
    return judge(answer, names=["primitives"])


def _copies(folder: Path) -> Outcome:
    """A small file in which 300 nodes each repeat a mesh 1,000 times."""
    build = Glb()
    part = build.relief(0.5)
    name = "EXT_mesh_gpu_instancing"
    moves = build.add(np.zeros((1000, 3), "<f4"), "VEC3")
    node = {"mesh": 0, "extensions": {name: {"attributes": {"TRANSLATION": moves}}}}
    path = build.write(folder / "copies.glb", {
        "nodes": [node] * 300, "scenes": [{"nodes": list(range(300))}],
        "meshes": [{"primitives": [part]}], "extensionsUsed": [name],
    })  # fmt: skip
    begin = time.monotonic()
    answer = sgp("project", path, "--out", folder / "out", "--unit", "mm", "--pixel-mm", PX)
    took = time.monotonic() - begin
    if took > 20:
        return Outcome("wrong", f"{took:.0f} s, exit code {answer.code}")
    return judge(answer, 1e9, names=["copies"])


# -- the cases ------------------------------------------------------------------------------------


def _stl_halves(**how: Any) -> bytes:
    vertices, faces, _ = grid()
    low, high = halves(faces)
    first = stl(vertices, low, **how)
    return first + (stl(vertices, high) if not how else stl(vertices, high)[84:])


def _stl_text_halves() -> str:
    vertices, faces, _ = grid()
    low, high = halves(faces)
    return stl_text(vertices, low, "vertex plate") + stl_text(vertices, high, "part 2")


def _half_stated() -> bytes:
    low, _ = halves(grid()[1])
    return _stl_halves(stated=len(low))


def _ply_extra_rows() -> bytes:
    """A binary cloud with twice as many points as its header states."""
    points, _ = cloud()
    points = points[np.argsort(points[:, 0])]
    return ply(len(points) // 2, points.astype("<f4").tobytes())


def _ply_face_colours() -> bytes:
    """Faces with colours that the header does not state."""
    vertices, faces, _ = grid()
    body = rows(vertices) + rows(np.insert(faces, 0, 3, axis=1), "%d").replace("\n", " 9 9 9\n")
    return ply(len(vertices), body, more=FACES.format(len(faces)))


def _off_extra() -> str:
    vertices, faces, _ = grid()
    low, _ = halves(faces)
    table = rows(vertices) + rows(np.insert(faces, 0, 3, axis=1), "%d")
    return f"OFF\n{len(vertices)} {len(low)} 0\n{table}"


def _ply_normals() -> bytes:
    vertices, faces, normals = grid(5.0)
    table = rows(np.concatenate([vertices, normals], 1))
    body = table + rows(np.insert(faces, 0, 3, axis=1), "%d")
    return ply(len(vertices), body, "x y z nx ny nz", FACES.format(len(faces)))


def _concave_ply() -> bytes:
    return ply(5, rows(CONCAVE) + "5 0 1 2 3 4\n", more=FACES.format(1))


def _clean_obj() -> str:
    vertices, faces, _ = grid()
    return obj(vertices, corners(faces))


def _zero() -> str:
    vertices, faces, _ = grid()
    return obj(vertices, corners(faces, begin=0))


CASES = (
    Case("obj_negative_two", 2, "drawn whole", _judged("a.obj", _two_blocks, names=GOOD_FILE)),
    Case("obj_index_zero", 2, "refused with the line", _judged("a.obj", _zero, names=["line"])),
    Case("obj_vn", 2, "given normals used", _judged("a.obj", _vn, limit=2)),
    Case(
        "ply_concave", 2, "700 mm2",
        lambda folder: _area(_write(folder, "a.ply", _concave_ply()), 700),
    ),
    Case("obj_double_sided", 2, "0.22 deg, stated",
         _judged("a.obj", _double_sided, codes=["faces-doubled"])),
    Case("stl_cube", 2, "edges kept, angle stated",
         lambda folder: _against_faces(_write(folder, "cube.stl", stl(*box())))),
    Case("stl_more_than_stated", 2, "refused with both counts",
         _judged("a.stl", _half_stated, names=["triangles"])),
    Case("stl_two_solids", 2, "both drawn",
         _judged("a.stl", _stl_halves, codes=["solids-joined"], names=["solid"])),
    Case("ply_cloud_extra_numbers", 2, "refused with the row", _judged(
        "a.ply", lambda: ply(1271, rows(np.pad(grid()[0], ((0, 0), (0, 3)), constant_values=9))),
        names=["numbers", "header"])),
    Case("glb_quantized_i2", 2, "height range right", _quantized),
    Case("glb_instancing", 2, "both copies, or refused", _instancing),
    Case("glb_morph_weights", 2, "applied, or refused by name",
         _glb(_morphed, names=["morph"])),
    Case("xyz_decimal_comma", 2, "read as decimals",
         _judged("a.xyz", lambda: _comma(" "), codes=["decimal-commas"], names=["comma"])),
    Case("xyz_colours_as_normals", 2, "not used as normals",
         _judged("a.xyz", lambda: _with_colours((1, 0, 0)), codes=["point-normals-doubtful"])),
    Case("ply_float32_map", 2, "named: too coarse", _judged(
        "a.ply", lambda: _in_map_coordinates("<f4"), enough=["coordinates-coarse"])),
    Case("xyz_scan_lines", 2, "drawn, or coverage named", _judged(
        "a.xyz", lambda: rows(scan_lines()), limit=1.0, codes=["points-in-lines"])),
    Case("xyz_outliers", 2, "named", _judged(
        "a.xyz", lambda: _outliers(20), limit=1.0, codes=["points-isolated"],
        enough=["points-isolated"])),
    Case("glb_million_primitives", 3, "refused within 20 s", _million),
    # Further members.
    Case("obj_negative_mixed", 2, "drawn whole",
         _judged("a.obj", _negative_mixed, names=GOOD_FILE), False),
    Case("obj_vn_stale", 2, "not used, stated", _judged(
        "a.obj", lambda: _vn(25, 1.0), codes=["vertex-normals-doubtful"]), False),
    Case("ply_vertex_normals", 2, "given normals used",
         _judged("a.ply", _ply_normals, limit=2), False),
    Case("obj_concave", 2, "700 mm2", lambda folder: _area(
        _write(folder, "a.obj", obj(CONCAVE[[2, 3, 4, 0, 1]], ["f 5 4 3 2 1"])), 700), False),
    Case("off_comb", 2, "700 mm2", _comb, False),
    Case("stl_double_sided", 2, "0.22 deg, stated", _judged("a.stl", lambda: stl(
        grid()[0], np.concatenate([grid()[1], grid()[1][:, [1, 0, 2]]])),
        codes=["faces-doubled"]), False),
    Case("off_chamfered_box", 2, "edges kept, angle stated", lambda folder: _against_faces(
        _write(folder, "a.obj", obj(box(4)[0], corners(box(4)[1])))), False),
    Case("stl_cylinder", 2, "mantle smooth, rim sharp", _cylinder, False),
    Case("stl_text_two_solids", 2, "both drawn",
         _judged("a.stl", _stl_text_halves, names=GOOD_FILE), False),
    Case("ply_binary_more_rows", 2, "refused",
         _judged("a.ply", _ply_extra_rows, names=["header"]), False),
    Case("ply_face_colours", 2, "refused with the row",
         _judged("a.ply", _ply_face_colours, names=["numbers", "header"]), False),
    Case("off_more_faces", 2, "refused", _judged("a.off", _off_extra, names=["header"]), False),
    Case("glb_quantized_u1", 2, "height range right",
         lambda folder: _quantized(folder, "<u1"), False),
    Case("glb_sparse", 2, "applied, or refused by name", _glb(_sparse, names=["sparse"]), False),
    Case("glb_draco", 2, "refused by name",
         _glb(_draco, True, names=["KHR_draco_mesh_compression"]), False),
    Case("glb_meshopt", 2, "refused by name",
         _glb(_meshopt, True, names=["EXT_meshopt_compression"]), False),
    Case("glb_unknown_required", 2, "refused by name",
         _glb(_unknown, True, names=["VENDOR_displaced_surface"]), False),
    Case("glb_skin", 2, "refused by name", _glb(_skinned, True, names=["skin"]), False),
    Case("glb_fan", 2, "1200 mm2, or refused", _fan, False),
    Case("glb_copies", 3, "refused within 20 s", _copies, False),
    Case("xyz_semicolons", 2, "read as decimals", _judged(
        "a.xyz", lambda: _comma(";"), codes=["decimal-commas"], names=["comma"]), False),
    Case("xyz_commas_only", 2, "refused: ambiguous",
         _judged("a.xyz", lambda: _comma(","), names=["comma"]), False),
    Case("xyz_colours_then_normals", 2, "normals found, or columns named", _judged(
        "a.xyz", _nine_columns, limit=0.5, codes=["columns-left-out"]), False),
    Case("xyz_white_points", 2, "not used as normals", _judged(
        "a.xyz", lambda: _with_colours((0, 0, 1)), codes=["point-normals-doubtful"]), False),
    Case("xyz_scan_lines_turned", 2, "drawn, or coverage named", _judged(
        "a.xyz", lambda: rows(scan_lines(0.05, 0.8, 33)), limit=1.0,
        codes=["points-in-lines"]), False),
    Case("xyz_missed_points", 2, "named", _judged(
        "a.xyz", lambda: _outliers(1, zeros=True), limit=1.0, codes=["points-isolated"]), False),
    Case("xyz_clutter", 2, "named", _judged(
        "a.xyz", _clutter, limit=1.0, codes=["points-isolated"]), False),
    Case("xyz_rounded_normals", 2, "used", _rounded_normals, False),
    Case("xyz_comment_of_slashes", 2, "right, no notice", _judged(
        "a.xyz", lambda: "\ufeff//X Y Z\n" + rows(cloud()[0])), False),
    Case("xyz_map_coordinates", 2, "right", _judged(
        "a.xyz", lambda: _in_map_coordinates("xyz"), names=GOOD_FILE), False),
    Case("clean_obj", 2, "right, no notice", _judged("a.obj", _clean_obj, names=GOOD_FILE), False),
    Case("clean_cloud", 2, "right, no notice", _judged(
        "a.xyz", lambda: rows(cloud()[0]), names=GOOD_FILE), False),
)  # fmt: skip
