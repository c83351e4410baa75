"""Polynomial texture maps: files of six coefficients per pixel, written and read.

Format: T. Malzbender and D. Gelb, *Polynomial Texture Map (.ptm) File Format*, version 1.2,
HPL-2001-104. A header of lines with version, kind, size, six scales and six biases; then bytes, of
which ``(byte - bias) * scale`` is a coefficient for values of 0 to 255. The six are those of
u², v², uv, u, v and 1. ``PTM_FORMAT_LRGB``: the coefficients of all pixels, then their colours of
three bytes (version 1.1 has the nine bytes of a pixel together). ``PTM_FORMAT_RGB``: the
coefficients of all pixels for red, then for green, then for blue. The first row is the lowest one.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from acquisition import DataError
from acquisition.files import write_pieces
from processing.maps.npy_file import readable
from processing.relight.ptm_bytes import ptm_bytes
from processing.relight.relightable_image import RelightableImage
from rig import MAX_PIXELS, UnreadableError, check_type, read_bounded
from rig.arrays import Float32, UInt8
from rig.files import MAX_BINARY_BYTES, check_pixels

# Where the terms of the basis ptm (1, u, v, u², uv, v²) are in the file, and the reverse.
_TO_FILE: Final = [3, 5, 4, 1, 2, 0]
_FROM_FILE: Final = [5, 3, 4, 0, 2, 1]
_HEADER: Final = 4096
_FIRST_LINES = re.compile(rb"(PTM_1\.[0-9])[ \t]*\r?\n(PTM_FORMAT_[A-Z_]{1,20})[ \t]*\r?\n")
_NUMBERS = re.compile(rb"((?:\s*[-+.0-9eE]{1,40}(?=\s)){14})[ \t]*\r?\n")
_BYTES: Final = {"PTM_FORMAT_LRGB": 9, "PTM_FORMAT_RGB": 18}
_WHITE = 255.0


class _Header(NamedTuple):
    version: str
    kind: str
    width: int
    height: int
    scale: list[float]
    bias: list[float]
    end: int


def write_ptm(path: str | Path, image: RelightableImage) -> RelightableImage:
    """Write a relightable image of the basis ``ptm`` as a polynomial texture map.

    A shared function becomes PTM_FORMAT_LRGB, functions of three colours become PTM_FORMAT_RGB.
    Functions and colours of a pixel are rounded to 8 bits together, so that under any light the
    values deviate as little as the format allows: with a shared function by at most about 1/255,
    with functions of three colours by about 2/255. Colours below 0 become 0.

    Parameters
    ----------
    path
        File to write, replaced if it exists.
    image
        The image; values of 0 to 1 become 0 to 255.

    Returns
    -------
    RelightableImage
        The image as `read_ptm` reads it from the file.

    Raises
    ------
    DataError
        If the image has another basis.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap
    >>> from processing.relight import fit_normals, read_ptm, write_ptm
    >>> facing = NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (4, 5, 1)))
    >>> stored = write_ptm("card.ptm", fit_normals(facing, np.ones((4, 5))).image)
    >>> np.allclose(read_ptm("card.ptm").relit([1, 0, 1]), stored.relit([1, 0, 1]))
    True
    """
    check_type("image", image, RelightableImage, "fit_recording(source).image is one")
    if image.basis != "ptm":
        raise DataError(f"a polynomial texture map has the basis 'ptm', not {image.basis!r}")
    height, width = image.size
    shared = image.colour is not None
    # One function after the other: of red, green and blue.
    separate = image.coefficients.reshape(height * width, 6, -1)
    functions = np.moveaxis(separate, 2, 0).reshape(-1, 6)
    tint = image.colour.reshape(-1, 3) if image.colour is not None else None
    made = ptm_bytes(functions, tint)
    blocks = list(made.samples.reshape(-1, height, width, 6)[..., _TO_FILE])
    blocks += list(made.colour.reshape(-1, height, width, 3)) if shared else []
    lines = [
        "PTM_1.2",
        "PTM_FORMAT_LRGB" if shared else "PTM_FORMAT_RGB",
        f"{width}",
        f"{height}",
        " ".join(f"{scale:.9g}" for scale in _WHITE * made.scale[_TO_FILE]),
        " ".join(f"{round(bias)}" for bias in made.bias[_TO_FILE].tolist()),
    ]
    head = "".join(f"{line}\n" for line in lines).encode()
    write_pieces(Path(path), [head, *(np.ascontiguousarray(b[::-1]).data for b in blocks)])
    stored = made.samples.astype(np.float32)
    stored -= made.bias.astype(np.float32)
    stored *= made.scale.astype(np.float32)
    stored = stored.reshape(-1, height, width, 6)
    if not shared:
        return RelightableImage("ptm", np.moveaxis(stored, 0, -1))
    return RelightableImage("ptm", stored[0], blocks[-1].astype(np.float32) / np.float32(_WHITE))


def read_ptm(path: str | Path, *, max_pixels: int = MAX_PIXELS) -> RelightableImage:
    r"""Read a polynomial texture map of the kinds PTM_FORMAT_LRGB and PTM_FORMAT_RGB.

    Parameters
    ----------
    path
        A ``.ptm`` file.
    max_pixels
        Refuse images with more pixels than this.

    Returns
    -------
    RelightableImage
        Of the basis ``ptm``, whose values of 0 to 1 are 0 to 255 in the file.

    Raises
    ------
    MissingPathError
        If the file does not exist.
    DataError
        If it is not such a file, is compressed, cut short or damaged, or has too many pixels.

    Examples
    --------
    >>> from pathlib import Path
    >>> from processing.relight import read_ptm
    >>> head = b"PTM_1.2\nPTM_FORMAT_LRGB\n1 1\n1 1 1 1 1 1\n0 0 0 0 0 0\n"
    >>> _ = Path("one.ptm").write_bytes(head + bytes([0, 0, 0, 0, 204, 51]) + bytes([255, 0, 0]))
    >>> read_ptm("one.ptm").relit([0, 1, 0]).round(3).tolist()
    [[[1.0, 0.0, 0.0]]]
    """
    path = Path(path)
    with readable(path, "polynomial texture map"):
        data = read_bounded(path, MAX_BINARY_BYTES)
        return _image(data, _header(data[:_HEADER]), max_pixels)


def _header(data: bytes) -> _Header:
    first = _FIRST_LINES.match(data)
    if first is None:
        raise UnreadableError("it does not begin with PTM_1.2 and a line PTM_FORMAT_...")
    version, kind = first[1].decode(), first[2].decode()
    if kind not in _BYTES or version not in ("PTM_1.1", "PTM_1.2"):
        raise UnreadableError(
            f"{version} of the kind {kind}: only PTM_FORMAT_LRGB and PTM_FORMAT_RGB of version 1.1 "
            "and 1.2, without compression, are read"
        )
    found = _NUMBERS.match(data, first.end())
    if found is None:
        raise UnreadableError("its header is cut short or damaged")
    numbers = [_number(token) for token in found[1].split()]
    width, height = numbers[:2]
    if not (width.is_integer() and height.is_integer()):
        raise UnreadableError("its width or height is not a whole number")
    return _Header(version, kind, int(width), int(height), numbers[2:8], numbers[8:], found.end())


def _number(token: bytes) -> float:
    try:
        value = float(token)
    except ValueError as error:
        raise UnreadableError("its header is damaged: a number cannot be read") from error
    # Larger ones would overflow the coefficients.
    if not (math.isfinite(value) and abs(value) < 1e9):
        raise UnreadableError(f"its header is damaged: {value:g} is out of range")
    return value


def _image(data: bytes, header: _Header, max_pixels: int) -> RelightableImage:
    of_pixel = _BYTES[header.kind]
    width, height = header.width, header.height
    check_pixels(width, height, 8 * of_pixel, len(data), max_pixels)
    count = width * height
    missing = header.end + of_pixel * count - len(data)
    if missing > 0:
        raise UnreadableError(f"{missing} bytes are missing: cut short, copy it again")
    # Some programs end the file with a newline.
    if missing < -2:
        raise UnreadableError(f"{-missing} bytes too many for {width} x {height} pixels: damaged")
    body = np.frombuffer(data, np.uint8, of_pixel * count, header.end)
    if header.kind == "PTM_FORMAT_RGB":
        blocks = body.reshape(3, height, width, 6)[:, ::-1]
        decoded = [_coefficients(block, header) for block in blocks]
        return RelightableImage("ptm", np.stack(decoded, axis=-1))
    if header.version == "PTM_1.1":
        together = body.reshape(height, width, 9)[::-1]
        samples, colour = together[..., :6], together[..., 6:]
    else:
        samples = body[: 6 * count].reshape(height, width, 6)[::-1]
        colour = body[6 * count :].reshape(height, width, 3)[::-1]
    tint = colour.astype(np.float32) / np.float32(_WHITE)
    return RelightableImage("ptm", _coefficients(samples, header), tint)


def _coefficients(samples: UInt8, header: _Header) -> Float32:
    scale = np.array(header.scale, np.float32)[_FROM_FILE] / np.float32(_WHITE)
    bias = np.array(header.bias, np.float32)[_FROM_FILE]
    return (samples[..., _FROM_FILE].astype(np.float32) - bias) * scale
