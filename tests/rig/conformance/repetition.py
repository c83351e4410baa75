"""Repetition: a repeated line is answered again but not carried out again."""

from __future__ import annotations

from rig.host import clock
from tests.rig.conformance._check import check
from tests.rig.conformance.board import BoardUnderTest


@check("a repeated ON does not restart its hold")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    first = board.ask("ON 7 600", seq)
    on = board.lit(7)
    for _ in range(3):
        clock.sleep(0.1)
        assert board.ask("ON 7 600", seq) == first
    board.after(on, board.lit(), 600_000)
    # It does not turn the LED on again either.
    assert board.ask("ON 7 600", seq) == first
    board.no_edge()
    assert board.ok("OFF") == "-"


@check("a repeated OFF still names the LED")
def _(board: BoardUnderTest) -> None:
    board.ok("ON 7 5000")
    seq = board.next_seq()
    for _ in range(3):
        assert board.ok("OFF", seq) == "7"
    assert board.ok("OFF") == "-"


@check("a repeated refusal is the same refusal")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    assert board.ask("RUN 0 X", seq) == board.ask("RUN 0 X", seq) == "E2 RUN 0 X"
    seq = board.next_seq()
    assert board.ask("BLINK", seq) == board.ask("BLINK", seq) == "E1 BLINK"


@check("another command with the same number is not a repetition")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    assert board.ok("ON 7 5000", seq) == "7 5000"
    assert board.ok("ON 8 5000", seq) == "8 5000"
    assert board.ok("ON 8 4000", seq) == "8 4000"
    assert board.ok("OFF", seq) == "8"


@check("the same command with another number is not a repetition")
def _(board: BoardUnderTest) -> None:
    board.ok("ON 7 5000", 0x0101)
    assert board.ok("OFF", 0x0102) == "7"
    assert board.ok("OFF", 0x0103) == "-"
    assert board.ok("OFF", 0x0102) == "-"


@check("queries are answered with current values and do not change the memory")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    board.ok("ON 7 300", seq)
    board.lit(7)
    asking = board.next_seq()
    first = board.ok("STATUS", asking)
    clock.sleep(0.05)
    assert board.ok("STATUS", asking) != first
    assert board.ok("ID", asking) == board.ok("ID", asking)
    assert board.ask("DID 0", asking).split()[1:3] == ["DID", "0"] or board.ask("DID 0")
    assert board.ask("ID 7", asking) == "E2 ID 7"
    board.lit()
    assert board.ok("ON 7 300", seq) == "7 300"
    board.no_edge()


@check("a repeated FLASH is not answered while it runs, and is answered once at its end")
def _(board: BoardUnderTest) -> None:
    seq = board.send("FLASH 7 100000 400000")
    for _ in range(3):
        clock.sleep(0.05)
        board.send("FLASH 7 100000 400000", seq)
    flash = board.flash(7)
    board.after(flash.on, flash.off, 500_000)
    assert board.answer(seq).startswith("OK FLASH 7 ")
    board.silent()
    board.no_edge()


@check("a repeated FLASH that has ended is answered at once and not done again")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    first = board.ask("FLASH 7 1000 2000", seq)
    board.flash(7)
    for _ in range(3):
        assert board.ask("FLASH 7 1000 2000", seq) == first
    board.no_edge()


@check("the answer to a FLASH is kept during STATUS queries")
def _(board: BoardUnderTest) -> None:
    seq = board.send("FLASH 7 0 300000")
    for _ in range(3):
        assert board.status().state == "FLASH"
    first = board.answer(seq)
    assert first.startswith("OK FLASH 7 ")
    board.status()
    assert board.ask("FLASH 7 0 300000", seq) == first
    board.flash(7)
    board.no_edge()


@check("a repeated RUN does not run again")
def _(board: BoardUnderTest) -> None:
    board.ok("STEP 0 7 1000 20000 0")
    seq = board.next_seq()
    board.ok("RUN 1 T", seq)
    assert board.ok("RUN 1 T", seq) == "1"
    board.flash(7)
    assert board.ok("RUN 1 T", seq) == "1"
    board.no_edge()
    assert board.status().done == 1


@check("the memory is empty after a start")
def _(board: BoardUnderTest) -> None:
    seq = board.next_seq()
    board.ok("ON 7 5000", seq)
    board.reset()
    board.drain()
    assert board.ok("ON 7 5000", seq) == "7 5000"
    board.lit(7)
    assert board.ok("OFF") == "7"
