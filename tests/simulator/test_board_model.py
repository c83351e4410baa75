"""Random series of commands to the board, compared with a plain model of its protocol."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from rig.board import Command, ErrorCode, Reply, decode_reply, encode_command
from simulator.led_board.firmware import BoardFirmware
from simulator.led_board.outputs import ActiveInput, BoardOutputs
from simulator.world.light import LightHistory, LightView

LEDS = 6
MS = 1_000_000
WATCHDOG_MS = 900
LED = st.integers(0, LEDS)  # one too many


class BoardModel(RuleBasedStateMachine):
    """The model: the LED that is on and until when, the flash that runs, the last command."""

    def __init__(self) -> None:
        super().__init__()
        self.history = LightHistory()
        outputs = BoardOutputs(self.history)
        self.now_ns = 1_000_000_000
        active = ActiveInput(LightView(self.history, lambda: None))
        self.board = BoardFirmware(LEDS, outputs, active, self.now_ns)
        self.seq = 0
        self.last: tuple[Command, list[Reply]] | None = None
        self.led: int | None = None
        self.hold_ns = self.heard_ns = 0
        self.flash_ns = 0
        self.damaged = 0

    @property
    def lit(self) -> int | None:
        """The LED that is on now."""
        ends_ns = self.hold_ns if self.flash_ns else min(self.hold_ns, self._silent_ns)
        return self.led if self.now_ns < ends_ns else None

    @property
    def _silent_ns(self) -> int:
        return self.heard_ns + WATCHDOG_MS * MS

    @property
    def busy(self) -> bool:
        return self.now_ns < self.flash_ns

    def send(self, verb: str, *args: object) -> list[Reply]:
        """Send a command; return the replies to it."""
        self.seq = (self.seq + 1) % 65536
        command = Command(self.seq, verb, tuple(map(str, args)))
        replies = self._receive(encode_command(command))
        if verb not in ("STATUS", "ID", "DID"):
            self.last = command, replies
        return replies

    def _receive(self, data: bytes) -> list[Reply]:
        sent = self.board.receive(data, self.now_ns)
        replies = [decode_reply(line) for line in sent.splitlines()]
        return [reply for reply in replies if reply.seq == self.seq]

    def _refused(self, replies: list[Reply], code: ErrorCode) -> None:
        assert [reply.error for reply in replies] == [code]

    def _heard(self) -> None:
        # What has ended stays off.
        if self.lit is None and not self.busy:
            self.led, self.flash_ns = None, 0
        self.heard_ns = self.now_ns

    @rule(led=LED, hold_ms=st.sampled_from([0, 1, 50, 2000, 60_000, 60_001]))
    def on(self, led: int, hold_ms: int) -> None:
        busy = self.busy
        replies = self.send("ON", led, hold_ms)
        self._heard()
        if busy:
            self._refused(replies, ErrorCode.BUSY)
        elif led >= LEDS:
            self._refused(replies, ErrorCode.NO_SUCH_LED)
        elif not 1 <= hold_ms <= 60_000:
            self._refused(replies, ErrorCode.BAD_TIME)
        else:
            assert replies == [Reply(self.seq, "ON", (str(led), str(hold_ms)), None)]
            self.led, self.hold_ns, self.flash_ns = led, self.now_ns + hold_ms * MS, 0

    @rule()
    def off(self) -> None:
        before = "-" if self.lit is None else str(self.lit)
        replies = self.send("OFF")
        self._heard()
        self.led, self.flash_ns = None, 0
        assert replies == [Reply(self.seq, "OFF", (before,), None)]

    @rule(led=st.one_of(st.none(), LED), hold_us=st.sampled_from([1, 10, 40_000]))
    def flash(self, led: int | None, hold_us: int) -> None:
        busy = self.busy
        replies = self.send("FLASH", "-" if led is None else led, 0, hold_us)
        self._heard()
        if busy:
            self._refused(replies, ErrorCode.BUSY)
        elif led == LEDS:
            self._refused(replies, ErrorCode.NO_SUCH_LED)
        elif hold_us < 10:
            self._refused(replies, ErrorCode.BAD_TIME)
        else:
            assert replies == []  # it follows when the flash has ended
            self.led, self.hold_ns = led, self.now_ns + hold_us * 1000
            self.flash_ns = self.hold_ns

    @rule(ms=st.sampled_from([0, 1, 39, 41, 300, 899, 901, 5000]))
    def wait(self, ms: int) -> None:
        ended = self.busy and self.now_ns + ms * MS >= self.flash_ns
        self.now_ns += ms * MS
        replies = [decode_reply(line) for line in self.board.advance(self.now_ns).splitlines()]
        assert [reply.verb for reply in replies] == (["FLASH"] if ended else [])
        if ended:
            led = "-" if self.led is None else str(self.led)
            assert replies[0].args[0] == led
            self.led, self.flash_ns = None, 0

    @rule()
    def status(self) -> None:
        (reply,) = self.send("STATUS")
        self._heard()
        assert reply.args[1] == ("-" if self.lit is None else str(self.lit))
        assert reply.args[2] == str(self.damaged)
        assert reply.args[5] == ("FLASH" if self.busy else "IDLE" if self.lit is None else "ON")

    @rule()
    def repeat(self) -> None:
        """Send the last command again: the same reply, and nothing happens."""
        if self.last is None:
            return
        command, replies = self.last
        self.seq = command.seq
        light = list(self.history.lit)
        again = self._receive(encode_command(command))
        self._heard()
        assert again[: len(replies)] == replies
        assert [one.start_ns for one in self.history.lit] == [one.start_ns for one in light]

    @rule(data=st.binary(max_size=12).filter(lambda data: b"\n" not in data and b"\r" not in data))
    def disturb(self, data: bytes) -> None:
        """Send a damaged line."""
        if data:
            assert self.board.receive(b"\n" + data + b"\n", self.now_ns) == b""
            self.damaged += 1

    @invariant()
    def one_led_at_most(self) -> None:
        now_ns = self.now_ns
        lit = [one.led for one in self.history.lit if one.start_ns <= now_ns < one.end_ns]
        assert lit == ([] if self.lit is None else [self.lit])


TestBoard = BoardModel.TestCase
TestBoard.settings = settings(max_examples=200, stateful_step_count=30)
