"""Faults of the virtual board and of its line."""

import contextlib

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig.board import LineBuffer, LineError, Reply, decode_reply
from simulator.led_board import BoardFault, PowerCutError
from tests.cases import cases
from tests.simulator.desk import MS, Desk

# Effect of each fault on FLASH 7, sent to a board whose LED 3 is on.
FLASHED = ["7 - 8000 -"]


@cases(
    ("fault", "replies", "triggers", "leds"),
    {
        "drop-command": ({"kind": "drop-command"}, [], [], {3}),
        "corrupt-command": ({"kind": "corrupt-command", "value": 9}, [], [], {3}),
        "lost byte": ({"kind": "lose-byte-command", "value": 3}, [], [], {3}),
        "lost line end": ({"kind": "lose-byte-command", "value": -1}, [], [], {3}),
        "double byte": ({"kind": "double-byte-command", "value": 8}, [], [], {3}),
        "double-command": ({"kind": "double-command"}, FLASHED, [12], {3, 7}),
        "drop-reply": ({"kind": "drop-reply"}, [], [12], {3, 7}),
        "double-reply": ({"kind": "double-reply"}, FLASHED * 2, [12], {3, 7}),
        "delay-reply": ({"kind": "delay-reply", "value": 50}, FLASHED, [12], {3, 7}),
        "wrong-led": ({"kind": "wrong-led", "value": 9}, ["9 - 8000 -"], [12], {3, 9}),
        "double-led": ({"kind": "double-led", "value": 9}, FLASHED, [12], {3, 7, 9}),
        "goes-dark": ({"kind": "goes-dark", "value": 3}, ["7 - 3000 -"], [12], {3, 7}),
        "lose-trigger": ({"kind": "lose-trigger"}, FLASHED, [], {3, 7}),
        "double-trigger": ({"kind": "double-trigger"}, FLASHED, [12, 12.3], {3, 7}),
    },
)
def test_each_fault_has_its_effect(desk, fault, replies, triggers, leds):
    desk.ask("ON", "3", "100")
    desk.at_ms(10)
    desk.board.set_faults([BoardFault(**fault)])
    desk.send("FLASH", "7", "2000", "6000")
    assert [" ".join(reply.args) for reply in desk.at_ms(100)] == replies
    assert desk.triggers() == triggers
    assert {led for led, _, _ in desk.lit()} == leds
    assert [end for led, _, end in desk.lit() if led == 9] == [18] * (9 in leds)


@pytest.mark.parametrize("way", ["corrupt", "lose-byte", "double-byte"])
@pytest.mark.parametrize("at", range(24))
def test_a_damaged_reply_is_never_read_as_another_reply(desk, way, at):
    desk.board.set_faults([BoardFault(kind=f"{way}-reply", value=at)])
    received = (
        desk.send("ON", "7", "1000", seq=1) + desk.send("STATUS", seq=2) + desk.send("OFF", seq=3)
    )
    read = []
    for line in LineBuffer().feed(received):
        with contextlib.suppress(LineError):
            read.append(decode_reply(line))
    sent = [
        Reply(1, "ON", ("7", "1000")),
        Reply(2, "STATUS", ("0", "7", "0", "0", "2982", "ON", "0")),
        Reply(3, "OFF", ("7",)),
    ]
    # A lost line end also loses the next reply; a doubled one loses none.
    assert read in (sent, sent[1:], sent[2:])
    assert (read == sent) == (way == "double-byte" and at == 23)


def test_a_reset_during_a_command_executes_neither_half(desk):
    desk.ask("ON", "3", "1000")
    desk.at_ms(10)
    desk.board.set_faults([BoardFault(kind="reset")])
    assert b"boot" in desk.send("ON", "7", "1000")
    assert desk.lit() == [(3, 0, 10)]
    assert desk.ask("STATUS") == "0 - 1 0 2982 IDLE 0"


def test_a_reset_after_a_command_loses_its_reply(desk):
    desk.board.set_faults([BoardFault(kind="reset-after", verb="ON")])
    assert b"OK ON" not in desk.send("ON", "7", "1000")
    assert desk.lit() == []
    assert desk.ask("OFF") == "-"


@cases(
    ("fault", "back_ns"),
    {
        "for good": (BoardFault(kind="die"), None),
        "comes back": (BoardFault(kind="hang-up", value=30), 40 * MS),
    },
)
def test_a_board_that_loses_its_power_is_dark(desk, fault, back_ns):
    desk.ask("ON", "7", "1000")
    desk.at_ms(10)
    desk.board.set_faults([fault])
    with pytest.raises(PowerCutError) as cut:
        desk.send("STATUS")
    assert cut.value.back_ns == back_ns
    assert desk.lit() == [(7, 0, 10)]


def test_faults_affect_only_their_commands(desk):
    desk.board.set_faults([BoardFault(kind="drop-command", verb="ON", skip=1, times=2)])
    struck = [desk.ask("ON", "7", "100") is None for _ in range(5)]
    assert struck == [False, True, True, False, False]
    assert desk.ask("OFF") == "7"


@given(st.binary(max_size=90) | st.binary(max_size=55).map(lambda b: b">0001 " + b))
@settings(max_examples=300)
def test_damaged_lines_get_no_reply_and_turn_no_led_on(tmp_path_factory, data):
    desk = Desk(tmp_path_factory.mktemp("desk") / "bench.state")
    desk.board.receive(data + b"\n", 0)
    assert desk.board.advance(0) == b""
    assert desk.state.periods() == ()
    assert desk.ask("STATUS").split()[:2] == ["0", "-"]
    desk.close()


WORDS = st.text("".join(map(chr, [*range(33, 42), *range(43, 127)])), min_size=1, max_size=12)


VERBS = st.sampled_from(["ID", "ON", "OFF", "LEVEL", "STEP", "DID", "RUN", "STATUS"]) | WORDS


ARGUMENTS = st.integers(0, 10**10).map(str) | st.sampled_from(["x", "-", "T", "A", "0", "1"])


@given(VERBS, st.lists(ARGUMENTS, max_size=5))
@settings(max_examples=300)
def test_every_complete_command_gets_one_reply_that_repeats_it(tmp_path_factory, verb, args):
    desk = Desk(tmp_path_factory.mktemp("desk") / "bench.state")
    assume(len(" ".join((verb, *args))) <= 50)
    assert desk.ask(verb, *args) is not None
    desk.close()
