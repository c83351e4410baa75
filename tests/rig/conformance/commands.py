"""Identity, ON, OFF, LEVEL, STATUS, refusals, and the start."""

from __future__ import annotations

from rig.host import clock
from tests.rig.conformance._check import check
from tests.rig.conformance.board import BoardUnderTest, line


@check("ID returns the identity of the board")
def _(board: BoardUnderTest) -> None:
    identity = board.identity
    assert identity.protocol == 2
    assert 1 <= identity.leds <= 255
    assert identity.max_hold_ms >= 1000
    assert identity.watchdog_ms == 900
    assert identity.steps >= 1


@check("no LED is on and the trigger is low from the start")
def _(board: BoardUnderTest) -> None:
    board.ok("ON 7 5000")
    board.lit(7)
    board.reset()
    board.lit()
    board.no_edge(0.3)
    assert board.status().led == "-"
    assert board.ok("OFF") == "-"


@check("a reset in the middle of a flash turns the LED off and leaves no trace")
def _(board: BoardUnderTest) -> None:
    board.send("FLASH 7 0 3000000")
    board.lit(7)
    board.edge("trigger", 1)
    board.reset()
    edges = [(kind, e[kind]) for e in board.drain() for kind in ("lit", "trigger") if kind in e]
    assert sorted(edges) == [("lit", []), ("trigger", 0)]
    assert board.ok("OFF") == "-"
    board.no_edge()


@check("the requested LED turns on")
def _(board: BoardUnderTest) -> None:
    for led in range(board.identity.leds):
        assert board.ok(f"ON {led} 5000") == f"{led} 5000"
        board.lit(led)
        assert board.status().led == str(led)
        assert board.ok("OFF") == str(led)
        board.lit()
        assert board.status().led == "-"


@check("never two LEDs at once")
def _(board: BoardUnderTest) -> None:
    for led in (3, 35, 0, 3, 3):
        board.ok(f"ON {led} 5000")
    board.ok("OFF")
    seen = [event["lit"] for event in board.drain() if "lit" in event]
    assert [leds for leds in seen if leds] in ([[3], [35], [0], [3]], [[3], [35], [0], [3], [3]])
    assert seen[-1] == []


@check("commands in one piece never light two LEDs at once")
def _(board: BoardUnderTest) -> None:
    for leds in ((3, 5), (5, 4, 3), (0, 35), (7, 7, 8)):
        numbers = [board.next_seq() for _ in leds]
        pairs = zip(numbers, leds, strict=True)
        board.write(b"".join(line(seq, f"ON {led} 5000") for seq, led in pairs))
        for seq, led in zip(numbers, leds, strict=True):
            assert board.answer(seq) == f"OK ON {led} 5000"
        # A sign of life extends this light and no other.
        assert board.status().led == str(leds[-1])
        seen = [event["lit"] for event in board.drain() if "lit" in event]
        assert seen[-1] == [leds[-1]], seen
        assert all(len(lit) <= 1 for lit in seen), seen
    assert board.ok("OFF") == "8"


@check("ON is answered when the LED is on, OFF when it is off")
def _(board: BoardUnderTest) -> None:
    for _ in range(10):
        board.ok("ON 7 5000")
        board.lit(7)
        board.ok("OFF")
        board.lit()


@check("an LED turns off at the end of its hold")
def _(board: BoardUnderTest) -> None:
    for hold_ms in (1, 30, 300):
        board.ok(f"ON 7 {hold_ms}")
        board.after(board.lit(7), board.lit(), hold_ms * 1000)
        assert board.ok("OFF") == "-"
        assert board.status().state == "IDLE"


@check("a new ON has its own hold")
def _(board: BoardUnderTest) -> None:
    board.ok("ON 7 400")
    board.lit(7)
    clock.sleep(0.2)
    board.ok("ON 7 400")
    again = next((e["us"] for e in board.drain() if e.get("lit") == [7]), None)
    off = board.lit()
    if again is not None:
        board.after(again, off, 400_000)
    assert board.ok("OFF") == "-"


@check("OFF names the LED that was on until now")
def _(board: BoardUnderTest) -> None:
    assert board.ok("OFF") == "-"
    board.ok("ON 11 5000")
    assert board.ok("OFF") == "11"
    assert board.ok("OFF") == "-"


@check("LEVEL dims an LED from the next time it is turned on")
def _(board: BoardUnderTest) -> None:
    def levels() -> list[int]:
        return [level for event in board.drain() for level in event.get("levels", [])]

    board.ok("ON 7 5000")
    assert levels() == [4095]
    assert board.ok("LEVEL 7 1234") == "7 1234"
    assert levels() == []
    board.ok("ON 7 5000")
    board.ok("OFF")
    assert levels() == [1234]
    board.ok("ON 8 5000")
    board.ok("OFF")
    assert levels() == [4095]
    board.ok("LEVEL 7 0")
    board.ok("ON 7 5000")
    assert board.ok("OFF") == "7"
    assert levels() == []
    board.ok("LEVEL 7 4095")


@check("a start clears levels and steps")
def _(board: BoardUnderTest) -> None:
    board.ok("LEVEL 7 1")
    board.ok("STEP 0 7 0 1000 0")
    board.reset()
    board.drain()
    board.ok("ON 7 5000")
    board.ok("OFF")
    assert [e["levels"] for e in board.drain() if e.get("lit")] == [[4095]]
    assert board.ask("RUN 1 T") == "E7 RUN 1 T"
    assert board.ask("DID 0") == "E7 DID 0"


@check("numbers may have leading zeros, up to nine digits")
def _(board: BoardUnderTest) -> None:
    outcome = board.ok("ON 000000007 000001000")
    assert [int(word) for word in outcome.split()] == [7, 1000]
    board.lit(7)


@check("STATUS reports time, LED and state")
def _(board: BoardUnderTest) -> None:
    first = board.status()
    assert (first.led, first.state) == ("-", "IDLE")
    board.ok("ON 9 5000")
    clock.sleep(0.2)
    then = board.status()
    assert (then.led, then.state, then.trips) == ("9", "ON", first.trips)
    assert 100 <= then.uptime_ms - first.uptime_ms <= 5000
    temperature = board.ok("STATUS").split()[4]
    assert temperature == "-" or 2000 <= int(temperature) <= 4200
    board.ok("OFF")
    assert (board.status().led, board.status().state) == ("-", "IDLE")


# The fields in braces are one more than the board has or allows.
REFUSED = {
    "BLINK 7": 1,
    "on 7 100": 1,
    "ONE 7 100": 1,
    "O 7 100": 1,
    "7": 1,
    "ID 0": 2,
    "STATUS 0": 2,
    "OFF 7": 2,
    "ON": 2,
    "ON 7": 2,
    "ON 7 100 1": 2,
    "ON 7 100 1 1 1 1 1": 2,
    "ON x 100": 2,
    "ON - 100": 2,
    "ON 7 -": 2,
    "ON -1 100": 2,
    "ON +1 100": 2,
    "ON 7 0x10": 2,
    "ON 7 1.5": 2,
    "ON 7 1234567890": 2,
    "LEVEL 7": 2,
    "LEVEL - 7": 2,
    "FLASH 7 0": 2,
    "FLASH 7 - 100": 2,
    "FLASH 7 0 100 0": 2,
    "STEP 0 7 0 100": 2,
    "STEP - 7 0 100 0": 2,
    "RUN 1": 2,
    "RUN 1 X": 2,
    "RUN 1 TT": 2,
    "RUN 1 t": 2,
    "RUN - T": 2,
    "DID": 2,
    "DID -": 2,
    "ON {leds} 100": 3,
    "ON 256 100": 3,
    "ON 65536 100": 3,
    "ON 999999999 100": 3,
    "LEVEL {leds} 4095": 3,
    "FLASH {leds} 0 100": 3,
    "STEP 0 {leds} 0 100 0": 3,
    "ON 7 0": 4,
    "ON 7 {hold_ms}": 4,
    "ON 7 999999999": 4,
    "FLASH 7 1000001 100": 4,
    "FLASH 7 0 9": 4,
    "FLASH 7 0 {hold_us}": 4,
    "FLASH 7 1000000 {late_us}": 4,
    "FLASH 7 999999999 999999999": 4,
    "STEP 0 7 1000001 100 0": 4,
    "STEP 0 7 0 9 0": 4,
    "STEP 0 7 0 {hold_us} 0": 4,
    "STEP 0 7 0 100 1000001": 4,
    "LEVEL 7 4096": 6,
    "LEVEL 7 65536": 6,
    "STEP {steps} 7 0 100 0": 7,
    "STEP 256 7 0 100 0": 7,
    "RUN {too_many} T": 7,
    "DID {steps}": 7,
    "DID 256": 7,
    "DID 999999999": 7,
    # More than one error: the order is 1, 2, 5, 7, 3, 4, 6.
    "BLINK {leds} x": 1,
    "ON {leds} x": 2,
    "STEP {steps} {leds} x 0 0": 2,
    "STEP {steps} {leds} 0 0 0": 7,
    "STEP 0 {leds} 0 0 0": 3,
    "ON {leds} 0": 3,
    "FLASH {leds} 0 0": 3,
    "LEVEL {leds} 4096": 3,
}


@check("refusals have the right number, repeat the command and change nothing")
def _(board: BoardUnderTest) -> None:
    identity = board.identity
    board.ok("ON 3 60000")
    board.lit(3)
    for pattern, error in REFUSED.items():
        words = pattern.format(
            leds=identity.leds,
            hold_ms=identity.max_hold_ms + 1,
            hold_us=1000 * identity.max_hold_ms + 1,
            late_us=1000 * identity.max_hold_ms - 999_999,
            steps=identity.steps,
            too_many=identity.steps + 1,
        )
        assert board.ask(words) == f"E{error} {words}"
    board.no_edge(0.05)
    assert board.ok("OFF") == "3"


@check("the limits themselves are accepted")
def _(board: BoardUnderTest) -> None:
    identity = board.identity
    last, hold_us = identity.leds - 1, 1000 * identity.max_hold_ms
    for words in (
        f"ON {last} {identity.max_hold_ms}",
        "ON 0 1",
        f"LEVEL {last} 4095",
        f"STEP {identity.steps - 1} {last} 1000000 {hold_us - 1_000_000} 1000000",
        f"STEP 0 - 0 {hold_us} 0",
        "STEP 0 0 0 10 0",
    ):
        assert board.ok(words) == words.partition(" ")[2]
    board.ok("OFF")
    board.send(f"FLASH {last} 1000000 {hold_us - 1_000_000}")
    clock.sleep(0.05)
    assert board.status().state == "FLASH"
    board.ok("OFF")
    assert board.ok("FLASH 0 0 10").split()[0] == "0"
