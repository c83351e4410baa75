"""Feeds two boards the same items and collects their differences."""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

from tests.rig.conformance.board import line
from tests.rig.differential.difference import Tolerance, differences, violations
from tests.rig.differential.items import STEPS, Item, Items
from tests.rig.differential.program import BYTE_US, Event, Program, Step

VIRTUAL = [sys.executable, "-P", str(Path(__file__).with_name("virtual_board.py"))]
# After this time a board has started and has read all bytes on its line.
_START_US = 200_000
_MOST_WAITS = 100


@dataclass
class Comparison:
    """Result of a comparison.

    Parameters
    ----------
    items, replies
        Number of items, and of replies of the virtual board.
    raced
        Number of items whose differences do not count: an edge or the watchdog was due within the
        tolerance of the second or a later line of a write, so either may have been first.
    differing
        For each item that differs: its number, the item and the differences.
    dark
        Whether all LEDs of both boards were off after the last `OFF`.
    """

    items: int = 0
    replies: int = 0
    raced: int = 0
    differing: list[tuple[int, Item, list[str]]] = field(default_factory=list)
    dark: bool = False


class _Board:
    """One of the two boards: its program, and the state of its LEDs and trigger."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._on: dict[str, Event] = {}

    def order(self, text: str) -> None:
        self._program.order(text)

    def step(self, data: bytes, until_us: int, *, burst: bool = False) -> Step:
        """Do a step; the events begin with the lights that were on before it."""
        before = [{**event, "us": 0} for event in self._on.values()]
        step = self._program.step(data, until_us, burst=burst)
        for event in step.events:
            self._on["lit" if "lit" in event else "trigger"] = event
        return replace(step, events=(*before, *step.events))

    @property
    def dark(self) -> bool:
        return not self._on.get("lit", {}).get("lit")


class _Pair:
    """The virtual board and another board, with equal times on their clocks."""

    def __init__(self, virtual: Program, other: Program, tolerance: Tolerance) -> None:
        self.boards = _Board(virtual), _Board(other)
        self._tolerance = tolerance
        self._now_us = 0
        self._last_us = 0
        self.next_us = 0
        self.step(b"\n", _START_US)

    def order(self, text: str) -> tuple[Step, Step]:
        """Send both boards an order; after a reset, wait until they have started."""
        for board in self.boards:
            board.order(text)
        return self.step(b"", _START_US if text == "reset" else 0)

    def step(self, data: bytes, pass_us: int, *, burst: bool = False) -> tuple[Step, Step]:
        """Send both boards the same bytes, and let time pass after the last one."""
        self._now_us += pass_us + (0 if burst else BYTE_US * len(data))
        virtual, other = (board.step(data, self._now_us, burst=burst) for board in self.boards)
        assert virtual.next_us is not None
        self.next_us = virtual.next_us
        times_us = [event["us"] for event in virtual.events]
        self._last_us = max([self._last_us, *times_us])
        return virtual, other

    def settle(self, ahead_us: int) -> list[tuple[Step, Step]]:
        """Let time pass until nothing was due just before or is due within ``ahead_us``."""
        steps: list[tuple[Step, Step]] = []
        margin_us = self._tolerance.late_us
        for _ in range(_MOST_WAITS):
            if self.next_us <= self._now_us + ahead_us + margin_us:
                steps.append(self.step(b"", max(0, self.next_us - self._now_us) + margin_us))
            elif self._last_us >= self._now_us - margin_us:
                steps.append(self.step(b"", margin_us))
            else:
                break
        return steps

    def do(self, item: Item) -> tuple[Step, Step, bool]:
        """Return the steps of both boards, and whether something was due when a line arrived."""
        begun = self.settle(BYTE_US * len(item.data) + 3 * self._tolerance.late_us)
        if item.order:
            begun.append(self.order(item.order))
        start_us = self._now_us
        ends = [at + 1 for at, byte in enumerate(item.data) if byte == ord("\n")]
        sending_us = self._tolerance.reply_us * len(ends)
        done = self.step(item.data, item.pass_us + sending_us, burst=item.burst)
        steps = [*begun, done, *self.settle(0)]
        virtual, other = (_joined(side) for side in zip(*steps, strict=True))
        arrivals_us = [start_us + (0 if item.burst else BYTE_US * end) for end in ends]
        raced = self._raced(arrivals_us, done[0].due_us)
        unsettled = len(begun) >= _MOST_WAITS or len(steps) > _MOST_WAITS
        return virtual, other, raced or unsettled

    def _raced(self, arrivals_us: list[int], due_us: tuple[tuple[int, int], ...]) -> bool:
        """Return whether something was due close to the arrival of a line other than the first."""
        pairs = zip(arrivals_us[1:], due_us[1:], strict=True)
        margin_us = self._tolerance.late_us
        return any(abs(one - at) <= margin_us for at, due in pairs for one in due)


def _joined(steps: tuple[Step, ...]) -> Step:
    """Return steps as one; only the first one lists the lights that were on before."""
    first, *later = steps
    for step in later:
        new = tuple(event for event in step.events if event["us"] > 0)
        first = Step(first.replies + step.replies, first.events + new)
    return first


def compare(
    command: list[str],
    *,
    seed: int,
    items: int,
    tolerance: Tolerance,
    longest: int = 600,
    bursts: bool = True,
    steps: int = STEPS,
) -> Comparison:
    """Feed the virtual board and another board the same items.

    After an item that differs or was raced, both boards are reset.

    Parameters
    ----------
    command
        Command that starts the other board in stepped mode.
    seed, items
        Seed of `Items`, and number of items.
    tolerance
        Tolerance of the other board.
    longest, bursts
        See `Items`.
    steps
        How many steps of a sequence the other board stores.
    """
    result = Comparison()
    series = Items(seed, longest=longest, bursts=bursts)
    with Program([*VIRTUAL, str(steps)]) as virtual, Program(command) as other:
        pair = _Pair(virtual, other, tolerance)
        for number, item in enumerate(itertools.islice(series, items)):
            virtual_did, other_did, raced = pair.do(item)
            at_once = item.data.count(b"\n") if item.burst else 0
            found = differences(virtual_did, other_did, tolerance, at_once=at_once)
            broken = [*violations(virtual_did), *violations(other_did)]
            result.items += 1
            result.replies += len(virtual_did.replies)
            if broken or (found and not raced):
                result.differing.append((number, item, broken + found))
            elif found:
                result.raced += 1
            if broken or found:
                pair.order("reset")
        pair.step(b"\n" + line(0x1234, "OFF"), _START_US)
        result.dark = all(board.dark for board in pair.boards)
    return result
