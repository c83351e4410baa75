"""STEP, RUN and DID: a list of flashes that the board runs by itself."""

from __future__ import annotations

from rig.host import clock
from tests.rig.conformance._check import check
from tests.rig.conformance.board import BoardUnderTest, Edges


def load(board: BoardUnderTest, *steps: str) -> None:
    for index, step in enumerate(steps):
        assert board.ok(f"STEP {index} {step}") == f"{index} {step}"


def did(board: BoardUnderTest, index: int) -> list[str]:
    return board.ok(f"DID {index}").split()


def wait_for(board: BoardUnderTest, state: str) -> None:
    """Send STATUS until the board is in a state, which also keeps its watchdog from acting."""
    ends_s = clock.monotonic() + 10
    while (status := board.status()).state != state:
        assert clock.monotonic() < ends_s, status
        clock.sleep(0.02)


@check("a sequence keeps its times and reports every step")
def _(board: BoardUnderTest) -> None:
    declared = [(1, 2000, 6000, 50_000), (35, 1000, 4000, 100_000), (0, 0, 30_000, 20_000)]
    declared = [(led % board.identity.leds, *times) for led, *times in declared]
    load(board, *(" ".join(map(str, step)) for step in declared))
    assert board.ok("RUN 3 T") == "3"
    edges: list[Edges] = [board.flash(step[0]) for step in declared]
    start = edges[0].on
    due = 0
    for (_, settle_us, hold_us, gap_us), edge in zip(declared, edges, strict=True):
        board.after(start, edge.on, due)
        board.after(edge.on, edge.up, settle_us)
        board.after(edge.up, edge.down, 200)
        board.after(edge.up, edge.off, hold_us)
        due = edge.off - start + gap_us
    wait_for(board, "IDLE")
    assert board.status().done == 3
    for index, (step, edge) in enumerate(zip(declared, edges, strict=True)):
        words = did(board, index)
        assert words[:2] == [str(index), str(step[0])]
        board.after(0, int(words[2]), edge.up - start)
        board.after(0, int(words[3]), edge.off - edge.on)
        assert words[4] == "-"


@check("a step is reported when it has ended, not before")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 700000 700000", "2 0 700000 0")
    board.ok("RUN 2 T")
    status = board.status()
    assert (status.state, status.led, status.done) == ("RUN", "1", 0)
    assert board.ask("DID 0") == "E7 DID 0"
    board.flash(1)
    assert did(board, 0)[1] == "1"
    assert board.ask("DID 1") == "E7 DID 1"
    status = board.status()
    assert (status.state, status.led, status.done) == ("RUN", "-", 1)
    board.flash(2)
    assert did(board, 1)[1] == "2"


@check("a step may be dark")
def _(board: BoardUnderTest) -> None:
    load(board, "- 1000 5000 1000", "4 0 5000 0")
    board.ok("RUN 2 T")
    board.flash(None)
    board.flash(4)
    assert did(board, 0)[:2] == ["0", "-"]


@check("the maximum number of steps runs, each with its own LED")
def _(board: BoardUnderTest) -> None:
    identity = board.identity
    leds = [(7 * index) % identity.leds for index in range(identity.steps)]
    load(board, *(f"{led} 200 800 3000" for led in leds))
    assert board.ok(f"RUN {identity.steps} T") == str(identity.steps)
    starts = [board.flash(led).on for led in leds]
    assert starts == sorted(starts)
    assert [did(board, index)[1] for index in range(identity.steps)] == [str(led) for led in leds]
    assert board.status().state == "IDLE"


@check("a sequence may be run again, and shorter")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 2000 1000", "2 0 2000 1000", "3 0 2000 0")
    for count in (3, 2, 3):
        board.ok(f"RUN {count} T")
        for led in range(1, count + 1):
            board.flash(led)
        wait_for(board, "IDLE")
        assert board.status().done == count
        assert board.ask(f"DID {count}") == f"E7 DID {count}"


@check("a sequence that is not loaded is refused")
def _(board: BoardUnderTest) -> None:
    board.reset()
    board.drain()
    board.ok("STEP 0 1 0 1000 0")
    board.ok("STEP 2 1 0 1000 0")
    assert board.ask("RUN 2 T") == "E7 RUN 2 T"
    assert board.ask("RUN 3 T") == "E7 RUN 3 T"
    board.no_edge()
    board.ok("RUN 1 T")
    board.flash(1)


@check("a running sequence refuses commands that would disturb it, and continues")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 700000 600000", "2 0 100000 0")
    board.ok("RUN 2 T")
    for words in ("ON 3 100", "LEVEL 3 9", "FLASH 3 0 10", "STEP 0 3 0 10 0", "RUN 1 T"):
        assert board.ask(words) == f"E5 {words}"
    board.flash(1)
    assert board.ask("ON 3 100") == "E5 ON 3 100"
    flash = board.flash(2)
    board.after(flash.on, flash.off, 100_000)


@check("OFF ends a sequence")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 50000 50000", "2 0 800000 50000", "3 0 50000 0")
    board.ok("RUN 3 T")
    board.flash(1)
    board.lit(2)
    assert board.ok("OFF") == "2"
    board.edge("trigger", 1)
    board.edge("trigger", 0)
    board.lit()
    board.no_edge(0.3)
    status = board.status()
    assert (status.state, status.done) == ("IDLE", 1)
    assert did(board, 0)[1] == "1"
    assert board.ask("DID 1") == "E7 DID 1"


@check("OFF between two steps ends a sequence")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 10000 1000000", "2 0 10000 0")
    board.ok("RUN 2 T")
    board.flash(1)
    assert board.ok("OFF") == "-"
    board.no_edge(1.3)
    assert board.status().state == "IDLE"


@check("the camera's exposure paces a sequence")
def _(board: BoardUnderTest) -> None:
    load(board, "1 1000 20000000 20000", "2 1000 20000000 0")
    board.ok("RUN 2 A")
    ends, shortest_us = [], 100_000
    for led in (1, 2):
        on = board.lit(led)
        board.edge("trigger", 1)
        board.edge("trigger", 0)
        board.active(True)
        board.wait(shortest_us // 1000)
        board.active(False)
        off = board.lit()
        assert shortest_us <= off - on < 19_000_000, "the LED did not turn off with the exposure"
        ends.append((on, off))
    board.after(ends[0][1], ends[1][0], 20_000)
    wait_for(board, "IDLE")
    for index, (on, off) in enumerate(ends):
        words = did(board, index)
        assert words[1] == str(index + 1)
        board.after(0, int(words[3]), off - on)
        assert 0.99 * shortest_us <= int(words[4]) <= int(words[3])


@check("an exposure that began before the trigger does not pace the sequence")
def _(board: BoardUnderTest) -> None:
    load(board, "1 1000000 300000 0", "2 0 1000 0")
    board.active(True)
    board.ok("RUN 2 A")
    on = board.lit(1)
    board.wait(50)
    board.active(False)
    board.edge("trigger", 1)
    board.edge("trigger", 0)
    board.after(on, board.lit(), 1_300_000)
    board.no_edge()
    assert board.status().state == "HALT"


@check("an exposure-active input that stays high has no edge")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 300000 0", "2 0 1000 0")
    board.active(True)
    board.ok("RUN 2 A")
    board.lit(1)
    board.edge("trigger", 1)
    board.edge("trigger", 0)
    board.active(True)
    board.wait(20)
    board.active(False)
    # It was high before the trigger, so its fall does not count.
    board.lit()
    board.no_edge()
    assert board.status().state == "HALT"


@check("a sequence whose camera does not expose halts in the dark")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 100000 1000", "2 0 100000 0")
    board.ok("RUN 2 A")
    flash = board.flash(1)
    board.after(flash.up, flash.off, 100_000)
    board.no_edge()
    status = board.status()
    assert (status.state, status.led, status.done) == ("HALT", "-", 1)
    assert did(board, 0)[4] == "-"
    assert board.ask("DID 1") == "E7 DID 1"


@check("a sequence whose camera exposes for too long halts in the dark")
def _(board: BoardUnderTest) -> None:
    load(board, "1 0 300000 1000", "2 0 300000 0")
    board.ok("RUN 2 A")
    board.lit(1)
    board.edge("trigger", 1)
    board.edge("trigger", 0)
    board.active(True)
    board.lit()
    board.no_edge()
    assert board.status().state == "HALT"
    assert did(board, 0)[4].endswith("+")
    board.active(False)


@check("HALT lasts until the next command that acts")
def _(board: BoardUnderTest) -> None:
    for acting in ("OFF", "LEVEL 3 4095", "STEP 0 1 0 1000 0", "ON 3 100"):
        load(board, "1 0 1000 0", "2 0 1000 0")
        board.ok("RUN 2 A")
        board.flash(1)
        for asking in ("ID", "STATUS", "DID 0"):
            board.ok(asking)
        assert board.ask("ON 3 0") == "E4 ON 3 0"
        assert board.ask("BLINK") == "E1 BLINK"
        assert board.status().state == "HALT"
        board.ok(acting)
        assert board.status().state == ("ON" if acting.startswith("ON") else "IDLE")
        board.ok("OFF")
        board.drain()
