"""The GenICam camera with our own producer: faults between sensor and array."""

import gc
import os
import signal
import threading
import time
import weakref

import numpy as np
import pytest
from genicam import gentl

import rig.genicam.camera
import rig.genicam.system
from acquisition import NoiseModel
from rig import CameraError
from rig.genicam import find_cameras, open_genicam
from rig.genicam.nodes import Nodes
from tests.cases import cases
from tests.rig.camera_benches import (
    BLACK,
    EXPOSURE_US,
    SIZE,
    grey,
)


def armed(bench, trigger="software", **options):
    camera = bench.open(**options)
    camera.configure(exposure_us=EXPOSURE_US)
    camera.arm(trigger)
    return camera


def shoot(bench, camera, led):
    bench.light(led)
    frame = camera.fetch(camera.trigger(), 5.0)
    bench.dark()
    assert (frame.pixels == grey(led)).all()
    return frame


def pulsed(bench, camera, led, after_s=0.001):
    frame_id = camera.expect()
    bench.light(led)
    bench.pulse(after_s)
    return camera.fetch(frame_id, 1.0)


def test_the_properties_of_the_camera(make):
    info = make(frame_rate_hz=20.0, temperature_c=33.5).open().info
    assert (info.serial, info.width, info.height) == ("c7", SIZE[1], SIZE[0])
    assert (info.pixel_format, info.bit_depth, info.cfa) == ("Mono12", 12, None)
    assert (info.exposure_min_us, info.exposure_max_us) == (10, 1e7)
    assert (info.shutter, info.readout_us, info.trigger_delay_us) == ("global", 0, 0)
    assert info.frame_period_us == pytest.approx(50_000)


def test_temperature_and_black_level(make):
    bench = make(temperature_c=33.5)
    camera = armed(bench, black_level=100)
    bench.light(1)
    frame = camera.fetch(camera.trigger(), 5.0)
    assert frame.temperature_c == 33.5
    assert (frame.pixels == grey(1) - BLACK + 100).all()


def test_a_limit_of_the_frame_rate(make):
    assert make().open(frame_rate_hz=8.0).info.frame_period_us == pytest.approx(125_000)


@pytest.mark.parametrize("base", [0, 1])
def test_block_ids_may_count_from_0_or_1(make, base):
    bench = make(first_block_id=base)
    camera = armed(bench)
    for led in (1, 2):
        shoot(bench, camera, led)
    camera.arm("line")
    assert [pulsed(bench, camera, led).frame_id for led in (3, 4)] == [2, 3]


@pytest.mark.parametrize("base", [0, 1])
def test_the_loss_of_the_first_frame_of_a_run_is_detected(make, base):
    bench = make(first_block_id=base)
    camera = armed(bench)
    shoot(bench, camera, 1)
    camera.arm("line")
    bench.fault("next", "lost")
    ids = [camera.expect() for _ in range(2)]
    for led in (2, 3):
        bench.light(led)
        bench.pulse(0.001)
        time.sleep(0.05)
    with pytest.raises(CameraError, match="frame 1 was lost in transfer, frame 2 arrived"):
        camera.fetch(ids[0], 1.0)
    assert (pulsed(bench, camera, 5).pixels == grey(5)).all()


def test_the_loss_of_a_frame_within_a_run_is_detected_at_once(make):
    bench = make()
    camera = armed(bench, "line")
    bench.fault(1, "lost")
    ids = [camera.expect() for _ in range(3)]
    for led in (2, 3, 4):
        bench.light(led)
        bench.pulse(0.001)
        time.sleep(0.05)
    assert (camera.fetch(ids[0], 1.0).pixels == grey(2)).all()
    with pytest.raises(CameraError, match="frame 1 was lost in transfer, frame 2 arrived instead"):
        camera.fetch(ids[1], 1.0)


@pytest.mark.parametrize("trigger", ["software", "line"])
def test_an_incomplete_frame_is_reported_and_its_buffer_reused(make, trigger):
    bench = make()
    camera = armed(bench, trigger)
    # More often than there are buffers.
    take = shoot if trigger == "software" else pulsed
    for _ in range(12):
        bench.fault("next", "incomplete")
        with pytest.raises(CameraError, match="a frame is incomplete"):
            take(bench, camera, 3)
    assert (take(bench, camera, 6).pixels == grey(6)).all()


def test_a_repeated_frame_is_not_mistaken_for_the_next(make):
    bench = make()
    camera = armed(bench)
    bench.fault(1, "doubled")
    shoot(bench, camera, 1)
    shoot(bench, camera, 2)
    time.sleep(0.02)
    with pytest.raises(CameraError, match="a frame without a trigger"):
        camera.trigger()
    shoot(bench, camera, 3)


def test_a_repeated_frame_within_a_run_is_reported(make):
    bench = make()
    camera = armed(bench, "line")
    bench.fault(0, "doubled")
    ids = [camera.expect() for _ in range(2)]
    bench.light(2)
    bench.pulse(0.001)
    assert (camera.fetch(ids[0], 1.0).pixels == grey(2)).all()
    with pytest.raises(CameraError, match="frame 1 was awaited, block 0 arrived twice"):
        camera.fetch(ids[1], 1.0)


def test_an_extra_pulse_is_reported_before_the_next_shot(make):
    bench = make()
    camera = armed(bench, "line")
    assert (pulsed(bench, camera, 2).pixels == grey(2)).all()
    bench.pulse()
    time.sleep(0.05)
    with pytest.raises(CameraError, match="a frame without a trigger on Line0: check the wire"):
        camera.expect()
    assert (pulsed(bench, camera, 4).pixels == grey(4)).all()


def test_a_trigger_that_the_camera_does_not_see_times_out(make):
    bench = make()
    camera = armed(bench)
    bench.fault("next", "missed")
    with pytest.raises(CameraError, match="frame 0 did not come"):
        camera.fetch(camera.trigger(), 0.02)
    shoot(bench, camera, 4)


@pytest.mark.parametrize("when", ["waiting", "idle"])
def test_an_unplugged_camera_is_reported_and_opens_again(make, when):
    bench = make()
    camera = armed(bench)
    shoot(bench, camera, 1)
    if when == "waiting":
        camera.configure(exposure_us=10_000_000)
        frame_id = camera.trigger()
        bench.device.unplug()
        with pytest.raises(CameraError, match=r"c7.*no longer answers.*check its cable"):
            camera.fetch(frame_id, 0.05)
    else:
        bench.device.unplug()
        with pytest.raises(CameraError, match=r"c7.*no longer answers"):
            camera.trigger()
    camera.close()
    with pytest.raises(CameraError, match="no camera found"):
        bench.open()
    bench.device.replug()
    shoot(bench, armed(bench), 5)


@pytest.mark.parametrize("automatic", ["exposure", "gain", "white", "gamma"])
def test_automatics_that_are_on_are_turned_off(make, automatic):
    bench = make(automatics=[automatic])
    shoot(bench, armed(bench), 3)


def test_an_automatic_that_comes_with_the_pixel_format_is_turned_off_too(make, monkeypatch):
    bench = make(automatics=["white", "gain"])
    has, set_up = Nodes.has, rig.genicam.camera.set_up
    chosen = []

    def once_chosen(nodes, *words):
        chosen.append(nodes)
        return set_up(nodes, *words)

    def as_with_colour(nodes, names):
        return (names != "BalanceWhiteAuto" or bool(chosen)) and has(nodes, names)

    monkeypatch.setattr(rig.genicam.camera, "set_up", once_chosen)
    monkeypatch.setattr(Nodes, "has", as_with_colour)
    assert bench.open().info.turned_off == ("GainAuto", "BalanceWhiteAuto")
    assert chosen[0].text("BalanceWhiteAuto") == "Off"


@pytest.mark.parametrize(
    ("automatic", "node"),
    [("exposure", "ExposureAuto"), ("gain", "GainAuto"), ("white", "BalanceWhiteAuto"),
     ("gamma", "GammaEnable")],
)  # fmt: skip
def test_an_automatic_that_stays_on_is_named(make, automatic, node):
    with pytest.raises(CameraError, match=f"c7, {node}: was set to .* but is still"):
        make(automatics=[automatic], stuck=[automatic]).open()


@pytest.mark.parametrize(
    "nodes",
    [("ExposureTime",), ("TriggerMode", "TriggerSource"), ("Width",), ("PixelFormat",),
     ("ExposureTime", "AcquisitionStart")],
    ids="+".join,
)  # fmt: skip
def test_a_camera_without_a_needed_node_is_refused_by_name(make, nodes):
    with pytest.raises(CameraError, match=r"c7 .*it lacks nodes: ") as error:
        make(without_nodes=nodes).open()
    assert set(str(error.value).split("nodes: ")[1].split(", ")) == set(nodes)


@pytest.mark.parametrize(
    "nodes",
    [
        pytest.param(("Gain", "GainAuto", "Gamma", "GammaEnable", "BalanceWhiteAuto", "BlackLevel",
                      "ExposureAuto", "ExposureMode", "DeviceTemperature", "AcquisitionMode"),
                     id="of the image"),
        pytest.param(("TriggerDelay", "TriggerSelector", "TriggerActivation", "LineSelector",
                      "LineStatus", "SensorShutterMode", "SensorReadoutTime",
                      "AcquisitionFrameRate", "AcquisitionFrameRateEnable"), id="of time"),
    ],
)  # fmt: skip
def test_nodes_that_are_not_needed_may_be_absent(make, nodes):
    bench = make(without_nodes=nodes)
    camera = armed(bench)
    assert (shoot(bench, camera, 3).temperature_c is None) == ("DeviceTemperature" in nodes)
    assert (camera.info.frame_period_us == 0) == ("AcquisitionFrameRate" in nodes)
    camera.arm("line")
    assert (pulsed(bench, camera, 4).pixels == grey(4)).all()


def test_a_line_that_the_camera_lacks_is_named(make):
    camera = make().open(trigger_line="Line5")
    with pytest.raises(
        CameraError, match="TriggerSource: 'Line5' is not available, only Software, Line0"
    ):
        camera.arm("line")
    camera.arm()


def test_a_rolling_shutter_is_recognised_with_its_readout(make):
    info = make(shutter="rolling", readout_us=12_000.0).open().info
    assert (info.shutter, info.readout_us) == ("rolling", 12_000.0)
    bench = make(shutter="rolling", readout_us=12_000.0, frame_rate_hz=50.0,
                 without_nodes=["SensorReadoutTime"])  # fmt: skip
    assert bench.open().info.readout_us == pytest.approx(20_000)


def test_a_readout_option_overrides_the_cameras(make):
    assert make(shutter="rolling", readout_us=9.0).open(readout_us=7000.0).info.readout_us == 7000


FORMATS = ["8", "10", "12", "16", "10p", "12p", "10Packed", "12Packed"]


@pytest.mark.parametrize("cfa", [None, "RGGB", "GBRG"])
@pytest.mark.parametrize("suffix", FORMATS)
def test_pixels_arrive_bit_by_bit_in_every_format(make, cfa, suffix):
    size = (7, 10) if cfa is None else (8, 10)
    values = np.random.default_rng(5).integers(0, 2**16, size).astype(np.uint16)
    bench = make(
        planes=lambda led: values if led is None else None, size=size, leds=0, cfa=cfa,
        noise=NoiseModel(1.0, 0.0, 0.0, 16), precomposed=True,
    )  # fmt: skip
    name = f"Mono{suffix}" if cfa is None else f"Bayer{cfa[0] + cfa[1 if cfa[0] != cfa[1] else 2]}"
    name = name if cfa is None else name + suffix
    camera = bench.open(pixel_format=name)
    camera.configure(exposure_us=100)
    camera.arm()
    pixels = camera.fetch(camera.trigger(), 5.0).pixels
    assert (camera.info.pixel_format, camera.info.cfa) == (name, cfa)
    assert np.array_equal(pixels, values >> (16 - camera.info.bit_depth))


@cases(
    ("wanted", "message"),
    {
        "not available": ("Mono14", "PixelFormat: 'Mono14' is not available, only Mono8, Mono10,"),
        "not raw": ("RGB8", "format of raw samples, .* not RGB8; the camera offers"),
    },
)
def test_an_unavailable_format_is_refused(make, wanted, message):
    with pytest.raises(CameraError, match=message):
        make().open(pixel_format=wanted)


def test_other_threads_run_while_a_frame_is_awaited(make):
    """The frame comes when another thread has run 100 times; harvesters' own wait allows one."""
    bench = make()
    camera = armed(bench, "line")
    done = threading.Event()

    def run():
        for _ in range(100):
            if done.wait(0.001):
                return
        bench.pulse()

    thread = threading.Thread(target=run)
    frame_id = camera.expect()
    thread.start()
    try:
        assert camera.fetch(frame_id, 20.0).frame_id == frame_id
    finally:
        done.set()
        thread.join()


def test_opening_does_not_change_the_handler_of_ctrl_c(make):
    before = signal.getsignal(signal.SIGINT)
    camera = make().open()
    assert signal.getsignal(signal.SIGINT) is before
    camera.close()
    assert signal.getsignal(signal.SIGINT) is before


WAITING = """
import sys, time
from rig.genicam import open_genicam
camera = open_genicam(sys.argv[1])
camera.configure(exposure_us=1000)
camera.arm("line")
try:
    print("waiting", flush=True)
    camera.fetch(camera.expect(), 60.0)
except KeyboardInterrupt:
    camera.arm()
    print("frame", camera.fetch(camera.trigger(), 5.0).frame_id, flush=True)
camera.close()
"""


def test_ctrl_c_ends_the_wait_and_the_camera_stays_usable(make, forks):
    process = forks.start(WAITING, make().device.cti)
    assert process.stdout.readline() == "waiting\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "frame 1\n"
    assert process.wait() == 0
    process.end()


def test_two_cameras_of_a_process_do_not_disturb_each_other(make):
    one, other = make(), make()
    first, second = armed(one), armed(other)
    for led in (1, 2):
        shoot(one, first, led)
        shoot(other, second, led + 5)
    first.close()
    shoot(other, second, 9)
    shoot(one, armed(one), 3)


def test_a_camera_that_is_open_is_not_opened_twice(make):
    bench = make()
    camera = armed(bench)
    with pytest.raises(CameraError, match=r"c7 .*: another program has it open"):
        open_genicam(bench.device.cti)
    shoot(bench, camera, 2)


def test_cameras_are_found_and_picked(make):
    one, other = make().device.cti, make().device.cti
    assert [camera.serial for camera in find_cameras([one, other])] == ["c7", "c7"]
    with pytest.raises(CameraError, match=r"2 cameras found, choose one by serial number: c7 \("):
        open_genicam([one, other], serial="c7")
    with pytest.raises(CameraError, match=r"no camera c8; found: c7 \("):
        open_genicam(one, serial="c8")
    open_genicam([one, one], serial="c7").close()


def test_a_failing_producer_gives_a_message_of_one_line(make, monkeypatch):
    def fail(harvester):
        raise gentl.IoException("out of order")

    monkeypatch.setattr(rig.genicam.system.Harvester, "update", fail)
    monkeypatch.setattr(rig.genicam.system.Harvester, "reset", fail)
    with pytest.raises(CameraError, match=r"this GenTL producer fails \(.*out of order") as error:
        find_cameras([make().device.cti])
    assert "\n" not in str(error.value)


def resident_kb():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4


@pytest.mark.slow
def test_memory_stays_flat_over_opening_and_closing(make):
    if not os.path.exists("/proc/self/statm"):
        pytest.skip("no /proc here to read the memory from")
    bench = make()

    def cycle():
        camera = open_genicam(bench.device.cti)
        camera.arm()
        camera.fetch(camera.trigger(), 5.0)
        camera.close()

    for _ in range(30):
        cycle()
    before = resident_kb()
    for _ in range(50):
        cycle()
    # harvesters alone would keep 240 kB per camera.
    assert resident_kb() - before < 50 * 100


def test_a_closed_camera_leaves_nothing_behind(make):
    camera = open_genicam(make().device.cti)
    camera.arm()
    camera.fetch(camera.trigger(), 5.0)
    acquirer = weakref.ref(camera._device.acquirer)
    camera.close()
    del camera
    gc.collect()
    assert acquirer() is None


def test_without_triggers_the_next_frames_are_returned(make):
    bench = make(without_nodes=["TriggerMode", "ExposureTime"])
    camera = bench.open(needs=())
    camera.arm()
    frames = [camera.fetch(camera.trigger(), 5.0) for _ in range(3)]
    assert [frame.frame_id for frame in frames] == [0, 1, 2]
    assert np.isnan(frames[0].exposure_us)
    with pytest.raises(CameraError, match="c7 has no node ExposureTime"):
        camera.configure(exposure_us=100)
