"""The board client on a virtual board that is made to fail."""

import time

import pytest
import serial

from rig import Board, BoardError
from simulator._board_faults import BoardFault


@pytest.fixture
def board(bench):
    board = Board(bench.virtual.port)
    board.off()
    yield board
    board.close()


def burning(bench):
    return bench.state.led(time.monotonic_ns())


def test_identity(board):
    identity = board.identity
    assert (identity.protocol, identity.leds, identity.max_hold_ms) == (1, 36, 10_000)


def test_on_lights_the_led_and_off_says_that_it_burned(bench, board):
    assert board.on(7, 5000).led == 7
    assert burning(bench) == 7
    assert board.status().led == 7
    assert board.off().led == 7
    assert burning(bench) is None
    assert board.off().led is None
    assert board.status().led is None


def test_exactly_one_led_burns(bench, board):
    board.on(3, 5000)
    board.on(35, 5000)
    assert burning(bench) == 35
    assert [p.led for p in bench.state.periods()][-2:] == [3, 35]
    assert board.off().led == 35


def test_the_board_itself_ends_the_hold(bench, board):
    board.on(5, 30)
    time.sleep(0.05)
    assert burning(bench) is None
    last = bench.state.periods()[-1]
    assert last.end_ns - last.start_ns == 30_000_000
    assert board.off().led is None


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(BoardFault(kind="drop-command", verb="ON"), id="lost command"),
        pytest.param(BoardFault(kind="drop-reply", verb="ON"), id="lost reply"),
        pytest.param(BoardFault(kind="corrupt-reply", verb="ON"), id="corrupt reply"),
        pytest.param(BoardFault(kind="delay-reply", verb="ON", value=300), id="late reply"),
        pytest.param(BoardFault(kind="banner", verb="ON"), id="noise spoils the reply"),
        pytest.param(BoardFault(kind="reset", verb="ON"), id="reset instead of ON"),
    ],
)
def test_one_failed_exchange_is_mended_by_a_repetition(bench, board, fault):
    bench.virtual.set_faults(fault)
    before = len([p for p in bench.state.periods() if p.led == 9])
    assert board.on(9, 5000).led == 9
    assert burning(bench) == 9
    assert board.off().led == 9
    # A repetition must not light the LED a second time.
    assert len([p for p in bench.state.periods() if p.led == 9]) == before + 1


def test_a_late_reply_is_never_taken_for_the_next_commands(bench, board):
    # The answer "LED 1 burned" comes 300 ms late, while the client waits for the next OFF's.
    bench.virtual.set_faults(
        BoardFault(kind="delay-reply", verb="OFF", value=300),
        BoardFault(kind="drop-reply", verb="OFF", skip=2),
    )
    board.on(1, 5000)
    assert board.off().led == 1
    board.on(2, 5000)
    assert board.off().led == 2


def test_a_lost_reply_to_off_still_tells_what_burned(bench, board):
    board.on(11, 5000)
    bench.virtual.set_faults(BoardFault(kind="drop-reply", verb="OFF"))
    assert board.off().led == 11


def test_off_tries_hard(bench, board):
    board.on(11, 9000)
    bench.virtual.set_faults(BoardFault(kind="drop-command", verb="OFF", times=6))
    assert board.off().led == 11
    assert burning(bench) is None


def one_line(error, *parts):
    text = str(error.value)
    assert "\n" not in text
    for part in parts:
        assert part in text


def test_another_led_lit_is_an_error(bench, board):
    bench.virtual.set_faults(BoardFault(kind="wrong-led", verb="ON", value=8))
    with pytest.raises(BoardError) as error:
        board.on(7, 5000)
    one_line(error, board.port, "LED 7", "LED 8")
    assert board.off().led == 8


def test_a_board_that_stops_answering(bench, board):
    bench.virtual.set_faults(BoardFault(kind="drop-command", times=100))
    with pytest.raises(BoardError) as error:
        board.on(7, 5000)
    one_line(error, board.port, "ON LED 7", "0.75 s")


@pytest.mark.parametrize(
    ("led", "hold_ms", "reason"),
    [
        pytest.param(36, 100, "error 3: no such led", id="LED"),
        pytest.param(0, 0, "error 4: bad hold", id="no hold"),
        pytest.param(0, 10_001, "error 4: bad hold", id="long hold"),
        pytest.param(-1, 100, "error 2: bad arguments", id="negative"),
    ],
)
def test_refusals_name_port_led_and_reason(bench, board, led, hold_ms, reason):
    with pytest.raises(BoardError) as error:
        board.on(led, hold_ms)
    one_line(error, board.port, f"ON LED {led}", reason)
    assert burning(bench) is None


def test_a_reset_in_mid_shot_shows_in_off_and_uptime(bench, board):
    board.on(4, 5000)
    bench.virtual.set_faults(BoardFault(kind="reset", verb="STATUS"))
    assert board.status().uptime_ms < 1000
    assert burning(bench) is None
    assert board.off().led is None


def test_damaged_commands_are_counted_and_not_obeyed(bench, board):
    before = board.status().faults
    board._serial.write(b">0001 ON 7 5000*0000\n")
    assert board.status().faults == before + 1
    assert burning(bench) is None


def test_a_command_cut_short_does_not_spoil_the_off_that_follows(bench, board):
    board.on(7, 5000)
    board._serial.write(b">0001 ON 8 50")
    assert board.off().led == 7
    assert burning(bench) is None


def test_the_handshake_survives_a_board_that_is_still_starting(bench):
    bench.virtual.set_faults(
        BoardFault(kind="drop-command", times=3), BoardFault(kind="banner", skip=3)
    )
    board = Board(bench.virtual.port)
    assert board.identity.leds == 36
    board.close()


def test_a_busy_port(bench, board):
    with pytest.raises(BoardError) as error:
        Board(board.port)
    one_line(error, board.port, "no other program uses it")


def test_unplugged(own_bench):
    board = Board(own_bench.virtual.port)
    board.on(7, 200)
    own_bench.virtual.unplug()
    for act in (lambda: board.on(8, 100), board.off, board.status):
        with pytest.raises(BoardError) as error:
            act()
        one_line(error, board.port, "unplugged")
    time.sleep(0.2)
    assert burning(own_bench) is None
    board.close()


def test_a_port_that_cannot_be_closed_does_not_hide_why_it_was_refused(bench, monkeypatch):
    really_close = serial.Serial.close

    def close(self):
        really_close(self)
        raise OSError("stuck")

    def handshake(self, timeout_s):
        raise BoardError("the first thing to go wrong")

    monkeypatch.setattr(serial.Serial, "close", close)
    monkeypatch.setattr(Board, "_handshake", handshake)
    with pytest.raises(BoardError, match="the first thing") as caught:
        Board(bench.virtual.port)
    assert len(caught.value.__notes__) == 1
    assert caught.value.__notes__[0].startswith("on closing: LED board on")
    monkeypatch.undo()
    Board(bench.virtual.port).close()
