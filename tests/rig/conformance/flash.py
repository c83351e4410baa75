"""FLASH: times of LED and pulse, the report, and commands that are refused meanwhile."""

from __future__ import annotations

from rig.host import clock
from tests.rig.conformance._check import check
from tests.rig.conformance.board import ANSWER_S, BoardUnderTest

PULSE_US = 200


@check("a flash turns on, settles, triggers and turns off as declared")
def _(board: BoardUnderTest) -> None:
    for settle_us, hold_us in ((2000, 6000), (0, 5000), (20_000, 1000), (300, 200_000)):
        seq = board.send(f"FLASH 7 {settle_us} {hold_us}")
        flash = board.flash(7)
        board.after(flash.on, flash.up, settle_us)
        board.after(flash.up, flash.down, PULSE_US)
        board.after(flash.up, flash.off, hold_us)
        words = board.answer(seq).split()
        assert words[:3] == ["OK", "FLASH", "7"]
        board.after(0, int(words[4]), flash.off - flash.on)
        assert words[5:] == ["-"]
        assert board.status().state == "IDLE"


@check("a short flash lowers the trigger at its end")
def _(board: BoardUnderTest) -> None:
    for hold_us in (10, 100):
        board.ok(f"FLASH 7 500 {hold_us}")
        flash = board.flash(7)
        board.after(flash.up, flash.down, hold_us)
        board.after(flash.up, flash.off, hold_us)


@check("a flash reports the time since the previous pulse")
def _(board: BoardUnderTest) -> None:
    board.reset()
    assert board.ok("FLASH 7 0 1000").split()[1] == "-"
    earlier = board.flash(7).up
    for command, led in (("FLASH 8 2000 1000", 8), ("FLASH 9 0 300", 9)):
        since_us = int(board.ok(command).split()[1])
        pulse = board.flash(led).up
        board.after(0, since_us, pulse - earlier)
        earlier = pulse


@check("every LED can be flashed")
def _(board: BoardUnderTest) -> None:
    for led in range(board.identity.leds):
        assert board.ok(f"FLASH {led} 0 1000").split()[0] == str(led)
        board.flash(led)


@check("a flash of no LED pulses the trigger in the dark")
def _(board: BoardUnderTest) -> None:
    assert board.ok("FLASH - 1000 5000").split()[0] == "-"
    board.after(board.edge("trigger", 1), board.edge("trigger", 0), PULSE_US)
    board.no_edge()


@check("FLASH is answered at its end")
def _(board: BoardUnderTest) -> None:
    seq = board.send("FLASH 7 0 1500000")
    board.lit(7)
    board.silent(0.2)
    assert board.answer(seq).startswith("OK FLASH 7")


@check("a flash that ends while the next command arrives is reported correctly")
def _(board: BoardUnderTest) -> None:
    hold_us = 3000
    board.ok(f"FLASH 7 0 {hold_us}")
    board.drain()
    # Some of these arrive just as the flash ends.
    for try_ in range(160):
        words = ("ON 8 1000", "FLASH 9 0 20")[try_ % 2]
        first = board.send(f"FLASH 7 0 {hold_us}")
        arrives_s = clock.monotonic() + (hold_us - 700 + 10 * try_) / 1e6
        while clock.monotonic() < arrives_s:
            pass
        second = board.send(words)
        answers: dict[int, list[str]] = {}
        for text in board.lines(ANSWER_S):
            answers[int(text[1:5], 16)] = text[6:].partition("*")[0].split()
            if len(answers) == 2:
                break
        assert set(answers) == {first, second}, f"{words}: {answers}"
        reply = answers[first]
        assert reply[:3] == ["OK", "FLASH", "7"], f"{words}: {reply}"
        board.after(0, int(reply[4]), hold_us)
        assert answers[second][0] in ("OK", "E5"), answers
        board.ok("OFF")
        board.drain()


@check("a flash replaces the LED that is on")
def _(board: BoardUnderTest) -> None:
    board.ok("ON 3 60000")
    board.lit(3)
    board.ok("FLASH 7 0 10000")
    seen = [event["lit"] for event in board.drain() if "lit" in event]
    assert [leds for leds in seen if leds] == [[7]], seen
    assert seen[-1] == []
    assert board.ok("OFF") == "-"


@check("a running flash refuses commands that would disturb it, and continues")
def _(board: BoardUnderTest) -> None:
    board.ok("STEP 0 3 0 1000 0")
    seq = board.send("FLASH 7 500000 1000000")
    # Wrong arguments are reported first, all other errors after that.
    for words in ("ON 3 100", "LEVEL 3 9", "FLASH 3 0 10", "STEP 0 3 0 10 0", "RUN 1 T"):
        assert board.ask(words) == f"E5 {words}"
    for words in ("ON 3 0", "ON 99 100", "LEVEL 3 9999", "STEP 99 3 0 10 0", "RUN 99 T"):
        assert board.ask(words) == f"E5 {words}"
    assert board.ask("ON x 100") == "E2 ON x 100"
    assert board.ask("BLINK") == "E1 BLINK"
    status = board.status()
    assert (status.state, status.led) == ("FLASH", "7")
    assert board.ok("ID").split()[1] == "2"
    flash = board.flash(7)
    board.after(flash.on, flash.up, 500_000)
    board.after(flash.up, flash.off, 1_000_000)
    assert board.answer(seq).startswith("OK FLASH 7 ")


@check("OFF ends a flash, which is then not answered")
def _(board: BoardUnderTest) -> None:
    board.send("FLASH 7 0 5000000")
    on = board.lit(7)
    board.edge("trigger", 1)
    board.edge("trigger", 0)
    assert board.ok("OFF") == "7"
    assert board.lit() - on < 4_000_000
    board.silent()
    assert board.status().state == "IDLE"


@check("OFF before the trigger leaves the trigger low")
def _(board: BoardUnderTest) -> None:
    board.send("FLASH 7 1000000 1000")
    board.lit(7)
    assert board.ok("OFF") == "7"
    board.lit()
    board.no_edge(1.3)


@check("a flash reports how long the camera exposed")
def _(board: BoardUnderTest) -> None:
    seq = board.send("FLASH 7 0 2000000")
    board.lit(7)
    board.wait(200)
    board.active(True)
    board.wait(200)
    board.active(False)
    board.wait(200)
    active = board.answer(seq).split()[5]
    assert 198_000 <= int(active) <= 1_600_000


@check("an exposure that the light did not cover is reported")
def _(board: BoardUnderTest) -> None:
    seq = board.send("FLASH 7 0 2000000")
    board.lit(7)
    board.wait(100)
    board.active(True)
    active = board.answer(seq).split()[5]
    assert active.endswith("+")
    assert 0 < int(active[:-1]) <= 1_902_000
    board.active(False)


@check("exposures of one flash add up")
def _(board: BoardUnderTest) -> None:
    seq = board.send("FLASH 7 0 3000000")
    board.lit(7)
    for up in (True, False, True, False):
        board.wait(200)
        board.active(up)
    active = board.answer(seq).split()[5]
    # Twice 200 ms, and at most the total time without the other two waits.
    assert 396_000 <= int(active) <= 2_600_000
    # It does not count for the next flash.
    assert board.ok("FLASH 7 0 1000").split()[3] == "-"
