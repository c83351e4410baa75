"""Checks for all readers of files: limits for their content, and one error if it is unreadable.

A file that may be damaged or of another origin is checked here before a parser reads it: it must be
a regular file, not too large, not nested too deeply, and its numbers not too long. Exceptions of a
parser become one error, which each package converts to its own (decision 13).
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
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

# A plan of 60,000 LEDs has 0.4 MB, a session.toml with 4096 lights has 1 MB.
MAX_TOML_BYTES: Final = 2 << 20
# Files of lights and cameras, and notes of an export: 60,000 lights have 10 MB.
MAX_TEXT_BYTES: Final = 16 << 20
# Files of pixels, vertices and arrays, which are also limited by the size that they declare.
MAX_BINARY_BYTES: Final = 16 << 30
MAX_NESTING: Final = 32
# More than a double has, and few enough that Python converts them quickly and without an error.
MAX_DIGITS: Final = 300
MAX_PIXELS: Final = 200_000_000
# Deflate reaches 1032; `_SMALL_BYTES` allows for codecs that pack a uniform image more densely.
_MAX_EXPANSION: Final = 1032
_SMALL_BYTES: Final = 32 << 20

# Tokens of TOML and JSON: strings, comments, brackets, ends of dotted keys, and words.
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

# Exceptions that the parsers in use have been seen to raise for damaged bytes. Their own exception
# classes are passed in by the callers.
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


class FileStatus(NamedTuple):
    """What differs if a file was replaced or changed, even if its time was set back.

    The number of its inode is not part of it: exFAT and several network file systems give a file
    another one after a while.

    Parameters
    ----------
    size
        Bytes.
    mtime_ns, ctime_ns
        Times of the last change of the content and of the file itself, in ns; programs can set the
        first one only.
    """

    size: int
    mtime_ns: int
    ctime_ns: int

    @classmethod
    def of(cls, status: os.stat_result) -> Self:
        """Return the part of a status that a reading does not change."""
        return cls(status.st_size, status.st_mtime_ns, status.st_ctime_ns)


_read: dict[Path, FileStatus] | None = None


@contextmanager
def files_read() -> Iterator[Mapping[Path, FileStatus]]:
    """Collect the files that are read in the block, by all threads of this process.

    Yields
    ------
    Mapping[Path, FileStatus]
        The status of each file when it was first opened, by its absolute path.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import read_bounded
    >>> from rig.files import files_read
    >>> _ = Path("notes.txt").write_text("owl")
    >>> with files_read() as found:
    ...     _ = read_bounded(Path("notes.txt"))
    >>> [(path.name, status.size) for path, status in found.items()]
    [('notes.txt', 3)]
    """
    global _read  # readers have no other way to reach the command that they work for
    before, _read = _read, {}
    try:
        yield _read
    finally:
        _read = before


def note_read(path: Path, descriptor: int) -> os.stat_result:
    """Return the status of an open file, which is kept if it is the first one inside `files_read`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig.files import note_read
    >>> _ = Path("notes.txt").write_text("owl")
    >>> with Path("notes.txt").open("rb") as file:
    ...     note_read(Path("notes.txt"), file.fileno()).st_size
    3
    """
    status = os.fstat(descriptor)
    if _read is not None:
        _read.setdefault(Path(os.path.abspath(path)), FileStatus.of(status))
    return status


def status_when_read(path: Path) -> FileStatus | None:
    """Return the status that a file had when it was first opened; None if it was not noted.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig.files import status_when_read
    >>> status_when_read(Path("notes.txt")) is None
    True
    """
    return None if _read is None else _read.get(Path(os.path.abspath(path)))


class SgpError(Exception):
    """Base class of all errors that the packages raise on purpose."""


class UnreadableError(SgpError, ValueError):
    """A file that its reader cannot accept. The message does not name the file."""


def read_bounded(path: Path, most_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Return the bytes of a regular file of limited size; links are followed.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UnreadableError
        If it cannot be read, is not a regular file (and might never end), or has more bytes.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import read_bounded
    >>> _ = Path("notes.txt").write_text("owl")
    >>> read_bounded(Path("notes.txt"), most_bytes=100)
    b'owl'
    """
    data, size = read_head(path, most_bytes)
    if size > most_bytes:
        raise UnreadableError(
            f"larger than {most_bytes >> 20} MB, the limit for a file of this kind: is it the "
            "right file?"
        )
    return data


def read_head(path: Path, count: int) -> tuple[bytes, int]:
    """Return the first bytes of a regular file and its size; raises as `read_bounded`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig.files import read_head
    >>> _ = Path("notes.txt").write_text("an owl")
    >>> read_head(Path("notes.txt"), 2)
    (b'an', 6)
    """
    try:
        # Opening a pipe for reading would wait for its writer.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | _BINARY)
        with os.fdopen(descriptor, "rb") as file:
            status = note_read(path, descriptor)
            if stat.S_ISDIR(status.st_mode):
                raise IsADirectoryError
            if not stat.S_ISREG(status.st_mode):
                raise UnreadableError("not a regular file: put the file itself there")
            # read() allocates the requested size immediately, so limit it to the file's size.
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
    """Refuse, in one pass, a TOML or JSON text that would overload a parser.

    Raises
    ------
    UnreadableError
        If brackets or dotted keys are nested too deeply or a number has too many digits; the
        message names the line.

    Examples
    --------
    >>> from rig.files import check_text
    >>> check_text("leds = [[0, 1], [2, 3]]")
    >>> check_text("[" * 10_000)
    Traceback (most recent call last):
        ...
    rig.UnreadableError: line 1: nested more than 32 levels deep: is it the right file?
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
                        f"line {line}: a number has more than {MAX_DIGITS} digits: correct it"
                    )
        if max(depth, dots) > MAX_NESTING:
            line = text.count("\n", 0, token.start()) + 1
            raise UnreadableError(
                f"line {line}: nested more than {MAX_NESTING} levels deep: is it the right file?"
            )


def parse_toml(data: bytes) -> dict[str, Any]:
    """Parse the bytes of a TOML file.

    Raises
    ------
    UnreadableError
        If they are not UTF-8 or not TOML, or if `check_text` refuses them.

    Examples
    --------
    >>> from rig.files import parse_toml
    >>> parse_toml(b"leds = 36")
    {'leds': 36}
    """
    with convert_parser_errors("is not TOML"):
        text = data.decode("utf-8-sig")
        check_text(text)
        return tomllib.loads(text)


def parse_json(data: bytes | str) -> Any:
    """Parse a JSON text; raises as `parse_toml`.

    Examples
    --------
    >>> from rig.files import parse_json
    >>> parse_json('{"leds": 36}')
    {'leds': 36}
    """
    with convert_parser_errors("is not JSON"):
        text = data if isinstance(data, str) else data.decode("utf-8-sig")
        check_text(text)
        return json.loads(text)


def check_pixels(
    width: int, height: int, pixel_bits: int, file_bytes: int, max_pixels: int = MAX_PIXELS
) -> None:
    """Refuse an image before it is decoded if it declares more pixels than allowed.

    Parameters
    ----------
    width, height
        Size as the header declares it.
    pixel_bits
        Bits of one pixel as the file stores it, all channels.
    file_bytes
        Size of the file.
    max_pixels
        Largest number of pixels that the caller allows.

    Raises
    ------
    UnreadableError
        If there are no pixels, more than ``max_pixels``, or far more than the file can hold.

    Examples
    --------
    >>> from rig.files import check_pixels
    >>> check_pixels(640, 480, 24, file_bytes=300_000)
    >>> check_pixels(60_000, 60_000, 24, file_bytes=300_000)
    Traceback (most recent call last):
        ...
    rig.UnreadableError: an image of 60000 x 60000 pixels, 200000000 are allowed: ...
    """
    if width < 1 or height < 1:
        raise UnreadableError(f"an image of {width} x {height} pixels: its header is damaged")
    if width * height > max_pixels:
        raise UnreadableError(
            f"an image of {width} x {height} pixels, {max_pixels} are allowed: if the size is "
            "correct, raise the limit on pixels"
        )
    if width * height * pixel_bits // 8 > _SMALL_BYTES + _MAX_EXPANSION * file_bytes:
        raise UnreadableError(
            f"declares {width} x {height} pixels, which {file_bytes} bytes cannot hold: cut short "
            "or damaged, copy it again"
        )


@contextmanager
def convert_parser_errors(what: str, *own: type[Exception]) -> Iterator[None]:
    """Convert any exception that a parser raises for damaged bytes to an `UnreadableError`.

    The block should contain only the call of the parser: an error in other code would be reported
    as an error of the file.

    Parameters
    ----------
    what
        Beginning of the message, for instance ``is not TOML``; the parser's reason follows.
    own
        Exception classes of the parser.

    Examples
    --------
    >>> from rig.files import convert_parser_errors
    >>> with convert_parser_errors("is not a list of numbers"):
    ...     [int(word) for word in "1 2 x".split()]
    Traceback (most recent call last):
        ...
    rig.UnreadableError: is not a list of numbers: invalid literal for int() with base 10: 'x'
    """
    try:
        yield
    except SgpError:
        raise
    except (*_PROVOKED, *own) as error:
        raise UnreadableError(f"{what}: {reason_of(error)}") from error


def reason_of(error: BaseException) -> str:
    """Return a parser's reason as part of one line."""
    match error:
        case MemoryError():
            return "it needs more memory than there is"
        case RecursionError():
            return "nested too deeply"
    reason = error.args[0] if error.args else ""
    text = reason.decode("ascii", "replace") if isinstance(reason, bytes) else str(error)
    said = " ".join(text.split()) or type(error).__name__
    return said if len(said) <= _LONGEST_REASON else f"{said[:_LONGEST_REASON]}..."
