"""Ports without a usable board, and wrong answers."""

import contextlib
import os
import threading
import time
import tty
from pathlib import Path

import pytest

from rig import Board, BoardError
from rig.board import Step
from rig.board import line as board_line
from tests.rig.fake_port import IDENTITY, VirtualPorts, device, saying

TIMEOUT_S = 0.25


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        pytest.param(lambda line: b"", "no answer within 0.25 s", id="silent"),
        pytest.param(lambda line: line + b"\n", "it sent", id="echo"),
        pytest.param(lambda line: b"$GPGGA,1*00\r\n", "$GPGGA", id="another device"),
        pytest.param(lambda line: bytes(range(256)) * 4, "it sent", id="noise"),
        pytest.param(saying("dome", "1", "3.0", "36", "10000"), "speaks protocol 1", id="older"),
        pytest.param(saying("dome", "3", "3.0", "36"), "speaks protocol 3", id="newer"),
        pytest.param(saying("dome"), "speaks protocol ?", id="no version"),
        pytest.param(saying("dome", "2", "1.0"), "reply is invalid", id="no LED count"),
        pytest.param(saying(*IDENTITY[:6]), "reply is invalid", id="no step count"),
        pytest.param(saying(*IDENTITY[:3], "x", *IDENTITY[4:]), "is invalid", id="LED count x"),
        pytest.param(saying(*IDENTITY[:3], "-1", *IDENTITY[4:]), "is invalid", id="LED count -1"),
        pytest.param(saying(*IDENTITY, STATUS=("5", "-", "0")), "is invalid", id="STATUS of 1"),
    ],
)
@pytest.mark.usefixtures("world")
def test_other_devices_are_refused(answer, said, monkeypatch):
    with VirtualPorts(monkeypatch).device(answer) as port:
        with pytest.raises(BoardError) as error:
            Board(port, handshake_timeout_s=TIMEOUT_S)
        assert port in str(error.value)
        assert said in str(error.value)
        assert "\n" not in str(error.value)
        # The port was closed: it opens again, and fails for the same reason.
        with pytest.raises(BoardError, match=r"protocol|no answer|is invalid"):
            Board(port, handshake_timeout_s=0.05)


def test_the_identity_of_another_firmware_is_accepted():
    with device(saying(*IDENTITY)) as port:
        board = Board(port)
        assert (board.identity.name, board.identity.firmware) == ("dome", "3.5")
        assert (board.identity.leds, board.identity.max_hold_ms) == (24, 3000)
        assert (board.identity.watchdog_ms, board.identity.max_steps) == (1000, 8)
        board.close()


WRONG_ANSWERS = {
    "other LED": ("ON", ("8", "500"), lambda b: b.on(7, 500), "did ON LED 8 500 instead"),
    "other hold": ("ON", ("7", "9"), lambda b: b.on(7, 500), "LED 7 9 instead"),
    "no hold": ("ON", ("7",), lambda b: b.on(7, 500), "did ON LED 7 instead"),
    "ON of nothing": ("ON", (), lambda b: b.on(7, 500), "did ON instead"),
    "OFF of nothing": ("OFF", (), lambda b: b.off(), "is invalid"),
    "OFF of x": ("OFF", ("x",), lambda b: b.off(), "is invalid"),
    "level": ("LEVEL", ("7", "1"), lambda b: b.level(7, 2), "LED 7 1 instead"),
    "other flash": ("FLASH", ("8", "-", "9", "-"), lambda b: b.flash(7, 0, 9), "LED 8 - 9 -"),
    "flash cut": ("FLASH", ("7", "-", "9"), lambda b: b.flash(7, 0, 9), "is invalid"),
    "flash active": ("FLASH", ("7", "-", "9", "+"), lambda b: b.flash(7, 0, 9), "is invalid"),
    "other step": (
        "STEP",
        ("0", "7", "1", "20", "3"),
        lambda b: b.load([Step(7, 1, 10, 3)]),
        "did STEP 0 LED 7 1 20 3 instead of STEP 0 LED 7 1 10 3",
    ),
    "other count": ("RUN", ("2",), lambda b: b.run(1), "RUN 2 instead of RUN 1 T"),
    "other did": ("DID", ("1", "7", "0", "9", "-"), lambda b: b.step_report(0), "DID 1 LED 7"),
    "did cut": ("DID", ("0", "7", "0", "9"), lambda b: b.step_report(0), "is invalid"),
}


@pytest.mark.parametrize(
    ("verb", "outcome", "act", "said"), WRONG_ANSWERS.values(), ids=WRONG_ANSWERS
)
def test_wrong_answers_are_refused(verb, outcome, act, said):
    with device(saying(*IDENTITY, **{verb: outcome})) as port:
        board = Board(port)
        with pytest.raises(BoardError) as error:
            act(board)
        assert said in str(error.value)
        assert port in str(error.value)
        assert "\n" not in str(error.value)
        board.close()


def test_a_board_without_a_thermometer():
    outcome = ("5", "-", "0", "0", "-", "IDLE", "0")
    with device(saying(*IDENTITY, STATUS=outcome)) as port:
        board = Board(port)
        assert board.status().temperature_c is None
        board.close()


@pytest.mark.usefixtures("world")
def test_a_device_that_sends_noise_does_not_delay_the_host(monkeypatch):
    ports = VirtualPorts(monkeypatch)
    with ports.device(lambda line: b"", chatter=b"73.2,18.1\r\n") as port:
        with pytest.raises(BoardError) as error:
            Board(port, handshake_timeout_s=0.5)
        assert "no answer within 0.5 s, but it sent b'73.2,18.1'" in str(error.value)


def test_a_board_is_found_in_spite_of_noise():
    with device(saying(*IDENTITY), chatter=b"\xff\x00<0000 OK \n") as port:
        board = Board(port)
        assert board.identity.leds == 24
        board.close()


def fill(fd: int) -> None:
    """Write until the other end would have to read first."""
    written = 1
    while written:
        written = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                written += os.write(fd, b"x" * 1000)
        # The written bytes move to the other end, which makes room again.
        time.sleep(0.1)


def test_a_device_that_does_not_read_is_reported(monkeypatch):
    monkeypatch.setattr(board_line, "_WRITE_TIMEOUT_S", 0.1)
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(slave, False)
    fill(slave)
    try:
        with pytest.raises(BoardError, match="no device accepts the data sent") as error:
            Board(os.ttyname(slave))
        assert "\n" not in str(error.value)
    finally:
        os.close(slave)
        os.close(master)


def test_darken_discards_unsent_data():
    lines = []
    reads = threading.Event()

    def answer(line):
        lines.append(line)
        if b" ON " in line:
            # It is busy, so it does not read.
            assert reads.wait(60)
        return saying(*IDENTITY)(line)

    with device(answer) as port:
        board = Board(port)
        board._line._serial.write(b">0000 ON 7 500*0000\n")
        fill(board._line._serial.fd)
        board.darken()
        reads.set()
        ends = time.monotonic() + 10
        while b" OFF*" not in lines[-1]:
            assert time.monotonic() < ends
            time.sleep(0.01)
        board.close()


@pytest.mark.parametrize("kind", ["absent", "file", "folder", "nul"])
def test_a_path_that_is_not_a_port_is_refused(kind, tmp_path: Path):
    (tmp_path / "file").write_text("text")
    port = {"folder": str(tmp_path), "nul": "a\0b"}.get(kind, str(tmp_path / kind))
    with pytest.raises(BoardError, match="cannot be opened") as error:
        Board(port)
    assert "\n" not in str(error.value)
