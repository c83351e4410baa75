"""A board that refuses, resets, is unplugged or fails: each error is one clear line."""

import termios

import pytest
import serial

from rig import Board, BoardError
from rig.host import clock
from simulator.led_board import BoardFault
from tests.rig.board_calls import VERBS, one_line
from tests.rig.conftest import led_on


def test_a_reply_that_names_another_led_is_an_error(bench, board):
    bench.virtual.set_faults(BoardFault(kind="wrong-led", verb="ON", value=8))
    with pytest.raises(BoardError) as error:
        board.on(7, 5000)
    one_line(error, board.port, "LED 7", "LED 8")
    assert board.off().led == 8


def test_a_board_that_stops_answering(bench, board):
    bench.virtual.set_faults(BoardFault(kind="drop-command", times=100))
    with pytest.raises(BoardError) as error:
        board.on(7, 5000)
    one_line(error, board.port, "ON LED 7", "2 s")


@pytest.mark.parametrize(
    ("led", "hold_ms", "reason"),
    [
        pytest.param(36, 100, "error 3: no such led", id="LED"),
        pytest.param(0, 0, "error 4: bad time", id="no hold"),
        pytest.param(0, 60_001, "error 4: bad time", id="long hold"),
        pytest.param(-1, 100, "error 2: bad arguments", id="negative"),
    ],
)
def test_refusals_name_port_led_and_reason(bench, board, led, hold_ms, reason):
    with pytest.raises(BoardError) as error:
        board.on(led, hold_ms)
    one_line(error, board.port, f"ON LED {led}", reason)
    assert led_on(bench) is None


def test_a_reset_during_a_shot_shows_in_off_and_uptime(bench, board):
    board.on(4, 5000)
    bench.virtual.set_faults(BoardFault(kind="reset", verb="STATUS"))
    assert board.status().uptime_ms < 1000
    assert led_on(bench) is None
    assert board.off().led is None


def test_damaged_commands_are_counted_and_not_carried_out(bench, board):
    before = board.status().faults
    board._line._serial.write(b">0001 ON 7 5000*0000\n")
    assert board.status().faults == before + 1
    assert led_on(bench) is None


def test_a_command_cut_short_does_not_damage_the_next_off(bench, board):
    board.on(7, 5000)
    board._line._serial.write(b">0001 ON 8 50")
    assert board.off().led == 7
    assert led_on(bench) is None


def test_the_handshake_survives_a_board_that_is_still_starting(bench):
    bench.virtual.set_faults(
        BoardFault(kind="drop-command", times=3), BoardFault(kind="banner", skip=3)
    )
    board = Board(bench.virtual.port)
    assert board.identity.leds == 36
    board.close()


def test_a_busy_port(real_bench, real_board):
    with pytest.raises(BoardError) as error:
        Board(real_board.port)
    one_line(error, real_board.port, "no other program uses it")


def test_unplugged(own_bench):
    board = Board(own_bench.virtual.port)
    board.on(7, 100)
    own_bench.virtual.unplug()
    for verb, act in VERBS.items():
        with pytest.raises(BoardError) as error:
            act(board)
        one_line(error, board.port, verb, "unplugged")
    clock.sleep(0.1)
    assert led_on(own_bench) is None
    board.close()


def test_unplugged_and_plugged_in_again_on_the_same_path(own_bench):
    port = own_bench.virtual.port
    board = Board(port)
    board.on(7, 5000)
    own_bench.virtual.set_faults(BoardFault(kind="hang-up", verb="STATUS", value=200))
    with pytest.raises(BoardError, match="unplugged"):
        board.status()
    assert led_on(own_bench) is None
    board.close()
    ends = clock.monotonic() + 10
    while True:
        try:
            board = Board(port)
            break
        except BoardError:
            assert clock.monotonic() < ends
    assert board.status().uptime_ms < 10_000
    assert board.on(8, 5000).led == 8
    assert board.off().led == 8
    board.close()


@pytest.mark.parametrize(
    ("name", "error"),
    [
        pytest.param("write", serial.SerialException("gone"), id="write"),
        pytest.param("read", serial.SerialException("gone"), id="read"),
        pytest.param("in_waiting", OSError(5, "gone"), id="in_waiting"),
        pytest.param("write", serial.SerialTimeoutException("Write timeout"), id="full"),
    ],
)
def test_every_failure_of_the_port_is_a_board_error(
    real_bench, real_board, monkeypatch, name, error
):
    def fail(*_):
        raise error

    broken = property(fail) if name == "in_waiting" else fail
    monkeypatch.setattr(serial.Serial, name, broken)
    for verb, act in VERBS.items():
        with pytest.raises(BoardError) as caught:
            act(real_board)
        one_line(caught, real_board.port, verb, "gone" if "gone" in str(error) else "Write timeout")
    monkeypatch.undo()
    real_board.off()
    assert led_on(real_bench) is None


@pytest.mark.parametrize("error", [termios.error(5, "gone"), serial.SerialException("gone")])
def test_a_port_that_fails_during_the_handshake_is_closed(real_bench, monkeypatch, error):
    def fail(self):
        raise error

    monkeypatch.setattr(serial.Serial, "reset_input_buffer", fail)
    with pytest.raises(BoardError, match=r"ID: the connection is lost .*gone"):
        Board(real_bench.virtual.port)
    monkeypatch.undo()
    Board(real_bench.virtual.port).close()


def test_a_failure_while_closing_does_not_hide_the_first_error(real_bench, monkeypatch):
    really_close = serial.Serial.close

    def close(self):
        really_close(self)
        raise OSError("stuck")

    def handshake(self, timeout_s):
        raise BoardError("the first thing to go wrong")

    monkeypatch.setattr(serial.Serial, "close", close)
    monkeypatch.setattr(Board, "_handshake", handshake)
    with pytest.raises(BoardError, match="the first thing") as caught:
        Board(real_bench.virtual.port)
    assert len(caught.value.__notes__) == 1
    assert caught.value.__notes__[0].startswith("on closing: LED board on")
    monkeypatch.undo()
    Board(real_bench.virtual.port).close()
