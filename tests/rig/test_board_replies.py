"""Replies of the board: words, numbers and LEDs, and the messages about them."""

from contextlib import nullcontext

import pytest
import serial

from rig import BoardError
from rig.board import Command, Reply
from rig.board.replies import Outcome, lost, overtaken, silent, spoken, where

ON = Command(7, "ON", ("3", "2500"))


def outcome(*words, error=None, command=ON, again=False):
    return Outcome("p", command, Reply(7, command.verb, words, error), again=again)


def test_an_outcome_has_the_values_of_its_reply():
    found = outcome("3", "2500", again=True)
    assert (found.seq, found.error, found.words, found.again) == (7, None, ("3", "2500"), True)
    assert not outcome("3").again
    assert found.done() is found
    assert found.repeats(2) is found


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (1, "error 1: unknown command"),
        (5, "error 5: busy"),
        (99, "error 99: not known to this software"),
    ],
)
def test_a_refusal_is_an_error(error, says):
    with pytest.raises(BoardError, match=f"on p, ON LED 3 2500: the board refused, {says}"):
        outcome("3", "2500", error=error).done()


@pytest.mark.parametrize(
    ("words", "count", "right"),
    [
        (("3", "2500", "9"), 2, True),
        (("3", "9"), 1, True),
        (("4", "2500"), 2, False),
        (("3", "2501"), 2, False),
        (("3",), 2, False),
    ],
)
def test_the_board_must_repeat_the_arguments(words, count, right):
    with nullcontext() if right else pytest.raises(BoardError, match="instead of ON LED 3 2500"):
        outcome(*words).repeats(count)


def test_words_are_converted():
    found = outcome("0", "35", "-", "999999999", "12+", "12")
    assert [found.number(index) for index in (0, 1, 3)] == [0, 35, 999_999_999]
    assert [found.led(index) for index in (0, 1, 2)] == [0, 35, None]
    assert [found.exposure(index) for index in (2, 4, 5)] == [
        (None, False),
        (12, True),
        (12, False),
    ]
    assert found.word(5) == "12"


@pytest.mark.parametrize("word", ["", "x", "-1", "1.5", "1000000000", "+3", "2+"])
def test_a_word_that_is_not_a_number_is_invalid(word):
    with pytest.raises(BoardError, match="reply is invalid"):
        outcome(word).number(0)
    with pytest.raises(BoardError, match="reply is invalid"):
        outcome(word).led(0)


@pytest.mark.parametrize("read", ["word", "number", "led", "exposure"])
def test_a_missing_word_is_invalid(read):
    with pytest.raises(BoardError, match=r"reply is invalid \(1 2\); check the firmware"):
        getattr(outcome("1", "2"), read)(2)


@pytest.mark.parametrize(
    ("verb", "args", "said"),
    [
        ("ON", ("3", "2500"), "ON LED 3 2500"),
        ("FLASH", ("-", "1", "2"), "FLASH no LED 1 2"),
        ("LEVEL", ("0", "9"), "LEVEL LED 0 9"),
        ("STEP", ("4", "3", "1", "2"), "STEP 4 LED 3 1 2"),
        ("DID", ("4", "-"), "DID 4 no LED"),
        ("OFF", (), "OFF"),
        ("ON", (), "ON"),
        ("STATUS", ("3",), "STATUS 3"),
    ],
)
def test_messages_name_the_led_of_a_command(verb, args, said):
    assert spoken(verb, args) == said
    assert where("p", Command(1, verb, args)) == f"LED board on p, {said}"


def test_messages_of_port_failures_give_advice():
    head = "LED board on p, ON LED 3 2500: "
    full = str(lost("p", ON, serial.SerialTimeoutException("full")))
    assert full.startswith(f"{head}no device accepts the data sent (full)")
    gone = str(lost("p", ON, OSError("gone")))
    assert gone == f"{head}the connection is lost (gone); check whether the board was unplugged"
    quiet = str(silent("p", ON, 0.75, b""))
    assert quiet.startswith(f"{head}no answer within 0.75 s; check power")
    talking = str(silent("p", ON, 2.0, b"x" * 50))
    assert f"no answer within 2 s, but it sent {b'x' * 40!r}; check" in talking
    assert str(overtaken("p", ON)).startswith(f"{head}all LEDs were turned off meanwhile")
