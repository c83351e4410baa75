"""GLB files, made safe for the library that reads them: lengths checked, all but shape left out.

Format: Khronos, glTF 2.0.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Final

from rig import UnreadableError, parse_json, refusing

_MAGIC, _VERSION = b"glTF", 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
# Pictures, materials and motion are of no use here, and each has a reader of its own.
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
    """Return a GLB file with nothing but its shapes, every length of which was checked.

    Raises
    ------
    UnreadableError
        If it is damaged or truncated, its nodes go in circles, or its surface is of a kind that is
        not read.
    """
    if len(data) < 20:
        raise UnreadableError("not a GLB file, is it whole?")
    magic, version, length, size, kind = struct.unpack("<4sIIII", data[:20])
    if magic != _MAGIC or version != _VERSION or kind != _JSON:
        raise UnreadableError("not a GLB file of version 2")
    if length > len(data) or size > length - 20:
        raise UnreadableError("truncated: shorter than its header says: get the whole file")
    content = parse_json(data[20 : 20 + size])
    rest = data[20 + size : length]
    if not isinstance(content, dict):
        raise UnreadableError("its JSON is no object")
    kept = {name: content[name] for name in _KEPT if name in content}
    # What the checks stumble over is damage, as what the parser stumbles over is.
    with refusing("its structure is damaged"):
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
            raise UnreadableError("truncated: its lengths go beyond its end: get the whole file")
    buffers = content.get("buffers", ())
    if len(buffers) > 1 or any("uri" in one for one in buffers):
        raise UnreadableError("its data are in another file: save all in one GLB")


def _check_accessors(content: dict[str, Any]) -> None:
    views = content.get("bufferViews", [])
    for one in content.get("accessors", ()):
        if "sparse" in one or "bufferView" not in one:
            raise UnreadableError("sparse accessors, which are not read: save it without")
        view = views[_count(one["bufferView"])]
        item = _BYTES[one["componentType"]] * _NUMBERS[one["type"]]
        step, count = _count(view.get("byteStride", item)) or item, _count(one["count"])
        wanted = _count(one.get("byteOffset", 0)) + step * (count - 1) + item if count else 0
        if step < item or wanted > view["byteLength"]:
            raise UnreadableError("truncated: its counts go beyond its data: get the whole file")


def _check_meshes(content: dict[str, Any]) -> None:
    accessors = content.get("accessors", [])
    for mesh in content.get("meshes", ()):
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) not in (4, 5):
                raise UnreadableError("a mesh that is not made of triangles: save it with these")
            if "extensions" in primitive:
                raise UnreadableError("compressed geometry, which is not read: save it without")
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
    """Refuse nodes that are reached twice: circles, and copies of copies without end."""
    nodes = content.get("nodes", [])
    reached = [_count(child) for node in nodes for child in node.get("children", ())]
    if len(nodes) > _MOST_NODES or len(set(reached)) < len(reached):
        raise UnreadableError("its nodes have two parents, or are far too many")
    roots = set(range(len(nodes))) - set(reached)
    seen: set[int] = set()
    waiting = list(roots)
    while waiting:
        node = waiting.pop()
        seen.add(node)
        waiting += nodes[node].get("children", ())
    if len(seen) < len(nodes):
        raise UnreadableError("its nodes go in circles")
    meshes, accessors = content.get("meshes", []), content.get("accessors", [])
    sizes = [
        sum(accessors[p["attributes"]["POSITION"]]["count"] for p in mesh["primitives"])
        for mesh in meshes
    ]
    if sum(sizes[_count(node["mesh"])] for node in nodes if "mesh" in node) > _MOST_VERTICES:
        raise UnreadableError(f"more than {_MOST_VERTICES} vertices in all its copies")


def _count(value: Any) -> int:
    if type(value) is not int or value < 0:
        raise UnreadableError(f"{str(value)[:40]!r} where a count is to be: the file is damaged")
    return value
