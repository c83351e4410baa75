"""The guard of every reader: what a file may ask for, and how a reader says that it asks too much.

A file that somebody else wrote or damaged is judged here before a parser sees it: it is a regular
file, not too large, not nested too deeply, and its numbers can be numbers. What a parser raises all
the same becomes one error, which each room turns into its own (decision 13).
"""

from __future__ import annotations

import json
import os
import re
import stat
import struct
import tokenize
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

# A plan of 60,000 LEDs has 0.4 MB, a session.toml with 4096 lights has 1 MB.
MAX_TOML_BYTES: Final = 2 << 20
# Lights, cameras, and notes of an export: 60,000 lights have 10 MB.
MAX_TEXT_BYTES: Final = 16 << 20
# Files of pixels, vertices and arrays, which are limited by what they declare, too.
MAX_BINARY_BYTES: Final = 16 << 30
MAX_NESTING: Final = 32
# More than a double has, and fewer than Python takes a second or an error for.
MAX_DIGITS: Final = 300
MAX_PIXELS: Final = 200_000_000
# Deflate reaches 1032; the few codecs that pack an even image more densely have the rest.
_MAX_EXPANSION: Final = 1032
_SMALL_BYTES: Final = 32 << 20

# Strings, comments, brackets, what ends a dotted key, and the words between: all of TOML and JSON.
_TOKEN = re.compile(
    r'"""[^"\\]*(?:(?:\\.|"(?!""))[^"\\]*)*"""'
    r"|'''.*?'''"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'"
    r"|#[^\n]*"
    r"|(?P<open>[\[{])|(?P<close>[\]}])|(?P<end>[\n=,])"
    r"|(?P<word>[^\s\"'#\[\]{}=,]+)",
    re.DOTALL,
)
_LONG_NUMBER = re.compile(rf"\d[\da-fx_]{{{MAX_DIGITS}}}", re.IGNORECASE)

# What the parsers at hand have been seen to raise when they were given damaged bytes. Errors of
# their own classes are named where they are called.
_PROVOKED: Final[tuple[type[Exception], ...]] = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    BufferError,
    EOFError,
    LookupError,
    MemoryError,
    NameError,
    OSError,
    RuntimeError,
    StopIteration,
    SyntaxError,
    SystemError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
)
_LONGEST_REASON: Final = 120
_BINARY: Final = getattr(os, "O_BINARY", 0)


class UnreadableError(ValueError):
    """A file that is not what its reader takes. The message does not name the file."""


def read_bounded(path: Path, most_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Return the bytes of a regular file, links followed, that is not too large.

    Raises
    ------
    FileNotFoundError
        If there is none.
    UnreadableError
        If it cannot be read, is no regular file, which might never end, or has more bytes.
    """
    data, size = read_head(path, most_bytes)
    if size > most_bytes:
        raise UnreadableError(
            f"larger than {most_bytes >> 20} MB, the most that a file of its kind has: is it the "
            "right file?"
        )
    return data


def read_head(path: Path, count: int) -> tuple[bytes, int]:
    """Return the first bytes of a regular file and its size; errors as of `read_bounded`."""
    try:
        # Opening a pipe for reading would wait for its writer.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | _BINARY)
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(descriptor)
            if stat.S_ISDIR(status.st_mode):
                raise IsADirectoryError
            if not stat.S_ISREG(status.st_mode):
                raise UnreadableError("not a regular file: put the file itself there")
            # A buffer of the size that is asked for is made at once.
            return file.read(min(count, status.st_size)), status.st_size
    except (FileNotFoundError, NotADirectoryError) as error:
        raise FileNotFoundError(str(path)) from error
    except IsADirectoryError as error:
        raise UnreadableError("a folder, not a file") from error
    except UnreadableError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise UnreadableError(f"cannot be read ({reason}): check the file") from error


def check_text(text: str) -> None:
    """Refuse a TOML or JSON text that a parser would choke on, in one pass.

    Raises
    ------
    UnreadableError
        If brackets or dotted keys are nested too deeply or a number has too many digits; the
        message names the line.
    """
    depth = dots = 0
    for token in _TOKEN.finditer(text):
        match token.lastgroup:
            case "open":
                depth += 1
            case "close":
                depth -= 1
            case "end":
                dots = 0
            case "word":
                word = token[0]
                dots += word.count(".")
                if len(word) > MAX_DIGITS and _LONG_NUMBER.search(word):
                    line = text.count("\n", 0, token.start()) + 1
                    raise UnreadableError(
                        f"line {line}: a number of more than {MAX_DIGITS} digits: correct it"
                    )
        if max(depth, dots) > MAX_NESTING:
            line = text.count("\n", 0, token.start()) + 1
            raise UnreadableError(
                f"line {line}: nested more than {MAX_NESTING} deep: is it the right file?"
            )


def parse_toml(data: bytes) -> dict[str, Any]:
    """Parse the bytes of a TOML file.

    Raises
    ------
    UnreadableError
        If they are not UTF-8 or not TOML, or see `check_text`.
    """
    with refusing("is not TOML"):
        text = data.decode("utf-8")
        check_text(text)
        return tomllib.loads(text)


def parse_json(data: bytes | str) -> Any:
    """Parse a JSON text. Errors are those of `parse_toml`."""
    with refusing("is not JSON"):
        text = data if isinstance(data, str) else data.decode("utf-8")
        check_text(text)
        return json.loads(text)


def check_pixels(
    width: int, height: int, pixel_bits: int, file_bytes: int, max_pixels: int = MAX_PIXELS
) -> None:
    """Refuse an image before it is decoded if it declares more pixels than it should.

    Parameters
    ----------
    width, height
        As the header declares them.
    pixel_bits
        Of one pixel as the file stores it, all channels.
    file_bytes
        Size of the file.
    max_pixels
        The most that the caller expects.

    Raises
    ------
    UnreadableError
        If there are none, more than ``max_pixels``, or far more than the file can hold.
    """
    if width < 1 or height < 1:
        raise UnreadableError(f"an image of {width} x {height} pixels: its header is damaged")
    if width * height > max_pixels:
        raise UnreadableError(
            f"an image of {width} x {height} pixels, {max_pixels} are allowed: if it is to be so "
            "large, raise the limit on pixels"
        )
    if width * height * pixel_bits // 8 > _SMALL_BYTES + _MAX_EXPANSION * file_bytes:
        raise UnreadableError(
            f"declares {width} x {height} pixels, which {file_bytes} bytes cannot hold: cut short "
            "or damaged, copy it again"
        )


@contextmanager
def refusing(what: str, *own: type[Exception]) -> Iterator[None]:
    """Turn whatever a parser raises over damaged bytes into an `UnreadableError`.

    Nothing but the call of the parser belongs into the block: an error of ours would pass as one of
    the file.

    Parameters
    ----------
    what
        What the file is then, such as ``is not TOML``; the parser's reason follows.
    own
        Error classes of the parser's own.
    """
    try:
        yield
    except (*_PROVOKED, *own) as error:
        raise UnreadableError(f"{what}: {reason_of(error)}") from error


def reason_of(error: BaseException) -> str:
    """Return what a parser has to say about a file, as part of one line."""
    match error:
        case MemoryError():
            return "it asks for more memory than there is"
        case RecursionError():
            return "nested too deeply"
    reason = error.args[0] if error.args else ""
    text = reason.decode("ascii", "replace") if isinstance(reason, bytes) else str(error)
    said = " ".join(text.split()) or type(error).__name__
    return said if len(said) <= _LONGEST_REASON else f"{said[:_LONGEST_REASON]}..."
