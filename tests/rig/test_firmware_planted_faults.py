"""The conformance checks detect faults that are planted in the firmware, one at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.rig.conformance import BoardUnderTest, run_checks
from tests.rig.firmware import builds

LIGHT, LINE, AVR = "core/light.cpp", "core/line.cpp", "avr/board.cpp"
COMMANDS, VERBS = "core/commands.cpp", "core/verbs.cpp"
BOOT = "no LED is on and the trigger is low from the start"
WHICH = "the requested LED turns on"
FLASH = "a flash turns on, settles, triggers and turns off as declared"
REFUSALS = "refusals have the right number, repeat the command and change nothing"
DAMAGE = "damaged lines are counted, not answered and not carried out"
PACED = "the camera's exposure paces a sequence"
SILENCE = "silence turns off an LED that ON turned on"
SEQUENCE = "a sequence keeps its times and reports every step"


@dataclass(frozen=True)
class Fault:
    """A change of the sources, and the check that must detect it."""

    file: str
    old: str
    new: str
    check: str


# In the core: seen by the firmware that is built for Linux.
FAULTS = {
    "LED off by one": Fault(LIGHT, "channel == led ?", "channel == led + 1 ?", WHICH),
    "two LEDs at once": Fault(
        LIGHT, "channel == led ? levels[channel]", "channel / 2 == led / 2 ? levels[led]", WHICH
    ),
    "no watchdog": Fault(LIGHT, "        watchdog();\n", "        if (0) watchdog();\n", SILENCE),
    "a slow watchdog": Fault(LIGHT, "WATCHDOG_MS * 1000 ||", "WATCHDOG_MS * 1500 ||", SILENCE),
    "watchdog not counted": Fault(
        LIGHT, "end_light();\n        trip_count++;", "end_light();", SILENCE
    ),
    "the watchdog ends a flash": Fault(
        LIGHT,
        "if (now_in == ON) {",
        "if (now_in != RUN && lit()) {",
        "silence does not cut a declared flash",
    ),
    "the watchdog ignores sequences": Fault(
        LIGHT,
        "else if (stopping)",
        "else if (stopping && count == 0)",
        "a sequence of a silent host finishes the current step and turns on no other LED",
    ),
    "noise is a sign of life": Fault(
        "core/firmware.cpp",
        "        if (line::take(",
        "        light::heard();\n        if (line::take(",
        "damaged lines are not a sign of life",
    ),
    "an ended flash is not reported": Fault(
        COMMANDS,
        "if (!asks && light::flash_ended())",
        "if (verb == nullptr && light::flash_ended())",
        "a flash that ends while the next command arrives is reported correctly",
    ),
    "no CRC test": Fault(LINE, " && stated == sum", "", DAMAGE),
    "damage not counted": Fault(LINE, "        damaged++;", "        damaged += 0;", DAMAGE),
    "overlong lines are accepted": Fault(
        LINE,
        "length <= LONGEST;",
        "length <= LONGEST + 1;",
        "lines that are too long are ignored and have no effect on others",
    ),
    "repetition acts twice": Fault(
        COMMANDS,
        "if (repeated()) {",
        "if (repeated() && verb == nullptr) {",
        "a repeated OFF still names the LED",
    ),
    "repetition by number alone": Fault(
        COMMANDS,
        "text.length != last_length)\n        return false;",
        "last_length == 0)\n        return false;\n    return true;",
        "another command with the same number is not a repetition",
    ),
    "queries erase the memory": Fault(
        COMMANDS,
        "    uint32_t args[verbs::MOST_ARGUMENTS];",
        "    if (asks)\n        remember();\n    uint32_t args[verbs::MOST_ARGUMENTS];",
        "the answer to a FLASH is kept during STATUS queries",
    ),
    "the memory is not cleared by a reset": Fault(
        COMMANDS,
        "    last_length = 0;\n    last_is_flash = false;\n    reply::forget();\n",
        "",
        "the memory is empty after a start",
    ),
    "range test off by one": Fault(
        VERBS,
        "args[0] >= BOARD_LEDS)\n        return LED;\n    if (args[1] < 1",
        "args[0] > BOARD_LEDS)\n        return LED;\n    if (args[1] < 1",
        REFUSALS,
    ),
    "hold without limit": Fault(
        VERBS, "args[1] > light::MAX_HOLD_MS", "args[1] > 999999998", REFUSALS
    ),
    "hold of a flash without limit": Fault(
        VERBS, "settle_us + hold_us > MAX_HOLD_US", "hold_us > MAX_HOLD_US", REFUSALS
    ),
    "errors in another order": Fault(
        VERBS,
        "if (args[0] >= BOARD_STEPS)\n",
        "if (args[0] >= BOARD_STEPS && !no_such_led(args[1]))\n",
        REFUSALS,
    ),
    "busy is not reported": Fault(
        COMMANDS,
        "verb->refused && busy()",
        "verb->refused && busy() && args[0] == 99",
        "a running flash refuses commands that would disturb it, and continues",
    ),
    "OFF does not name the LED": Fault(
        LIGHT,
        "const uint8_t was = burning;",
        "const uint8_t was = NO_LED;",
        "OFF names the LED that was on until now",
    ),
    "a reset leaves the LED on": Fault(
        LIGHT,
        "void start() {\n    board_dark();\n",
        "void start() {\n",
        "a reset in the middle of a flash turns the LED off and leaves no trace",
    ),
    "hold of ON ignored": Fault(
        LIGHT,
        "due = lit_at + hold_ms * 1000;",
        "due = lit_at + hold_ms * 2000;",
        "an LED turns off at the end of its hold",
    ),
    "trigger before the light has settled": Fault(
        LIGHT, "due = lit_at + settle_us;", "due = lit_at + settle_us / 4;", FLASH
    ),
    "hold too short": Fault(
        LIGHT, "due = pulse_at + hold_us;", "due = pulse_at + hold_us / 2;", FLASH
    ),
    "no trigger": Fault(LIGHT, "board_trigger(true);", "board_trigger(false);", FLASH),
    "exposure not measured": Fault(
        LIGHT,
        "burn.active_us += now - up_at;\n    fell",
        "fell",
        "a flash reports how long the camera exposed",
    ),
    "uncovered exposure not reported": Fault(
        LIGHT,
        "burn.seen = STILL_UP;",
        "burn.seen = ROSE;",
        "an exposure that the light did not cover is reported",
    ),
    "gap ignored": Fault(LIGHT, "+ step.gap_us;", "+ 0 * step.gap_us;", SEQUENCE),
    "steps in reverse": Fault(
        LIGHT, "shift_in(steps[next].led);", "shift_in(steps[count - 1 - next].led);", SEQUENCE
    ),
    "pace ignored": Fault(LIGHT, "if (fell && now_in == RUN", "if (fell && now_in == ON", PACED),
    "an unseen exposure does not halt": Fault(
        LIGHT,
        "if (pace == BY_EXPOSURE && !fell)",
        "if (pace == BY_EXPOSURE && !fell && count == 0)",
        "a sequence whose camera does not expose halts in the dark",
    ),
    "an exposure from before the trigger counts": Fault(
        LIGHT,
        "fell = rose;",
        "fell = true;",
        "an exposure that began before the trigger does not pace the sequence",
    ),
    "HALT never ends": Fault(
        LIGHT,
        "if (now_in == HALT)\n        now_in = IDLE;",
        "if (now_in == RUN)\n        now_in = IDLE;",
        "HALT lasts until the next command that acts",
    ),
}

# At the pins: seen by the image in simavr.
PIN_FAULTS = {
    "boot glitch": Fault(
        AVR, "    UP(BLANK);\n    OUTPUT(BLANK);\n", "    OUTPUT(BLANK);\n    UP(BLANK);\n", BOOT
    ),
    "a bit too many": Fault(AVR, "bit = 0x800;", "bit = 0x1000;", WHICH),
    "lowest bit first": Fault(
        AVR,
        "uint16_t bit = 0x800; bit != 0; bit >>= 1",
        "uint16_t bit = 1; bit < 0x1000; bit <<= 1",
        "LEVEL dims an LED from the next time it is turned on",
    ),
    "light before the latch": Fault(
        AVR, "    latch();\n    DOWN(BLANK);", "    DOWN(BLANK);\n    latch();", WHICH
    ),
    "trigger too long": Fault(LIGHT, "PULSE_US = 200;", "PULSE_US = 400;", FLASH),
    "a slow clock": Fault(AVR, "return base + (half >> 1);", "return base + (half >> 2);", FLASH),
}
HOST_LATE_US, AVR_LATE_US = 50_000, 60


def failures(
    build: Callable[..., list[str]], late_us: int, folder: Path, fault: Fault
) -> list[str]:
    changed = builds.changed(folder / "firmware", fault.file, fault.old, fault.new)
    with BoardUnderTest(build(folder, firmware=changed), late_us=late_us) as board:
        return run_checks(board, [fault.check])


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_a_planted_fault_is_noticed(tmp_path: Path, fault: Fault) -> None:
    assert failures(builds.host, HOST_LATE_US, tmp_path, fault)


@pytest.mark.slow
@pytest.mark.parametrize("fault", PIN_FAULTS.values(), ids=PIN_FAULTS)
def test_a_fault_at_the_pins_is_noticed(tmp_path: Path, fault: Fault) -> None:
    assert failures(builds.avr, AVR_LATE_US, tmp_path, fault)


@pytest.mark.slow
def test_without_a_fault_the_same_checks_pass(tmp_path: Path) -> None:
    for build, late_us, faults in (
        (builds.host, HOST_LATE_US, FAULTS),
        (builds.avr, AVR_LATE_US, PIN_FAULTS),
    ):
        with BoardUnderTest(build(tmp_path), late_us=late_us) as board:
            checks = {fault.check for fault in faults.values()}
            assert run_checks(board, checks, attempts=3) == []
