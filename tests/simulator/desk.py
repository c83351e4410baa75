"""A virtual board without a process, whose time is set by the tests."""

from rig.board import Command, decode_reply, encode_command
from simulator.bench import BenchState, BenchWriter
from simulator.led_board import ActiveInput, BoardFirmware, BoardOutputs, FaultyBoard

MS = 1_000_000


US = 1000


class Desk:
    """A board without a process, whose time is set by the test."""

    def __init__(self, path):
        self.writer = BenchWriter(path)
        self.state = BenchState(path)
        self.outputs = BoardOutputs(self.writer)
        self.active = ActiveInput(self.state)
        self.firmware = BoardFirmware(36, self.outputs, self.active, 0)
        self.board = FaultyBoard(self.firmware, self.outputs)
        self.now_ns = 0
        self.seq = 0

    def at_ms(self, ms):
        """Advance the time, wake the board whenever it is due, and return its replies."""
        until_ns = round(ms * MS)
        sent = b""
        while self.now_ns < until_ns:
            self.now_ns = min(until_ns, max(self.now_ns + 1, self.board.next_ns(self.now_ns)))
            sent += self.board.advance(self.now_ns)
        return [decode_reply(line) for line in sent.splitlines()]

    def send(self, *words, seq=None):
        """Send a command now; return the bytes of the immediate reply."""
        self.seq = self.seq + 1 if seq is None else seq
        self.board.receive(encode_command(Command(self.seq, words[0], words[1:])), self.now_ns)
        return self.board.advance(self.now_ns)

    def ask(self, *words, seq=None):
        """Send a command now; return the words of the reply, or None if there is no reply."""
        answer = self.send(*words, seq=seq)
        if not answer:
            return None
        reply = decode_reply(answer.rstrip())
        assert (reply.seq, reply.verb) == (self.seq, words[0])
        return " ".join(reply.args) if reply.error is None else f"E{reply.error}"

    def lit(self):
        """The lit periods, in ms, without empty ones."""
        periods = self.state.periods()
        return [(p.led, p.start_ns / MS, p.end_ns / MS) for p in periods if p.end_ns > p.start_ns]

    def triggers(self):
        return [pulse.time_ns / MS for pulse in self.state.triggers()]

    def close(self):
        self.state.close()
        self.writer.close()


def load_steps(desk, *steps):
    for index, step in enumerate(steps):
        assert desk.ask("STEP", str(index), *step.split()) is not None
