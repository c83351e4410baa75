"""Finding the board among ports that are silent, busy, gone, or other devices."""

import contextlib
import os
import threading
import tty

import pytest

from rig import Board, BoardError
from rig.board import find_board, find_boards
from rig.board import ports as ports
from rig.host import clock, lines
from tests.rig.fake_port import IDENTITY, VirtualPorts, device, saying

TIMEOUT_S = 0.5


@contextlib.contextmanager
def neighbours(device):
    """Open ports of every kind without a board; yield the expected complaint of each.

    Other devices receive only an empty line and ID.
    """
    heard = []

    def listens(line):
        heard.append(line)
        return b""

    with contextlib.ExitStack() as stack:
        silent = stack.enter_context(device(listens))
        chatters = stack.enter_context(device(lambda line: b"", chatter=b"$GPGGA\r\n"))
        echoes = stack.enter_context(device(lambda line: line + b"\n"))
        older = stack.enter_context(device(saying("dome", "1", "1.0", "36", "10000")))
        busy = stack.enter_context(device(saying(*IDENTITY)))
        owner = Board(busy)
        stack.callback(owner.close)
        yield {
            silent: "no answer within 0.5 s",
            chatters: "it sent b'$GPGGA'",
            echoes: "no answer",
            older: "speaks protocol 1",
            busy: "no other program uses it",
            "/dev/no-such-port": "cannot be opened",
        }
    assert len(set(heard)) == 1
    assert heard[0][5:8] == b" ID"


def test_the_board_is_found_among_others(real_bench):
    with neighbours(device) as others:
        found = find_boards([*others, real_bench.virtual.port], timeout_s=TIMEOUT_S)
        assert [port.port for port in found] == [*others, real_bench.virtual.port]
        for port, said in zip(found, others.values(), strict=False):
            assert port.identity is None
            assert port.port in port.problem
            assert said in port.problem
            assert "\n" not in port.problem
        assert found[-1].identity is not None
        assert (found[-1].identity.name, found[-1].problem) == ("sgp-virtual-board", "")
        # Without those that are waited for.
        soon = [*list(others)[3:], real_bench.virtual.port]
        assert find_board(soon, timeout_s=TIMEOUT_S) == real_bench.virtual.port
    # The port of the board was closed.
    Board(real_bench.virtual.port).close()


def test_all_ports_are_queried_at_the_same_time():
    """Each device answers when all have been asked."""
    heard, all_asked = set(), threading.Event()
    says = saying("dome", "1", "1.0", "36", "10000")

    def listening(number):
        def answer(line):
            heard.add(number)
            if len(heard) == 3:
                all_asked.set()
            return says(line) if all_asked.wait(60) else b""

        return device(answer)

    with contextlib.ExitStack() as stack:
        found = find_boards(
            [stack.enter_context(listening(number)) for number in range(3)], timeout_s=60
        )
    assert all("speaks protocol 1" in port.problem for port in found)


@pytest.mark.usefixtures("world")
def test_without_a_board_the_message_lists_every_port(monkeypatch):
    with neighbours(VirtualPorts(monkeypatch).device) as others:
        with pytest.raises(BoardError, match="no LED board found") as error:
            find_board(others, timeout_s=TIMEOUT_S)
        for port, said in others.items():
            assert port in str(error.value)
            assert said in str(error.value)
        assert "\n" not in str(error.value)
        assert not str(error.value).endswith("check cable and power"), "each has its own advice"


def test_no_ports_at_all(monkeypatch):
    monkeypatch.setattr(lines, "ports", dict)
    assert find_boards() == ()
    with pytest.raises(BoardError, match="no serial port; check cable and power"):
        find_board()


def test_the_ports_of_this_computer_are_queried(monkeypatch, real_bench):
    monkeypatch.setattr(lines, "ports", lambda: {real_bench.virtual.port: "its socket"})
    assert find_board() == real_bench.virtual.port


def test_several_boards_are_listed_and_one_is_chosen_by_name(real_bench):
    dome = saying(*IDENTITY)
    with device(dome) as first, device(dome) as second:
        everything = [first, real_bench.virtual.port, second]
        with pytest.raises(BoardError, match="3 LED boards found") as error:
            find_board(everything)
        for port in everything:
            assert port in str(error.value)
        assert find_board(everything, name="sgp-virtual-board") == real_bench.virtual.port
        with pytest.raises(BoardError, match="2 LED boards named dome found") as error:
            find_board(everything, name="dome")
        assert real_bench.virtual.port not in str(error.value)
        with pytest.raises(BoardError, match="no LED board named ring found: dome is on"):
            find_board(everything, name="ring")


def test_a_port_named_twice_is_one_port(real_bench):
    assert len(find_boards([real_bench.virtual.port] * 3)) == 1


def test_a_port_whose_driver_never_returns_does_not_delay_others(monkeypatch, bench):
    opened = ports.Board

    def stuck(port, **options):
        if port == "stuck":
            clock.sleep(60)
            raise BoardError("at last")
        return opened(port, **options)

    monkeypatch.setattr(ports, "Board", stuck)
    monkeypatch.setattr(ports, "_GRACE_S", 0.5)
    found = find_boards(["stuck", bench.virtual.port], timeout_s=TIMEOUT_S)
    assert "takes longer than 1 s" in found[0].problem
    assert found[1].identity is not None


def test_a_port_that_disappears_while_it_is_queried():
    master, slave = os.openpty()
    tty.setraw(slave)
    port = os.ttyname(slave)

    def vanish():
        os.read(master, 100)
        os.close(master)

    thread = threading.Thread(target=vanish)
    thread.start()
    (found,) = find_boards([port], timeout_s=TIMEOUT_S)
    thread.join()
    os.close(slave)
    assert found.identity is None
    assert "unplugged" in found.problem
