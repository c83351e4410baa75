"""The virtual board: its firmware with a clock set by the tests, and the life of its process."""

import contextlib
import subprocess
import sys

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rig import Command, LineBuffer, LineError, Reply, decode_reply, encode_command
from simulator._bench_state import BenchState, BenchWriter, LitPeriod
from simulator._board.faults import BoardFault, FaultyBoard, PowerCutError
from simulator._board.firmware import BoardFirmware
from simulator._board.outputs import ActiveInput, BoardOutputs

MS = 1_000_000
US = 1000


class Desk:
    """A board without a process, whose time is set by the test."""

    def __init__(self, path):
        self.writer = BenchWriter(path)
        self.state = BenchState(path)
        self.outputs = BoardOutputs(self.writer)
        self.active = ActiveInput(self.state)
        self.firmware = BoardFirmware(36, self.outputs, self.active, 0)
        self.board = FaultyBoard(self.firmware, self.outputs)
        self.now_ns = 0
        self.seq = 0

    def at_ms(self, ms):
        """Advance the time, wake the board whenever it is due, and return its replies."""
        until_ns = round(ms * MS)
        sent = b""
        while self.now_ns < until_ns:
            self.now_ns = min(until_ns, max(self.now_ns + 1, self.board.next_ns(self.now_ns)))
            sent += self.board.advance(self.now_ns)
        return [decode_reply(line) for line in sent.splitlines()]

    def send(self, *words, seq=None):
        """Send a command now; return the bytes of the immediate reply."""
        self.seq = self.seq + 1 if seq is None else seq
        self.board.receive(encode_command(Command(self.seq, words[0], words[1:])), self.now_ns)
        return self.board.advance(self.now_ns)

    def ask(self, *words, seq=None):
        """Send a command now; return the words of the reply, or None if there is no reply."""
        answer = self.send(*words, seq=seq)
        if not answer:
            return None
        reply = decode_reply(answer.rstrip())
        assert (reply.seq, reply.verb) == (self.seq, words[0])
        return " ".join(reply.args) if reply.error is None else f"E{reply.error}"

    def lit(self):
        """The lit periods, in ms, without empty ones."""
        periods = self.state.periods()
        return [(p.led, p.start_ns / MS, p.end_ns / MS) for p in periods if p.end_ns > p.start_ns]

    def triggers(self):
        return [pulse.time_ns / MS for pulse in self.state.triggers()]

    def close(self):
        self.state.close()
        self.writer.close()


@pytest.fixture
def desk(tmp_path):
    desk = Desk(tmp_path / "bench.state")
    yield desk
    desk.close()


@pytest.mark.parametrize(
    ("words", "outcome"),
    [
        pytest.param("ID", "sgp-virtual-board 2 2.0.0 36 60000 900 48", id="identity"),
        pytest.param("ON 7 1000", "7 1000", id="on"),
        pytest.param("ON 35 60000", "35 60000", id="last LED, longest hold"),
        pytest.param("ON 007 1", "7 1", id="leading zeros, shortest hold"),
        pytest.param("OFF", "-", id="off while dark"),
        pytest.param("LEVEL 3 4095", "3 4095", id="level"),
        pytest.param("FLASH 3 0 10", None, id="flash answers later"),
        pytest.param(
            "STEP 47 - 1000000 59000000 1000000", "47 - 1000000 59000000 1000000", id="step"
        ),
        pytest.param("RUN 1 T", "E7", id="no step loaded"),
        pytest.param("DID 0", "E7", id="no step done"),
        pytest.param("STATUS", "5 - 0 0 2982 IDLE 0", id="status"),
        pytest.param("BLINK 3", "E1", id="unknown"),
        pytest.param("ON 3", "E2", id="too few"),
        pytest.param("ON 3 1234567890", "E2", id="ten digits"),
        pytest.param("ON 36 0", "E3", id="LED before time"),
        pytest.param("FLASH 3 0 60000001", "E4", id="flash too long"),
        pytest.param("LEVEL 3 4096", "E6", id="level too high"),
        pytest.param("STEP 48 36 0 0 0", "E7", id="step before LED"),
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


def load(desk, *steps):
    for index, step in enumerate(steps):
        assert desk.ask("STEP", str(index), *step.split()) is not None


def test_a_sequence_is_recorded_in_advance_and_exact_to_the_microsecond(desk):
    load(desk, "1 2000 6000 50000", "2 1000 4000 10000", "- 0 500 0")
    assert desk.ask("RUN", "3", "T") == "3"
    assert desk.lit() == [(1, 0, 8), (2, 58, 63)]
    assert desk.triggers() == [2, 59, 73]
    desk.at_ms(58)
    assert desk.ask("DID", "0") == "0 1 2000 8000 -"
    assert desk.ask("DID", "1") == "E7"
    assert desk.ask("STATUS").split()[5:] == ["RUN", "1"]
    desk.at_ms(74)
    assert desk.ask("DID", "1") == "1 2 59000 5000 -"
    assert desk.ask("DID", "2") == "2 - 73000 500 -"
    assert desk.ask("STATUS").split()[5:] == ["IDLE", "3"]


def test_a_sequence_cut_short_cancels_its_future_steps(desk):
    load(desk, "1 2000 6000 50000", "2 1000 4000 10000", "3 0 500 0")
    desk.ask("RUN", "3", "T")
    desk.at_ms(10)
    assert desk.ask("OFF") == "-"
    assert desk.lit() == [(1, 0, 8)]
    assert desk.triggers() == [2]
    desk.at_ms(500)
    assert desk.ask("STATUS").split()[5:] == ["IDLE", "1"]


def test_a_sequence_of_a_silent_host_finishes_its_step_and_halts(desk):
    load(desk, "1 0 400000 0", "2 0 400000 0", "3 0 400000 0", "4 0 400000 0")
    desk.ask("RUN", "4", "T")
    desk.at_ms(5000)
    assert desk.lit() == [(1, 0, 400), (2, 400, 800), (3, 800, 1200)]
    assert desk.triggers() == [0, 400, 800]
    assert desk.ask("STATUS").split()[3:] == ["1", "2982", "HALT", "3"]
    desk.ask("LEVEL", "0", "4095")
    assert desk.ask("STATUS").split()[5] == "IDLE"


def test_the_camera_paces_a_sequence(desk):
    load(desk, "1 1000 50000 10000", "2 1000 50000 0", "3 0 50000 0")
    desk.ask("RUN", "3", "A")
    assert desk.triggers() == [1]
    # The camera sees the pulse a little later and knows the end of its exposure in advance.
    desk.at_ms(1.2)
    desk.state.expose(1 * MS, 6 * MS)
    desk.at_ms(4)
    assert desk.lit() == [(1, 0, 6)]
    desk.at_ms(16)
    assert desk.ask("DID", "0") == "0 1 1000 6000 5000"
    assert desk.triggers() == [1, 17]
    desk.state.expose(17 * MS, 30 * MS)
    desk.at_ms(31)
    # There is no last exposure.
    desk.at_ms(300)
    assert [row[:2] for row in desk.lit()] == [(1, 0), (2, 16), (3, 30)]
    assert desk.lit()[2][2] == 80
    assert desk.ask("DID", "2") == "2 3 30000 50000 -"
    assert desk.ask("STATUS").split()[5:] == ["HALT", "3"]


@pytest.mark.parametrize(
    ("exposure_ms", "active"),
    [
        pytest.param((2, 7), "5000", id="whole"),
        pytest.param((2, 20), "6000+", id="cut off"),
        pytest.param((-5, 1), "1000", id="began before the light"),
        pytest.param((8, 9), "-", id="after the light"),
    ],
)
def test_a_flash_reports_how_long_the_camera_exposed(desk, exposure_ms, active):
    desk.at_ms(100)
    desk.state.expose(*(round((100 + t) * MS) for t in exposure_ms))
    desk.ask("FLASH", "7", "2000", "6000")
    (reply,) = desk.at_ms(400)
    assert reply.args == ("7", "-", "8000", active)


def test_the_board_waits_for_an_exposure_that_a_camera_records_late(desk):
    desk.state.expose(0, 1)
    desk.at_ms(100)
    desk.ask("FLASH", "7", "2000", "6000")
    assert desk.at_ms(150) == []
    desk.state.expose(102 * MS, 106 * MS)
    (reply,) = desk.at_ms(152)
    assert reply.args == ("7", "-", "8000", "4000")


def test_a_new_level_takes_effect_the_next_time_the_led_turns_on(desk):
    desk.ask("ON", "7", "100")
    desk.ask("LEVEL", "7", "1365")
    assert desk.state.periods() == (LitPeriod(7, 0, 100 * MS),)
    desk.at_ms(200)
    desk.ask("ON", "7", "100")
    assert desk.state.periods()[-1].level == 1365
    assert desk.state.lit_ns(200 * MS, 230 * MS) == {7: 10 * MS}


def test_a_restart_turns_everything_off_and_resets_the_state(desk):
    load(desk, "1 0 400 0")
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


def test_the_edges_are_reported_in_order(desk):
    assert desk.outputs.events(0) == [{"us": 0, "lit": [], "levels": []}]
    load(desk, "1 1000 6000 1000", "- 0 100 0")
    desk.ask("RUN", "2", "T")
    desk.at_ms(20)
    assert desk.outputs.events(desk.now_ns) == [
        {"us": 0, "lit": [1], "levels": [4095]},
        {"us": 1000, "trigger": 1},
        {"us": 1200, "trigger": 0},
        {"us": 7000, "lit": [], "levels": []},
        {"us": 8000, "trigger": 1},
        {"us": 8100, "trigger": 0},
    ]


# Effect of each fault on FLASH 7, sent to a board whose LED 3 is on.
FLASHED = ["7 - 8000 -"]


@pytest.mark.parametrize(
    ("fault", "replies", "triggers", "leds"),
    [
        pytest.param({"kind": "drop-command"}, [], [], {3}, id="drop-command"),
        pytest.param({"kind": "corrupt-command", "value": 9}, [], [], {3}, id="corrupt-command"),
        pytest.param({"kind": "lose-byte-command", "value": 3}, [], [], {3}, id="lost byte"),
        pytest.param({"kind": "lose-byte-command", "value": -1}, [], [], {3}, id="lost line end"),
        pytest.param({"kind": "double-byte-command", "value": 8}, [], [], {3}, id="double byte"),
        pytest.param({"kind": "double-command"}, FLASHED, [12], {3, 7}, id="double-command"),
        pytest.param({"kind": "drop-reply"}, [], [12], {3, 7}, id="drop-reply"),
        pytest.param({"kind": "double-reply"}, FLASHED * 2, [12], {3, 7}, id="double-reply"),
        pytest.param({"kind": "delay-reply", "value": 50}, FLASHED, [12], {3, 7}, id="delay-reply"),
        pytest.param(
            {"kind": "wrong-led", "value": 9}, ["9 - 8000 -"], [12], {3, 9}, id="wrong-led"
        ),
        pytest.param({"kind": "double-led", "value": 9}, FLASHED, [12], {3, 7, 9}, id="double-led"),
        pytest.param(
            {"kind": "goes-dark", "value": 3}, ["7 - 3000 -"], [12], {3, 7}, id="goes-dark"
        ),
        pytest.param({"kind": "lose-trigger"}, FLASHED, [], {3, 7}, id="lose-trigger"),
        pytest.param({"kind": "double-trigger"}, FLASHED, [12, 12.3], {3, 7}, id="double-trigger"),
    ],
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


@pytest.mark.parametrize(
    ("fault", "back_ns"),
    [
        pytest.param(BoardFault(kind="die"), None, id="for good"),
        pytest.param(BoardFault(kind="hang-up", value=30), 40 * MS, id="comes back"),
    ],
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
@settings(max_examples=300, deadline=None)
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
@settings(max_examples=300, deadline=None)
def test_every_complete_command_gets_one_reply_that_repeats_it(tmp_path_factory, verb, args):
    desk = Desk(tmp_path_factory.mktemp("desk") / "bench.state")
    assume(len(" ".join((verb, *args))) <= 50)
    assert desk.ask(verb, *args) is not None
    desk.close()


def test_the_next_wake_up_is_never_in_the_past(desk):
    load(desk, "1 1000 50000 10000", "2 1000 900000 0", "3 0 50000 0")
    for words in ("ON 3 700", "FLASH 3 10 10", "RUN 3 T", "RUN 3 A"):
        desk.ask("OFF")
        desk.ask(*words.split())
        woken = 0
        end_ns = desk.now_ns + 2000 * MS
        while desk.now_ns < end_ns:
            desk.now_ns = min(end_ns, max(desk.now_ns + 1, desk.board.next_ns(desk.now_ns)))
            desk.board.advance(desk.now_ns)
            woken += 1
        assert woken < 30, words


def test_the_process_imports_no_part_of_the_renderer():
    heavy = "{'numba', 'cv2', 'scipy', 'harvesters'}"
    code = f"import sys, simulator.board; sys.exit(' '.join({heavy} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
