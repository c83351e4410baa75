"""Differences between two boards in the same item.

They may differ

- in the name and the number of steps that `ID` answers, and in the temperature of `STATUS`,
- in measured times: `STATUS` uptime, `since`, `lit`, `active` of `FLASH`, `trigger`, `lit`,
  `active` of `DID`, and the times of edges, by `Tolerance.late_us` and 0.1 % of the time,
- by a pause of less than `Tolerance.pause_us` between two lights of the same LED, and of less than
  `Tolerance.low_us` between two pulses,
- if several commands arrive at the same instant, by 0.3 ms for each of them, and by lights
  shorter than that: the virtual board carries out all of them at that instant, but a processor
  needs time.

Everything else must be equal: which lines are answered, in which order, every other word, which
LEDs are on and how bright, how often the trigger line rises. No board ever turns on two LEDs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tests.rig.differential.program import BYTE_US, Event, Step, whole

# Indices of the words after the verb of a reply that are measured, and that are board-specific.
_MEASURED = {"STATUS": (0,), "FLASH": (1, 2, 3), "DID": (2, 3, 4)}
_OWN = {"ID": (0, 6), "STATUS": (4,)}
# Longest time that a processor needs for a line that has already arrived.
_LINE_US = 300


@dataclass(frozen=True)
class Tolerance:
    """Tolerances for the times of a board relative to the virtual board, us.

    Parameters
    ----------
    late_us
        Tolerance of an edge or a measured time.
    pause_us, low_us
        Longest pause between two lights of the same LED, and between two pulses, that the virtual
        board joins.
    reply_us
        Longest time that the other board takes to send a reply; 0 if it sends in the background.
    """

    late_us: int
    pause_us: int
    low_us: int
    reply_us: int = 0


@dataclass(frozen=True)
class _Span:
    """A state, ``(leds, levels)`` or the trigger line, with its start and end, us."""

    what: object
    start_us: int
    end_us: int


def violations(step: Step) -> list[str]:
    """Return a line for each violation of the protocol: a damaged reply, two LEDs at once."""
    damaged = [f"a damaged reply {text!r}" for text in step.replies if not whole(text)]
    doubled = [event for event in step.events if len(event.get("lit", ())) > 1]
    return damaged + [f"more than one LED at once: {event}" for event in doubled]


def differences(virtual: Step, other: Step, tolerance: Tolerance, *, at_once: int = 0) -> list[str]:
    """Return a line for each difference between two boards that is not allowed.

    Parameters
    ----------
    virtual, other
        Steps of the two boards. Lights that began before are listed with the start 0.
    tolerance
        Tolerance of the other board.
    at_once
        Number of lines that arrived at the same instant.
    """
    found = []
    late_us = tolerance.late_us + _LINE_US * at_once
    if tolerance.reply_us:  # it hears the next line when it has sent its replies
        late_us += BYTE_US * sum(len(reply) + 1 for reply in virtual.replies)
    pause_us = tolerance.pause_us + _LINE_US * at_once
    tolerance = replace(tolerance, late_us=late_us, pause_us=pause_us)
    if len(virtual.replies) != len(other.replies):
        found.append(f"replies {virtual.replies} and {other.replies}")
    else:
        pairs = zip(virtual.replies, other.replies, strict=True)
        found += [f"{a!r} and {b!r}" for a, b in pairs if not _alike(a, b, tolerance)]
    for kind in ("lit", "trigger"):
        spans = [_spans(step.events, kind) for step in (virtual, other)]
        shortest_us = late_us if at_once and kind == "lit" else 0
        if not _same_spans(*spans, tolerance, kind, shortest_us):
            found.append(f"{kind}: {spans[0]} and {spans[1]}")
    return found


def _alike(one: bytes, two: bytes, tolerance: Tolerance) -> bool:
    if one == two:
        return True
    words = one.partition(b"*")[0].decode().split(), two.partition(b"*")[0].decode().split()
    verb = words[0][2:3]
    if len(words[0]) != len(words[1]) or words[0][:3] != words[1][:3] or words[0][1] != "OK":
        return False
    measured, own = (table.get(verb[0], ()) for table in (_MEASURED, _OWN))
    for at, (a, b) in enumerate(zip(words[0][3:], words[1][3:], strict=True)):
        if a == b or at in own:
            continue
        if at not in measured or a[-1] == "-" or b[-1] == "-":
            return False
        if (a[-1] == "+") != (b[-1] == "+"):
            return False
        unit_us = 1000 if verb[0] == "STATUS" else 1
        if not _near(
            int(a.rstrip("+")) * unit_us, int(b.rstrip("+")) * unit_us, tolerance, unit_us
        ):
            return False
    return True


def _near(one_us: int, two_us: int, tolerance: Tolerance, unit_us: int = 1) -> bool:
    return abs(one_us - two_us) <= tolerance.late_us + unit_us + max(one_us, two_us) // 1000


def _spans(events: Sequence[Event], kind: str) -> list[_Span]:
    """Return the spans in which LEDs or the trigger line were on, in order."""
    spans: list[_Span] = []
    on: tuple[object, int] | None = None
    for event in [*events, {"us": -1, kind: None}]:
        if kind not in event:
            continue
        if on is not None:
            spans.append(_Span(*on, event["us"]))
        value = event[kind]
        on = ((value, event.get("levels")), event["us"]) if value else None
    return spans


def _same_spans(
    one: list[_Span], two: list[_Span], tolerance: Tolerance, kind: str, shortest_us: int
) -> bool:
    """Return whether the spans of two boards correspond, in order.

    Each span corresponds to one of the other board, or to several with pauses below the tolerance.
    Spans shorter than ``shortest_us`` may be missing on the other board. The two measurements of a
    short span may be on either side of that limit, so all possible pairs are tried.
    """

    def same(a: list[_Span], b: list[_Span]) -> bool:
        return (
            a[0].what == b[0].what
            and abs(a[0].start_us - b[0].start_us) <= tolerance.late_us
            and abs(a[-1].end_us - b[-1].end_us) <= tolerance.late_us
        )

    # Pairs (i, j): the first i spans of one and the first j of two correspond.
    reached, ahead = {(0, 0)}, [(0, 0)]
    pause_us = tolerance.pause_us if kind == "lit" else tolerance.low_us
    while ahead:
        i, j = ahead.pop()
        steps = [(i + 1, j)] if i < len(one) and _short(one[i], shortest_us) else []
        steps += [(i, j + 1)] if j < len(two) and _short(two[j], shortest_us) else []
        ends_one, ends_two = (
            _joinable(spans, at, pause_us, shortest_us) for spans, at in ((one, i), (two, j))
        )
        steps += [(m, n) for m in ends_one for n in ends_two if same(one[i:m], two[j:n])]
        ahead += [step for step in steps if step not in reached]
        reached.update(steps)
    return (len(one), len(two)) in reached


def _joinable(spans: list[_Span], first: int, pause_us: int, shortest_us: int) -> list[int]:
    """Return the ends of the runs of equal spans from ``first`` on that short pauses separate.

    Spans shorter than ``shortest_us`` count as part of a pause.
    """
    ends = [first + 1] if first < len(spans) else []
    last = first
    for at in range(first + 1, len(spans)):
        if spans[at].start_us - spans[last].end_us >= pause_us:
            break
        if spans[at].what == spans[last].what:
            last = at
            ends.append(at + 1)
        elif not _short(spans[at], shortest_us):
            break
    return ends


def _short(span: _Span, than_us: int) -> bool:
    return span.end_us >= 0 and span.end_us - span.start_us < than_us
