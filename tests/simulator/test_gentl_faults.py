"""Faults of the virtual GenICam camera."""

import threading
import time

import numpy as np
import pytest

from acquisition import NoiseModel
from rig import CameraError
from simulator.camera import GentlCamera
from simulator.camera.gentl_camera import FAULTS
from tests.simulator import gentl_client as gentl
from tests.simulator.camera_options import grouped

SIZE = (8, 6)
NOISE = NoiseModel(1.0, 0.0, 20.0, 12)


@pytest.fixture
def open_camera():
    opened = []

    def make(*, buffers=4, armed=True, size=SIZE, **options):
        options = {"frame_rate_hz": 1e5, "noisy": False, "noise": NOISE, **options}
        camera = GentlCamera(
            lambda led: np.full(size, 0.1, np.float32), **grouped(size=size, leds=0, **options)
        )
        library = gentl.Library(camera.cti)
        opened.append((library, camera))
        device = gentl.Device(library, buffers)
        device.set("TriggerMode", "On")
        device.set("ExposureTime", 1000.0)
        if armed:
            device.start()
        return camera, device

    yield make
    for library, camera in opened:
        library.close()
        camera.close()


def counts(camera):
    """Return exposures, delivered and dropped frames; a frame is counted after it arrived."""
    seen = camera.counts()
    return seen.exposures, seen.delivered, seen.dropped


def test_a_lost_frame_has_a_block_id_and_is_not_delivered(open_camera):
    camera, device = open_camera()
    camera.set_fault("next", "lost")
    device.execute("TriggerSoftware")
    assert device.no_frame_arrives()
    assert device.shoot().block == 1
    gentl.wait_for(lambda: counts(camera) == (2, 1, 1))


def test_a_late_frame_arrives_later_with_its_id_and_time(open_camera):
    camera, device = open_camera()
    camera.set_fault(1, "late", late_ms=150.0)
    assert device.shoot().block == 0
    began = time.monotonic_ns()
    device.execute("TriggerSoftware")
    assert device.no_frame_arrives(0.1)
    frame = device.fetch()
    assert frame.block == 1
    assert frame.start_ns - began < 50e6
    assert time.monotonic_ns() - frame.start_ns >= 151e6


def test_frames_after_a_late_one_wait_for_it(open_camera):
    camera, device = open_camera()
    camera.set_fault("next", "late", late_ms=50.0)
    for _ in range(3):
        device.execute("TriggerSoftware")
        time.sleep(0.003)
    assert [device.fetch().block for _ in range(3)] == [0, 1, 2]


def test_an_incomplete_frame_is_marked_and_has_half_of_its_rows(open_camera):
    camera, device = open_camera()
    camera.set_fault("next", "incomplete")
    frame = device.shoot()
    assert frame.incomplete
    assert frame.filled == len(frame.data) // 2
    assert (frame.pixels[:4] == 120).all()
    assert (frame.pixels[4:] == 0).all()
    whole = device.shoot()
    assert not whole.incomplete
    assert (whole.pixels == 120).all()


def test_a_doubled_frame_is_delivered_twice_with_one_id(open_camera):
    camera, device = open_camera()
    camera.set_fault("next", "doubled")
    assert [device.shoot().block, device.fetch().block, device.shoot().block] == [0, 0, 1]


def test_an_underrun_is_counted_and_the_buffer_stays_free(open_camera):
    camera, device = open_camera()
    camera.set_fault(1, "underrun")
    assert device.shoot().block == 0
    device.execute("TriggerSoftware")
    assert device.no_frame_arrives()
    # As many frames as there are buffers.
    for _ in range(4):
        device.execute("TriggerSoftware")
        time.sleep(0.005)
    assert [device.fetch().block for _ in range(4)] == [2, 3, 4, 5]
    assert (device.counter(gentl.DELIVERED), device.counter(gentl.UNDERRUN)) == (5, 1)
    gentl.wait_for(lambda: counts(camera) == (6, 5, 1))


def test_frames_that_find_no_buffer_are_counted(open_camera):
    camera, device = open_camera(buffers=3)
    for _ in range(5):
        device.execute("TriggerSoftware")
        time.sleep(0.005)
    gentl.wait_for(lambda: counts(camera) == (5, 3, 2))
    assert (device.counter(gentl.DELIVERED), device.counter(gentl.UNDERRUN)) == (3, 2)
    assert [device.fetch().block for _ in range(3)] == [0, 1, 2]
    assert device.no_frame_arrives()
    assert device.shoot().block == 5


def test_a_second_delivery_without_a_buffer_is_an_underrun_too(open_camera):
    camera, device = open_camera(buffers=1)
    camera.set_fault("next", "doubled")
    device.execute("TriggerSoftware")
    gentl.wait_for(lambda: device.counter(gentl.UNDERRUN) == 1)
    assert device.fetch().block == 0


def test_the_number_of_buffers_is_limited(open_camera):
    _, device = open_camera(buffers=3, most_buffers=3)
    assert [device.shoot().block for _ in range(7)] == list(range(7))
    device.stop()
    device._count = 4
    with pytest.raises(gentl.GentlError, match="at most 3 buffers"):
        device.start()


@pytest.mark.parametrize("most_buffers", [0, 257])
def test_most_buffers_must_be_within_1_to_256(most_buffers):
    with pytest.raises(CameraError, match=r"within 1\.\.256"):
        gentl.blind_camera(most_buffers=most_buffers)


def test_a_missed_trigger_uses_no_id(open_camera):
    camera, device = open_camera()
    camera.set_fault(0, "missed")
    device.execute("TriggerSoftware")
    assert device.no_frame_arrives()
    assert device.shoot().block == 0
    assert camera.counts().missed == 1


def test_each_fault_occurs_once_at_its_frame(open_camera):
    camera, device = open_camera()
    for frame in (4, 2):
        camera.set_fault(frame, "incomplete")
    assert [device.shoot().incomplete for _ in range(6)] == [i in (2, 4) for i in range(6)]


def test_too_many_faults_and_unknown_ones_are_refused(open_camera):
    camera, _ = open_camera(armed=False)
    with pytest.raises(CameraError, match="unknown fault 'stuck'"):
        camera.set_fault("next", "stuck")
    for frame in range(FAULTS):
        camera.set_fault(frame, "lost")
    with pytest.raises(CameraError, match="256 faults"):
        camera.set_fault("next", "lost")


@pytest.mark.parametrize("how", ["fault", "hand"])
def test_an_unplugged_camera_does_not_answer_until_it_is_opened_again(open_camera, how):
    camera, device = open_camera()
    device.shoot()
    if how == "fault":
        camera.set_fault("next", "unplug")
        device.execute("TriggerSoftware")
    else:
        camera.unplug()
    assert device.no_frame_arrives()
    for act in (
        lambda: device.get("Width"),
        lambda: device.execute("AcquisitionStop"),
        lambda: device.set("Gain", 1.0),
    ):
        with gentl.refused(gentl.IO, "unplugged"):
            act()
    assert device.library.devices() == 0
    camera.replug()
    assert device.library.devices() == 1
    with pytest.raises(gentl.GentlError, match="unplugged"):
        device.get("Width")
    device.end_stream()
    device.close()
    again = gentl.Device(device.library)
    again.set("TriggerMode", "On")
    again.start()
    assert again.shoot().block == 0


def test_an_unplugged_camera_is_not_listed(open_camera):
    camera, device = open_camera(armed=False)
    device.close()
    camera.unplug()
    assert device.library.devices() == 0
    with pytest.raises(gentl.GentlError, match="no device 0"):
        gentl.Device(device.library)


def test_the_wait_of_a_client_can_be_aborted(open_camera):
    _, device = open_camera()
    timer = threading.Timer(0.05, device.library.call, ("EventKill", device.event))
    timer.start()
    began = time.monotonic()
    with gentl.refused(gentl.ABORT):
        device.take(20.0)
    assert time.monotonic() - began < 10
    timer.join()
    assert device.shoot().block == 0


@pytest.mark.parametrize("delay_s", [0.0, 0.001, 0.005, 0.02, 0.05])
def test_buffers_are_not_touched_after_they_have_been_revoked(open_camera, delay_s):
    noise = NoiseModel(2.0, 3.0, 100.0, 12)
    _, device = open_camera(size=(600, 800), noise=noise, noisy=True)
    memories = list(device._buffers.values())
    device.execute("TriggerSoftware")
    time.sleep(delay_s)
    device.end_stream()  # without stopping the camera before
    for memory in memories:
        memory.raw = b"\xa5" * len(memory)
    time.sleep(0.1)
    assert all(set(memory.raw) == {0xA5} for memory in memories)


def test_closing_during_an_exposure_does_not_wait_for_its_end(open_camera):
    _, device = open_camera()
    device.set("ExposureTime", 5e6)
    device.execute("TriggerSoftware")
    began = time.monotonic()
    device.close()
    assert time.monotonic() - began < 2


def test_automatic_functions_that_are_on_at_power_up_can_be_turned_off(open_camera):
    _, device = open_camera(automatics=("exposure", "gain", "white", "gamma"), armed=False)
    nodes = ["ExposureAuto", "GainAuto", "BalanceWhiteAuto"]
    assert [device.get(node) for node in nodes] == ["Continuous"] * 3
    assert (device.get("GammaEnable"), device.get("Gamma")) == (1, 0.45)
    for node in nodes:
        device.set(node, "Off")
        assert device.get(node) == "Off"
    device.set("GammaEnable", 0)
    device.set("Gamma", 1.0)
    assert (device.get("GammaEnable"), device.get("Gamma")) == (0, 1.0)


def test_a_stuck_automatic_function_accepts_settings_and_ignores_them(open_camera):
    _, device = open_camera(automatics=["exposure", "gain"], stuck=["exposure"], armed=False)
    device.set("ExposureAuto", "Off")
    device.set("GainAuto", "Off")
    assert (device.get("ExposureAuto"), device.get("GainAuto")) == ("Continuous", "Off")


@pytest.mark.parametrize(("auto", "node"), [("ExposureAuto", "ExposureTime"), ("GainAuto", "Gain")])
def test_an_active_automatic_function_changes_its_setting_from_frame_to_frame(
    open_camera, auto, node
):
    _, device = open_camera()
    before = device.get(node)
    device.set(auto, "Continuous")
    means = [device.shoot().pixels.mean() for _ in range(4)]
    assert device.get(node) > before
    assert means == sorted(means)
    assert means[-1] > 3 * means[0]


def test_a_camera_may_lack_nodes(open_camera):
    _, device = open_camera(without_nodes=["Gain", "LineStatus"], armed=False)
    for node, there in (("Gain", False), ("LineStatus", False), ("GainAuto", True)):
        assert (f'Name="{node}"' in device.xml) is there
        assert (f"<pFeature>{node}</pFeature>" in device.xml) is there


def test_the_temperature_of_the_device_can_change(open_camera):
    camera, device = open_camera(temperature_c=35.5, armed=False)
    assert device.get("DeviceTemperature") == 35.5
    camera.set_temperature(61.25)
    assert device.get("DeviceTemperature") == 61.25
