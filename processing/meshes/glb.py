"""Meshes as binary glTF 2.0 (Khronos Group, 2021)."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np

from acquisition import StorageError
from processing.meshes.mesh import Mesh
from rig.arrays import AnyArray, UInt8

# The unit of glTF is the metre.
_METRES = 1e-3
_VERTICES, _INDICES = 34962, 34963
_FLOAT, _UNSIGNED = 5126, 5125
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_CLAMP, _LINEAR = 33071, 9729


def glb(
    mesh: Mesh,
    texture: UInt8 | None = None,
    normals: UInt8 | None = None,
) -> list[bytes | memoryview]:
    """Return the parts of a .glb file.

    Parameters
    ----------
    mesh
        The mesh; its coordinates are divided by 1000.
    texture
        ``(H, W)`` or ``(H, W, 3)`` uint8 sRGB, the base colour of a rough dielectric material. The
        mesh must have places in it.
    normals
        ``(H, W, 3)`` uint8, ``(n / 2 + 0.5) * 255`` of normals in the frame of the mesh, instead of
        those of the vertices. Vertex normals are then z and tangents x, so that the tangent space
        of glTF is this frame.

    Raises
    ------
    StorageError
        If the texture cannot be encoded.
    """
    positions = mesh.vertices * np.float32(_METRES)
    views: list[tuple[memoryview, int]] = []
    accessors: list[dict[str, Any]] = []

    def add(array: AnyArray, kind: str, **bounds: object) -> int:
        indices = kind == "SCALAR"
        flat = np.ascontiguousarray(array, "<i4" if indices else "<f4").reshape(-1)
        views.append((flat.view(np.uint8).data, _INDICES if indices else _VERTICES))
        form = {"componentType": _UNSIGNED if indices else _FLOAT, "type": kind}
        count = flat.size // _COMPONENTS[kind]
        accessors.append({"bufferView": len(accessors), **form, "count": count, **bounds})
        return len(accessors) - 1

    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    attributes = {"POSITION": add(positions, "VEC3", **bounds)}
    if normals is not None:
        attributes["NORMAL"] = add(np.tile([0, 0, 1], (len(positions), 1)), "VEC3")
        attributes["TANGENT"] = add(np.tile([1, 0, 0, 1], (len(positions), 1)), "VEC4")
    elif mesh.normals is not None:
        attributes["NORMAL"] = add(mesh.normals, "VEC3")
    images = [image for image in (texture, normals) if image is not None]
    if images and mesh.places is not None:
        attributes["TEXCOORD_0"] = add(mesh.places, "VEC2")
    primitive: dict[str, Any] = {"attributes": attributes}
    primitive["indices"] = add(mesh.faces, "SCALAR")
    blobs: list[bytes | memoryview] = [data for data, _ in views]
    if images:
        primitive["material"] = 0
        blobs += [_png(image) for image in images]
    offsets = np.cumsum([0] + [len(data) for data in blobs]).tolist()
    layout: list[dict[str, int]] = [
        {"buffer": 0, "byteOffset": offset, "byteLength": len(data)}
        for offset, data in zip(offsets, blobs, strict=False)
    ]
    for view, (_, target) in zip(layout, views, strict=False):
        view["target"] = target
    unit = "m" if mesh.unit == "mm" else "px / 1000"
    document = {
        "asset": {"version": "2.0", "extras": {"unit": unit}},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offsets[-1]}],
        "bufferViews": layout,
        "accessors": accessors,
    }
    if images:
        document |= _material(len(views), texture is not None, normals is not None)
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    binary_bytes = offsets[-1]
    total = 12 + 8 + len(text) + 8 + binary_bytes
    words = np.array([0x46546C67, 2, total, len(text), 0x4E4F534A], "<u4").tobytes()
    binary = np.array([binary_bytes, 0x004E4942], "<u4").tobytes()
    return [words, text, binary, *blobs]


def _material(first_view: int, painted: bool, bumpy: bool) -> dict[str, Any]:
    """Return the parts of the document for the images in the buffer views from a first one."""
    surface: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 1}
    material: dict[str, Any] = {"name": "surface", "pbrMetallicRoughness": surface}
    if painted:
        surface["baseColorTexture"] = {"index": 0}
    if bumpy:
        material["normalTexture"] = {"index": int(painted)}
    count = painted + bumpy
    return {
        "materials": [material],
        "textures": [{"sampler": 0, "source": i} for i in range(count)],
        "samplers": [{"magFilter": _LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": [{"bufferView": first_view + i, "mimeType": "image/png"} for i in range(count)],
    }


def _png(texture: UInt8) -> bytes:
    image = texture if texture.ndim == 2 else cv2.cvtColor(texture, cv2.COLOR_RGB2BGR)
    done, encoded = cv2.imencode(".png", image)
    if not done:
        raise StorageError(
            "the texture cannot be encoded as PNG: check the memory of this computer"
        )
    data = encoded.tobytes()
    # Bytes after the end chunk are allowed; the parts of a .glb begin at multiples of 4.
    return data + b"\0" * (-len(data) % 4)
