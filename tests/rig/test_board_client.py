"""The board client with a virtual board that has faults."""

import signal
from itertools import product

import pytest

from rig import Board, BoardError
from rig.board import Step
from rig.host import clock, threads
from simulator.led_board import BoardFault
from tests.cases import cases
from tests.rig.board_calls import VERBS, one_line
from tests.rig.conftest import led_on


def test_identity(board):
    found = board.identity
    assert (found.name, found.protocol, found.firmware) == ("sgp-virtual-board", 2, "2.0.0")
    assert (found.leds, found.max_hold_ms) == (36, 60_000)
    assert (found.watchdog_ms, found.max_steps) == (900, 48)


def test_on_turns_the_led_on_and_off_names_it(bench, board):
    assert board.on(7, 5000).led == 7
    assert led_on(bench) == 7
    assert board.status().led == 7
    assert board.off().led == 7
    assert led_on(bench) is None
    assert board.off().led is None
    assert board.status().led is None


def test_exactly_one_led_is_on(bench, board):
    board.on(3, 5000)
    board.on(35, 5000)
    assert led_on(bench) == 35
    assert [p.led for p in bench.state.periods()][-2:] == [3, 35]
    assert board.off().led == 35


def test_the_board_itself_ends_the_hold(bench, board):
    board.on(5, 30)
    clock.sleep(0.05)
    assert led_on(bench) is None
    last = bench.state.periods()[-1]
    assert last.end_ns - last.start_ns == 30_000_000
    assert board.off().led is None


@cases(
    "fault",
    {
        "lost command": BoardFault(kind="drop-command", verb="ON"),
        "corrupt command": BoardFault(kind="corrupt-command", verb="ON", value=9),
        "lost byte": BoardFault(kind="lose-byte-command", verb="ON", value=4),
        "lost line end": BoardFault(kind="lose-byte-command", verb="ON", value=-1),
        "double byte": BoardFault(kind="double-byte-command", verb="ON", value=2),
        "command arrives twice": BoardFault(kind="double-command", verb="ON"),
        "reply without end": BoardFault(kind="lose-byte-reply", verb="ON", value=-1),
        "reply garbled": BoardFault(kind="double-byte-reply", verb="ON", value=7),
        "reply arrives twice": BoardFault(kind="double-reply", verb="ON"),
        "lost reply": BoardFault(kind="drop-reply", verb="ON"),
        "corrupt reply": BoardFault(kind="corrupt-reply", verb="ON"),
        "late reply": BoardFault(kind="delay-reply", verb="ON", value=300),
        "noise damages the reply": BoardFault(kind="banner", verb="ON"),
        "reset instead of ON": BoardFault(kind="reset", verb="ON"),
    },
)
def test_one_failed_exchange_is_repaired_by_a_repetition(bench, board, fault):
    bench.virtual.set_faults(fault)
    before = len([p for p in bench.state.periods() if p.led == 9])
    assert board.on(9, 5000).led == 9
    assert led_on(bench) == 9
    assert board.off().led == 9
    # A repetition must not turn the LED on a second time.
    assert len([p for p in bench.state.periods() if p.led == 9]) == before + 1


@pytest.mark.parametrize(
    ("kind", "verb"),
    list(product(("drop-command", "drop-reply", "corrupt-reply", "double-reply"), VERBS)),
)
def test_every_command_survives_a_failed_exchange_and_is_done_once(bench, board, verb, kind):
    board.load([Step(9, 1000, 2000, 0)])
    since_ns = clock.monotonic_ns()  # the rings hold the last 64 periods and pulses only
    bench.virtual.set_faults(BoardFault(kind=kind, verb=verb))
    VERBS[verb](board)
    board.off()
    lit = [period for period in bench.state.periods() if period.start_ns > since_ns]
    pulses = [pulse for pulse in bench.state.triggers() if pulse.time_ns > since_ns]
    assert len(lit) <= (verb in ("ON", "FLASH", "RUN"))
    assert len(pulses) <= (verb in ("FLASH", "RUN"))


def test_a_late_reply_is_not_mistaken_for_that_of_the_next_command(bench, board):
    # The reply that names LED 1 is 300 ms late, while the client waits for that of the next OFF.
    bench.virtual.set_faults(
        BoardFault(kind="delay-reply", verb="OFF", value=300),
        BoardFault(kind="drop-reply", verb="OFF", skip=2),
    )
    board.on(1, 5000)
    assert board.off().led == 1
    board.on(2, 5000)
    assert board.off().led == 2


def test_a_repeated_off_still_names_the_led_after_a_lost_reply(bench, board):
    board.on(11, 5000)
    bench.virtual.set_faults(BoardFault(kind="drop-reply", verb="OFF"))
    assert board.off().led == 11


def test_off_is_repeated_until_it_is_answered(bench, board):
    board.on(11, 9000)
    bench.virtual.set_faults(BoardFault(kind="drop-command", verb="OFF", times=6))
    # The silence is longer than the watchdog time: the LED is off before the OFF arrives.
    assert board.off().led is None
    assert led_on(bench) is None


def test_a_flash_returns_its_report(bench, board):
    report = board.flash(7, 2000, 6000)
    assert (report.led, report.lit_us, report.active_us, report.cut_off) == (7, 8000, None, False)
    dark = board.flash(None, 0, 1000)
    assert (dark.led, dark.active_us) == (None, None)
    first, second = bench.state.triggers()[-2:]
    assert second.time_ns - first.time_ns > 6_000_000
    assert bench.state.periods()[-1].led == 7


def test_a_flash_reports_the_exposure(bench):
    board = Board(bench.virtual.port)
    for end_us, expected in ((5000, (5000, False)), (90_000, (60_000, True))):
        board.begin_flash(7, 2000, 60_000)
        board.ping()
        trigger_ns = bench.state.triggers()[-1].time_ns
        bench.state.expose(trigger_ns, trigger_ns + end_us * 1000)
        report = board.end_flash()
        assert (report.active_us, report.cut_off) == expected
        clock.sleep(0.1)
    board.close()


def test_queries_are_answered_during_a_flash(bench, board):
    board.begin_flash(7, 0, 200_000)
    for _ in range(3):
        status = board.status()
        assert (status.state, status.led) == ("FLASH", 7)
        board.ping()
    report = board.end_flash()
    assert (report.led, report.lit_us) == (7, 200_000)


def test_a_reply_to_a_flash_that_arrived_earlier_is_found(bench, board):
    board.begin_flash(7, 0, 1000)
    clock.sleep(0.3)
    assert board.end_flash().lit_us == 1000
    board.begin_flash(8, 0, 1000)
    clock.sleep(0.3)
    board.ping()
    assert board.end_flash().led == 8


def test_a_flash_that_was_ended_has_no_report(bench, board):
    board.begin_flash(7, 0, 5_000_000)
    assert board.off().led == 7
    with pytest.raises(BoardError, match="no command is pending"):
        board.end_flash()


def test_the_next_ping_reports_a_refused_flash(bench, board):
    board.begin_flash(36, 0, 1000)
    clock.sleep(0.05)
    with pytest.raises(BoardError, match=r"FLASH LED 36 .*the board refused, error 3"):
        board.ping()
    board.begin_flash(36, 0, 1000)
    with pytest.raises(BoardError, match="error 3"):
        board.end_flash()


def test_a_sequence_reports_every_step(bench, board):
    board.load([Step(3, 1000, 4000, 5000), Step(None, 0, 1000, 5000), Step(5, 0, 3000, 0)])
    board.run(3)
    reports = []
    while len(reports) < 3:
        report = board.step_report(len(reports))
        reports += [] if report is None else [report]
    assert [r.led for r in reports] == [3, None, 5]
    assert [r.trigger_us for r in reports] == [1000, 10_000, 16_000]
    assert [r.lit_us for r in reports] == [5000, 1000, 3000]
    assert board.status().done == 3
    assert board.status().state == "IDLE"


def test_level_dims_an_led(bench, board):
    board.level(7, 1000)
    board.on(7, 5000)
    assert bench.state.periods()[-1].level == 1000
    board.level(7, 4095)


def test_the_next_ping_reports_a_restart(bench, board):
    clock.sleep(0.6)
    board.ping()
    bench.virtual.set_faults(BoardFault(kind="reset", verb="STATUS"))
    with pytest.raises(BoardError, match="restarted") as error:
        board.ping()
    one_line(error, board.port)
    board.ping()


def test_a_flash_that_may_have_been_repeated_by_a_restart_is_refused(bench, board):
    bench.virtual.set_faults(BoardFault(kind="reset-after", verb="FLASH"))
    clock.sleep(0.1)
    since_ns = clock.monotonic_ns()
    with pytest.raises(BoardError, match="restarted"):
        board.flash(7, 0, 1000)
    assert any(pulse.time_ns > since_ns for pulse in bench.state.triggers())


def test_a_sequence_with_too_many_steps_is_refused(bench, board):
    with pytest.raises(BoardError, match=r"STEP 48 LED 1 .* error 7: no such step"):
        board.load([Step(1, 0, 100, 0)] * 49)
    with pytest.raises(BoardError, match="RUN 49 T: the board refused, error 7"):
        board.run(49)


def test_darken_does_not_wait(bench, board):
    board.on(7, 5000)
    board.darken()
    # The board needs only a moment; nothing was read.
    ends = clock.monotonic() + 5
    while led_on(bench) is not None:
        assert clock.monotonic() < ends
        clock.sleep(0.002)
    # The light was cut off: the next OFF must not name the LED as on until then.
    assert board.off().led is None
    assert board.on(8, 5000).led == 8
    assert board.off().led == 8


def test_a_command_overtaken_by_darken_is_not_sent_again(bench, board):
    bench.virtual.set_faults(BoardFault(kind="drop-reply", verb="ON", times=2))

    def darken():
        clock.sleep(0.1)
        board.darken()

    thread = threads.Thread(target=darken)
    thread.start()
    with pytest.raises(BoardError, match="turned off meanwhile") as error:
        board.on(7, 5000)
    one_line(error, board.port, "ON LED 7")
    thread.join()
    assert led_on(bench) is None


def test_a_flash_overtaken_by_darken_is_not_sent_again(bench, board):
    board.begin_flash(7, 0, 200_000)
    board.darken()
    with pytest.raises(BoardError, match="turned off meanwhile"):
        board.end_flash()
    assert led_on(bench) is None


@pytest.mark.parametrize(
    "sent", [0, 7, -1, None], ids=["before", "in the middle", "before its end", "after"]
)
def test_darken_during_the_writing_of_a_command_leaves_all_leds_off(real_board, monkeypatch, sent):
    port = real_board._line._serial
    write = port.write

    def overtaken(line):
        monkeypatch.undo()
        write(line[:sent])
        real_board.darken()
        write(line[len(line[:sent]) :])

    monkeypatch.setattr(port, "write", overtaken)
    with pytest.raises(BoardError, match="turned off meanwhile"):
        real_board.on(7, 5000)
    assert real_board.status().led is None


def test_darken_in_a_signal_handler_turns_the_led_off(real_bench, real_board):
    real_bench.virtual.set_faults(BoardFault(kind="drop-reply", verb="ON", times=9))

    def handler(number, frame):
        real_board.darken()
        raise SystemExit

    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        with pytest.raises(SystemExit):
            real_board.on(7, 5000)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert real_board.status().led is None


def test_darken_raises_nothing_without_a_board(own_bench):
    board = Board(own_bench.virtual.port)
    own_bench.virtual.unplug()
    board.darken()
    board.close()
    board.darken()


def test_a_signal_while_the_port_closes_writes_nothing(board, monkeypatch):
    """Another file may have the number of the port by then."""
    line, written = board._line._serial, []
    with monkeypatch.context() as patched:
        patched.setattr(line, "write", written.append)
        patched.setattr(line, "close", board.darken)
        board.close()
    assert written == []
