"""The guard of the readers: what it accepts, what it refuses, and its messages."""

from __future__ import annotations

import json
import os
from contextlib import nullcontext, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import MAX_PIXELS, RigConfigError, UnreadableError, read_bounded, read_rig_config
from rig.files import check_pixels, check_text, convert_parser_errors, parse_json, parse_toml
from tests.cases import cases

needs_fifo = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFO")


@cases(
    ("text", "said"),
    {
        "arrays": ("a = " + "[" * 20_000, "line 1: nested more than 32 levels deep"),
        "tables": ("a = " + "{b = " * 20_000, "line 1: nested more than 32 levels deep"),
        "dotted key": ("\n\n" + "a." * 20_000 + "a = 1", "line 3: nested"),
        "quoted dotted header": ("[" + '"a" . ' * 20_000 + "a]", "line 1: nested"),
        "digits": ("x = 1\ny = " + "9" * 4301, "line 2: a number has more than"),
        "hexadecimal digits": ("y = 0x" + "f" * 301, "digits"),
        "string without end": ('a = """[[', "is not TOML"),
        "twice": ("a = 1\na = 2", "is not TOML"),
        "empty": ("", None),
        "some nesting": ("a = [[[[1]]]]\nb.c.d.e = 'x'", None),
        "brackets in a string": (f"a = '{'[' * 100}'", None),
        "an escaped quote": (f'a = "\\"{"[" * 100}"', None),
        "brackets in a long string": (f'a = """\n"{"[" * 100}"""', None),
        "brackets in a comment": (f"# {'[' * 100}\na = 1", None),
        "digits in a string": (f"a = '{'9' * 5000}'", None),
    },
)
def test_toml(text: str, said: str | None) -> None:
    if said is None:
        assert isinstance(parse_toml(text.encode()), dict)
        return
    with pytest.raises(UnreadableError, match=said) as caught:
        parse_toml(text.encode())
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("[" * 100_000, id="deep"),
        pytest.param('{"a":' * 100_000, id="deep objects"),
        pytest.param("[" + "9" * 5000 + "]", id="digits"),
        pytest.param('{"a": 1', id="cut short"),
    ],
)
def test_json(text: str) -> None:
    with pytest.raises(UnreadableError, match=r"is not JSON|nested|digits"):
        parse_json(text)


def test_a_byte_order_mark_is_no_part_of_a_text() -> None:
    assert parse_toml(b"\xef\xbb\xbfa = 1\r\n") == {"a": 1}
    assert parse_json(b'\xef\xbb\xbf{"a": 1}\r\n') == {"a": 1}


def test_bytes_that_are_not_utf8() -> None:
    for parse in (parse_toml, parse_json):
        with pytest.raises(UnreadableError, match="utf-8"):
            parse(b'{"a": "\xff"}')


@given(st.text(alphabet="[]{}\"'#=,.\n\\a1 ", max_size=200))
def test_random_text_raises_only_unreadable_errors(text: str) -> None:
    for parse in (parse_toml, parse_json):
        with suppress(UnreadableError):
            parse(text.encode())


@given(st.dictionaries(st.text("ab.\"' ", max_size=4), st.lists(st.floats(allow_nan=False))))
def test_json_output_passes(content: dict[str, list[float]]) -> None:
    assert parse_json(json.dumps(content)) == content
    check_text(json.dumps(content, indent=1))


@needs_fifo
def test_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UnreadableError, match="not a regular file"):
        read_bounded(tmp_path / "pipe")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        pytest.param("/dev/zero", "not a regular file", id="device"),
        pytest.param(".", "a folder", id="folder"),
        pytest.param("a" * 300, "cannot be read", id="long name"),
        pytest.param("a\0b", "cannot be read", id="NUL in the name"),
    ],
)
def test_other_things_than_files_are_refused(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(UnreadableError, match=said):
        read_bounded(tmp_path / name)


@pytest.mark.parametrize("name", ["nowhere", "file/below"])
def test_missing_files(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(FileNotFoundError):
        read_bounded(tmp_path / name)


def test_a_large_file_is_not_read(tmp_path: Path) -> None:
    """The file is sparse: reading it would need more memory than there is."""
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(UnreadableError, match="larger than 16 MB"):
        read_bounded(path)


@pytest.mark.parametrize(
    ("size", "bits", "file_bytes", "said"),
    [
        ((20_000, 20_000), 8, 2_300_000, "200000000 are allowed"),
        ((0, 5), 8, 100, "header is damaged"),
        ((-1, -5), 8, 100, "header is damaged"),
        ((14_000, 14_000), 48, 20_000, "cannot hold"),
        ((14_000, 14_000), 1, 20_000, None),
        ((100, 100), 8, 100, None),
    ],
)
def test_pixels(size: tuple[int, int], bits: int, file_bytes: int, said: str | None) -> None:
    with nullcontext() if said is None else pytest.raises(UnreadableError, match=said):
        check_pixels(*size, bits, file_bytes)


def test_the_limit_on_pixels_can_be_raised() -> None:
    assert MAX_PIXELS == 200_000_000
    check_pixels(20_000, 20_000, 8, 500_000_000, max_pixels=400_000_000)


def test_other_exceptions_are_not_converted() -> None:
    """Only the listed exceptions count as damage of the file; all others are passed on."""

    class OtherError(Exception):
        pass

    with pytest.raises(OtherError), convert_parser_errors("damaged"):
        raise OtherError
    with (
        pytest.raises(UnreadableError, match="damaged: OtherError"),
        convert_parser_errors("damaged", OtherError),
    ):
        raise OtherError
    with pytest.raises(KeyboardInterrupt), convert_parser_errors("damaged"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RecursionError("maximum recursion depth exceeded"), "damaged: nested too deeply"),
        (MemoryError(), "damaged: it needs more memory than there is"),
        (ValueError("a\nb\tc"), "damaged: a b c"),
        (ValueError("x" * 1000), "damaged: xxx"),
    ],
)
def test_reasons_are_one_short_line(error: Exception, said: str) -> None:
    with pytest.raises(UnreadableError, match=said) as caught, convert_parser_errors("damaged"):
        raise error
    assert len(str(caught.value)) < 150
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["[" * 20_000, "leds = " + "9" * 5000, "options = " + "[" * 20_000, "a." * 20_000]
)
def test_rig_files_are_guarded(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(RigConfigError, match=r"rig\.toml"):
        read_rig_config(path)
