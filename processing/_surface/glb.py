"""Meshes as binary glTF 2.0 (Khronos Group, 2021)."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import StorageError
from processing._surface.mesh import Mesh

# The unit of glTF is the metre.
_METRES = 1e-3
_VERTICES, _INDICES = 34962, 34963
_FLOAT, _UNSIGNED = 5126, 5125
_CLAMP, _LINEAR = 33071, 9729


def glb(mesh: Mesh, texture: npt.NDArray[np.uint8] | None = None) -> list[bytes]:
    """Return the parts of a .glb file.

    Parameters
    ----------
    mesh
        The mesh; its coordinates are divided by 1000.
    texture
        ``(H, W)`` or ``(H, W, 3)`` uint8 sRGB, the base colour of a rough dielectric material. The
        mesh must have places in it.

    Raises
    ------
    StorageError
        If the texture cannot be encoded.
    """
    positions = mesh.vertices * np.float32(_METRES)
    views: list[tuple[bytes, int]] = []
    accessors: list[dict[str, Any]] = []

    def add(array: npt.NDArray[Any], target: int, **form: object) -> int:
        views.append((array.tobytes(), target))
        accessors.append({"bufferView": len(views) - 1, **form})
        return len(accessors) - 1

    vectors = {"componentType": _FLOAT, "type": "VEC3", "count": len(positions)}
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    attributes = {"POSITION": add(positions.astype("<f4"), _VERTICES, **vectors, **bounds)}
    if mesh.normals is not None:
        attributes["NORMAL"] = add(mesh.normals.astype("<f4"), _VERTICES, **vectors)
    painted = texture is not None and mesh.places is not None
    if painted and mesh.places is not None:
        places = {"componentType": _FLOAT, "type": "VEC2", "count": len(positions)}
        attributes["TEXCOORD_0"] = add(mesh.places.astype("<f4"), _VERTICES, **places)
    scalars = {"componentType": _UNSIGNED, "type": "SCALAR", "count": mesh.faces.size}
    primitive: dict[str, Any] = {"attributes": attributes}
    primitive["indices"] = add(mesh.faces.astype("<u4"), _INDICES, **scalars)
    blobs = [data for data, _ in views]
    if painted and texture is not None:
        primitive["material"] = 0
        # Last, since its length is not a multiple of 4 as glTF requires of the others.
        blobs.append(_png(texture))
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
    if painted:
        document |= _material(len(blobs) - 1)
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    blobs.append(b"\0" * (-offsets[-1] % 4))
    binary_bytes = offsets[-1] + len(blobs[-1])
    total = 12 + 8 + len(text) + 8 + binary_bytes
    words = np.array([0x46546C67, 2, total, len(text), 0x4E4F534A], "<u4").tobytes()
    binary = np.array([binary_bytes, 0x004E4942], "<u4").tobytes()
    return [words, text, binary, *blobs]


def _material(view: int) -> dict[str, Any]:
    """Return the parts of the document that paint a mesh with the image in a buffer view."""
    paint = {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1}
    return {
        "materials": [{"name": "albedo", "pbrMetallicRoughness": paint}],
        "textures": [{"sampler": 0, "source": 0}],
        "samplers": [{"magFilter": _LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": [{"bufferView": view, "mimeType": "image/png"}],
    }


def _png(texture: npt.NDArray[np.uint8]) -> bytes:
    image = texture if texture.ndim == 2 else cv2.cvtColor(texture, cv2.COLOR_RGB2BGR)
    done, encoded = cv2.imencode(".png", image)
    if not done:
        raise StorageError(
            "the texture cannot be encoded as PNG: check the memory of this computer"
        )
    return encoded.tobytes()
