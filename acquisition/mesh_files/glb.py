"""GLB files: the triangles of the scene that the file shows first.

Format: Khronos, glTF 2.0. KHR_mesh_quantization, EXT_mesh_gpu_instancing and KHR_node_visibility
are applied, morph targets too. Extensions that only change colours are ignored, others that a file
requires are refused by name.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from acquisition.mesh_files.glb_accessors import Accessors, as_count, refuse_coded
from acquisition.mesh_files.mesh_file import SHORTER, MeshFile
from rig import Notice, UnreadableError, pluralize
from rig.arrays import Float64, Int64
from rig.files import convert_parser_errors, parse_json

_MAGIC, _VERSION = b"glTF", 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_INSTANCING: Final = "EXT_mesh_gpu_instancing"
_VISIBILITY: Final = "KHR_node_visibility"
_APPLIED: Final = (_INSTANCING, _VISIBILITY, "KHR_mesh_quantization")
# Parts of a transformation, each as it is where none is stated.
_UNMOVED: Final = {
    "translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)
}  # fmt: skip
# Modes of primitives that are points or lines.
_NO_SURFACE: Final = (0, 1, 2, 3)
# Extensions with these beginnings change colours, lights and pictures, not the surface.
_OF_COLOUR: Final = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "EXT_lights_")
# A primitive takes some microseconds to place, so a file with as many takes some seconds.
_MOST_NODES: Final = 100_000
_MOST_PARTS: Final = 100_000
# Vertices and corners that copies may add to those of the file: about 1 GB of arrays.
_MOST_COPIED: Final = 20_000_000


@dataclass(frozen=True)
class _Part:
    """One primitive: vertices, triangles and normals, in the axes of its mesh."""

    vertices: Float64
    faces: Int64
    normals: Float64 | None


def read_glb(data: bytes) -> MeshFile:
    """Read the triangles of a GLB file, with all transformations of its nodes.

    Raises
    ------
    UnreadableError
        If the file is damaged or truncated, its nodes form a cycle, its surface is of a kind or
        needs an extension that is not supported, or it has too many nodes, primitives or copies.
    """
    content, binary = _chunks(data)
    # Any other exception means that the structure is damaged.
    with convert_parser_errors("its structure is damaged"):
        _check_extensions(content)
        _check_nodes(content)
        nodes = content.get("nodes", [])
        shown = _shown(content)
        accessors = Accessors(content, binary)
        _check_sizes(content, accessors, shown)
        parts: dict[tuple[int, int], _Part] = {}
        vertices, faces, normals = [], [], []
        total = lines = 0
        for node, place in shown.items():
            if "mesh" not in nodes[node]:
                continue
            mesh = content["meshes"][nodes[node]["mesh"]]
            weights = nodes[node].get("weights", mesh.get("weights", ()))
            # A part with the weights of its node is not the part of other nodes.
            owner = node if "weights" in nodes[node] else -1 - nodes[node]["mesh"]
            for number, primitive in enumerate(mesh["primitives"]):
                if primitive.get("mode", 4) in _NO_SURFACE:
                    lines += 1
                    continue
                key = owner, number
                if key not in parts:
                    parts[key] = _part(primitive, accessors, weights)
                part = parts[key]
                for copy in _copies(nodes[node], accessors):
                    matrix = place @ copy
                    vertices.append(part.vertices @ matrix[:3, :3].T + matrix[:3, 3])
                    # A mirrored copy is wound the other way.
                    mirrored = np.linalg.det(matrix[:3, :3]) < 0
                    faces.append(total + (part.faces[:, ::-1] if mirrored else part.faces))
                    normals.append(_turned(part, matrix))
                    total += len(part.vertices)
        hidden = sum("mesh" in one for one in nodes) - sum("mesh" in nodes[n] for n in shown)
    notices = []
    if hidden:
        text = f"{pluralize(hidden, 'node is', 'nodes are')} hidden or in another scene"
        notices.append(Notice("nodes-not-shown", f"{text}: left out"))
    if not vertices:
        raise UnreadableError("its scene has no triangles: save it with triangles")
    if lines:
        text = f"primitives left out because they are points or lines: {lines}"
        notices.append(Notice("lines-left-out", text))
    known = None
    if any(each is not None for each in normals):
        known = np.concatenate([
            np.full(one.shape, np.nan) if each is None else each
            for each, one in zip(normals, vertices, strict=True)
        ])  # fmt: skip
    triangles = np.concatenate(faces)
    return MeshFile(
        np.concatenate(vertices), triangles if len(triangles) else None, known, tuple(notices)
    )


def _chunks(data: bytes) -> tuple[dict[str, Any], memoryview]:
    """Return the JSON and the binary chunk."""
    if len(data) < 20:
        raise UnreadableError("not a GLB file, or truncated: get the complete file")
    magic, version, length, size, kind = struct.unpack("<4sIIII", data[:20])
    if magic != _MAGIC or version != _VERSION or kind != _JSON:
        raise UnreadableError("not a GLB file of version 2")
    if length > len(data) or size > length - 20:
        raise UnreadableError(SHORTER)
    if data[length:].strip(b"\0\r\n\t "):
        raise UnreadableError(f"it has {len(data) - length} bytes more than its header states")
    # Each primitive has this key; a million of them would take long to parse.
    if data.count(b'"attributes"', 20, 20 + size) > _MOST_PARTS + _MOST_NODES:
        raise _too_many()
    content = parse_json(data[20 : 20 + size])
    if not isinstance(content, dict):
        raise UnreadableError("its JSON is not an object")
    rest = memoryview(data)[20 + size : length]
    if len(rest) < 8:
        return content, memoryview(b"")
    size, kind = struct.unpack("<II", rest[:8])
    if kind != _BIN or size > len(rest) - 8:
        raise UnreadableError("truncated: its lengths go beyond its end: get the complete file")
    return content, rest[8 : 8 + size]


def _too_many() -> UnreadableError:
    return UnreadableError(f"more than {_MOST_PARTS} primitives: save it as one mesh")


def _check_extensions(content: dict[str, Any]) -> None:
    for name in content.get("extensionsRequired", ()):
        if name not in _APPLIED and not name.startswith(_OF_COLOUR):
            raise UnreadableError(
                f"it requires the extension {str(name)[:60]}, which is not supported: save it "
                "without it"
            )


def _check_nodes(content: dict[str, Any]) -> None:
    """Refuse nodes that are reached twice, that is, cycles and endless copies of copies."""
    nodes = content.get("nodes", [])
    if len(nodes) > _MOST_NODES:
        raise UnreadableError(f"more than {_MOST_NODES} nodes: save it as one mesh")
    reached = [as_count(child) for node in nodes for child in node.get("children", ())]
    if len(set(reached)) < len(reached):
        raise UnreadableError("a node has two parents: the file is damaged")
    waiting = list(set(range(len(nodes))) - set(reached))
    seen: set[int] = set()
    while waiting:
        node = waiting.pop()
        seen.add(node)
        waiting += nodes[node].get("children", ())
    if len(seen) < len(nodes):
        raise UnreadableError("its nodes form a cycle: the file is damaged")


def _shown(content: dict[str, Any]) -> dict[int, Float64]:
    """Return the nodes of the scene that the file shows first, and their transformations."""
    nodes, scenes = content.get("nodes", []), content.get("scenes", [])
    if scenes:
        roots = scenes[as_count(content.get("scene", 0))].get("nodes", [])
    else:
        roots = sorted(set(range(len(nodes))) - {c for n in nodes for c in n.get("children", ())})
    shown: dict[int, Float64] = {}
    waiting = [(as_count(root), np.eye(4)) for root in reversed(roots)]
    while waiting:
        node, above = waiting.pop()
        if node in shown:
            raise UnreadableError("a node is in its scene twice: the file is damaged")
        if "mesh" in nodes[node] and "skin" in nodes[node]:
            raise UnreadableError("a mesh with a skin is not supported: save it without bones")
        if nodes[node].get("extensions", {}).get(_VISIBILITY, {}).get("visible") is False:
            continue
        shown[node] = above @ _own_matrix(nodes[node])
        waiting += [(as_count(c), shown[node]) for c in reversed(nodes[node].get("children", []))]
    return shown


def _own_matrix(node: dict[str, Any]) -> Float64:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    return _matrix(*(np.array(node.get(name, one), np.float64) for name, one in _UNMOVED.items()))


def _matrix(translation: Float64, rotation: Float64, scale: Float64) -> Float64:
    length = float(np.linalg.norm(rotation))
    if not length > 0:
        raise UnreadableError("a rotation of length 0: the file is damaged")
    x, y, z, w = rotation / length
    matrix = np.eye(4)
    matrix[:3, :3] = scale * np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    matrix[:3, 3] = translation
    return matrix


def _instances(node: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = node.get("extensions", {}).get(_INSTANCING, {}).get("attributes", {})
    return {name: found[name.upper()] for name in _UNMOVED if name.upper() in found}


def _copies(node: dict[str, Any], accessors: Accessors) -> Iterator[Float64]:
    """Yield the transformation of each copy that a node draws of its mesh."""
    places = _instances(node)
    if not places:
        yield np.eye(4)
        return
    values = {
        name: accessors.table(place, f"VEC{len(_UNMOVED[name])}").astype(np.float64)
        for name, place in places.items()
    }
    count = min(map(len, values.values()))
    columns = (values.get(name, np.tile(one, (count, 1))) for name, one in _UNMOVED.items())
    for parts in zip(*columns, strict=False):
        yield _matrix(*parts)


def _check_sizes(content: dict[str, Any], accessors: Accessors, shown: dict[int, Float64]) -> None:
    """Refuse files whose primitives or copies would take too much time or memory."""
    meshes = [mesh["primitives"] for mesh in content.get("meshes", [])]
    parts = list(map(len, meshes))
    if sum(parts) > _MOST_PARTS:
        raise _too_many()

    def size(part: dict[str, Any]) -> int:
        corners = accessors.count(part["indices"]) if "indices" in part else 0
        return accessors.count(part["attributes"]["POSITION"]) + corners

    sizes = [sum(map(size, primitives)) for primitives in meshes]
    drawn = [node for n in shown if "mesh" in (node := content["nodes"][n])]
    copies = [
        (as_count(node["mesh"]), min(map(accessors.count, _instances(node).values()), default=1))
        for node in drawn
    ]
    if sum(parts[mesh] * count for mesh, count in copies) > _MOST_PARTS:
        raise UnreadableError(
            f"more than {_MOST_PARTS} primitives in all copies: save it as one mesh"
        )
    if sum(sizes[mesh] * count for mesh, count in copies) > sum(sizes) + _MOST_COPIED:
        raise UnreadableError(
            f"copies of its meshes have more than {_MOST_COPIED} vertices and corners: save it "
            "with fewer copies"
        )


def _part(primitive: dict[str, Any], accessors: Accessors, weights: Any) -> _Part:
    refuse_coded(primitive)
    attributes = primitive["attributes"]
    vertices = accessors.table(attributes["POSITION"], "VEC3").astype(np.float64)
    normals = None
    if "NORMAL" in attributes:
        normals = accessors.table(attributes["NORMAL"], "VEC3").astype(np.float64)
    for target, weight in zip(primitive.get("targets", ()), weights, strict=False):
        if weight and "POSITION" in target:
            vertices = vertices + weight * accessors.table(target["POSITION"], "VEC3")
            normals = None  # those of the moved surface
    if normals is not None and len(normals) != len(vertices):
        raise UnreadableError("a primitive with fewer or more normals than vertices")
    if "indices" in primitive:
        corners = accessors.table(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
    else:
        corners = np.arange(len(vertices), dtype=np.int64)
    if len(corners) and (corners.max() >= len(vertices) or corners.min() < 0):
        raise UnreadableError("a face refers to a vertex that does not exist")
    return _Part(vertices, _triangles(corners, primitive.get("mode", 4)), normals)


def _triangles(corners: Int64, mode: Any) -> Int64:
    match mode:
        case 4:
            if len(corners) % 3:
                raise UnreadableError("triangles whose corners are not a multiple of three")
            return corners.reshape(-1, 3)
        case 5:
            strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
            strip[1::2] = strip[1::2, [1, 0, 2]]
            return strip
        case 6:
            first = np.full(max(len(corners) - 2, 0), corners[0] if len(corners) else 0)
            return np.stack([first, corners[1:-1], corners[2:]], axis=1)
        case _:
            raise UnreadableError("a primitive of an unknown kind: the file is damaged")


def _turned(part: _Part, matrix: Float64) -> Float64 | None:
    """Return normals in the axes of the file: those of planes, which turn by the inverse."""
    if part.normals is None:
        return None
    try:
        turned = part.normals @ np.linalg.inv(matrix[:3, :3])
    except np.linalg.LinAlgError:
        return None
    with np.errstate(invalid="ignore"):
        unit: Float64 = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return unit
