"""Random items for LED boards: commands in any order, several at once, in pieces, and damaged."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from tests.rig.conformance.board import signed

LEDS, STEPS = 36, 48
_ENDS = (b"\n", b"\r\n", b"\r\r\n", b"\n\r", b"\r", b"\n\n", b"\r\n\r\n", b"\r\r\r\n", b"")
# Words that are numbers, almost numbers, or no numbers.
_NUMBERS = (
    *map(str, (0, 1, 9, 10, 35, 36, 47, 48, 49, 63, 64, 255, 256, 4095, 4096, 60_000, 60_001)),
    *map(str, (65535, 65536, 1_000_000, 1_000_001, 59_000_000, 60_000_000, 60_000_001)),
    *map(str, (999_999_999, 1_000_000_000, 2**32 - 1, 2**32, 2**64)),
    *("007", "000000007", "0000000007", "00", "-1", "+1", "-", "--", "0x10", "1.5", "1e3", "1_0"),
    *("\xb9", "x", "T", "A", "t"),
)
_LENGTHS = (63, 64, 65, 66, 67, 80, 128, 254, 255, 256, 257, 300)


@dataclass(frozen=True)
class Item:
    """One write to the port, or one order, and the time after it.

    Parameters
    ----------
    data
        Bytes to write; they may end in the middle of a line, which the next item continues.
    order
        ``active 0``, ``active 1``, ``reset`` or empty; sent before the write.
    pass_us
        Time from the last byte to the end of the item.
    burst
        Whether all bytes arrive at once, as from a pty, instead of one after the other.
    """

    data: bytes
    order: str
    pass_us: int
    burst: bool


class Items:
    """An endless series of items, the same for the same seed.

    Parameters
    ----------
    seed
        Seed of the random numbers.
    longest
        Maximum number of bytes of one write.
    bursts
        Whether some items are bursts.
    """

    def __init__(self, seed: int, *, longest: int, bursts: bool) -> None:
        self._draw = random.Random(seed)
        self._longest = longest
        self._bursts = bursts
        self._seq = self._draw.randrange(0x10000)
        self._last = "ID"
        self._rest = b""

    def __iter__(self) -> Items:
        return self

    def __next__(self) -> Item:
        draw = self._draw
        order = ""
        if draw.random() < 0.04:
            order = draw.choice(("active 0", "active 1", "active 0", "active 1", "reset"))
        count = draw.choice((0, 1, 1, 1, 1, 1, 1, 2, 2, 3, 5, 8))
        data = self._rest + b"".join(self._line() for _ in range(count))
        cut = len(data)
        # In pieces: the rest is sent with the next item.
        if draw.random() < 0.12:
            cut = draw.randrange(len(data) + 1)
        cut = min(cut, self._longest)
        data, self._rest = data[:cut], data[cut:]
        return Item(data, order, self._pass_us(), self._bursts and draw.random() < 0.4)

    def _pass_us(self) -> int:
        draw = self._draw
        kind = draw.random()
        if kind < 0.03:
            # Longer than the watchdog time.
            return draw.randrange(900_000, 2_500_000)
        if kind < 0.15:
            return draw.randrange(60_000, 900_000)
        return draw.randrange(1000, 60_000)

    def _line(self) -> bytes:
        draw = self._draw
        body = f">{self._number():04X} {self._words()}".encode("latin-1")
        text = signed(body) if draw.random() < 0.72 else draw.choice(_DAMAGES)(draw, body)
        end = b"\n" if draw.random() < 0.85 else draw.choice(_ENDS)
        return text + end

    def _number(self) -> int:
        kind = self._draw.random()
        if kind < 0.04:
            self._seq = self._draw.choice((0xFFFE, 0xFFFF, 0, 1, 0x7FFF, 0x8000))
        elif kind < 0.9:
            self._seq = (self._seq + 1) % 0x10000
        elif kind < 0.92:
            self._seq = (self._seq + 0x8000) % 0x10000
        # Otherwise the number of the previous command.
        return self._seq

    def _words(self) -> str:
        draw = self._draw
        if draw.random() < 0.15:
            return self._last
        self._last = self._command()
        return self._last

    def _command(self) -> str:
        draw = self._draw
        led = draw.randrange(LEDS) if draw.random() < 0.95 else LEDS + draw.randrange(3)
        either = "-" if draw.random() < 0.15 else str(led)
        settle, hold = self._settle_us(), self._hold_us()
        index = draw.choice((0, 0, 0, 0, 1, 1, 1, 2, 2, 3, 4, 47, 48))
        pace = draw.choice("TTTA")
        words = draw.choice(
            (
                "ID",
                "STATUS",
                "STATUS",
                f"DID {draw.randrange(5)}",
                "OFF",
                f"ON {led} {self._hold_ms()}",
                f"ON {led} {self._hold_ms()}",
                f"LEVEL {led} {draw.choice((0, 1, 100, 4095, 4095, 4096))}",
                f"FLASH {either} {settle} {hold}",
                f"FLASH {either} {settle} {hold}",
                f"STEP {index} {either} {settle} {hold} {self._settle_us()}",
                f"STEP {index} {either} {settle} {hold} {self._settle_us()}",
                f"RUN {draw.choice((0, 1, 1, 1, 2, 2, 3, 4, 5, 48, 49))} {pace}",
                f"RUN {draw.choice((1, 1, 2, 2, 3))} {pace}",
            )
        )
        kind = draw.random()
        if kind < 0.83:
            return words
        # One word is changed, missing or added.
        parts = words.split()
        at = draw.randrange(len(parts))
        if kind < 0.92:
            parts[at] = draw.choice(_NUMBERS)
        elif kind < 0.95:
            parts[at] = parts[at].lower()
        elif kind < 0.97:
            parts[at] = parts[at].zfill(draw.choice((8, 9, 9, 10)))
        elif kind < 0.98:
            parts.insert(at, draw.choice(_NUMBERS))
        else:
            del parts[at]
        return " ".join(parts) or "NOTHING"

    def _settle_us(self) -> int:
        draw = self._draw
        return draw.choice(
            (0, 0, 1, 200, 2000, 5000, draw.randrange(300_000), 1_000_000, 1_000_001)
        )

    def _hold_us(self) -> int:
        draw = self._draw
        often = (10, 199, 200, 201, 1000, 6000, draw.randrange(10, 30_000))
        return draw.choice((*often, *often, draw.randrange(10, 900_000), 2_000_000, 60_000_000, 9))

    def _hold_ms(self) -> int:
        # No hold within a millisecond of the watchdog's 900 ms, when either may act first.
        draw = self._draw
        return draw.choice((1, 2, 20, draw.randrange(1, 880), 5000, 60_000, 0, 60_001))


def _flipped(draw: random.Random, body: bytes) -> bytes:
    text = bytearray(signed(body))
    text[draw.randrange(len(text))] ^= 1 << draw.randrange(8)
    return bytes(text)


def _inserted(draw: random.Random, body: bytes) -> bytes:
    """Return the line with an invalid extra byte and a correct checksum."""
    at = draw.randrange(len(body) + 1)
    byte = draw.choice(b" \t\0\r*>!~\x7f\x80\xff\x1b_")
    return signed(body[:at] + bytes((byte,)) + body[at:])


def _padded(draw: random.Random, body: bytes) -> bytes:
    """Return a line with a length close to the limit."""
    length = draw.choice(_LENGTHS)
    return signed(body + b" " + b"7" * max(1, length - len(body) - 6))


_DAMAGES: tuple[Callable[[random.Random, bytes], bytes], ...] = (
    _flipped,
    _flipped,
    _inserted,
    _inserted,
    _padded,
    _padded,
    lambda draw, body: body,
    lambda draw, body: signed(body)[: draw.randrange(len(body) + 5)],
    lambda draw, body: signed(body).lower(),
    lambda draw, body: signed(body[:6].lower() + body[6:]),
    lambda draw, body: signed(body)[:-4] + signed(body)[-4:].lower(),
    lambda draw, body: signed(body) + draw.choice((b" ", b"0", b"\0", b"*", b"\t")),
    lambda draw, body: draw.choice((b" ", b"\0", b"x", b"\xff", b"\t")) + signed(body),
    lambda draw, body: signed(b"<" + body[1:]),
    lambda draw, body: signed(body) + signed(body),
    lambda draw, body: signed(body.replace(b" ", b"  ", 1)),
    lambda draw, body: draw.randbytes(draw.randrange(1, 90)),
    lambda draw, body: b"",
)
