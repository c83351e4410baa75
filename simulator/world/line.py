"""The LED board of the world, and the serial line to it."""

from __future__ import annotations

import random

from serial import SerialException

from simulator.led_board.faults import BoardFault, FaultyBoard, PowerCutError
from simulator.led_board.firmware import BoardFirmware
from simulator.led_board.outputs import ActiveInput, BoardOutputs
from simulator.world.light import LightHistory, LightView
from simulator.world.scheduler import NEVER_NS, Scheduler

# Bytes at 115200 baud, and the time in the driver.
_BYTE_NS = 87_000
_DRIVER_NS = (100_000, 1_500_000)
_MOST_UNREAD = 4096
_TICK_NS = 100_000_000


class WorldBoard:
    """The board, and both directions of its line.

    Parameters
    ----------
    scheduler
        Owner of the time.
    leds
        Number of LEDs.
    wired
        Whether the camera's exposure-active output reaches the board.

    Attributes
    ----------
    port
        Name of its port now.
    outputs
        LEDs and trigger line, with their edges.
    """

    def __init__(self, scheduler: Scheduler, leds: int, *, wired: bool = True) -> None:
        self._scheduler = scheduler
        self.port = "world"
        # How often it was plugged in: a line to an earlier one stays dead.
        self.plugs = 1
        self.history = LightHistory()
        self.view = LightView(self.history, self.advance)
        self.outputs = BoardOutputs(self.history)
        self._active = ActiveInput(self.view if wired else None)
        firmware = BoardFirmware(leds, self.outputs, self._active, scheduler.now_ns)
        self.board = FaultyBoard(firmware, self.outputs)
        # When the board is on the line again; it is now if this is not later than now.
        self.back_ns = 0
        self.user: object = None
        self.extra_ns = 0
        self.splits = 0
        self._to_board: list[tuple[int, bytes]] = []
        self._to_host: list[tuple[int, bytes]] = []
        self.arrived = b""
        # Before this time, nothing happens.
        self.due_ns = 0

    @property
    def present(self) -> bool:
        """Whether the port exists."""
        return self._scheduler.now_ns >= self.back_ns

    def add_fault(self, fault: BoardFault) -> None:
        """Add a fault to those that wait for their command."""
        self.board.add_fault(fault)

    def set_faults(self, *faults: BoardFault) -> None:
        """Replace the faults; the new ones apply to the commands sent from now on."""
        self.board.set_faults(faults)

    def set_active(self, up: bool) -> None:
        """Set the level of the exposure-active input."""
        self.advance()
        self.due_ns = 0
        self._active.set(up, self._scheduler.now_ns)

    def reset(self) -> None:
        """Restart the firmware."""
        self.advance()
        self.due_ns = 0
        self.board.reset(self._scheduler.now_ns)

    def unplug(self, away_ns: int = NEVER_NS, port: str | None = None) -> None:
        """Remove the board, for ever by default: an LED stays on until its declared end.

        Parameters
        ----------
        away_ns
            After this time, the board is plugged in again.
        port
            Name of its port then; the same by default.
        """
        self.advance()
        self.due_ns = 0
        self._gone_until(self._scheduler.now_ns + away_ns)
        self.port = port or self.port

    def repair(self) -> None:
        """End all faults: the operator has checked board and cable."""
        self.due_ns = 0
        self.board.set_faults(())
        self.extra_ns = self.splits = 0
        self.port = "world"
        if self.back_ns > self._scheduler.now_ns:
            self.back_ns = 0
            self.board.reset(self._scheduler.now_ns)

    def garbage(self, data: bytes) -> None:
        """Let bytes arrive that no device has sent."""
        self.due_ns = 0
        self._to_host.append((self._scheduler.now_ns, data))

    def sent(self, data: bytes) -> None:
        """Take bytes from the host."""
        self.due_ns = 0
        self._to_board.append((self._arrival_ns(self._to_board, len(data)), data))

    def next_ns(self) -> int:
        """Return when something arrives, or the board does something."""
        arrivals = [at for at, _ in (*self._to_board, *self._to_host)]
        back_ns = NEVER_NS if self.present else self.back_ns
        own_ns = self.board.next_ns(self._scheduler.now_ns)
        return min([*arrivals, own_ns, back_ns, NEVER_NS])

    def advance(self) -> None:
        """Do all that is due, in the order of time."""
        if self._scheduler.now_ns < self.due_ns:
            return
        before, self._scheduler.aside = self._scheduler.aside, True
        try:
            self._advance()
        finally:
            self._scheduler.aside = before
        self.due_ns = min(self.next_ns(), self._scheduler.now_ns + _TICK_NS)

    def _advance(self) -> None:
        now_ns = self._scheduler.now_ns
        if not self.present:
            self.board.advance(now_ns)  # no host hears it
            self._forget_bytes()
            return
        try:
            while self._to_board and self._to_board[0][0] <= now_ns:
                at_ns, data = self._to_board.pop(0)
                self._answer(self.board.advance(at_ns), at_ns)
                self.board.receive(data, at_ns)
                self._answer(self.board.advance(at_ns), at_ns)
            self._answer(self.board.advance(now_ns), now_ns)
        except PowerCutError as cut:
            self._gone_until(NEVER_NS if cut.back_ns is None else cut.back_ns)
            self.board.reset(now_ns)
        due = [data for at, data in self._to_host if at <= now_ns]
        self._to_host = [(at, data) for at, data in self._to_host if at > now_ns]
        self.arrived = (self.arrived + b"".join(due))[-_MOST_UNREAD:]

    def _gone_until(self, back_ns: int) -> None:
        self.back_ns = back_ns
        self.plugs += 1
        self.user = None
        self._forget_bytes()

    def _forget_bytes(self) -> None:
        self._to_board.clear()
        self._to_host.clear()

    def _answer(self, data: bytes, at_ns: int) -> None:
        generator: random.Random = self._scheduler.random
        while data:
            size = len(data)
            if self.splits > 0:
                self.splits -= 1
                size = generator.randint(1, size)
            arrives_ns = max(at_ns, self._arrival_ns(self._to_host, size))
            self._to_host.append((arrives_ns, data[:size]))
            data = data[size:]

    def _arrival_ns(self, queue: list[tuple[int, bytes]], count: int) -> int:
        driver_ns = self._scheduler.random.randint(*_DRIVER_NS) + self.extra_ns
        last_ns = queue[-1][0] if queue else 0
        return max(last_ns, self._scheduler.now_ns + driver_ns) + count * _BYTE_NS


class WorldLine:
    """A serial port of the world; as `serial.Serial`."""

    def __init__(
        self,
        scheduler: Scheduler,
        board: WorldBoard,
        port: str,
        *,
        timeout: float | None,
    ) -> None:
        scheduler.step("open the line")
        board.advance()
        user = board.user
        if not board.present or port != board.port:
            raise SerialException("no such port")
        if user is not None and not getattr(user, "dead", False):
            raise SerialException("the port is in use")
        self._scheduler = scheduler
        self._board = board
        self._program = scheduler.program
        board.user = self._program
        board.arrived = b""
        self.timeout = timeout
        self._open = True
        self._plugs = board.plugs

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived."""
        self._advance("line state")
        return len(self._board.arrived)

    def read(self, size: int = 1) -> bytes:
        """Return the next bytes, fewer if they do not arrive in time."""
        self._advance("read the line")
        board, scheduler = self._board, self._scheduler
        wait_ns = NEVER_NS if self.timeout is None else round(self.timeout * 1e9)

        def there() -> bool:
            board.advance()
            return len(board.arrived) >= size or board.plugs != self._plugs

        scheduler.wait(there, scheduler.now_ns + wait_ns, lambda: board.due_ns)
        self._check()
        data, board.arrived = board.arrived[:size], board.arrived[size:]
        return data

    def write(self, data: bytes) -> int:
        """Send bytes."""
        self._advance(f"send {data!r}")
        self._board.sent(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Discard what has arrived."""
        self._advance("discard input")
        self._board.arrived = b""

    def reset_output_buffer(self) -> None:
        """Discard nothing: what was written is on its way."""

    def close(self) -> None:
        """Close the port."""
        self._scheduler.step("close the line")
        self._open = False
        if self._board.user is self._program and self._board.plugs == self._plugs:
            self._board.user = None

    def _advance(self, name: str) -> None:
        self._scheduler.step(name)
        self._board.advance()
        self._check()

    def _check(self) -> None:
        if not self._open:
            raise SerialException("the port is closed")
        if self._board.plugs != self._plugs:
            raise SerialException("the device was disconnected")
