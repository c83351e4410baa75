"""Camera files of OpenCV: the nodes of a calibration in YAML, XML or JSON.

FileStorage itself follows any depth of nesting until the process crashes. This module reads the few
nodes of a camera file and ignores all others.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import cv2
import numpy as np

from acquisition._errors import DataError
from acquisition.values.camera_model import CameraModel
from rig import UnreadableError
from rig.arrays import Float64

_ROOT = "opencv_storage"
# A camera matrix has 9 numbers, the longest distortion 14.
_MOST_NUMBERS: Final = 1000
_MOST_DEPTH: Final = 32
_KEY = re.compile(r"(?P<key>[A-Za-z_][\w-]*)[ \t]*:(?P<rest>[^\n]*)")
_SPECIAL = {".nan": "nan", ".inf": "inf", "-.inf": "-inf", "+.inf": "inf"}
# Names of the nodes in OpenCV's samples, and in files of other programs that write the same format.
_MATRIX: Final = ("camera_matrix", "Camera_Matrix", "K", "M", "M1")
_DISTORTION: Final = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "D")
_FISHEYE: Final = ("fisheye_model", "fisheye")
# ROS calls the five coefficients of OpenCV plumb_bob.
_BROWN: Final = ("plumb_bob", "rational_polynomial", "radtan", "brown", "none", "")

# The text of a scalar, or the parts of a matrix.
_Node = str | dict[str, str]
Nodes = Mapping[str, _Node]


def number_of(node: _Node | None) -> float | None:
    """Return a scalar node as a number, or None if it is not a number."""
    if not isinstance(node, str):
        return None
    try:
        return float(_SPECIAL.get(node.strip().lower(), node))
    except ValueError:
        return None


def _matrix_named(names: Sequence[str], nodes: Nodes, path: Path) -> Float64 | None:
    """Return the first node with one of the names as ``(rows, cols)``; None without one."""
    name = next((name for name in names if name in nodes), None)
    if name is None:
        return None
    node = nodes[name]
    parts = node if isinstance(node, dict) else {}
    words = parts.get("data", "").replace(",", " ").split()
    rows, columns = number_of(parts.get("rows")), number_of(parts.get("cols"))
    if not words or len(words) > _MOST_NUMBERS or rows is None or columns is None:
        raise DataError(f"{path}: {name} is not a matrix: write it with OpenCV's FileStorage")
    values = [number_of(word) for word in words]
    numbers = [value for value in values if value is not None]
    if len(numbers) < len(values) or rows * columns != len(numbers) or rows != int(rows):
        raise DataError(
            f"{path}: {name} does not have {rows:g} x {columns:g} numbers: write it with OpenCV's "
            "FileStorage"
        )
    return np.array(numbers, np.float64).reshape(int(rows), int(columns))


def _yaml(text: str) -> Nodes:
    """Read the keys that begin in the first column, and the indented block below each key."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith(("%", "#"))]
    if not text.startswith("%YAML") and not any(_KEY.match(line) for line in lines):
        raise UnreadableError("not an OpenCV camera file")
    nodes: dict[str, _Node] = {}
    block: list[str] = []
    key = rest = ""

    def close() -> None:
        if key:
            nodes[key] = _block(block) if block and not rest.startswith('"') else rest

    for line in lines:
        if line.rstrip() in ("---", "..."):
            continue
        if line[0] in " \t":
            block.append(line)
            continue
        close()
        match = _KEY.match(line)
        if match is None:
            raise UnreadableError(f"not an OpenCV camera file ({line[:40]!r})")
        key, rest, block = match["key"], match["rest"].strip(), []
    close()
    return nodes


def _block(lines: list[str]) -> dict[str, str]:
    """Read the indented keys of a matrix; a list may span several lines."""
    parts: dict[str, str] = {}
    key = ""
    pieces: list[str] = []
    for line in lines:
        match = _KEY.match(line.strip())
        if match is not None:
            parts[key] = " ".join(pieces)
            key, pieces = match["key"], [match["rest"]]
        else:
            pieces.append(line)
    parts[key] = " ".join(pieces)
    return {name: _unbracketed(value.strip()) for name, value in parts.items() if name}


def _unbracketed(value: str) -> str:
    if value[:1] != "[":
        return value
    if value[-1] != "]":
        raise UnreadableError("a list has no closing bracket: the file is truncated")
    return value[1:-1]


def _xml(text: str) -> Nodes:
    """Read the elements of the first and second level below the root."""
    path: list[str] = []
    pieces: dict[tuple[str, ...], list[str]] = {}

    def begin(name: str, _: dict[str, str]) -> None:
        path.append(name)
        if len(path) > _MOST_DEPTH:
            raise UnreadableError(f"nested more than {_MOST_DEPTH} levels deep")
        pieces.setdefault(tuple(path[1:3]), [])

    def refuse(*_: object) -> None:
        raise UnreadableError("a document type declaration is not allowed in a camera file")

    parser = expat.ParserCreate()
    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: path.pop()
    parser.CharacterDataHandler = lambda piece: pieces[tuple(path[1:3])].append(piece)
    parser.StartDoctypeDeclHandler = refuse
    try:
        # The text is already decoded, so the encoding in its first line is removed.
        parser.Parse(re.sub(r"^\s*<\?xml[^>]*\?>", "", text).encode("utf-8"), True)
    except expat.ExpatError as error:
        raise UnreadableError(f"not an OpenCV camera file ({error})") from error
    nodes: dict[str, _Node] = {}
    for place, parts_of_text in pieces.items():
        words = "".join(parts_of_text).strip()
        if len(place) == 1:
            nodes.setdefault(place[0], words)
        elif len(place) == 2:
            parent = nodes[place[0]]
            nodes[place[0]] = (parent if isinstance(parent, dict) else {}) | {place[1]: words}
    return nodes


def camera_of_storage(text: str, path: Path, size: tuple[int, int] | None) -> CameraModel:
    """Return the camera of a YAML or XML file; ``size`` is used if it has none.

    Raises
    ------
    DataError
        If the text has neither of the two formats, or no such camera; the message names ``path``.
    """
    try:
        nodes = _xml(text) if text.lstrip().startswith("<") else _yaml(text)
    except UnreadableError as error:
        raise DataError(f"{path}: {error}: write the file with OpenCV's FileStorage") from error
    return _camera_of(nodes, path, size)


def camera_of_json(content: Mapping[str, Any], path: Path) -> CameraModel:
    """Return the camera of a parsed JSON file of OpenCV's FileStorage."""
    return _camera_of({name: _node(value) for name, value in content.items()}, path, None)


def has_camera(content: Mapping[str, Any]) -> bool:
    """Return whether a parsed JSON file has a camera matrix under a name of OpenCV."""
    return any(name in content for name in _MATRIX)


def opencv_text(camera: CameraModel) -> str:
    """Return a camera as the text of a YAML file, with our addition working_distance_mm."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("camera_matrix", camera.K)
    storage.write("distortion_coefficients", camera.distortion[None])
    if camera.working_distance_mm is not None:
        storage.write("working_distance_mm", camera.working_distance_mm)
    return storage.releaseAndGetString()


def _camera_of(nodes: Nodes, path: Path, size: tuple[int, int] | None) -> CameraModel:
    K = _matrix_named(_MATRIX, nodes, path)
    if K is None:
        raise DataError(
            f"{path}: camera_matrix is missing: write the file with OpenCV's FileStorage"
        )
    _check_model(nodes, path)
    distortion = _matrix_named(_DISTORTION, nodes, path)
    sides = [number_of(nodes.get(side)) for side in ("image_height", "image_width")]
    whole = [int(side) for side in sides if side is not None and float(side).is_integer()]
    if len(whole) == 2:
        size = whole[0], whole[1]
    distance_mm = number_of(nodes.get("working_distance_mm"))
    coefficients = np.zeros(0) if distortion is None else distortion.ravel()
    if np.any(coefficients[5:]):
        raise DataError(f"{path}: more than five distortion coefficients: calibrate with five")
    height, width = known_size(size, path)
    return CameraModel(K, width, height, distance_mm, coefficients[:5])


def _check_model(nodes: Nodes, path: Path) -> None:
    """Refuse a distortion model whose coefficients have another meaning."""
    model = str(nodes.get("distortion_model", "")).strip().strip('"').lower()
    if model not in _BROWN:
        raise DataError(
            f"{path}: distortion_model {model[:40]} is not supported: calibrate with OpenCV's five "
            "coefficients (plumb_bob)"
        )
    if any(number_of(nodes.get(name)) for name in _FISHEYE):
        raise DataError(
            f"{path}: the fisheye model is not supported: calibrate with OpenCV's five coefficients"
        )


def known_size(size: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    """Return a size that must be known, (height, width).

    Raises
    ------
    DataError
        If it is None; the message names ``path``.
    """
    if size is None:
        raise DataError(f"{path}: the file has no image size: give the camera with its images")
    return size


def _node(value: object) -> _Node:
    """Return a value of a JSON file as one of a YAML file."""
    if not isinstance(value, dict):
        return str(value)
    parts = {str(name): str(part) for name, part in value.items() if not isinstance(part, list)}
    data = value.get("data")
    if isinstance(data, list):
        parts["data"] = " ".join(str(number) for number in data)
    return parts
