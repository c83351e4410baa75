"""Lines of the serial protocol: the examples of docs/serial-protocol.md, and invalid lines."""

import string
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.board import (
    Command,
    LineBuffer,
    LineError,
    Reply,
    crc16,
    decode_command,
    decode_reply,
    encode_command,
    encode_reply,
)

PROTOCOL = Path(__file__).parents[2] / "docs" / "serial-protocol.md"

words = st.text(
    "".join(c for c in string.printable if "!" <= c <= "~" and c != "*"), min_size=1, max_size=8
)
numbers = st.integers(0, 0xFFFF)
commands = st.builds(Command, numbers, words, st.lists(words, max_size=4).map(tuple))
errors = st.none() | st.integers(1, 9999)
replies = st.builds(Reply, numbers, words, st.lists(words, max_size=4).map(tuple), errors)


def shown_lines() -> list[bytes]:
    lines = PROTOCOL.read_text().splitlines()
    return [line.encode() for line in lines if line[:1] in "<>" and "*" in line]


def test_crc_is_ccitt_false_by_its_published_check_value():
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"") == 0xFFFF


@pytest.mark.parametrize(
    ("command", "line"),
    [
        pytest.param(Command(0x00A0, "ID"), b">00A0 ID*31F0\n", id="identity"),
        pytest.param(Command(0x00A1, "ON", ("7", "1012")), b">00A1 ON 7 1012*5D2F\n", id="on"),
        pytest.param(Command(0x00A2, "OFF"), b">00A2 OFF*6E31\n", id="off"),
        pytest.param(Command(0x00A4, "STATUS"), b">00A4 STATUS*2F44\n", id="status"),
    ],
)
def test_golden_commands(command, line):
    assert encode_command(command) == line
    assert decode_command(line.rstrip()) == command


@pytest.mark.parametrize(
    ("reply", "line"),
    [
        pytest.param(Reply(0xA1, "ON", ("7", "1012")), b"<00A1 OK ON 7 1012*751B\n", id="on"),
        pytest.param(Reply(0xA2, "OFF", ("7",)), b"<00A2 OK OFF 7*90D3\n", id="was on"),
        pytest.param(Reply(0xA3, "OFF", ("-",)), b"<00A3 OK OFF -*4CED\n", id="was off"),
        pytest.param(Reply(0xA5, "ON", ("36", "500"), 3), b"<00A5 E3 ON 36 500*D60E\n", id="E3"),
    ],
)
def test_golden_replies(reply, line):
    assert encode_reply(reply) == line
    assert decode_reply(line.rstrip()) == reply


def test_every_line_the_document_shows_is_a_line_of_the_protocol():
    lines = shown_lines()
    assert len(lines) == 22
    for line in lines:
        decode = decode_command if line.startswith(b">") else decode_reply
        decode(line)


def line_with_crc(body: bytes) -> bytes:
    return body + b"*%04X" % crc16(body)


@pytest.mark.parametrize(
    "line",
    [
        pytest.param(b"", id="empty"),
        pytest.param(b">00A2 OFF", id="no checksum"),
        pytest.param(b">00A2 OFF*6E32", id="wrong checksum"),
        pytest.param(b">00A2 OFF*6e31", id="small letters"),
        pytest.param(line_with_crc(b"<00A2 OFF"), id="a reply"),
        pytest.param(line_with_crc(b"00A2 OFF"), id="no mark"),
        pytest.param(line_with_crc(b">A2 OFF"), id="short number"),
        pytest.param(line_with_crc(b">00A2  OFF"), id="two spaces"),
        pytest.param(line_with_crc(b">00A2 OFF "), id="space at the end"),
        pytest.param(line_with_crc(b">00A2"), id="no verb"),
        pytest.param(line_with_crc(b">00A2 \xc3\xa4"), id="not ASCII"),
        pytest.param(line_with_crc(b">00A2 A*B"), id="star inside"),
        pytest.param(line_with_crc(b">00A2 " + b"X" * 60), id="too long"),
        pytest.param(b"\xff" + line_with_crc(b">00A2 OFF"), id="noise before"),
        pytest.param(line_with_crc(b">00A2 OFF") + b"\r", id="stray end"),
    ],
)
def test_lines_that_are_not_commands_are_refused(line):
    with pytest.raises(LineError):
        decode_command(line)


@pytest.mark.parametrize(
    "body", [b"<0001 OK", b"<0001 E0 ON", b"<0001 ON 7", b"<0001 E ON", b">0001 OK ON"]
)
def test_lines_that_are_not_replies_are_refused(body):
    with pytest.raises(LineError):
        decode_reply(line_with_crc(body))


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(Command(0, "TWO WORDS"), id="space"),
        pytest.param(Command(0, "A*"), id="star"),
        pytest.param(Command(0, ""), id="empty"),
        pytest.param(Command(0x10000, "ID"), id="number too big"),
        pytest.param(Command(0, "X" * 60), id="too long"),
    ],
)
def test_invalid_commands_are_not_encoded(command):
    with pytest.raises(LineError):
        encode_command(command)


@given(command=commands, reply=replies)
@settings(max_examples=200)
def test_lines_round_trip(command, reply):
    assert decode_command(encode_command(command).rstrip(b"\n")) == command
    assert decode_reply(encode_reply(reply).rstrip(b"\n")) == reply


@pytest.mark.parametrize("line", shown_lines(), ids=lambda line: line.decode())
def test_no_single_flipped_bit_passes(line):
    decode = decode_command if line.startswith(b">") else decode_reply
    for bit in range(8 * len(line)):
        damaged = bytearray(line)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(LineError):
            decode(bytes(damaged))


@given(command=commands, data=st.data())
@settings(max_examples=200)
def test_up_to_three_flipped_bits_under_the_checksum_never_pass(command, data):
    # The CRC's Hamming distance is 4 at these lengths.
    line = bytearray(encode_command(command).rstrip(b"\n"))
    bits = st.integers(0, 8 * line.index(b"*") - 1)
    for bit in data.draw(st.lists(bits, min_size=1, max_size=3, unique=True)):
        line[bit // 8] ^= 1 << bit % 8
    with pytest.raises(LineError):
        decode_command(bytes(line))


@given(st.binary(max_size=100))
@settings(max_examples=300)
def test_random_bytes_raise_only_line_errors(data):
    for decode in (decode_command, decode_reply):
        with pytest.raises(LineError):
            decode(data)


@given(lines=st.lists(commands.map(encode_command), max_size=6), data=st.data())
@settings(max_examples=100)
def test_lines_are_assembled_from_any_pieces(lines, data):
    stream = b"\r\n".join(line.rstrip() for line in lines) + b"\n"
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=8).map(sorted))
    buffer = LineBuffer()
    got = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += buffer.feed(stream[start:end])
    assert got == [line.rstrip() for line in lines]


def test_noise_without_a_line_end_is_discarded():
    buffer = LineBuffer()
    for _ in range(100):
        assert buffer.feed(b"x" * 1000) == []
    assert len(buffer._rest) < 200
    assert buffer.feed(b"y\n<line>\n") == [b"<line>"]


def longest(mark: str, words: str, limit: int) -> bytes:
    """Return a complete line of exactly ``limit`` characters."""
    body = f"{mark}0001 {words} ".encode()
    body += b"x" * (limit - len(body) - 5)
    return body + f"*{crc16(body):04X}".encode()


@pytest.mark.parametrize(
    ("decode", "mark", "words", "limit"),
    [
        pytest.param(decode_command, ">", "ON", 64, id="command"),
        pytest.param(decode_reply, "<", "OK ON", 80, id="reply"),
    ],
)
def test_the_longest_allowed_line_is_accepted(decode, mark, words, limit):
    line = longest(mark, words, limit)
    assert len(line) == limit
    value = decode(line)
    encode = encode_command if isinstance(value, Command) else encode_reply
    assert encode(value) == line + b"\n"
    with pytest.raises(LineError, match="not a line"):
        decode(longest(mark, words, limit + 1))
    with pytest.raises(LineError, match=f"one line of {limit} characters"):
        encode(type(value)(1, "ON", (value.args[0] + "x",)))


def test_a_buffer_keeps_lines_up_to_its_limit():
    assert LineBuffer(4).feed(b"\n\r\n1\n12\r\n1234\n1234\r\n12345\n\n") == [
        *(b"1", b"12", b"1234", b"1234"),
    ]
    assert LineBuffer().feed(b"x" * 80 + b"\n" + b"x" * 81 + b"\n") == [b"x" * 80]
    # The line end may arrive in two pieces, after a line of maximum length.
    buffer = LineBuffer(4)
    assert [buffer.feed(piece) for piece in (b"1234\r", b"\n12345", b"\n", b"1\n")] == [
        *([], [b"1234"], [], [b"1"]),
    ]
