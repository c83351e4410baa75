"""The virtual board: its firmware by the document, its process by its birth and death."""

import os
import signal
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig import Command, Reply, RigError, decode_reply, encode_command
from simulator._bench_state import BenchWriter
from simulator._board_faults import BoardFault
from simulator._board_firmware import BoardFirmware
from simulator._virtual_board import VirtualBoard

MS = 1_000_000


@pytest.fixture(scope="module")
def writer(tmp_path_factory):
    writer = BenchWriter(tmp_path_factory.mktemp("bench") / "bench.state")
    yield writer
    writer.close()


@pytest.fixture
def firmware(writer):
    firmware = BoardFirmware(36, writer, 0)
    # Later than any period of an earlier test.
    firmware.boot(10**15)
    return firmware


def ask(firmware, seq, verb, *args, at_ms=0):
    line = encode_command(Command(seq, verb, args)).rstrip(b"\n")
    return decode_reply(firmware.handle(line, 10**15 + at_ms * MS).rstrip(b"\n"))


@pytest.mark.parametrize(
    ("words", "outcome"),
    [
        pytest.param(("ID",), "sgp-virtual-board 1 1.0.0 36 10000", id="identity"),
        pytest.param(("ON", "7", "1000"), "7 1000", id="on"),
        pytest.param(("ON", "35", "10000"), "35 10000", id="last LED, longest hold"),
        pytest.param(("ON", "0", "1"), "0 1", id="first LED, shortest hold"),
        pytest.param(("ON", "007", "1000"), "7 1000", id="leading zeros"),
        pytest.param(("OFF",), "-", id="off while dark"),
        pytest.param(("STATUS",), "5 - 0", id="status"),
    ],
)
def test_commands(firmware, words, outcome):
    assert ask(firmware, 1, *words, at_ms=5) == Reply(1, words[0], tuple(outcome.split()))


@pytest.mark.parametrize(
    ("words", "error"),
    [
        pytest.param(("FLASH", "1"), 1, id="a later version's verb"),
        pytest.param(("on", "7", "100"), 1, id="small letters"),
        pytest.param(("ON", "7"), 2, id="too few"),
        pytest.param(("ON", "7", "100", "1"), 2, id="too many"),
        pytest.param(("ID", "0"), 2, id="argument to ID"),
        pytest.param(("ON", "x", "100"), 2, id="not a number"),
        pytest.param(("ON", "-1", "100"), 2, id="sign"),
        pytest.param(("ON", "1234567890", "100"), 2, id="ten digits"),
        pytest.param(("ON", "36", "100"), 3, id="no such LED"),
        pytest.param(("ON", "7", "0"), 4, id="no hold"),
        pytest.param(("ON", "7", "10001"), 4, id="hold too long"),
        pytest.param(("ON", "36", "0"), 3, id="LED before hold"),
    ],
)
def test_refusals_repeat_the_command_and_change_nothing(firmware, words, error):
    ask(firmware, 1, "ON", "3", "1000")
    reply = ask(firmware, 2, *words, at_ms=1)
    assert reply == Reply(2, words[0], words[1:], error)
    assert ask(firmware, 3, "OFF", at_ms=2).args == ("3",)


def test_hold_runs_from_the_first_on_and_a_repetition_does_not_renew_it(firmware):
    first = ask(firmware, 1, "ON", "7", "100", at_ms=0)
    assert ask(firmware, 1, "ON", "7", "100", at_ms=60) == first
    assert ask(firmware, 2, "STATUS", at_ms=99).args[1] == "7"
    assert ask(firmware, 3, "STATUS", at_ms=100).args[1] == "-"
    assert ask(firmware, 4, "OFF", at_ms=101).args == ("-",)


def test_a_repeated_off_still_names_the_led(firmware):
    ask(firmware, 1, "ON", "7", "1000")
    assert ask(firmware, 2, "OFF", at_ms=1).args == ("7",)
    assert ask(firmware, 2, "OFF", at_ms=2).args == ("7",)
    assert ask(firmware, 3, "OFF", at_ms=3).args == ("-",)


def test_the_same_number_with_another_command_is_no_repetition(firmware):
    ask(firmware, 1, "ON", "7", "1000")
    assert ask(firmware, 1, "ON", "8", "1000", at_ms=1).args == ("8", "1000")
    assert ask(firmware, 2, "OFF", at_ms=2).args == ("8",)


def test_a_start_turns_off_and_forgets(firmware):
    ask(firmware, 1, "ON", "7", "1000")
    firmware.handle(b"damaged", 10**15)
    firmware.boot(10**15 + 5 * MS)
    assert ask(firmware, 1, "STATUS", at_ms=8).args == ("3", "-", "0")


@given(st.binary(max_size=90) | st.binary(max_size=55).map(lambda b: b">0001 " + b))
@settings(max_examples=300, deadline=None)
def test_damage_is_counted_and_never_answered(writer, line):
    firmware = BoardFirmware(36, writer, 0)
    assert firmware.handle(line, 2 * 10**15) is None
    assert ask(firmware, 9, "STATUS", at_ms=2 * 10**9).args[2] == "1"


@given(
    st.text("".join(map(chr, [*range(33, 42), *range(43, 127)])), min_size=1, max_size=12),
    st.lists(st.integers(0, 10**12).map(str) | st.just("x"), max_size=3),
)
@settings(max_examples=300, deadline=None)
def test_every_whole_command_gets_one_reply_that_echoes_it(writer, verb, args):
    firmware = BoardFirmware(36, writer, 0)
    reply = ask(firmware, 77, verb, *args)
    assert (reply.seq, reply.verb) == (77, verb)


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_closing_ends_process_and_file():
    board = VirtualBoard(3)
    assert board.bench_state_path.is_file()
    assert not gone(board.pid)
    board.close()
    board.close()
    assert gone(board.pid)
    assert not board.bench_state_path.exists()


def test_closing_after_a_death_still_cleans_up():
    with VirtualBoard(3) as board:
        os.kill(board.pid, signal.SIGKILL)
        time.sleep(0.05)
        assert board.bench_state_path.exists()
    assert not board.bench_state_path.exists()
    with pytest.raises(RigError, match="gone"):
        board.set_faults(BoardFault(kind="die"))


def test_a_board_that_does_not_start_says_why(monkeypatch):
    monkeypatch.setattr("sys.executable", "/bin/false")
    with pytest.raises(RigError, match="did not start: no answer"):
        VirtualBoard(3)
