"""Mesh and point cloud files: every format, seams, and incomplete files."""

import numpy as np
import pytest
import trimesh

from acquisition import DataError, MissingPathError
from processing import Geometry, read_geometry

BALL = trimesh.creation.icosphere(subdivisions=1)
CUBE_OFF = """OFF
8 6 12
0 0 0
1 0 0
1 1 0
0 1 0
0 0 1
1 0 1
1 1 1
0 1 1
4 3 2 1 0
4 4 5 6 7
4 0 1 5 4
4 1 2 6 5
4 2 3 7 6
4 3 0 4 7
"""
CLOUD = """ply
format ascii 1.0
element vertex {count}
property float x
property float y
property float z
{more}end_header
{lines}
"""
NORMALS = "property float nx\nproperty float ny\nproperty float nz\n"


def _area(geometry):
    corners = geometry.vertices[geometry.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(cross, axis=1).sum() / 2


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "off"])
def test_every_format_gives_the_same_mesh(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    BALL.export(path)
    read = read_geometry(path)
    # The separate faces of the STL are connected at their corners again.
    assert read.vertices.shape == BALL.vertices.shape
    assert read.faces.shape == BALL.faces.shape
    assert read.faces.dtype == np.int32
    assert _area(read) == pytest.approx(BALL.area, rel=1e-6)
    # The normals still point outwards, so no winding has changed.
    corners = read.vertices[read.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((cross * corners.mean(axis=1)).sum(axis=1) > 0).all()


def test_polygons_are_split_into_triangles(tmp_path):
    path = tmp_path / "cube.off"
    path.write_text(CUBE_OFF, encoding="ascii")
    read = read_geometry(path)
    assert read.faces.shape == (12, 3)
    assert _area(read) == pytest.approx(6.0)


def test_vertices_split_along_a_texture_seam_are_merged(tmp_path):
    path = tmp_path / "seam.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 5 5 5\nvt 0 0\nvt 1 0\nvt 0 1\n"
        "f 1/1 2/2 3/3\nf 2/1 4/2 3/1\n",
        encoding="ascii",
    )
    read = read_geometry(path)
    np.testing.assert_array_equal(read.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    np.testing.assert_array_equal(read.faces, [[0, 1, 2], [1, 3, 2]])


def test_a_scene_of_several_parts_is_one_mesh_in_scene_coordinates(tmp_path):
    path = tmp_path / "two.glb"
    scene = trimesh.Scene()
    for shift in (0.0, 5.0):
        scene.add_geometry(BALL.copy(), transform=trimesh.transformations.translation_matrix(
            [shift, 0, 0]))  # fmt: skip
    scene.export(path)
    read = read_geometry(path)
    assert len(read.faces) == 2 * len(BALL.faces)
    assert read.vertices[:, 0].max() == pytest.approx(6.0, abs=0.1)


POINTS = ("0 0 0", "1 0 0", "0 1 0")


def _lines(more=""):
    return "\n".join(point + more for point in POINTS)


NO_FACES = "element face 0\nproperty list uchar int vertex_indices\n"
CLOUDS = {
    "xyz": ("a.xyz", "# three\n0 0 0\n1 0 0\n\n0 1 0\n", None),
    "commas": ("a.xyz", "0,0,0\n1,0,0\n0,1,0\n", None),
    "xyz, normals": ("a.xyz", _lines(" 0 0 1") + "\n", 1),
    "xyz, colours": ("a.xyz", _lines(" 9 9 200") + "\n", None),
    "ply": ("a.ply", CLOUD.format(count=3, more="", lines=_lines()), None),
    "ply, normals": ("a.ply", CLOUD.format(count=3, more=NORMALS, lines=_lines(" 0 0 1")), 1),
    "no faces": ("a.ply", CLOUD.format(count=3, more=NO_FACES, lines=_lines()), None),
}


@pytest.mark.parametrize("kind", CLOUDS)
def test_point_clouds_of_every_kind(tmp_path, kind):
    name, text, normals = CLOUDS[kind]
    path = tmp_path / name
    path.write_text(text, encoding="ascii")
    read = read_geometry(path)
    assert read.faces is None
    np.testing.assert_array_equal(read.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert (read.normals is None) == (normals is None)
    if normals:
        np.testing.assert_array_equal(read.normals, [[0, 0, 1]] * 3)


def test_normals_in_a_binary_ply_of_points_are_read(tmp_path):
    rows = np.zeros(4, [("p", "<f4", 3), ("n", "<f4", 3)])
    rows["p"], rows["n"] = np.eye(4, 3), [0, 1, 0]
    head = CLOUD.format(count=4, more=NORMALS, lines="").replace("ascii", "binary_little_endian")
    path = tmp_path / "cloud.ply"
    path.write_bytes(head[:-1].encode() + rows.tobytes())
    read = read_geometry(path)
    np.testing.assert_array_equal(read.vertices, np.eye(4, 3))
    np.testing.assert_array_equal(read.normals, [[0, 1, 0]] * 4)


def test_points_that_a_scanner_missed_are_reported(tmp_path):
    path = tmp_path / "scan.xyz"
    path.write_text("0 0 0\nnan nan nan\n1 0 0\n0 1 inf\n", encoding="ascii")
    read = read_geometry(path)
    assert len(read.vertices) == 2
    (notice,) = read.warnings
    assert str(notice) == "points left out because they are not finite: 2"


def test_normals_that_are_not_unit_vectors_are_reported(tmp_path):
    path = tmp_path / "scan.ply"
    lines = "0 0 0 0 0 1\n1 0 0 0 0 0\n0 1 0 nan 0 1"
    path.write_text(CLOUD.format(count=3, more=NORMALS, lines=lines), encoding="ascii")
    read = read_geometry(path)
    assert read.normals is None
    (warning,) = read.warnings
    assert warning.text.startswith("2 of 3 points have a normal that is not a unit vector")


def _cut(data):
    return data[: len(data) * 2 // 3]


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb", "off"])
def test_a_truncated_file_is_refused(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    BALL.export(path)
    path.write_bytes(_cut(path.read_bytes()))
    with pytest.raises(DataError, match=rf"ball\.{suffix}: .*truncated"):
        read_geometry(path)


def test_a_text_truncated_at_the_end_of_a_line_is_detected_by_its_counts(tmp_path):
    path = tmp_path / "cube.off"
    path.write_text("\n".join(CUBE_OFF.splitlines()[:-2]), encoding="ascii")
    with pytest.raises(DataError, match=r"cube\.off: truncated: its header states 14 lines"):
        read_geometry(path)
    path = tmp_path / "ball.ply"
    BALL.export(path, encoding="ascii")
    path.write_text("\n".join(path.read_text().splitlines()[:-30]), encoding="ascii")
    with pytest.raises(DataError, match="truncated: it ends within a list"):
        read_geometry(path)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        pytest.param("a.obj", "v 0 0 0\nv 1 0 0\n", "no faces", id="no faces"),
        pytest.param("a.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "vertex 1 is", id="NaN"),
        pytest.param("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "", id="missing vertex"),
        pytest.param("a.obj", "", "", id="empty"),
        pytest.param("a.ply", "hello", "no PLY header", id="no ply"),
        pytest.param("a.stl", "hello", "truncated", id="no stl"),
        pytest.param("a.glb", "hello", "not a GLB file", id="no glb"),
        pytest.param("a.fbx", "hello", "give one of .obj", id="unknown suffix"),
        pytest.param("a.xyz", "", "no point", id="no point"),
        pytest.param("a.xyz", "1 2\n3 4\n", "lines of 2 numbers", id="two columns"),
        pytest.param("a.xyz", "1 2 3\n4 5\n", "not a table", id="ragged"),
        pytest.param("a.xyz", "1 2 3\n4 five 6\n", "not a table", id="words"),
        pytest.param("a.xyz", "nan 0 0\n", "no finite point", id="nothing but misses"),
    ],
)
def test_bad_files_are_refused_and_named(tmp_path, name, text, words):
    path = tmp_path / name
    path.write_text(text, encoding="ascii")
    with pytest.raises(DataError) as caught:
        read_geometry(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MissingPathError, match="no such file"):
        read_geometry(tmp_path / "nowhere.obj")


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        pytest.param(np.zeros((0, 3)), None, "shape", id="no vertices"),
        pytest.param(np.zeros((3, 2)), None, "shape", id="flat vertices"),
        pytest.param(np.zeros((3, 3)), np.zeros((0, 3), int), "faces of shape", id="no faces"),
        pytest.param(np.zeros((3, 3)), [[0, 1, 2], [0, 1, 3]], "face 1 refers", id="too high"),
        pytest.param(np.zeros((3, 3)), [[0, -1, 2]], "face 0 refers", id="negative"),
    ],
)
def test_invalid_geometry_is_refused(vertices, faces, words):
    with pytest.raises(DataError, match=words):
        Geometry(vertices, faces)


@pytest.mark.parametrize(
    ("faces", "edges"),
    [
        pytest.param("1 2 3,2 1 4", 0, id="two faces"),
        pytest.param("1 2 3,2 1 4,1 2 5", 1, id="three faces at an edge"),
        pytest.param("1 2 3,2 1 4,1 2 5,2 1 6", 1, id="four faces at an edge"),
        pytest.param("1 2 3,1 2 3,1 2 3", 0, id="one face three times"),
        pytest.param("1 2 3,2 1 4,1 2 2", 0, id="a vertex twice"),
    ],
)
def test_edges_of_more_than_two_faces_are_reported(tmp_path, faces, edges):
    places = ["0 0 0", "1 0 0", "0 1 0", "0 -1 0", "0 0 1", "0 0 -1"]
    lines = [f"v {place}" for place in places] + [f"f {face}" for face in faces.split(",")]
    (tmp_path / "mesh.obj").write_text("\n".join(lines), encoding="utf-8")
    notices = read_geometry(tmp_path / "mesh.obj").warnings
    warnings = [notice for notice in notices if notice.code == "mesh-not-manifold"]
    assert len(warnings) == bool(edges)
    assert f"more than two faces: {edges}" in "".join(map(str, warnings)) or not edges


def _wound(path):
    """Return the vertex indices of the faces, each starting with its smallest."""
    return [tuple(np.roll(face, -face.argmin())) for face in read_geometry(path).faces]


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9])
def test_faces_of_opposite_winding_are_reversed(tmp_path, share):
    """Each part is treated separately: two balls, the second with all faces wound inwards."""
    both = trimesh.util.concatenate([BALL, BALL.copy().apply_translation([3, 0, 0])])
    both.faces[len(BALL.faces) :] = both.faces[len(BALL.faces) :, ::-1]
    both.export(tmp_path / "sound.off")
    sound = _wound(tmp_path / "sound.off")
    assert read_geometry(tmp_path / "sound.off").warnings == ()
    chosen = np.random.default_rng(0).random(len(both.faces)) < share
    both.faces[chosen] = both.faces[chosen, ::-1]
    both.export(tmp_path / "mixed.off")
    mixed = _wound(tmp_path / "mixed.off")
    # If most faces were reversed, the others follow them.
    expected = sound if share < 0.5 else [(a, c, b) for a, b, c in sound]
    assert mixed == expected
    (warning,) = read_geometry(tmp_path / "mixed.off").warnings
    turned = chosen.sum() if share < 0.5 else (~chosen).sum()
    assert str(warning) == f"faces reversed to match the winding of their neighbours: {turned}"


@pytest.mark.parametrize("faces", ["1 2 3,1 2 3", "1 2 3,1 3 2"])
def test_duplicate_faces_do_not_change(tmp_path, faces):
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0"] + [f"f {face}" for face in faces.split(",")]
    (tmp_path / "mesh.obj").write_text("\n".join(lines), encoding="utf-8")
    read = read_geometry(tmp_path / "mesh.obj")
    assert read.warnings == ()
    assert read.faces.tolist() == [
        [int(word) - 1 for word in face.split()] for face in faces.split(",")
    ]


def test_a_strip_with_one_side_does_not_change(tmp_path):
    """Five triangles form a Moebius strip."""
    places = np.random.default_rng(1).normal(size=(5, 3))
    faces = [[i, (i + 1) % 5, (i + 2) % 5] for i in range(5)]
    trimesh.Trimesh(places, faces, process=False).export(tmp_path / "strip.off")
    read = read_geometry(tmp_path / "strip.off")
    assert (read.faces == faces).all()
    assert read.warnings == ()


def test_a_folder_is_not_a_mesh(tmp_path):
    (tmp_path / "mesh.obj").mkdir()
    with pytest.raises(DataError, match=r"mesh\.obj: a folder, not a file"):
        read_geometry(tmp_path / "mesh.obj")
