"""The light in the room as a file: what is written is what is seen."""

import struct
import threading

import pytest

from rig import RigError
from simulator._bench_state import RING, SIZE, BenchState, BenchWriter, LitPeriod


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "bench.state"
    writer = BenchWriter(path)
    reader = BenchState(path)
    yield path, writer, reader
    reader.close()
    writer.close()


def test_an_untouched_room_is_dark(room):
    _, writer, reader = room
    assert reader.periods() == ()
    assert reader.led(5) is None
    assert reader.lit_ns(0, 100) == {}
    assert writer.led(0) is None
    assert reader.changes == 0


def test_light_ends_with_its_hold_off_or_the_next_led(room):
    _, writer, reader = room
    writer.light(3, 100, 200)
    writer.light(4, 300, 900)
    writer.put_out(350)
    writer.put_out(360)
    writer.light(5, 400, 900)
    writer.light(6, 500, 600)
    assert reader.periods() == (
        LitPeriod(3, 100, 200),
        LitPeriod(4, 300, 350),
        LitPeriod(5, 400, 500),
        LitPeriod(6, 500, 600),
    )
    seen = [reader.led(t) for t in (99, 100, 199, 200, 349, 350, 499, 500, 600)]
    assert seen == [None, 3, 3, None, 4, None, 5, 6, None]
    # Four lit, two ended early.
    assert reader.changes == 6


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


def test_the_ring_keeps_the_newest_and_says_when_it_forgot(room):
    _, writer, reader = room
    for k in range(RING + 10):
        writer.light(k % 36, 10 * k, 10 * k + 10)
    assert [p.start_ns for p in reader.periods()] == [10 * k for k in range(10, RING + 10)]
    assert reader.lit_ns(100, 110) == {10: 10}
    with pytest.raises(RigError, match="more than 64 LEDs"):
        reader.lit_ns(50, 200)


def test_the_layout_is_the_documented_one(room):
    path, writer, _ = room
    writer.light(7, 1000, 5000)
    writer.put_out(3000)
    data = path.read_bytes()
    assert len(data) == SIZE == 32 + 64 * 24
    assert struct.unpack_from("<8sIIQQ", data) == (b"SGPBENCH", 1, 64, 4, 1)
    assert struct.unpack_from("<qqq", data, 32) == (7, 1000, 3000)


def test_a_reader_never_sees_half_a_change(room):
    _, writer, reader = room
    done = threading.Event()

    def write():
        k = 0
        while not done.is_set():
            k += 1
            writer.light(k % 36, 1000 * k, 1000 * k + 1000)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(3000):
            for period in reader.periods():
                assert period.end_ns == period.start_ns + 1000
                assert period.led == period.start_ns // 1000 % 36
    finally:
        done.set()
        thread.join()


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(None, id="absent"),
        pytest.param(b"", id="empty"),
        pytest.param(b"x" * SIZE, id="another file"),
        pytest.param(b"SGPBENCH" + b"\2\0\0\0" * ((SIZE - 8) // 4), id="another version"),
    ],
)
def test_what_is_no_bench_state(tmp_path, content):
    path = tmp_path / "bench.state"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RigError, match="bench state"):
        BenchState(path)
