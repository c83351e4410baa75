"""A board program under test: its lines on the wire, its edges and its inputs."""

from __future__ import annotations

import binascii
import os
import select
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from rig.host import clock
from tests.rig.board_program import BoardProgram, Event

# Limits for the start of a program, an answer and an edge on a computer with other load.
START_S = 20.0
ANSWER_S = 5.0
EDGE_S = 15.0
# Long enough for an unexpected answer to arrive.
QUIET_S = 0.15
# A pty accepts more at once than 115200 baud transfer.
PIECE = 64
PIECE_S = 0.006


@dataclass(frozen=True)
class Identity:
    """The words of the answer to ID."""

    name: str
    protocol: int
    firmware: str
    leds: int
    max_hold_ms: int
    watchdog_ms: int
    steps: int


class BoardUnderTest(BoardProgram):
    """Starts a board program and communicates with it, without sharing code with it.

    Parameters
    ----------
    command
        Command that starts the program. The program prints ``{"port": PATH}``, then
        ``{"us": T, "lit": [LED, ...]}`` and ``{"us": T, "trigger": 0 or 1}`` for every edge; its
        standard input accepts ``active 0``, ``active 1`` and ``reset``; it ends when its standard
        input is closed.
    late_us
        How much later than declared an edge may be, in addition to 0.5 % of any time.
    """

    def __init__(self, command: list[str], *, late_us: int) -> None:
        super().__init__(command)
        self._begin(late_us)

    def _begin(self, late_us: int) -> None:
        self.late_us = late_us
        self._events: deque[Event] = deque()
        # All edges since the start.
        self.seen: list[Event] = []
        self.port = self._first_line()
        self._open_port(self.port)
        self._seq = 0x1000
        self._rest = b""
        self.identity = self.greet()

    def greet(self) -> Identity:
        """Send ID until the board answers: it may ignore commands while it starts."""
        for _ in range(round(START_S / 0.25)):
            self.write(b"\n" + line(self.next_seq(), "ID"))
            for text in self.lines(0.25):
                words = text.partition("*")[0].split()
                if words[:3] == [f"<{self._seq:04X}", "OK", "ID"]:
                    return Identity(
                        words[3], int(words[4]), words[5], *(int(word) for word in words[6:])
                    )
        raise AssertionError("the board does not answer")

    def prepare(self) -> None:
        """Make the board idle."""
        # A late answer, to a check that has failed, must not be taken for one of the next check.
        list(self.lines(0))
        self.active(False)
        self.ask("OFF")
        self.drain()

    def reset(self) -> None:
        """Reset the board and wait until it answers."""
        self.order("reset")
        # Its pending output is cut off; output during the start is ignored.
        self.greet()
        list(self.lines(QUIET_S))

    def active(self, up: bool) -> None:
        """Drive the exposure-active input."""
        self.order(f"active {int(up)}")

    def next_seq(self) -> int:
        """Return a sequence number that has not been used for a long time."""
        self._seq = (self._seq + 1) % 0x10000
        return self._seq

    def write(self, data: bytes) -> None:
        """Send bytes unchanged, no faster than a wire does."""
        for start in range(0, len(data), PIECE):
            if start:
                clock.sleep(PIECE_S)
            self._send(data[start : start + PIECE])

    def send(self, words: str, seq: int | None = None) -> int:
        """Send a command; return its number."""
        seq = self.next_seq() if seq is None else seq
        self.write(line(seq, words))
        return seq

    def answer(self, seq: int, timeout_s: float = ANSWER_S) -> str:
        """Return the words of the next answer, which must be complete and have this number."""
        for text in self.lines(timeout_s):
            body, _, crc = text.partition("*")
            assert crc == f"{binascii.crc_hqx(body.encode(), 0xFFFF):04X}", text
            assert len(text) <= 80, text
            assert body[:6] == f"<{seq:04X} ", f"{text} does not answer {seq:04X}"
            return body[6:]
        raise AssertionError(f"no answer to {seq:04X}")

    def ask(self, words: str, seq: int | None = None) -> str:
        """Send a command and return the words of its answer."""
        return self.answer(self.send(words, seq))

    def ok(self, words: str, seq: int | None = None) -> str:
        """Send a command that must be accepted; return the words after its verb."""
        answer = self.ask(words, seq)
        ok, _, rest = answer.partition(" ")
        assert ok == "OK", f"{words}: {answer}"
        verb, _, outcome = rest.partition(" ")
        assert verb == words.split()[0], f"{words}: {answer}"
        return outcome

    def silent(self, timeout_s: float = QUIET_S) -> None:
        """Require that there is no answer."""
        said = list(self.lines(timeout_s))
        assert not said, f"an unexpected answer: {said}"

    def status(self) -> Status:
        """Return the answer to STATUS."""
        words = self.ok("STATUS").split()
        assert len(words) == 7, words
        return Status(
            int(words[0]), words[1], int(words[2]), int(words[3]), words[5], int(words[6])
        )

    def wait(self, ms: int) -> None:
        """Wait until the board's own clock has advanced by this time; this sends STATUS."""
        start_ms = self.status().uptime_ms
        while self.status().uptime_ms - start_ms <= ms:
            clock.sleep(0.01)

    def lines(self, timeout_s: float) -> Iterator[str]:
        """Yield the lines that arrive within a time."""
        ends_s = clock.monotonic() + timeout_s
        while True:
            text, found, rest = self._rest.partition(b"\n")
            if found:
                self._rest = rest
                yield text.decode("ascii", "replace").rstrip("\r")
                continue
            ready = self._await(ends_s, self._fd, self._output)
            if self._fd in ready:
                self._rest += self._receive()
            if self._output in ready:
                self._take_events()
            if not ready:
                return

    def next_event(self, timeout_s: float) -> Event | None:
        """Return the next edge, None if no edge arrives within a time."""
        ends_s = clock.monotonic() + timeout_s
        while not self._events:
            if not self._await(ends_s, self._output):
                return None
            self._take_events()
        return self._events.popleft()

    def edge(self, kind: str, value: object) -> int:
        """Return the time, us, of the next edge, which must be this one."""
        event = self.next_event(EDGE_S)
        assert event is not None, f"no {kind} {value}; the last were {self.seen[-6:]}"
        assert event.get(kind) == value, f"expected {kind} {value}, got {event}"
        moment: int = event["us"]
        return moment

    def lit(self, *leds: int) -> int:
        """Return the time, us, of the next edge, at which exactly these LEDs must be on."""
        return self.edge("lit", list(leds))

    def flash(self, led: int | None) -> Edges:
        """Return the edges of a flash, which must be the next ones."""
        on = None if led is None else self.lit(led)
        up, down = self.edge("trigger", 1), None
        # A short pulse falls when the LED turns off.
        if led is None:
            return Edges(None, up, self.edge("trigger", 0), None)
        event = self.next_event(EDGE_S)
        assert event is not None, "the flash does not end"
        if "trigger" in event:
            down, off = event["us"], self.lit()
        else:
            assert event["lit"] == [], event
            off, down = event["us"], self.edge("trigger", 0)
        return Edges(on, up, down, off)

    def no_edge(self, within_s: float = QUIET_S) -> None:
        """Require that there is no edge."""
        event = self.next_event(within_s)
        assert event is None, f"an unexpected edge: {event}"

    def drain(self) -> list[Event]:
        """Return and remove all edges so far."""
        # Edges before the first of two answers have been printed before the second.
        self.status()
        self.status()
        while self._await(0, self._output):
            self._take_events()
        drained = list(self._events)
        self._events.clear()
        return drained

    def after(self, start_us: int, end_us: int, declared_us: int) -> None:
        """Require that the time between two edges is as declared."""
        passed_us = end_us - start_us
        allowed_us = self.late_us + declared_us // 200
        early_us = min(self.late_us, 20) + declared_us // 200
        assert declared_us - early_us <= passed_us <= declared_us + allowed_us, (
            f"{passed_us} us, but {declared_us} us were declared"
        )

    def _first_line(self) -> str:
        ends_s = clock.monotonic() + START_S
        while not self._events:
            assert self._await(ends_s, self._output), "the program does not start"
            self._take_events()
        port: str = self._events.popleft()["port"]
        del self.seen[0]
        return port

    def _take_events(self) -> None:
        events = self._read_events()
        self._events.extend(events)
        self.seen.extend(events)

    def _send(self, data: bytes) -> None:
        os.write(self._fd, data)

    def _receive(self) -> bytes:
        return os.read(self._fd, 4096)

    def _await(self, ends_s: float, *fds: int) -> list[int]:
        return select.select(fds, [], [], max(0.0, ends_s - clock.monotonic()))[0]


@dataclass(frozen=True)
class Status:
    """The words of the answer to STATUS that the checks use."""

    uptime_ms: int
    led: str
    faults: int
    trips: int
    state: str
    done: int


@dataclass(frozen=True)
class Edges:
    """Times, us, of a flash: LED on, trigger line up and down, LED off."""

    on: int | None
    up: int
    down: int | None
    off: int | None


def line(seq: int, words: str) -> bytes:
    """Return a command as it is on the wire."""
    return signed(f">{seq:04X} {words}".encode("latin-1")) + b"\n"


def signed(body: bytes) -> bytes:
    """Return a line with its checksum."""
    return body + b"*%04X" % binascii.crc_hqx(body, 0xFFFF)
