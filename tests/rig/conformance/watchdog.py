"""The watchdog: no LED stays on after the host has died, and no declared flash is cut off."""

from __future__ import annotations

from rig.host import clock
from tests.rig.conformance._check import check
from tests.rig.conformance.board import BoardUnderTest, line


def watchdog_us(board: BoardUnderTest) -> int:
    return board.identity.watchdog_ms * 1000


@check("silence turns off an LED that ON turned on")
def _(board: BoardUnderTest) -> None:
    before = board.status().trips
    board.ok(f"ON 7 {board.identity.max_hold_ms}")
    board.after(board.lit(7), board.lit(), watchdog_us(board))
    status = board.status()
    assert (status.state, status.led, status.trips) == ("IDLE", "-", before + 1)
    assert board.ok("OFF") == "-"


@check("the watchdog does not act on a hold that has ended before")
def _(board: BoardUnderTest) -> None:
    before = board.status().trips
    board.ok("ON 7 300")
    board.after(board.lit(7), board.lit(), 300_000)
    clock.sleep(1.0)
    assert board.status().trips == before


@check("a host that sends commands keeps its LED on")
def _(board: BoardUnderTest) -> None:
    before = board.status()
    light = f"ON 7 {board.identity.max_hold_ms}"
    seq = board.next_seq()
    board.ok(light, seq)
    # Each of these is a sign of life: a repetition, queries, a refusal.
    for words, number in ((light, seq), ("ID", None), ("DID 0", None), ("BLINK", None)):
        # Repeat until the watchdog time has passed on the board's clock.
        signs, passed_ms = 5, 0
        while passed_ms <= board.identity.watchdog_ms:
            start_ms = board.status().uptime_ms
            for _ in range(signs):
                clock.sleep(0.25)
                board.ask(words, number)
            status = board.status()
            assert (status.led, status.trips) == ("7", before.trips), f"{words} is no sign of life"
            passed_ms = status.uptime_ms - start_ms
            signs *= 2
    on = board.lit(7)
    assert board.lit() - on > 4 * watchdog_us(board)
    assert board.status().trips == before.trips + 1


@check("damaged lines are not a sign of life")
def _(board: BoardUnderTest) -> None:
    board.ok("ON 7 5000")
    on = board.lit(7)
    for _ in range(9):
        clock.sleep(0.1)
        board.write(line(1, "STATUS").replace(b"S", b"T") + b"\n\n" + b"x" * 90 + b"\n")
    board.after(on, board.lit(), watchdog_us(board))


@check("silence does not cut a declared flash")
def _(board: BoardUnderTest) -> None:
    before = board.status().trips
    seq = board.send("FLASH 7 200000 1800000")
    flash = board.flash(7)
    board.after(flash.up, flash.off, 1_800_000)
    board.answer(seq)
    assert board.status().trips == before


@check("a sequence of a silent host finishes the current step and turns on no other LED")
def _(board: BoardUnderTest) -> None:
    before = board.status().trips
    for index in range(4):
        board.ok(f"STEP {index} {index + 1} 0 380000 20000")
    board.ok("RUN 4 T")
    for led in (1, 2, 3):
        flash = board.flash(led)
        board.after(flash.on, flash.off, 380_000)
    board.no_edge(0.6)
    status = board.status()
    assert (status.state, status.done, status.trips) == ("HALT", 3, before + 1)


@check("a sequence of a silent host that is in a gap turns on no other LED")
def _(board: BoardUnderTest) -> None:
    before = board.status().trips
    board.ok("STEP 0 1 0 100000 1000000")
    board.ok("STEP 1 2 0 100000 0")
    board.ok("RUN 2 T")
    board.flash(1)
    board.no_edge(1.5)
    status = board.status()
    assert (status.state, status.done, status.trips) == ("HALT", 1, before + 1)


@check("a sequence whose host sends commands runs to its end")
def _(board: BoardUnderTest) -> None:
    before = board.status().trips
    for index in range(3):
        board.ok(f"STEP {index} {index} 0 500000 1000")
    board.ok("RUN 3 T")
    while board.status().state == "RUN":
        clock.sleep(0.1)
    for led in range(3):
        board.flash(led)
    status = board.status()
    assert (status.state, status.done, status.trips) == ("IDLE", 3, before)
