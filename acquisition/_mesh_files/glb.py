"""Checks that make GLB files safe for trimesh: lengths are checked, only shapes are kept.

Format: Khronos, glTF 2.0.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Final

from rig import UnreadableError, convert_parser_errors, parse_json

_MAGIC, _VERSION = b"glTF", 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
# Images, materials and animations are not needed and would need checks of their own.
_KEPT: Final = (
    "asset",
    "scene",
    "scenes",
    "nodes",
    "meshes",
    "accessors",
    "bufferViews",
    "buffers",
)
_BYTES: Final = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_NUMBERS: Final = {
    "SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16
}  # fmt: skip
_MOST_NODES: Final = 100_000
_MOST_VERTICES: Final = 100_000_000


def shape_of_glb(data: bytes) -> bytes:
    """Return a GLB file reduced to its shapes, with all lengths checked.

    Raises
    ------
    UnreadableError
        If the file is damaged or truncated, its nodes form a cycle, or its surface is of a kind
        that is not supported.
    """
    if len(data) < 20:
        raise UnreadableError("not a GLB file, or truncated: get the complete file")
    magic, version, length, size, kind = struct.unpack("<4sIIII", data[:20])
    if magic != _MAGIC or version != _VERSION or kind != _JSON:
        raise UnreadableError("not a GLB file of version 2")
    if length > len(data) or size > length - 20:
        raise UnreadableError("truncated: shorter than its header says: get the complete file")
    content = parse_json(data[20 : 20 + size])
    rest = data[20 + size : length]
    if not isinstance(content, dict):
        raise UnreadableError("its JSON is not an object")
    kept = {name: content[name] for name in _KEPT if name in content}
    # Any exception in the checks means that the file is damaged.
    with convert_parser_errors("its structure is damaged"):
        _check_views(kept, len(rest) - 8)
        _check_accessors(kept)
        _check_meshes(kept)
        _check_nodes(kept)
    text = json.dumps(kept).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", magic, version, 20 + len(text) + len(rest), len(text), _JSON)
    return head + text + rest


def _check_views(content: dict[str, Any], held: int) -> None:
    for view in content.get("bufferViews", ()):
        begin, length = _count(view.get("byteOffset", 0)), _count(view["byteLength"])
        if _count(view.get("buffer", 0)) or begin + length > held:
            raise UnreadableError("truncated: its lengths go beyond its end: get the complete file")
    buffers = content.get("buffers", ())
    if len(buffers) > 1 or any("uri" in one for one in buffers):
        raise UnreadableError("its data are in another file: save everything in one GLB file")


def _check_accessors(content: dict[str, Any]) -> None:
    views = content.get("bufferViews", [])
    for one in content.get("accessors", ()):
        if "sparse" in one or "bufferView" not in one:
            raise UnreadableError("sparse accessors are not supported: save the file without them")
        view = views[_count(one["bufferView"])]
        item = _BYTES[one["componentType"]] * _NUMBERS[one["type"]]
        step, count = _count(view.get("byteStride", item)) or item, _count(one["count"])
        needed = _count(one.get("byteOffset", 0)) + step * (count - 1) + item if count else 0
        if step < item or needed > view["byteLength"]:
            raise UnreadableError("truncated: its counts go beyond its data: get the complete file")


def _check_meshes(content: dict[str, Any]) -> None:
    accessors = content.get("accessors", [])
    for mesh in content.get("meshes", ()):
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) not in (4, 5):
                raise UnreadableError("a mesh that has no triangles: save it with triangles")
            if "extensions" in primitive:
                raise UnreadableError("compressed geometry is not supported: save it uncompressed")
            places = {"POSITION": primitive["attributes"]["POSITION"]}
            primitive["attributes"] = places
            for key in ("targets", "material", "extras"):
                primitive.pop(key, None)
            for place in (
                *places.values(),
                *([primitive["indices"]] if "indices" in primitive else []),
            ):
                accessors[_count(place)]
            if accessors[places["POSITION"]]["type"] != "VEC3":
                raise UnreadableError("vertices that are not three numbers each")


def _check_nodes(content: dict[str, Any]) -> None:
    """Refuse nodes that are reached twice, that is, cycles and endless copies of copies."""
    nodes = content.get("nodes", [])
    reached = [_count(child) for node in nodes for child in node.get("children", ())]
    if len(nodes) > _MOST_NODES or len(set(reached)) < len(reached):
        raise UnreadableError(
            f"a node has two parents, or there are more than {_MOST_NODES} nodes: the file is "
            "damaged"
        )
    roots = set(range(len(nodes))) - set(reached)
    seen: set[int] = set()
    waiting = list(roots)
    while waiting:
        node = waiting.pop()
        seen.add(node)
        waiting += nodes[node].get("children", ())
    if len(seen) < len(nodes):
        raise UnreadableError("its nodes form a cycle: the file is damaged")
    meshes, accessors = content.get("meshes", []), content.get("accessors", [])
    sizes = [
        sum(accessors[p["attributes"]["POSITION"]]["count"] for p in mesh["primitives"])
        for mesh in meshes
    ]
    if sum(sizes[_count(node["mesh"])] for node in nodes if "mesh" in node) > _MOST_VERTICES:
        raise UnreadableError(f"more than {_MOST_VERTICES} vertices in all its copies")


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise UnreadableError(f"{str(value)[:40]!r} instead of a count: the file is damaged")
    return value
