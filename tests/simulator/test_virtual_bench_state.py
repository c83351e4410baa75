"""The bench state: readers see what the writer has recorded."""

import struct
import threading

import pytest

from rig import RigError
from simulator.bench import BenchState, BenchWriter, ExposurePeriod, LitPeriod, TriggerPulse
from simulator.bench.state import NEVER_NS, RING, SIZE


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "bench.state"
    writer = BenchWriter(path)
    reader = BenchState(path)
    yield path, writer, reader
    reader.close()
    writer.close()


def test_an_untouched_room_is_dark(room):
    _, _, reader = room
    assert reader.periods() == ()
    assert reader.led(5) is None
    assert reader.lit_ns(0, 100) == {}
    assert reader.triggers() == ()
    assert reader.exposures() == ()
    assert reader.changes == 0


def test_an_led_turns_off_as_declared_or_earlier(room):
    _, writer, reader = room
    writer.light(3, 100, 200)
    writer.light(4, 300, 900)
    writer.put_out(350)
    writer.put_out(360)
    assert reader.periods() == (LitPeriod(3, 100, 200), LitPeriod(4, 300, 350))
    assert [reader.led(t) for t in (99, 100, 199, 200, 349, 350)] == [None, 3, 3, None, 4, None]
    # Two LEDs turned on, one ended early; the last call changed nothing.
    assert reader.changes == 3


def test_the_end_of_a_light_moves_but_not_before_its_start(room):
    _, writer, reader = room
    first, second = writer.light(3, 100, 200), writer.light(4, 300, 400)
    writer.end(first, 1000)
    writer.end(second, 50)
    assert reader.periods() == (LitPeriod(3, 100, 1000), LitPeriod(4, 300, 300))


def test_future_light_and_pulses_are_cancelled(room):
    _, writer, reader = room
    writer.light(3, 100, 200)
    assert writer.pulse(120) == 0
    writer.light(4, 300, 400)
    assert writer.pulse(320) == 1
    writer.put_out(150)
    assert reader.periods() == (LitPeriod(3, 100, 150), LitPeriod(4, 300, 300))
    assert reader.triggers() == (TriggerPulse(0, 120),)
    assert writer.pulse(500) == 2
    assert reader.triggers() == (TriggerPulse(0, 120), TriggerPulse(2, 500))


def test_the_camera_records_its_exposures(room):
    path, writer, reader = room
    other = BenchState(path)
    for k in range(RING + 5):
        other.expose(10 * k, 10 * k + 7)
        writer.light(k, 10 * k, 10 * k + 5)
    assert reader.exposures() == tuple(
        ExposurePeriod(10 * k, 10 * k + 7) for k in range(5, RING + 5)
    )
    assert reader.changes == RING + 5
    other.close()


def test_a_board_that_died_in_the_middle_of_a_change_does_not_block_the_readers(room):
    path, writer, reader = room
    writer.light(3, 100, 200)
    with path.open("r+b") as file:
        file.seek(16)
        file.write(struct.pack("<Q", 3))
    assert reader.periods() == (LitPeriod(3, 100, 200),)


def test_a_camera_that_died_in_the_middle_of_a_change_does_not_block_the_next(room):
    path, _, reader = room
    with path.open("r+b") as file:
        file.seek(48)
        file.write(struct.pack("<Q", 7))
    reader.expose(10, 20)
    assert reader.exposures() == (ExposurePeriod(10, 20),)


@pytest.mark.parametrize(
    ("start", "end", "lit"),
    [
        pytest.param(0, 100, {}, id="before"),
        pytest.param(120, 160, {3: 40}, id="within"),
        pytest.param(150, 250, {3: 50}, id="went dark"),
        pytest.param(250, 350, {4: 50}, id="lit late"),
        pytest.param(0, 1000, {3: 150, 4: 100}, id="all"),
    ],
)
def test_lit_time_is_the_overlap(room, start, end, lit):
    _, writer, reader = room
    writer.light(3, 100, 200)
    writer.light(4, 300, 400)
    writer.light(3, 500, 550)
    assert reader.lit_ns(start, end) == lit


def test_the_ring_keeps_the_newest_periods_and_reports_missing_ones(room):
    _, writer, reader = room
    for k in range(RING + 10):
        writer.light(k % 36, 10 * k, 10 * k + 10)
    assert [p.start_ns for p in reader.periods()] == [10 * k for k in range(10, RING + 10)]
    assert reader.lit_ns(100, 110) == {10: 10}
    with pytest.raises(RigError, match="more than 64 LEDs"):
        reader.lit_ns(50, 200)


def test_a_full_ring_contains_all_periods(room):
    _, writer, reader = room
    for k in range(RING):
        writer.light(k, 10 + 10 * k, 20 + 10 * k)
    assert reader.lit_ns(0, 10 * RING + 20) == dict.fromkeys(range(RING), 10)


def test_a_dimmed_led_counts_by_its_light(room):
    _, writer, reader = room
    writer.light(3, 0, 1000, level=819)
    writer.light(3, 1000, 1100)
    writer.light(4, 1100, 1200, level=0)
    assert reader.lit_ns(0, 1200) == {3: 300, 4: 0}


def test_the_layout_is_as_documented(room):
    path, writer, reader = room
    writer.light(7, 1000, 5000)
    writer.light(8, 6000, 7000, level=4000)
    writer.pulse(1500)
    writer.pulse(6500)
    writer.put_out(3000)
    reader.expose(1510, 2510)
    data = path.read_bytes()
    assert len(data) == SIZE == 64 + 64 * 24 + 2 * 64 * 16
    head = struct.unpack_from("<8sIIQQQIIQQ", data)
    assert head == (b"SGPBENCH", 2, 64, 10, 2, 2, 64, 64, 2, 1)
    # An LED at full level can be read as a 64-bit number.
    assert struct.unpack_from("<qqq", data, 64) == (7, 1000, 3000)
    assert struct.unpack_from("<iiqq", data, 64 + 24) == (8, 95, 6000, 6000)
    triggers = 64 + 64 * 24
    assert struct.unpack_from("<qqqq", data, triggers) == (0, 1500, 1, NEVER_NS)
    assert struct.unpack_from("<qq", data, triggers + 64 * 16) == (1510, 2510)


def test_a_reader_never_sees_a_partial_change(room):
    _, writer, reader = room
    camera = BenchState(room[0])
    done = threading.Event()

    def write():
        k = 0
        while not done.is_set():
            k += 1
            writer.light(k % 36, 1000 * k, 1000 * k + 1000)
            writer.pulse(1000 * k)
            camera.expose(1000 * k, 1000 * k + 500)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(1000):
            for period in reader.periods():
                assert period.end_ns == period.start_ns + 1000
                assert period.led == period.start_ns // 1000 % 36
            for pulse in reader.triggers():
                assert pulse.time_ns == 1000 * (pulse.number + 1)
            for exposure in reader.exposures():
                assert exposure.end_ns == exposure.start_ns + 500
    finally:
        done.set()
        thread.join()
        camera.close()


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(None, id="absent"),
        pytest.param(b"", id="empty"),
        pytest.param(b"x" * SIZE, id="another file"),
        pytest.param(b"SGPBENCH" + b"\3\0\0\0" * ((SIZE - 8) // 4), id="another version"),
    ],
)
def test_an_invalid_bench_state_is_refused(tmp_path, content):
    path = tmp_path / "bench.state"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RigError, match="bench state"):
        BenchState(path)
