"""Exposures of the virtual GenICam camera: by software, by the trigger line, free-running."""

import time

import numpy as np
import pytest

from acquisition import NoiseModel
from simulator.bench import BenchState
from tests.simulator import gentl_client as gentl

SIZE = (4, 6)
NOISE = NoiseModel(1.0, 0.0, 20.0, 16)
MS = 1_000_000
S = 1000 * MS


def plane(led):
    return np.full(SIZE, 0 if led is None else led + 1, np.float32)


class Bench(gentl.Bench):
    def __init__(self, path):
        super().__init__(path)
        self.state = BenchState(path)

    def camera(self, *, trigger="Line0", exposure_us=1000.0, armed=True, buffers=8, **options):
        options = {"size": SIZE, "leds": 3, "noise": NOISE, "noisy": False, **options}
        device = self.open(plane, buffers=buffers, **options)
        if trigger:
            device.set("TriggerMode", "On")
            device.set("TriggerSource", trigger)
        device.set("ExposureTime", exposure_us)
        if armed:
            device.start()
        return device

    def counts(self):
        return self.opened[0][1].counts()

    def pulse(self, in_ms):
        at_ns = time.monotonic_ns() + round(in_ms * MS)
        self.writer.pulse(at_ns)
        return at_ns

    def close(self):
        super().close()
        self.state.close()


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path / "bench.state")
    yield bench
    bench.close()


def test_the_exposure_begins_exactly_at_the_pulse(bench):
    device = bench.camera()
    at_ns = bench.pulse(20)
    bench.writer.light(1, at_ns - MS, at_ns + 10 * MS)
    frame = device.fetch()
    assert frame.start_ns == at_ns
    assert (frame.pixels == 20 + 2000).all()
    assert [(e.start_ns, e.end_ns) for e in bench.state.exposures()] == [(at_ns, at_ns + MS)]


def test_pulses_announced_together_give_one_frame_each_in_order(bench):
    device = bench.camera()
    times = [bench.pulse(5 + 4 * i) for i in range(6)]
    frames = [device.fetch() for _ in times]
    assert [frame.start_ns for frame in frames] == times
    assert [frame.block for frame in frames] == list(range(6))
    assert device.no_frame_arrives()


def test_the_exposure_of_a_pulse_read_late_begins_at_its_time(bench):
    device = bench.camera()
    time.sleep(0.01)
    at_ns = bench.pulse(-0.5)
    assert device.fetch().start_ns == at_ns


def test_a_cancelled_pulse_gives_no_frame(bench):
    device = bench.camera()
    bench.pulse(100)
    bench.writer.put_out(time.monotonic_ns())
    at_ns = bench.pulse(5)
    assert device.fetch().start_ns == at_ns
    assert device.no_frame_arrives(0.15)
    assert (bench.counts().exposures, bench.counts().missed) == (1, 0)


@pytest.mark.parametrize(("edge", "later_ns"), [("RisingEdge", 0), ("FallingEdge", 200_000)])
def test_a_partly_written_pulse_counts_when_it_is_complete(bench, edge, later_ns):
    device = bench.camera(armed=False)
    device.set("TriggerActivation", edge)
    device.start()
    map_, count_at = bench.writer._map, 32
    whole = bytes(map_)
    # The board has begun its change and counted the pulse, but has not written it.
    map_[16:24] = (1).to_bytes(8, "little")
    map_[count_at : count_at + 8] = (1).to_bytes(8, "little")
    map_[64 + 64 * 24 : 64 + 64 * 24 + 8] = (-64).to_bytes(8, "little", signed=True)
    # Wait until the camera uses the state as it is.
    assert device.no_frame_arrives(0.4)
    map_[:] = whole
    # No board uses the number of a change twice: the camera no longer waits for this one.
    bench.writer._changes += 1
    at_ns = bench.pulse(5)
    assert device.fetch().start_ns == at_ns + later_ns
    assert bench.counts().exposures == 1


def test_the_light_of_a_board_that_died_while_writing_is_used_as_it_is(bench):
    device = bench.camera(trigger="Software", exposure_us=1000.0)
    now = time.monotonic_ns()
    bench.writer.light(1, now, now + 10 * S)
    bench.writer._map[16] |= 1
    began = time.monotonic()
    assert (device.shoot().pixels == 20 + 2000).all()
    assert (device.shoot().pixels == 20 + 2000).all()
    assert time.monotonic() - began < 3


def test_pulses_before_the_start_are_ignored(bench):
    device = bench.camera(armed=False)
    bench.pulse(0)
    later_ns = bench.pulse(100)
    time.sleep(0.002)
    device.start()
    frame = device.fetch()
    assert (frame.block, frame.start_ns) == (0, later_ns)


def test_more_pulses_than_the_ring_holds(bench):
    device = bench.camera(armed=False)
    for _ in range(100):
        bench.pulse(-1)
    device.start()
    at_ns = bench.pulse(2)
    assert device.fetch().start_ns == at_ns


def test_a_pulse_during_the_exposure_is_missed_and_counted(bench):
    device = bench.camera(exposure_us=30_000.0)
    first, _, third = (bench.pulse(ms) for ms in (5, 20, 36))
    assert [device.fetch().start_ns for _ in range(2)] == [first, third]
    assert (bench.counts().exposures, bench.counts().missed) == (2, 1)


def test_no_pulse_is_missed_while_frames_are_delayed(bench):
    """The exposures are those of the pulses, even if threads or frames are late."""
    device = bench.camera(buffers=48)
    bench.opened[0][1].set_fault(0, "late", late_ms=250.0)
    first_ns = time.monotonic_ns() + 20 * MS
    pulses = [first_ns + 3 * MS * number for number in range(48)]
    for at_ns in pulses:
        bench.writer.pulse(at_ns)
    assert [device.fetch().start_ns for _ in pulses] == pulses
    assert (bench.counts().exposures, bench.counts().missed) == (48, 0)


def test_a_pulse_within_the_frame_period_is_missed(bench):
    device = bench.camera(exposure_us=100.0, frame_rate_hz=50.0)
    first, _, third = (bench.pulse(ms) for ms in (5, 24, 26))
    frames = [device.fetch() for _ in range(2)]
    assert [frame.start_ns for frame in frames] == [first, third]
    assert [frame.block for frame in frames] == [0, 1]
    assert bench.counts().missed == 1


def test_an_exposure_may_overlap_the_previous_readout_but_not_end_in_it(bench):
    device = bench.camera(exposure_us=10_000.0, readout_us=20_000.0)
    # Exposure 5..15, readout until 35: 24..34 would end before that, 26..36 does not.
    first, _, third = (bench.pulse(ms) for ms in (5, 24, 26))
    assert [device.fetch().start_ns for _ in range(2)] == [first, third]
    assert bench.counts().missed == 1


def test_frames_are_delivered_after_their_readout(bench):
    device = bench.camera(readout_us=30_000.0)
    at_ns = bench.pulse(2)
    device.fetch()
    assert time.monotonic_ns() >= at_ns + 31 * MS


@pytest.mark.parametrize(
    ("node", "value", "later_ns"),
    [
        pytest.param("TriggerDelay", 3000.0, 3 * MS, id="delay"),
        pytest.param("TriggerActivation", "FallingEdge", 200_000, id="the line falls after 200 us"),
    ],
)
def test_a_setting_moves_the_start_of_the_exposure(bench, node, value, later_ns):
    device = bench.camera()
    device.set(node, value)
    at_ns = bench.pulse(5)
    assert device.fetch().start_ns == at_ns + later_ns


def test_the_line_status_follows_the_pulse(bench):
    device = bench.camera(armed=False)
    assert device.get("LineStatus") == 0

    def high() -> bool:
        bench.writer.pulse(time.monotonic_ns())
        return device.get("LineStatus") == 1

    # A busy computer may read only after the pulse of 200 us.
    assert any(high() for _ in range(100))
    time.sleep(0.001)
    assert device.get("LineStatus") == 0


def test_a_software_trigger_begins_before_the_call_returns(bench):
    device = bench.camera(trigger="Software", exposure_us=20_000.0)
    before = time.monotonic_ns()
    device.execute("TriggerSoftware")
    after = time.monotonic_ns()
    assert after - before < 15 * MS
    frame = device.fetch()
    assert before <= frame.start_ns <= after
    assert time.monotonic_ns() >= frame.start_ns + 20 * MS


def test_a_software_trigger_during_the_exposure_is_missed(bench):
    device = bench.camera(trigger="Software", exposure_us=200_000.0)
    device.execute("TriggerSoftware")
    device.execute("TriggerSoftware")
    assert device.fetch().block == 0
    assert device.no_frame_arrives(0.25)
    assert (bench.counts().exposures, bench.counts().missed) == (1, 1)


def test_only_triggers_of_the_selected_source_count(bench):
    device = bench.camera(trigger="Software")
    bench.pulse(1)
    assert device.no_frame_arrives()
    device.set("TriggerSource", "Line0")
    with gentl.refused(gentl.ACCESS_DENIED, "TriggerSource Software"):
        device.execute("TriggerSoftware")


def test_a_software_trigger_before_the_start_is_missed(bench):
    device = bench.camera(trigger="Software", armed=False)
    device.execute("TriggerSoftware")
    assert bench.counts().missed == 1
    device.start()
    assert device.no_frame_arrives()


@pytest.mark.parametrize("base", [0, 1])
def test_block_ids_start_again_with_the_acquisition(bench, base):
    device = bench.camera(trigger="Software", first_block_id=base, frame_rate_hz=1e5)
    assert [device.shoot().block for _ in range(3)] == [base, base + 1, base + 2]
    device.stop()
    device.start()
    assert device.shoot().block == base


def test_the_free_running_camera_keeps_the_frame_rate(bench):
    device = bench.camera(trigger=None, frame_rate_hz=200.0)
    device.set("AcquisitionFrameRateEnable", 1)
    device.set("AcquisitionFrameRate", 100.0)
    starts = [device.fetch().start_ns for _ in range(10)]
    # A busy computer may delay frames, but it advances none, and the rate recovers: the starts are
    # exact again as soon as the camera is less than 1 ms late.
    while len(starts) < 500 and np.diff(starts[-3:]).tolist() != [10 * MS] * 2:
        starts.append(device.fetch().start_ns)
    assert np.diff(starts[-3:]).tolist() == [10 * MS] * 2
    periods = np.diff(starts)
    assert ((periods == 10 * MS) | (periods >= 11 * MS)).all()


def test_the_maximum_frame_rate_is_that_of_the_camera(bench):
    device = bench.camera(trigger=None, armed=False, frame_rate_hz=20.0)
    assert device.get("AcquisitionFrameRate") == 20.0
    with pytest.raises(gentl.GentlError, match=r"0\.1 to 20$"):
        device.set("AcquisitionFrameRate", 21.0)


@pytest.mark.parametrize(("mode", "count"), [("SingleFrame", 1), ("MultiFrame", 3)])
def test_a_multi_frame_acquisition_ends_by_itself(bench, mode, count):
    device = bench.camera(trigger=None, armed=False)
    device.set("AcquisitionMode", mode)
    device.set("AcquisitionFrameCount", 3)
    device.start()
    for _ in range(count):
        device.fetch()
    assert device.no_frame_arrives()


def test_stopping_discards_frames_in_progress(bench):
    device = bench.camera(trigger="Software", exposure_us=100_000.0)
    device.execute("TriggerSoftware")
    began = time.monotonic()
    device.stop()
    assert time.monotonic() - began < 0.09
    device.set("ExposureTime", 1000.0)
    device.start()
    assert device.no_frame_arrives(0.15)
    frame = device.shoot()
    assert (frame.block, frame.start_ns > began * 1e9) == (0, True)
    assert bench.counts().dropped == 1


def test_watching_the_line_uses_little_processor_time(bench):
    bench.camera()
    busy = time.process_time()
    time.sleep(0.5)
    # 5000 checks per second take about 8 % of a core, more on a busy computer.
    assert time.process_time() - busy < 0.15
