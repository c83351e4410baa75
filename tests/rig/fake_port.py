"""Ports with other devices than a board behind them: ptys, and ports in virtual time."""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Callable, Iterator

import pytest
from serial import SerialException

from rig.board import LineError, Reply, decode_command, encode_reply
from rig.host import clock, lines


@contextlib.contextmanager
def device(answer: Callable[[bytes], bytes], *, chatter: bytes = b"") -> Iterator[str]:
    """Open a pty whose other end sends ``answer(line)`` for every line, and always ``chatter``."""
    master, slave = os.openpty()
    tty.setraw(slave)
    over = threading.Event()

    def serve() -> None:
        rest = b""
        while data := os.read(master, 1000):
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                if line == b"stop":
                    return
                if line:
                    os.write(master, answer(line))

    def talk() -> None:
        os.set_blocking(master, True)
        while chatter and not over.wait(0.002):
            os.write(master, chatter)

    threads = [threading.Thread(target=serve), threading.Thread(target=talk)]
    for thread in threads:
        thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        over.set()
        os.write(slave, b"stop\n")
        # Unread data would block the thread that sends the chatter.
        os.set_blocking(slave, False)
        while any(thread.is_alive() for thread in threads):
            with contextlib.suppress(BlockingIOError):
                os.read(slave, 4096)
            threads[0].join(0.01)
        os.close(slave)
        os.close(master)


class VirtualPorts:
    """Ports in virtual time, which only those who use them wait for.

    Parameters
    ----------
    patch
        Makes them the ports that `rig.host.lines` opens, in the world of the fixture ``world``.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self._devices: dict[str, tuple[Callable[[bytes], bytes], bytes]] = {}
        self.in_use: set[str] = set()
        patch.setattr(lines, "open_line", self._open)

    @contextlib.contextmanager
    def device(self, answer: Callable[[bytes], bytes], *, chatter: bytes = b"") -> Iterator[str]:
        """Open a port; as the function `device`."""
        port = f"virtual-{len(self._devices)}"
        self._devices[port] = answer, chatter
        yield port

    def _open(self, port: str, *_: object, timeout: float, **__: object) -> _VirtualLine:
        if port not in self._devices:
            raise SerialException(f"no port {port}")
        if port in self.in_use:
            raise SerialException(f"{port} is in use")
        self.in_use.add(port)
        return _VirtualLine(*self._devices[port], timeout, lambda: self.in_use.remove(port))


class _VirtualLine:
    """A line to a device; as `serial.Serial`."""

    def __init__(
        self,
        answer: Callable[[bytes], bytes],
        chatter: bytes,
        timeout: float,
        close: Callable[[], None],
    ) -> None:
        self._answer, self._chatter, self.timeout, self.close = answer, chatter, timeout, close
        self._sent = self._arrived = b""

    @property
    def in_waiting(self) -> int:
        return len(self._arrived)

    def read(self, size: int) -> bytes:
        clock.sleep(min(self.timeout, 0.002) if self._arrived or self._chatter else self.timeout)
        self._arrived += self._chatter
        data, self._arrived = self._arrived[:size], self._arrived[size:]
        return data

    def write(self, data: bytes) -> None:
        *lines, self._sent = (self._sent + data).split(b"\n")
        self._arrived += b"".join(self._answer(line) for line in lines if line)

    def reset_input_buffer(self) -> None:
        self._arrived = b""


def saying(*words: str, **others: tuple[str, ...]) -> Callable[[bytes], bytes]:
    """Return a device that answers ID, STATUS, and the verbs in ``others`` with these words."""

    def answer(line: bytes) -> bytes:
        try:
            command = decode_command(line)
        except LineError:
            return b""
        outcome = {"ID": words, "STATUS": STATUS, **others}.get(command.verb)
        return b"" if outcome is None else encode_reply(Reply(command.seq, command.verb, outcome))

    return answer


IDENTITY = ("dome", "2", "3.5", "24", "3000", "1000", "8")
STATUS = ("5", "-", "0", "0", "-", "IDLE", "0")
