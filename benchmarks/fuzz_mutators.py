"""Mutations of files for `fuzz_readers.py`: random, from lists of bad values, and format-aware."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from random import Random

Mutator = Callable[[bytes, Random], bytes]

_HEADER = 512
# Bytes that mutations may add; more would exceed the memory limit that the readers must keep.
_LARGEST = 4_000_000
_WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_DEEP = (100, 3000, 30_000)
_NUMBERS = (
    b"nan", b"inf", b"-inf", b"1e400", b"-1", b"0", b"1e-400", b"1e308", b"2147483648", b"65536",
    b"18446744073709551616", b"9" * 30, b"9" * 400, b"9" * 5000, b"0x10", b"1_000", b"1.5", b"",
)  # fmt: skip
_STRINGS = (
    b"\0", b"\xff\xfe", b"\x1b[2J\x1b]0;owned\x07", "\u202egnp.exe".encode(), b"a" * 300,
    b"../../../etc/passwd", b"/dev/zero", b"/dev/null", b"\xc2\x9b31m", b"'", b'"', b'"""', b"\\",
    b"\r", b"\n", b"#", b"{", b"]", b":", b"-", b"<", b"&", b"\xed\xa0\x80", b"%s%n",
    b"a" * 100_000,
)  # fmt: skip
_NESTS = (
    (b"[", b"]"), (b"{", b"}"), (b'{"a":', b"}"), (b"{a = ", b"}"), (b"(", b")"), (b"- ", b""),
    (b"<a>", b"</a>"), (b"a.", b"a"), (b"[[", b"]]"), (b"{a: ", b"}"), (b"-", b""), (b"a: ", b""),
)  # fmt: skip


def mutated(data: bytes, dice: Random, text: bool) -> bytes:
    """Return the data after one to four mutations for text or binary files."""
    kinds = TEXT if text else BINARY
    most = len(data) + _LARGEST
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        data = dice.choice(kinds)(data, dice)[:most]
    return data


def _place(data: bytes, dice: Random) -> int:
    """Draw a position, every other time from the header."""
    end = len(data) if dice.random() < 0.5 else min(len(data), _HEADER)
    return dice.randrange(end) if end else 0


def flip(data: bytes, dice: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(dice.choice((1, 1, 1, 2, 8))):
        if changed:
            changed[_place(data, dice)] ^= 1 << dice.randrange(8)
    return bytes(changed)


def word(data: bytes, dice: Random) -> bytes:
    """Replace 1, 2, 4 or 8 bytes with a number that is often mishandled."""
    size = dice.choice("BHIQ")
    value = dice.choice(_WORDS) & ((1 << 8 * struct.calcsize(size)) - 1)
    at = _place(data, dice) & ~dice.choice((0, 1, 3))
    bits = struct.pack(dice.choice("<>") + size, value)
    return (data[:at] + bits + data[at + len(bits) :])[: max(len(data), at)]


def cut(data: bytes, dice: Random) -> bytes:
    return data[: _place(data, dice)]


def lengthen(data: bytes, dice: Random) -> bytes:
    return data + dice.choice((b"\0", b"\xff", b"\n", data[:100])) * dice.choice((1, 100, 10_000))


def _piece(data: bytes, dice: Random) -> tuple[int, int]:
    start = _place(data, dice)
    return start, min(len(data), start + dice.choice((1, 4, 16, 100, 1000)))


def double(data: bytes, dice: Random) -> bytes:
    start, end = _piece(data, dice)
    return data[:end] + data[start:end] * dice.choice((1, 1, 1000)) + data[end:]


def drop(data: bytes, dice: Random) -> bytes:
    start, end = _piece(data, dice)
    return data[:start] + data[end:]


def splice(data: bytes, dice: Random) -> bytes:
    start, end = _piece(data, dice)
    at = _place(data, dice)
    return data[:at] + data[start:end] + data[at + end - start :]


def insert(data: bytes, dice: Random) -> bytes:
    at = _place(data, dice)
    return data[:at] + dice.choice(_STRINGS) + data[at:]


def number(data: bytes, dice: Random) -> bytes:
    return _replaced(data, dice, rb"[-+]?\d[\d.eE+_-]*", dice.choice(_NUMBERS))


def name(data: bytes, dice: Random) -> bytes:
    return _replaced(data, dice, rb"[A-Za-z_]\w*", dice.choice(_STRINGS + _NUMBERS))


def nest(data: bytes, dice: Random) -> bytes:
    deep = dice.choice(_DEEP)
    begin, end = dice.choice(_NESTS)
    nested = begin * deep + dice.choice((b"", b"1", b'"a"')) + dice.choice((b"", end * deep))
    if dice.random() < 0.3:
        return nested
    return _replaced(data, dice, rb"[-+]?\d[\d.eE+_-]*|[\[{<\n]", nested)


def line(data: bytes, dice: Random) -> bytes:
    """Repeat, drop, swap or lengthen a line."""
    lines = data.split(b"\n")
    at = dice.randrange(len(lines))
    match dice.randrange(5):
        case 0:
            lines[at:at] = [lines[at]] * _times(lines[at], dice.choice((1, 100, 20_000)))
        case 1:
            del lines[at]
        case 2:
            other = dice.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case 3:
            lines[at] = lines[at] * _times(lines[at], dice.choice((2, 1000)))
        case _:
            lines[at] = dice.choice(_STRINGS)
    return b"\n".join(lines)


def _times(piece: bytes, often: int) -> int:
    return min(often, _LARGEST // max(1, len(piece)) + 1)


def _replaced(data: bytes, dice: Random, pattern: bytes, new: bytes) -> bytes:
    # A choice of a few hundred places is enough in long files.
    spans = [match.span() for _, match in zip(range(400), re.finditer(pattern, data), strict=False)]
    if not spans:
        return insert(data, dice)
    start, end = dice.choice(spans)
    return data[:start] + new + data[end:]


BINARY: tuple[Mutator, ...] = (
    flip, flip, flip, flip, word, word, word, cut, lengthen, double, drop, splice, insert, number,
)  # fmt: skip
TEXT: tuple[Mutator, ...] = (
    flip, cut, double, drop, splice, insert, number, number, number, name, nest, nest, line, line,
)  # fmt: skip


def within_png(data: bytes, dice: Random) -> bytes:
    """Damage one chunk of a PNG and correct its CRC, so that the decoder sees the damage."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    place = dice.choice((0, dice.randrange(len(chunks))))
    kind, content = chunks[place]
    chunks[place] = (kind, mutated(content, dice, text=False))
    return data[:8] + b"".join(
        struct.pack(">I", len(content)) + kind + content
        + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in chunks
    )  # fmt: skip


def within_mat(data: bytes, dice: Random) -> bytes:
    """Damage the content of the compressed element of a MAT-5 file."""
    kind, size = struct.unpack("<II", data[128:136])
    if kind != 15:
        return mutated(data, dice, text=False)
    packed = zlib.compress(mutated(zlib.decompress(data[136 : 136 + size]), dice, text=False))
    return data[:128] + struct.pack("<II", 15, len(packed)) + packed


def within_glb(data: bytes, dice: Random) -> bytes:
    """Damage the JSON of a GLB file and correct the lengths."""
    size = int.from_bytes(data[12:16], "little")
    inner = mutated(data[20 : 20 + size], dice, text=True)
    inner += b" " * (-len(inner) % 4)
    rest = data[20 + size :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(inner) + len(rest), len(inner), 0x4E4F534A)
    return head + inner + rest


def within_journal(data: bytes, dice: Random) -> bytes:
    """Damage a journal and compute the hash of every line again, so that all hashes match."""
    from acquisition.files.storage import sha256_of

    previous, lines = "0" * 64, []
    for one in mutated(data, dice, text=True).split(b"\n"):
        text = one.rpartition(b',"line_sha256"')[0]
        if not text:
            continue
        previous = sha256_of(previous.encode() + text)
        lines.append(text + b',"line_sha256":"' + previous.encode() + b'"}\n')
    return b"".join(lines)
