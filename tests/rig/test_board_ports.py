"""Ports behind which no usable board is."""

import contextlib
import os
import threading
import tty
from pathlib import Path

import pytest

from rig import Board, BoardError, Command, Reply, decode_command, encode_reply

TIMEOUT_S = 0.25


@contextlib.contextmanager
def device(answer):
    """A pty whose far end sends ``answer(line)`` for every line it gets."""
    master, slave = os.openpty()
    tty.setraw(slave)

    def serve():
        rest = b""
        # The read fails once the far end is closed below.
        with contextlib.suppress(OSError):
            while data := os.read(master, 1000):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    if line == b"stop":
                        return
                    if line:
                        os.write(master, answer(line))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        os.write(slave, b"stop\n")
        thread.join()
        os.close(slave)
        os.close(master)


def identity(*words):
    def answer(line: bytes) -> bytes:
        command: Command = decode_command(line)
        return encode_reply(Reply(command.seq, command.verb, words))

    return answer


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        pytest.param(lambda line: b"", "no answer within 0.25 s", id="silent"),
        pytest.param(lambda line: line + b"\n", "it does send", id="echo of our own words"),
        pytest.param(lambda line: b"$GPGGA,1*00\r\n", "$GPGGA", id="another device"),
        pytest.param(lambda line: bytes(range(256)) * 4, "it does send", id="noise"),
        pytest.param(identity("dome", "2", "3.0", "36", "10000"), "speaks protocol 2", id="newer"),
        pytest.param(identity("dome"), "speaks protocol ?", id="no version"),
        pytest.param(identity("dome", "1", "1.0"), "makes no sense", id="no LED count"),
        pytest.param(identity("dome", "1", "1.0", "x", "5"), "makes no sense", id="LED count x"),
    ],
)
def test_what_is_not_our_board(answer, said):
    with device(answer) as port:
        with pytest.raises(BoardError) as error:
            Board(port, handshake_timeout_s=TIMEOUT_S)
        assert port in str(error.value)
        assert said in str(error.value)
        assert "\n" not in str(error.value)
        # The port was given back: it opens again, and fails for the same reason.
        with pytest.raises(BoardError, match=r"protocol|no answer|no sense"):
            Board(port, handshake_timeout_s=TIMEOUT_S)


def test_a_board_of_another_make_is_taken_as_it_says():
    with device(identity("dome", "1", "2.5", "24", "3000")) as port:
        board = Board(port)
        assert (board.identity.name, board.identity.firmware) == ("dome", "2.5")
        assert (board.identity.leds, board.identity.max_hold_ms) == (24, 3000)
        board.close()


@pytest.mark.parametrize("kind", ["absent", "file", "folder", "nul"])
def test_what_is_not_a_port(kind, tmp_path: Path):
    (tmp_path / "file").write_text("text")
    port = {"folder": str(tmp_path), "nul": "a\0b"}.get(kind, str(tmp_path / kind))
    with pytest.raises(BoardError, match="cannot be opened") as error:
        Board(port)
    assert "\n" not in str(error.value)
