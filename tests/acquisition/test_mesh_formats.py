"""PLY in all its forms, STL and GLB: a tetrahedron is read from each, damaged files are refused."""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from acquisition import DataError, MissingPathError
from acquisition.mesh_files import MeshFile, read_mesh_file
from acquisition.mesh_files import glb as glb_files
from acquisition.mesh_files.ply import read_ply
from rig import UnreadableError
from tests.cases import cases

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
XYZ = "property float x\nproperty float y\nproperty float z\n"
ORDERS = {"<": "binary_little_endian", ">": "binary_big_endian"}


def ply(elements: str, body: bytes | str, form: str = "ascii") -> bytes:
    head = f"ply\nformat {form} 1.0\ncomment by hand\n{elements}end_header\n"
    return head.encode() + (body.encode() if isinstance(body, str) else body)


def text(rows: npt.ArrayLike) -> str:
    return "".join(" ".join(f"{value:g}" for value in row) + "\n" for row in np.atleast_2d(rows))


def glb(change: dict[str, object], binary: bytes = b"") -> bytes:
    indices = FACES.astype("<u2").tobytes()
    points = POINTS.astype("<f4").tobytes()
    content: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(indices)},
        ],
        "buffers": [{"byteLength": len(points + indices)}],
        **change,
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    data = points + indices
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


Content = str | bytes | dict[str, object]


def mesh_of(folder: Path, name: str, content: Content) -> MeshFile:
    """Read a file with this text, these bytes, or a GLB with this change."""
    data = glb(content) if isinstance(content, dict) else content
    (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    return read_mesh_file(folder / name)


def refused(folder: Path, name: str, content: Content, said: str) -> None:
    with pytest.raises(DataError, match=said) as caught:
        mesh_of(folder, name, content)
    assert str(caught.value).startswith(f"{folder / name}: ")
    assert "\n" not in str(caught.value)


def triangles(mesh: MeshFile) -> set[tuple[int, ...]]:
    """Return the faces independent of their first corner but not of their winding."""
    assert mesh.faces is not None
    return {tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in mesh.faces}


@pytest.mark.parametrize("name", ["vertex_indices", "vertex_index", "corners"])
@pytest.mark.parametrize("kind", ["char", "uchar", "short", "ushort", "int", "uint", "int32"])
def test_faces_of_any_type_and_name(name: str, kind: str) -> None:
    elements = f"element vertex 4\n{XYZ}element face 4\nproperty list uchar {kind} {name}\n"
    rows = text(POINTS) + text(np.insert(FACES, 0, 3, axis=1))
    assert triangles(read_ply(ply(elements, rows))) == triangles(MeshFile(POINTS, FACES))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("count", "code"), [("uchar", "B"), ("int", "i"), ("ushort", "H")])
def test_both_byte_orders_with_other_elements_between(order: str, count: str, code: str) -> None:
    """Other elements, other lists and colours of faces are skipped."""
    elements = (
        f"element camera 1\nproperty list uchar double pose\n"
        f"element vertex 4\n{XYZ}property uchar red\n"
        f"element edge 2\nproperty int a\nproperty list {count} short b\n"
        f"element face 4\nproperty uchar flag\nproperty list {count} int vertex_indices\n"
        "property list uchar float texcoord\n"
    )
    body = struct.pack(f"{order}B2d", 2, 1.5, 2.5)
    for point in POINTS:
        body += struct.pack(f"{order}3fB", *point, 200)
    body += struct.pack(f"{order}i{code}2h", 7, 2, 8, 9) + struct.pack(f"{order}i{code}h", 7, 1, 8)
    for number, face in enumerate(FACES):
        body += struct.pack(f"{order}B{code}3iB", 1, 3, *face, number)
        body += struct.pack(f"{order}{number}f", *range(number))
    mesh = read_ply(ply(elements, body, ORDERS[order]))
    np.testing.assert_array_equal(mesh.vertices, POINTS)
    np.testing.assert_array_equal(mesh.faces, FACES)


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize(
    ("sides", "cut"),
    [
        ([4, 3], [[0, 1, 2], [0, 2, 3], [4, 5, 6]]),
        ([3, 5], [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7]]),
        ([4, 4], [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]),
        ([2, 3, 1], [[2, 3, 4]]),
    ],
)
def test_convex_polygons_become_fans(order: str, sides: list[int], cut: list[list[int]]) -> None:
    elements = f"element vertex 8\n{XYZ}element face {len(sides)}\n"
    elements += "property list uchar int vertex_index\n"
    corners = np.split(np.arange(sum(sides)), np.cumsum(sides)[:-1])
    turn = np.arange(8) * np.pi / 4
    points = np.stack([np.cos(turn), np.sin(turn), np.cos(turn)], axis=1)
    if order:
        body = points.astype(order + "f4").tobytes()
        for face in corners:
            body += struct.pack(f"{order}B{len(face)}i", len(face), *face)
        mesh = read_ply(ply(elements, body, ORDERS[order]))
    else:
        lines = text(points) + "".join(text([len(face), *face]) for face in corners)
        mesh = read_ply(ply(elements, lines))
    np.testing.assert_array_equal(mesh.faces, cut)
    lost = sum(side < 3 for side in sides)
    assert len(mesh.warnings) == bool(lost)
    assert not lost or str(mesh.warnings[0]).startswith(
        f"{lost} faces with fewer than three corners"
    )


STRIPS = f"element vertex 6\n{XYZ}element tristrips 1\nproperty list int {{}} vertex_indices\n"


@pytest.mark.parametrize(
    ("run", "faces"),
    [
        pytest.param([0, 1, 2], [[0, 1, 2]], id="one"),
        pytest.param([0, 1, 2, 3, 4], [[0, 1, 2], [2, 1, 3], [2, 3, 4]], id="alternating"),
        pytest.param([0, 1, 2, 3, -1, 1, 3, 4, 5], [[0, 1, 2], [2, 1, 3], [1, 3, 4], [4, 3, 5]],
                     id="winding restarts"),
        pytest.param([0, 1, 2, -1, -1, 2, 3, 4, -1], [[0, 1, 2], [2, 3, 4]], id="empty strips"),
        pytest.param([0, 1, 2, 2, 3, 4], [[0, 1, 2], [2, 4, 3]], id="stitched"),
        pytest.param([0, 1], [], id="too short"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("order", ["", "<", ">"])
def test_triangle_strips(order: str, run: list[int], faces: list[list[int]]) -> None:
    elements = STRIPS.format("int")
    points = np.random.default_rng(0).random((6, 3))
    if order:
        body = points.astype(order + "f4").tobytes()
        body += struct.pack(f"{order}{len(run) + 1}i", len(run), *run)
        mesh = read_ply(ply(elements, body, ORDERS[order]))
    else:
        mesh = read_ply(ply(elements, text(points) + text([len(run), *run])))
    assert mesh.faces is not None
    assert triangles(mesh) == triangles(MeshFile(points, np.reshape(faces, (-1, 3))))
    assert len(mesh.faces) == len(faces)


def test_all_triangles_of_a_strip_have_the_same_winding() -> None:
    """A flat ladder of triangles: every normal points the same way."""
    ladder = np.array([[i // 2, i % 2, 0] for i in range(40)], np.float64)
    elements = STRIPS.format("int").replace("vertex 6", "vertex 40")
    mesh = read_ply(ply(elements, text(ladder) + text([40, *range(40)])))
    assert mesh.faces is not None
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    assert len(mesh.faces) == 38
    assert len(np.unique(np.sign(np.cross(b - a, c - a)[:, 2]))) == 1


def test_unsigned_strips_end_at_the_unsigned_value_of_minus_one() -> None:
    run = [0, 1, 2, 0xFFFFFFFF, 3, 4, 5]
    body = np.zeros((6, 3), "<f4").tobytes() + struct.pack("<8I", 7, *run)
    mesh = read_ply(ply(STRIPS.format("uint"), body, ORDERS["<"]))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [3, 4, 5]])


def test_a_large_strip_is_quick() -> None:
    count = 268_688
    body = np.zeros((6, 3), ">f4").tobytes()
    body += np.concatenate([[count], np.arange(count) % 6]).astype(">i4").tobytes()
    mesh = read_ply(ply(STRIPS.format("int"), body, ORDERS[">"]))
    assert mesh.faces is not None
    assert len(mesh.faces) == 268_686


WHOLE = f"element vertex 4\n{XYZ}element face 4\nproperty list uchar int vertex_indices\n"
ROWS = text(POINTS) + text(np.insert(FACES, 0, 3, axis=1))


@cases(
    ("elements", "body", "said"),
    {
        "fewer vertices": (
            WHOLE.replace("vertex 4", "vertex 9"),
            ROWS,
            r"list|not an integer|truncated",
        ),
        "huge count": (WHOLE.replace("face 4", "face 999999999"), ROWS, "truncated"),
        "digits": (WHOLE.replace("face 4", "face " + "9" * 5000), ROWS, "header"),
        "negative count": (WHOLE.replace("face 4", "face -4"), ROWS, "header"),
        "no x": (WHOLE.replace("float x", "float w"), ROWS, "x, y and z"),
        "x twice": (WHOLE.replace("float y", "float x"), ROWS, "two properties"),
        "type": (WHOLE.replace("float", "half"), ROWS, "line 5 of its header"),
        "float lengths": (WHOLE.replace("uchar int", "float int"), ROWS, "header"),
        "floats": (WHOLE.replace("uchar int", "uchar float"), ROWS, "list of integers"),
        "cut": (WHOLE, ROWS[:-9], "truncated"),
        "half a vertex": (WHOLE, ROWS.replace("3 0 2 1", "3 0 2.5 1"), "not an integer"),
        "negative length": (WHOLE, ROWS.replace("3 0 2 1", "-3 0 2 1"), "damaged"),
        "NaN length": (WHOLE, ROWS.replace("3 0 2 1", "nan 0 2 1"), "damaged"),
        "words": (WHOLE, ROWS.replace("3 0 2 1", "3 0 x 1"), "not a number"),
        "fans": (WHOLE.replace("face", "trifans"), ROWS, "trifans elements"),
        "no element": ("", "", "vertex"),
        "property without element": (XYZ, "", "header"),
    },
)
def test_damaged_ply(tmp_path: Path, elements: str, body: str, said: str) -> None:
    refused(tmp_path, "a.ply", ply(elements, body), said)


@given(st.binary(max_size=80), st.sampled_from(["ascii", *ORDERS.values()]), st.data())
def test_no_body_raises_an_undeclared_error(body: bytes, form: str, data: st.DataObject) -> None:
    kinds = st.sampled_from(["uchar", "int", "short", "double"])
    counts = data.draw(st.tuples(st.integers(0, 5), st.integers(0, 3)))
    elements = (
        f"element vertex {counts[0]}\n{XYZ}element face {counts[1]}\nproperty list "
        f"{data.draw(st.sampled_from(['uchar', 'char', 'int']))} {data.draw(kinds)} vertex_index\n"
        f"property {data.draw(kinds)} more\n"
    )
    with suppress(UnreadableError):
        read_ply(ply(elements, body, form))


@pytest.mark.parametrize("sides", [(), (3, 4)])
def test_a_signalling_nan_gives_no_warning(sides: tuple[int, ...]) -> None:
    """It warns while it is converted, which would be an error of ours."""
    faces = (
        f"element face {len(sides)}\nproperty list uchar int vertex_index\nproperty float more\n"
    )
    body = np.zeros((4, 3), "<f4").tobytes()[:-4] + bytes.fromhex("0000817f")
    for side in sides:
        body += struct.pack(f"<B{side}i", side, *range(side)) + bytes.fromhex("0000817f")
    content = ply(f"element vertex 4\n{XYZ}{faces}", body, ORDERS["<"])
    with suppress(UnreadableError):
        read_ply(content)


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "off", "glb"])
def test_the_same_ball_as_trimesh_reads(tmp_path: Path, suffix: str) -> None:
    ball = trimesh.creation.icosphere(2)
    path = tmp_path / f"ball.{suffix}"
    ball.export(path)
    mesh = read_mesh_file(path)
    assert mesh.faces is not None
    read = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert len(mesh.faces) == len(ball.faces)
    assert read.volume == pytest.approx(ball.volume, rel=1e-5)


def test_stl_as_text_and_a_binary_file_that_begins_like_text(tmp_path: Path) -> None:
    solid = trimesh.Trimesh(POINTS, FACES, process=False)
    binary = trimesh.exchange.stl.export_stl(solid)
    careless = b"solid by a careless program".ljust(80) + binary[80:]
    for content in (trimesh.exchange.stl.export_stl_ascii(solid), careless):
        vertices = mesh_of(tmp_path, "a.stl", content).vertices
        np.testing.assert_array_equal(vertices, POINTS[FACES].reshape(-1, 3))


@pytest.mark.parametrize(
    "lines",
    ["solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n", "solid\nendsolid\n",
     "solid\nvertex 1 2\nvertex 1 2 3\nvertex 1 2 3\nendfacet\nendsolid"],
)  # fmt: skip
def test_damaged_stl(tmp_path: Path, lines: str) -> None:
    refused(tmp_path, "a.stl", lines, r"facets|not three numbers|not a number")


def test_glb_without_change(tmp_path: Path) -> None:
    mesh = mesh_of(tmp_path, "a.glb", {"images": [{"uri": "/dev/zero"}], "materials": [{"x": 1}]})
    assert triangles(mesh) == triangles(MeshFile(POINTS, FACES))


VIEW = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
TARGET = {"attributes": {"POSITION": 0}, "indices": 1, "targets": [{"POSITION": 0}]}
COPIES = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}
CORNERS = {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        pytest.param({"accessors": [VIEW | {"count": 10**9}, VIEW]}, "counts go", id="count"),
        pytest.param({"accessors": [VIEW | {"count": -1}, VIEW]}, "of a count", id="negative"),
        pytest.param({"accessors": [VIEW | {"bufferView": 9}, VIEW]}, "damaged", id="no view"),
        pytest.param({"accessors": [VIEW | {"type": "VEC9"}, VIEW]}, "damaged", id="type"),
        pytest.param({"accessors": 5}, "damaged", id="no list"),
        pytest.param({"bufferViews": [{"byteLength": 10**12}]}, "beyond its end", id="view"),
        pytest.param({"nodes": [{"children": [1]}, {"children": [0]}]}, "cycle", id="cycle"),
        pytest.param(
            {"nodes": [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]}, "two", id="two ways"
        ),
        pytest.param({"buffers": [{"uri": "file:///etc/passwd"}]}, "another file", id="uri"),
        pytest.param(
            {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]}]},
            "no triangles", id="lines",
        ),
        pytest.param({"extensionsRequired": ["ADOBE_shape"]}, "extension ADOBE_shape", id="needs"),
        pytest.param({"nodes": [{"mesh": 0, "skin": 0}]}, "skin", id="skin"),
        pytest.param({"scenes": [{"nodes": []}]}, "no triangles", id="nothing shown"),
        pytest.param(
            {"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}, "rotation of length 0", id="turn"
        ),
        pytest.param(
            {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 101}]},
            "100 primitives", id="primitives",
        ),
        pytest.param(
            {"accessors": [{"componentType": 5126, "count": 10**9, "type": "VEC3"}, CORNERS]},
            "counts go beyond", id="zeros",
        ),
    ],
)  # fmt: skip
def test_damaged_glb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, object], said: str
) -> None:
    monkeypatch.setattr(glb_files, "_MOST_PARTS", 100)
    refused(tmp_path, "a.glb", change, said)


@pytest.mark.parametrize(
    ("change", "copies", "first", "last"),
    [
        pytest.param(
            {"nodes": [{"mesh": 0, "translation": [0, 0, 1], "rotation": [0, 0, 1, 0],
                        "scale": [2, 3, 4]}]},
            1, [0, 0, 1], [0, 0, 5], id="translation, rotation, scale"),
        pytest.param(
            {"nodes": [{"children": [1], "translation": [5, 0, 0]},
                       {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2, 0, 7, 0, 0, 1]}]},
            1, [12, 0, 0], [12, 0, 2], id="child with a matrix"),
        pytest.param({"nodes": [{"mesh": 0, "extensions": COPIES}]}, 4, [0, 0, 0], [0, 0, 2],
                     id="copies"),
        pytest.param({"meshes": [{"primitives": [TARGET], "weights": [0.5]}]}, 1, [0, 0, 0],
                     [0, 0, 1.5], id="morph"),
        pytest.param({"meshes": [{"primitives": [TARGET]}], "nodes": [{"mesh": 0, "weights": [1]}]},
                     1, [0, 0, 0], [0, 0, 2], id="morph of a node"),
        pytest.param(
            {"accessors": [VIEW | {"sparse": {
                "count": 1, "indices": {"bufferView": 1, "byteOffset": 2, "componentType": 5121},
                "values": {"bufferView": 0, "byteOffset": 36}}}, CORNERS]},
            1, [0, 0, 0], [0, 0, 1], id="sparse"),
        pytest.param(
            {"accessors": [VIEW | {"componentType": 5121, "normalized": True}, CORNERS],
             "bufferViews": [{"byteLength": 48, "byteStride": 4},
                             {"byteOffset": 48, "byteLength": 24}]},
            1, [0, 0, 0], [0, 0, 128 / 255], id="normalised"),
    ],
)  # fmt: skip
def test_what_moves_the_vertices_of_a_glb(
    tmp_path: Path,
    change: dict[str, object],
    copies: int,
    first: list[float],
    last: list[float],
) -> None:
    mesh = mesh_of(tmp_path, "a.glb", change)
    assert mesh.faces is not None
    assert (len(mesh.vertices), len(mesh.faces)) == (4 * copies, 4 * copies)
    np.testing.assert_allclose(mesh.vertices[[0, -1]], [first, last], atol=1e-9)


def test_what_a_glb_does_not_show_is_named(tmp_path: Path) -> None:
    hidden = {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}}
    part: dict[str, object] = {"attributes": {"POSITION": 0}, "indices": 1}
    change: dict[str, object] = {
        "nodes": [{"mesh": 0}, hidden, {"mesh": 0}],
        "scenes": [{"nodes": [0, 1]}, {"nodes": [2]}],
        "meshes": [{"primitives": [part, part | {"mode": 1}]}],
    }
    mesh = mesh_of(tmp_path, "a.glb", change)
    assert len(mesh.vertices) == 4
    assert [notice.code for notice in mesh.warnings] == ["nodes-not-shown", "lines-left-out"]


def test_a_mirrored_node_is_wound_the_other_way(tmp_path: Path) -> None:
    mesh = mesh_of(tmp_path, "a.glb", {"nodes": [{"mesh": 0, "scale": [-1, 1, 1]}]})
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(1 / 6)


def test_a_glb_that_requires_what_does_not_change_the_surface(tmp_path: Path) -> None:
    mesh_of(tmp_path, "a.glb", {"extensionsRequired": ["KHR_materials_unlit"]})


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("lines", "faces"),
    [
        pytest.param(SQUARE + "f 1 2 3\nf -4 -2 -1\n", [[0, 1, 2], [0, 2, 3]], id="both signs"),
        pytest.param(SQUARE + "f -4 -3 -2\n" + SQUARE + "f -4 -3 -2\n", [[0, 1, 2], [4, 5, 6]],
                     id="negative in two blocks"),
        pytest.param("f 1 2 3 4\n" + SQUARE, [[0, 1, 2], [0, 2, 3]], id="faces first"),
        pytest.param(SQUARE + "vt 0 0\nf 1/1 2/1 3/1\nf 1 3 4\n", [[0, 1, 2], [0, 2, 3]],
                     id="two forms"),
        pytest.param(SQUARE + "f 1 2 \\\n3 # last\n", [[0, 1, 2]], id="continued, comment"),
        pytest.param(SQUARE.replace("\nv", " 1 0.5 0.5\nv") + "f 1//1 2//1 3//1\n", [[0, 1, 2]],
                     id="colours, normals that are not there"),
    ],
)  # fmt: skip
def test_faces_of_an_obj(tmp_path: Path, lines: str, faces: list[list[int]]) -> None:
    mesh = mesh_of(tmp_path, "a.obj", lines)
    np.testing.assert_array_equal(mesh.faces, faces)
    assert mesh.normals is None


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("f 0 1 2", r"line 5: face .* \(0\): indices begin at 1"),
        ("f 1 2 5", r"line 5: face .* \(5\): the mesh has 4"),
        ("f -1 -2 -5", r"line 5: face .* \(-5\)"),
        ("f 1 2 2.5", "not an integer"),
        ("f 1/2/3/4 2 3", "corner of more than three"),
        ("v 1 2\nf 1 2 3", "'v 1 2' has 2 numbers"),
        ("vn 0 0 1\nf 1//1 2//1 3//2", r"line 6: face refers to a normal .* \(2\)"),
        ("surf 0 1 0 1 1 2 3", "line 5: free-form"),
    ],
)
def test_damaged_obj(tmp_path: Path, lines: str, said: str) -> None:
    refused(tmp_path, "a.obj", f"{SQUARE}{lines}\n", said)


def test_a_vertex_of_an_obj_with_two_normals_is_there_twice(tmp_path: Path) -> None:
    lines = "vn 0 0 1\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 3//2 4\n"
    mesh = mesh_of(tmp_path, "a.obj", SQUARE + lines)
    assert mesh.faces is not None
    assert mesh.normals is not None
    np.testing.assert_array_equal(mesh.vertices[mesh.faces][:, :, :2],
                                  [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])  # fmt: skip
    np.testing.assert_array_equal(mesh.normals[mesh.faces][0], [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(mesh.normals[mesh.faces][1, :2], [[1, 0, 0]] * 2)
    assert np.isnan(mesh.normals[mesh.faces][1, 2]).all()


@cases(
    ("lines", "expected"),
    {
        "decimal commas": ("0,5 1,25 2,0\n", [0.5, 1.25, 2]),
        "semicolons": ("0,5;1,25;2,0\n", [0.5, 1.25, 2]),
        "commas": ("1,2,3\n", [1, 2, 3]),
        "commas and spaces": ("1, 2, 3\n", [1, 2, 3]),
        "commas and points": ("1.5, 2, 3\n", [1.5, 2, 3]),
        "ambiguous": ("1,50,2,05,3,00\n", "commas that may be decimal"),
    },
)
def test_commas_in_xyz(tmp_path: Path, lines: str, expected: list[float] | str) -> None:
    if isinstance(expected, str):
        refused(tmp_path, "a.xyz", lines, expected)
    else:
        np.testing.assert_array_equal(mesh_of(tmp_path, "a.xyz", lines).vertices, [expected])


def test_an_obj_reads_no_other_file(tmp_path: Path) -> None:
    """A device that is named as a material file would be read without end."""
    lines = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS.astype(int))
    content = f"mtllib /dev/zero\n{lines}usemtl a\nf 1 3 2\nf 1 2 4\n"
    mesh = mesh_of(tmp_path, "a.obj", content)
    assert mesh.faces is not None
    assert len(mesh.faces) == 2


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", b"v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1e300 0 0\n0 1 0\n3 0 1 2\n"),
        ("a.xyz", b"0 0 0\n1e300 0 0\n"),
        ("a.ply", ply(f"element vertex 2\n{XYZ}", "0 0 0\n1e300 0 0\n")),
    ],
)
def test_far_away(tmp_path: Path, name: str, content: bytes) -> None:
    """Areas and lengths would overflow with these coordinates."""
    refused(tmp_path, name, content, r"vertex 1 has a coordinate beyond 1e\+30")


def test_paths(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError):
        read_mesh_file(tmp_path / "nowhere.ply")
    refused(tmp_path, "a.fbx", "", "give one of")
