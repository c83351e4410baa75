"""Ptys with other devices than a board behind them."""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Callable, Iterator

from rig.board import LineError, Reply, decode_command, encode_reply


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
