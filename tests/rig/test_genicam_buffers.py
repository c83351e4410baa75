"""Room for the frames of a sequence: how much there is, and what happens if it is too little."""

import threading
import time

import numpy as np
import pytest
from genicam import gentl
from hypothesis import given
from hypothesis import strategies as st

from rig import CameraError, FrameLostError
from rig.genicam.acquisition import Collector, StreamCounts
from rig.genicam.buffers import LEAST, Buffering
from tests.rig.camera_benches import EXPOSURE_US, SIZE, grey

MB = 10**6


def armed(bench, frames, **options):
    camera = bench.open(**options)
    camera.configure(exposure_us=EXPOSURE_US)
    camera.arm("line", frames)
    return camera


def flash(bench, led):
    """Pulse the line under an LED, and wait until the camera has sent the frame."""
    done = sum(counted(bench))
    bench.light(led)
    bench.pulse(0.001)
    wait_until(lambda: sum(counted(bench)) > done)
    bench.dark()


def counted(bench):
    counts = bench.device.counts()
    return counts.delivered, counts.dropped, counts.missed


def fetched(camera, ids, timeout_s=2.0):
    """Fetch frames and return the LEDs that they show."""
    frames = [camera.fetch(frame_id, timeout_s) for frame_id in ids]
    return [round((int(frame.pixels[0, 0]) - grey(0)) / (grey(1) - grey(0))) for frame in frames]


def collecting():
    return any(thread.name == "collector" for thread in threading.enumerate())


def wait_until(happened, timeout_s=10.0):
    ends = time.monotonic() + timeout_s
    while not happened():
        assert time.monotonic() < ends
        time.sleep(0.001)


@pytest.mark.parametrize(
    ("frames", "payload", "limit", "room"),
    [
        pytest.param(1, 10 * MB, 1000 * MB, Buffering(4), id="single shots"),
        pytest.param(37, 10 * MB, 1000 * MB, Buffering(39), id="5 Mpx"),
        pytest.param(36, 40 * MB, 1000 * MB, Buffering(12, 13), id="20 Mpx: memory for 25"),
        pytest.param(36, 40 * MB, 4000 * MB, Buffering(38), id="20 Mpx, memory for all"),
        pytest.param(36, 40 * MB, 100 * MB, Buffering(4, 4), id="memory for two"),
        pytest.param(1, 400 * MB, 100 * MB, Buffering(4), id="a frame larger than the limit"),
        pytest.param(3, 0, 100 * MB, Buffering(5), id="no payload"),
    ],
)
def test_the_room_depends_on_memory(frames, payload, limit, room):
    assert Buffering.within(limit, frames, payload) == room


@given(st.integers(1, 48), st.integers(1, 10**9), st.integers(1, 10**11), st.integers(1, 300))
def test_the_room_is_bounded_and_never_zero(frames, payload, limit, taken):
    for room in (
        Buffering.within(limit, frames, payload),
        Buffering.with_copies(min(taken, LEAST), frames, limit // payload),
    ):
        assert room.buffers >= 1
        together = room.buffers + room.copies
        # All frames have a place, or memory is used up; there is always the minimum.
        assert together >= min(frames, limit // payload)
        assert together * payload <= max(limit, 2 * LEAST * payload)
        assert not room.copies or room.buffers < frames


def test_every_frame_of_a_run_has_a_buffer_however_late_it_is_fetched(make):
    """With only four buffers, the fifth and all later frames would be lost."""
    bench = make()
    leds = [number % 12 for number in range(37)]
    camera = armed(bench, len(leds))
    ids = [camera.expect() for _ in leds]
    for led in leds:
        flash(bench, led)
    assert not collecting()
    assert fetched(camera, ids) == leds
    assert bench.device.counts().dropped == 0


@pytest.mark.parametrize(
    ("options", "opened", "buffers", "copies"),
    [
        pytest.param({"most_buffers": 3}, {}, 3, 30, id="a producer of three buffers"),
        pytest.param({"most_buffers": 1}, {}, 1, 30, id="a producer of one buffer"),
        pytest.param({}, {"most_bytes": 25 * 120}, 12, 13, id="memory for 25 frames"),
    ],
)
def test_a_thread_empties_buffers_that_are_too_few(make, options, opened, buffers, copies):
    bench = make(**options)
    leds = [number % 12 for number in range(25)]
    camera = armed(bench, 30, **opened)
    ids = [camera.expect() for _ in leds]
    kept = camera._acquisition._collected
    for number, led in enumerate(leds, 1):
        flash(bench, led)
        wait_until(lambda number=number: len(kept) == min(number, copies))
    assert camera._acquisition._acquirer.num_buffers == buffers
    assert fetched(camera, ids) == leds
    # The last pending frame has been fetched.
    assert not collecting()


def test_a_thread_keeps_no_more_frames_than_memory_allows(make):
    bench = make(most_buffers=3)
    # A frame has 120 bytes: memory for 8.
    camera = armed(bench, 20, most_bytes=1000)
    ids = [camera.expect() for _ in range(20)]
    kept = camera._acquisition._collected
    for number in range(20):
        flash(bench, number % 12)
        wait_until(lambda number=number: len(kept) == min(number + 1, 5))
    assert bench.device.counts().dropped == 20 - 8
    assert fetched(camera, ids[:8]) == list(range(8))
    with pytest.raises(FrameLostError, match="12 frames found none of the 3 buffers free") as lost:
        camera.fetch(ids[8], 0.02)
    assert lost.value.host_is_slow
    assert lost.value.counts == {"started": 8, "delivered": 8, "underrun": 12, "buffers": 3}
    assert not collecting()
    # A new run begins without frames or counters of this one.
    ids = [camera.expect()]
    flash(bench, 7)
    assert fetched(camera, ids) == [7]


@pytest.mark.parametrize("at", [0, 1, 5, 7])
@pytest.mark.parametrize("most_buffers", [3, 256])
def test_frames_without_a_buffer_indicate_a_slow_computer(make, at, most_buffers):
    bench = make(most_buffers=most_buffers, first_block_id=1)
    camera = armed(bench, 8)
    bench.fault(at, "underrun")
    ids = [camera.expect() for _ in range(8)]
    for led in range(8):
        flash(bench, led)
        wait_until(
            lambda: most_buffers > 8 or not camera._acquisition._stream.num_awaiting_delivery
        )
    assert fetched(camera, ids[:at]) == list(range(at))
    with pytest.raises(FrameLostError, match=r"1 frame found none of .* too busy") as lost:
        camera.fetch(ids[at], 0.02)
    assert f"frame {at} " in str(lost.value)
    assert "cable" not in str(lost.value)
    assert lost.value.counts["underrun"] == 1
    assert "\n" not in str(lost.value)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        pytest.param("lost", "check cable and network", id="lost"),
        pytest.param("missed", "did not come .* check trigger and cable", id="trigger not seen"),
        pytest.param("incomplete", "a frame is incomplete", id="incomplete"),
    ],
)
@pytest.mark.parametrize("most_buffers", [2, 256])
def test_other_losses_do_not_indicate_a_slow_computer(make, kind, said, most_buffers):
    bench = make(most_buffers=most_buffers)
    camera = armed(bench, 4)
    bench.fault(1, kind)
    ids = [camera.expect() for _ in range(3)]
    for led in (1, 2, 3):
        flash(bench, led)
        wait_until(
            lambda: not camera._acquisition._stream.num_awaiting_delivery or most_buffers > 2
        )
    assert fetched(camera, ids[:1]) == [1]
    if kind == "missed":
        # No block id is missing: the later frame takes its place, and the last frame is missing.
        assert fetched(camera, ids[1:2]) == [3]
        ids = ids[1:]
    with pytest.raises(FrameLostError, match=said) as lost:
        camera.fetch(ids[1], 0.02)
    assert not lost.value.host_is_slow
    assert lost.value.counts["underrun"] == 0
    assert "busy" not in str(lost.value)


class Stream:
    """A stream with given counters."""

    def __init__(self, infos=(), nodes=()):
        self._infos = dict(infos)
        self.node_map = self
        self._nodes = dict(nodes)

    def __getattr__(self, name):
        if name.startswith("num_"):
            if name not in self._infos:
                raise gentl.NotAvailableException("not here")
            return self._infos[name]
        raise AttributeError(name)

    def has_node(self, name):
        return name in self._nodes

    def get_node(self, name):
        return type("Node", (), {"value": self._nodes[name]})


@pytest.mark.parametrize(
    ("before", "after", "counted"),
    [
        pytest.param({}, {}, {}, id="counts nothing"),
        pytest.param(
            {"num_started": 5, "num_delivered": 5, "num_underrun": 2},
            {"num_started": 9, "num_delivered": 8, "num_underrun": 3},
            {"started": 4, "delivered": 3, "underrun": 1}, id="since it was opened"),
        pytest.param({"num_underrun": 0}, {"num_underrun": 3}, {"underrun": 3}, id="underruns"),
    ],
)  # fmt: skip
def test_counters_are_of_this_acquisition(before, after, counted):
    stream = Stream(before)
    counts = StreamCounts(stream)
    counts.begin()
    stream._infos = after
    assert counts.read() == counted


def test_a_counter_may_be_a_node_of_the_stream():
    stream = Stream(nodes={"StreamLostFrameCount": 1})
    counts = StreamCounts(stream)
    counts.begin()
    stream._nodes["StreamLostFrameCount"] = 4
    assert counts.read() == {"underrun": 3}


def test_a_producer_that_counts_nothing_leaves_both_causes_open(make, monkeypatch):
    monkeypatch.setattr(StreamCounts, "_read", lambda self: {})
    bench = make(first_block_id=1)
    camera = armed(bench, 4)
    bench.fault(0, "lost")
    ids = [camera.expect() for _ in range(2)]
    flash(bench, 1)
    flash(bench, 2)
    with pytest.raises(
        FrameLostError, match=r"check cable .* a busy computer may also be the cause"
    ):
        camera.fetch(ids[0], 0.02)


def test_closing_during_a_run_ends_the_thread(make):
    camera = armed(make(most_buffers=2), 10)
    for _ in range(10):
        camera.expect()
    assert collecting()
    camera.close()
    assert not collecting()


def test_the_next_fetch_reports_a_camera_that_is_gone(make):
    bench = make(most_buffers=2)
    camera = armed(bench, 10)
    ids = [camera.expect() for _ in range(10)]
    bench.device.unplug()
    with pytest.raises(CameraError, match="no longer answers"):
        camera.fetch(ids[0], 0.02)
    assert not collecting()
    camera.close()


def test_a_collector_ends_at_an_error_and_can_be_restarted():
    calls = []

    def collect():
        calls.append(len(calls))
        if len(calls) == 3:
            raise CameraError("gone")
        return True

    collector = Collector(collect)
    collector.begin()
    wait_until(lambda: len(calls) == 3)
    collector.end()
    collector.end()
    assert calls == [0, 1, 2]
    collector.begin()
    wait_until(lambda: len(calls) > 3)
    collector.end()
    assert not collecting()


@pytest.mark.parametrize("most_buffers", [2, 256])
def test_packed_pixels_arrive_with_and_without_the_thread(make, most_buffers):
    bench = make(most_buffers=most_buffers)
    camera = armed(bench, 6, pixel_format="Mono12p")
    ids = [camera.expect() for _ in range(6)]
    for number, led in enumerate(range(6), 1):
        flash(bench, led)
        wait_until(lambda n=number: most_buffers > 6 or len(camera._acquisition._collected) == n)
    for led, frame_id in enumerate(ids):
        assert np.array_equal(camera.fetch(frame_id, 2.0).pixels, np.full(SIZE, grey(led)))
