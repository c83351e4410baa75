"""The virtual board: its firmware with a clock set by the tests, and the life of its process."""

import subprocess
import sys

import pytest

from rig.board import Command, Reply, decode_reply, encode_command
from simulator.bench import LitPeriod
from simulator.led_board import BoardFault
from tests.simulator.desk import MS, load_steps


@pytest.mark.parametrize(
    ("words", "outcome"),
    [
        ("ID", "sgp-virtual-board 2 2.0.0 36 60000 900 48"),
        ("ON 7 1000", "7 1000"),
        ("ON 35 60000", "35 60000"),
        ("ON 007 1", "7 1"),
        ("OFF", "-"),
        ("LEVEL 3 4095", "3 4095"),
        ("FLASH 3 0 10", None),
        ("STEP 47 - 1000000 59000000 1000000", "47 - 1000000 59000000 1000000"),
        ("RUN 1 T", "E7"),
        ("DID 0", "E7"),
        ("STATUS", "5 - 0 0 2982 IDLE 0"),
        ("BLINK 3", "E1"),
        ("ON 3", "E2"),
        ("ON 3 1234567890", "E2"),
        ("ON 36 0", "E3"),
        ("FLASH 3 0 60000001", "E4"),
        ("LEVEL 3 4096", "E6"),
        ("STEP 48 36 0 0 0", "E7"),
    ],
)
def test_commands(desk, words, outcome):
    desk.at_ms(5)
    assert desk.ask(*words.split()) == outcome


def test_the_reply_to_a_refused_command_repeats_it_and_nothing_changes(desk):
    desk.ask("ON", "3", "1000")
    reply = decode_reply(desk.send("ON", "36", "100", seq=9).rstrip())
    assert reply == Reply(9, "ON", ("36", "100"), 3)
    assert desk.ask("OFF") == "3"


def test_the_end_of_a_light_is_recorded_when_it_begins(desk):
    desk.at_ms(10)
    desk.ask("ON", "7", "300")
    assert desk.lit() == [(7, 10, 310)]
    desk.at_ms(20)
    desk.ask("FLASH", "8", "2000", "6000")
    assert desk.lit() == [(7, 10, 20), (8, 20, 28)]
    assert desk.triggers() == [22]
    (reply,) = desk.at_ms(1000)
    assert reply.args == ("8", "-", "8000", "-")


def test_a_flash_cut_short_cancels_its_light_and_its_pulse(desk):
    desk.ask("FLASH", "8", "2000", "6000")
    desk.at_ms(1)
    assert desk.ask("OFF") == "8"
    assert desk.lit() == [(8, 0, 1)]
    assert desk.triggers() == []
    desk.ask("FLASH", "8", "2000", "6000")
    desk.at_ms(4)
    assert desk.ask("OFF") == "8"
    assert desk.triggers() == [3]
    assert desk.at_ms(100) == []


def test_a_flash_reports_the_time_since_the_previous_pulse(desk):
    def since():
        desk.ask("FLASH", "7", "2000", "6000")
        (reply,) = desk.at_ms(desk.now_ns / MS + 10)
        return reply.args[1]

    assert since() == "-"
    assert since() == "10000"
    desk.ask("FLASH", "8", "5000", "6000")
    assert desk.ask("OFF") == "8"
    # A cancelled pulse does not count.
    assert since() == "10000"
    desk.at_ms(desk.now_ns / MS + 998_000)
    assert since() == "998010000"
    desk.at_ms(desk.now_ns / MS + 999_000)
    assert since() == "-"


def test_the_previous_pulse_is_known_even_if_leds_were_on_in_between(desk):
    desk.ask("FLASH", "7", "0", "1000")
    desk.at_ms(10)
    for _ in range(300):
        desk.ask("ON", "3", "60000")
    desk.ask("FLASH", "7", "0", "1000")
    (reply,) = desk.at_ms(20)
    assert reply.args[1] == "10000"


def test_lights_that_begin_at_the_same_instant_have_their_own_ends(desk):
    desk.ask("ON", "7", "300")
    desk.ask("ON", "8", "300")
    # A command from the host moves the end of this light and of no other.
    desk.ask("STATUS")
    desk.at_ms(400)
    events = [event for event in desk.outputs.events(desk.now_ns) if "lit" in event]
    assert [event["lit"] for event in events] == [[8], []]


def test_two_carriage_returns_damage_a_line(desk):
    whole = encode_command(Command(1, "ON", ("7", "1000")))
    for end in (b"\r\r\n", b"\r\r\r\n"):
        desk.board.receive(whole[:-1] + end, desk.now_ns)
        assert desk.board.advance(desk.now_ns) == b""
    assert desk.ask("STATUS").split()[1:3] == ["-", "2"]


def test_a_reset_discards_a_partial_line_and_data_in_transit(desk):
    whole = encode_command(Command(1, "ON", ("7", "1000")))
    desk.board.set_faults([BoardFault(kind="delay-reply", value=50)])
    assert desk.ask("ID") is None
    desk.board.receive(whole[:9], desk.now_ns)
    desk.board.reset(desk.now_ns)
    desk.board.receive(whole[9:], desk.now_ns)
    assert desk.at_ms(100) == []
    assert desk.lit() == []


def test_an_input_that_is_raised_twice_falls_once(desk):
    desk.active.set(True, 10 * MS)
    desk.active.set(True, 20 * MS)
    desk.active.set(False, 30 * MS)
    desk.active.set(False, 40 * MS)
    spans = [(e.start_ns / MS, e.end_ns / MS) for e in desk.active.exposures()]
    assert spans == [(10, 30)]


def test_an_led_is_off_a_second_after_the_last_command_even_if_the_board_has_died(desk):
    desk.ask("ON", "7", "60000")
    desk.at_ms(400)
    desk.ask("STATUS")
    # The board does not run again.
    assert desk.lit() == [(7, 0, 1300)]


def test_an_hour_of_pings_keeps_an_led_on_until_the_end_of_its_hold(desk):
    for _ in range(60):
        begun_ms = desk.now_ns / MS
        desk.ask("ON", "7", "60000")
        for k in range(1, 200):
            desk.at_ms(begun_ms + 300 * k)
            assert desk.ask("STATUS").split()[1] == "7"
        desk.at_ms(begun_ms + 60_000)
        assert desk.ask("STATUS").split()[1:5] == ["-", "0", "0", "2982"]
        desk.at_ms(begun_ms + 60_100)


def test_the_watchdog_counts_each_time_it_acts(desk):
    for k in range(100):
        desk.at_ms(10_000 * k)
        desk.ask("ON", "7", "5000")
        desk.at_ms(10_000 * k + 899)
        assert desk.firmware.light.led(desk.now_ns) == 7
        desk.at_ms(10_000 * k + 1000)
        assert desk.firmware.light.led(desk.now_ns) is None
    assert desk.ask("STATUS").split()[3] == "100"


def test_the_watchdog_does_not_end_a_declared_flash(desk):
    desk.ask("FLASH", "7", "1000000", "59000000")
    assert desk.at_ms(59_999) == []
    assert desk.firmware.light.led(desk.now_ns) == 7
    (reply,) = desk.at_ms(60_001)
    assert reply.args == ("7", "-", "60000000", "-")
    assert desk.ask("STATUS").split()[3] == "0"


def test_a_new_level_takes_effect_the_next_time_the_led_turns_on(desk):
    desk.ask("ON", "7", "100")
    desk.ask("LEVEL", "7", "1365")
    assert desk.state.periods() == (LitPeriod(7, 0, 100 * MS),)
    desk.at_ms(200)
    desk.ask("ON", "7", "100")
    assert desk.state.periods()[-1].level == 1365
    assert desk.state.lit_ns(200 * MS, 230 * MS) == {7: 10 * MS}


def test_a_restart_turns_everything_off_and_resets_the_state(desk):
    load_steps(desk, "1 0 400 0")
    desk.ask("LEVEL", "7", "5")
    desk.ask("ON", "7", "1000", seq=50)
    desk.board.receive(b"damaged\n", desk.now_ns)
    desk.at_ms(5)
    desk.board.reset(desk.now_ns)
    desk.at_ms(8)
    assert desk.ask("STATUS") == "3 - 0 0 2982 IDLE 0"
    assert desk.ask("RUN", "1", "T") == "E7"
    assert desk.ask("ON", "7", "1000", seq=50) == "7 1000"
    assert desk.state.periods()[-1].level == 4095


def test_the_process_imports_no_part_of_the_renderer():
    heavy = "{'numba', 'cv2', 'scipy', 'harvesters'}"
    code = f"import sys, simulator.board; sys.exit(' '.join({heavy} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
