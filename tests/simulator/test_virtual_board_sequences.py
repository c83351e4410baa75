"""Sequences on the virtual board, and exposures that the camera reports."""

import pytest

from tests.simulator.desk import MS, load_steps


def test_a_sequence_is_recorded_in_advance_and_exact_to_the_microsecond(desk):
    load_steps(desk, "1 2000 6000 50000", "2 1000 4000 10000", "- 0 500 0")
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
    load_steps(desk, "1 2000 6000 50000", "2 1000 4000 10000", "3 0 500 0")
    desk.ask("RUN", "3", "T")
    desk.at_ms(10)
    assert desk.ask("OFF") == "-"
    assert desk.lit() == [(1, 0, 8)]
    assert desk.triggers() == [2]
    desk.at_ms(500)
    assert desk.ask("STATUS").split()[5:] == ["IDLE", "1"]


def test_a_sequence_of_a_silent_host_finishes_its_step_and_halts(desk):
    load_steps(desk, "1 0 400000 0", "2 0 400000 0", "3 0 400000 0", "4 0 400000 0")
    desk.ask("RUN", "4", "T")
    desk.at_ms(5000)
    assert desk.lit() == [(1, 0, 400), (2, 400, 800), (3, 800, 1200)]
    assert desk.triggers() == [0, 400, 800]
    assert desk.ask("STATUS").split()[3:] == ["1", "2982", "HALT", "3"]
    desk.ask("LEVEL", "0", "4095")
    assert desk.ask("STATUS").split()[5] == "IDLE"


def test_the_camera_paces_a_sequence(desk):
    load_steps(desk, "1 1000 50000 10000", "2 1000 50000 0", "3 0 50000 0")
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


def test_the_edges_are_reported_in_order(desk):
    assert desk.outputs.events(0) == [{"us": 0, "lit": [], "levels": []}]
    load_steps(desk, "1 1000 6000 1000", "- 0 100 0")
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


def test_the_next_wake_up_is_never_in_the_past(desk):
    load_steps(desk, "1 1000 50000 10000", "2 1000 900000 0", "3 0 50000 0")
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
