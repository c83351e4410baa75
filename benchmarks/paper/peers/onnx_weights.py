"""Read the weights of an ONNX file without the package onnx.

An ONNX file is a message of protocol buffers: fields with a number and a type, of which those with
a length are texts, bytes or messages themselves.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import acquisition
import rig
from rig.arrays import Float32

# Numbers of fields in ModelProto, GraphProto and TensorProto.
_GRAPH, _INITIALIZER = 7, 5
_DIMS, _TYPE, _NAME, _RAW = 1, 2, 8, 9
_FLOAT = 1
_MOST_BYTES = 1_500_000


def read_weights(path: Path) -> dict[str, Float32]:
    """Return the float32 weights of a network by name.

    Raises
    ------
    DataError
        If the file is not an ONNX file with such weights.
    MissingPathError
        If it does not exist.
    """
    try:
        data = rig.read_bounded(path, _MOST_BYTES)
    except FileNotFoundError as error:
        raise acquisition.MissingPathError(f"{path}: no such file") from error
    except rig.UnreadableError as error:
        raise acquisition.DataError(f"{path}: not a readable file: {error}") from error
    found: dict[str, Float32] = {}
    try:
        for number, graph in _fields(data):
            if number != _GRAPH or isinstance(graph, int):
                continue
            for part, tensor in _fields(graph):
                if part == _INITIALIZER and not isinstance(tensor, int):
                    found |= _weights(tensor)
    except (IndexError, ValueError, UnicodeDecodeError) as error:
        raise acquisition.DataError(f"{path}: not an ONNX file ({error})") from error
    if not found:
        raise acquisition.DataError(f"{path}: an ONNX file without weights")
    return found


def sha256(path: Path) -> str:
    """Return the hash of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _weights(tensor: bytes) -> dict[str, Float32]:
    sides: list[int] = []
    name, kind, raw = "", 0, b""
    for number, value in _fields(tensor):
        if isinstance(value, int):
            if number == _TYPE:
                kind = value
            elif number == _DIMS:
                sides.append(value)
        elif number == _DIMS:  # packed
            at = 0
            while at < len(value):
                side, at = _varint(value, at)
                sides.append(side)
        elif number == _NAME:
            name = value.decode()
        elif number == _RAW:
            raw = value
    if kind != _FLOAT or not sides:
        return {}
    return {name: np.frombuffer(raw, "<f4").reshape(sides).astype(np.float32)}


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield number and value of the fields of a message: an integer, or the bytes of the others."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == 0:
            value, at = _varint(message, at)
            yield number, value
            continue
        if kind == 2:
            length, at = _varint(message, at)
        elif kind in (1, 5):
            length = 8 if kind == 1 else 4
        else:
            raise ValueError(f"field {number} has the unknown type {kind}")
        if at + length > len(message):
            raise ValueError(f"field {number} ends after the file")
        yield number, message[at : at + length]
        at += length


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at += 1
        if byte < 128:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a number is too long")
