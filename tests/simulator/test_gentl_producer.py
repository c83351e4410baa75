"""The GenTL producer as a library for any client."""

import re
import struct
import subprocess
import sys
from pathlib import Path

import harvesters.test
import pytest

from simulator.camera.gentl_camera import SIZE
from simulator.gentl import build
from tests.simulator import gentl_client as gentl

NODES = """
    DeviceVendorName DeviceModelName DeviceSerialNumber DeviceTemperature DeviceTimestamp
    SensorWidth SensorHeight SensorShutterMode SensorReadoutTime Width Height OffsetX OffsetY
    PixelFormat PayloadSize ExposureTime ExposureAuto Gain GainAuto BalanceWhiteAuto BlackLevel
    Gamma GammaEnable AcquisitionMode AcquisitionStart AcquisitionStop AcquisitionFrameRate
    AcquisitionFrameRateEnable TriggerSelector TriggerMode TriggerSource TriggerActivation
    TriggerDelay TriggerSoftware LineSelector LineStatus TLParamsLocked
""".split()  # noqa: SIM905


@pytest.fixture
def library():
    with gentl.Library(build()) as library:
        yield library


@pytest.fixture
def device(library):
    with gentl.Device(library) as device:
        yield device


def resident_kb() -> int:
    text = Path("/proc/self/statm").read_text()
    return int(text.split()[1]) * 4


@pytest.mark.slow
def test_the_test_suite_of_harvesters_passes(tmp_path):
    tests = Path(harvesters.test.__file__).parent
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null"]
    ran = subprocess.run(
        [*command, f"--rootdir={tmp_path}", str(tests)],
        cwd=tmp_path,
        env={"HARVESTERS_TEST_TARGET": str(build()), "PATH": "", "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    counts = {what: int(n) for n, what in re.findall(r"(\d+) (passed|failed|error)", ran.stdout)}
    assert ran.returncode == 0, ran.stdout[-3000:]
    assert counts == {"passed": counts["passed"]}
    assert counts["passed"] >= 92


def test_the_bare_library_offers_one_camera(library, device):
    assert library.devices() == 1
    assert device.get("DeviceVendorName") == "sgp"
    assert (device.get("Width"), device.get("Height")) == (640, 480)
    assert device.get("PixelFormat") == "Mono12"


@pytest.mark.parametrize("node", NODES)
def test_the_camera_has_the_node(device, node):
    assert f'Name="{node}"' in device.xml
    if not node.startswith("Acquisition") or node == "AcquisitionMode":
        device.get(node)


def test_the_test_pattern_moves_from_frame_to_frame(device):
    device.set("TriggerMode", "On")
    device.start()
    one, other = device.shoot(), device.shoot()
    assert (other.pixels[:, :-2] == one.pixels[:, 2:]).all()
    assert (other.block, other.pixels[0, 0]) == (1, 16)


@pytest.mark.parametrize(
    ("node", "value"),
    [
        pytest.param("ExposureTime", 9.0, id="exposure too short"),
        pytest.param("ExposureTime", 1e7 + 1, id="exposure too long"),
        pytest.param("ExposureTime", float("nan"), id="exposure not a number"),
        pytest.param("Gain", -0.1, id="gain below 0"),
        pytest.param("Gain", 24.1, id="gain too high"),
        pytest.param("Width", 641, id="wider than the sensor"),
        pytest.param("Width", 0, id="no width"),
        pytest.param("OffsetX", 1, id="an offset that is too large for the width"),
        pytest.param("PixelFormat", 0x01080009, id="a mosaic's format on a monochrome sensor"),
        pytest.param("TriggerMode", 2, id="no such mode"),
        pytest.param("BlackLevel", 4095.0, id="black at the end of the converter"),
        pytest.param("AcquisitionFrameRate", 201.0, id="faster than the camera"),
    ],
)
def test_the_device_refuses_values_out_of_range_and_keeps_the_old_ones(device, node, value):
    before = device.get(node)
    with gentl.refused(gentl.INVALID_VALUE, f"{node} is .*, it must be within"):
        device.set(node, value)
    assert device.get(node) == before


@pytest.mark.parametrize("node", ["Width", "Height", "OffsetX", "PixelFormat", "AcquisitionMode"])
def test_nodes_that_determine_the_frame_size_are_locked_during_acquisition(device, node):
    device.set("TLParamsLocked", 1)
    with gentl.refused(gentl.ACCESS_DENIED, "TLParamsLocked"):
        device.set(node, device.get(node))


def test_values_of_the_camera_are_read_only(device):
    with pytest.raises(gentl.GentlError, match="is read-only"):
        device.set("PayloadSize", 1)


def test_an_address_without_a_register_is_refused(device):
    with pytest.raises(gentl.GentlError, match="no register of 8 bytes at 0x8"):
        device._read(8, 8)


@pytest.mark.parametrize("of", ["camera", "system"])
def test_a_huge_size_is_refused(library, device, of):
    port = device.port if of == "camera" else library.system
    code = gentl.ctypes
    # Ten bytes into the node map; the sum of address and size overflows to a small number.
    at, size = code.c_uint64(0x100000 + 10), code.c_size_t(2**64 - 5)
    with gentl.refused(gentl.INVALID_ADDRESS, "no register"):
        library.call("GCReadPort", port, at, code.create_string_buffer(8), code.byref(size))


@pytest.mark.parametrize(
    ("name", "of"),
    [
        ("TLGetNumInterfaces", "system"),
        ("IFGetParentTL", "interface"),
        ("IFGetNumDevices", "interface"),
        ("DevGetPort", "device"),
        ("DevGetParentIF", "device"),
        ("DevGetNumDataStreams", "device"),
        ("DSGetParentDev", "stream"),
    ],
)
def test_a_query_with_null_pointers_is_refused(library, device, name, of):
    handles = {
        "system": library.system,
        "interface": library.interface,
        "device": device.handle,
        "stream": device.stream,
    }
    with gentl.refused(gentl.INVALID_PARAMETER, "is NULL"):
        library.call(name, handles[of], None)


def test_a_refused_start_does_not_limit_the_previous_one(library, device):
    device.set("TriggerMode", "On")
    device.start()
    with gentl.refused(gentl.RESOURCE_IN_USE, "already started"):
        library.call("DSStartAcquisition", device.stream, 0, gentl.ctypes.c_uint64(1))
    assert [device.shoot().block for _ in range(3)] == [0, 1, 2]


def test_a_wait_for_an_invalid_event_is_refused_and_ends_no_other_wait(library, device):
    library.call("EventKill", device.event)
    event, device.event = device.event, device.stream
    with gentl.refused(gentl.INVALID_HANDLE):
        device.take(0.05)
    device.event = event
    with gentl.refused(gentl.ABORT):
        device.take(0.05)


def test_opening_twice_is_refused_until_it_is_closed(library, device):
    with gentl.refused(gentl.RESOURCE_IN_USE):
        gentl.Device(library)
    device.close()
    gentl.Device(library).close()
    with gentl.refused(gentl.INVALID_HANDLE):
        device.get("Width")
    gentl.Device(library)


def test_closing_the_library_closes_all_that_is_open():
    with gentl.Library(build()) as library:
        gentl.Device(library).start()
    with gentl.Library(build()) as library, gentl.Device(library) as device:
        assert device.get("Width") == 640


def test_opening_the_camera_again_resets_its_settings(library):
    with gentl.Device(library) as device:
        device.set("ExposureTime", 77.0)
        device.set("TLParamsLocked", 1)
    with gentl.Device(library) as device:
        assert device.get("ExposureTime") == 10_000.0
        assert device.get("TLParamsLocked") == 0


def test_calls_before_the_library_is_initialised_are_refused():
    library = gentl.Library(build())
    library.close()
    with pytest.raises(gentl.GentlError, match="GCInitLib"):
        library.handle("TLOpen")


@pytest.mark.parametrize("name", ["DSGetNumFlows", "DSGetBufferChunkData", "DSGetFlowInfo"])
def test_functions_of_later_versions_are_not_implemented(library, name):
    with gentl.refused(gentl.NOT_IMPLEMENTED, name):
        library.call(name)


def test_an_answer_that_does_not_fit_is_refused(library):
    code = gentl.ctypes
    text, size = code.create_string_buffer(4), code.c_size_t(4)
    with pytest.raises(gentl.GentlError, match="requires 9 bytes, not 4"):
        library.call("IFGetDeviceID", library.interface, 0, text, code.byref(size))


@pytest.mark.slow
def test_memory_stays_flat_over_a_thousand_times_open_and_close():
    def cycle():
        with gentl.Library(build()) as library, gentl.Device(library) as device:
            device.set("TriggerMode", "On")
            device.set("ExposureTime", 20.0)
            device.start()
            device.shoot()

    for _ in range(100):
        cycle()
    before = resident_kb()
    for _ in range(1000):
        cycle()
    # A leak of one frame, 600 kB, in a thousand cycles would be detected.
    assert resident_kb() - before < 500


@pytest.mark.slow
def test_memory_stays_flat_over_thousands_of_frames():
    with (
        gentl.blind_camera((48, 64), frame_rate_hz=1e4) as camera,
        gentl.Library(camera.cti) as library,
        gentl.Device(library) as device,
    ):
        device.set("ExposureTime", 100.0)
        device.start()
        for _ in range(200):
            device.fetch()
        before = resident_kb()
        for _ in range(5000):
            device.fetch()
        assert resident_kb() - before < 300


def spoil(path: Path, at: int, data: bytes) -> None:
    text = bytearray(path.read_bytes())
    text[at : at + len(data)] = data
    path.write_bytes(text)


@pytest.mark.parametrize(
    ("file", "at", "data", "message"),
    [
        ("camera.control", 0, b"X", "does not begin with SGPCAMRA"),
        ("camera.control", 8, b"\2", "another version"),
        ("camera.control", 16, bytes(4), "size is out of range"),
        ("camera.control", 27, b"\xff", "too many LEDs"),
        ("camera.control", 32, b"\x07", "bit depth is out of range"),
        ("camera.control", 80, b"?" * 64, "a text is not terminated"),
        ("camera.control", 72, b"RGB\0", "unknown mosaic"),
        ("camera.control", 1424, b"\xff" * 8, "negative or not finite"),
        ("camera.control", 1432, struct.pack("<d", 1e300), "out of range"),
        ("camera.control", SIZE, b"!", f"not {SIZE}"),
        ("planes.f32", 12, b"!", "has 13 bytes, .* 12"),
    ],
)
def test_a_damaged_camera_is_listed_and_opening_it_names_the_reason(file, at, data, message):
    with gentl.blind_camera((1, 3)) as camera:
        spoil(camera.cti.parent / file, at, data)
        with gentl.Library(camera.cti) as library:
            assert library.devices() == 1
            with gentl.refused(gentl.IO, message) as caught:
                gentl.Device(library)
            assert file in str(caught.value)
            assert "\n" not in str(caught.value)


def test_missing_planes_and_bench_state_are_named(tmp_path):
    bench = tmp_path / "bench.state"
    with gentl.blind_camera((1, 3), bench) as camera:
        with gentl.Library(camera.cti) as library:
            with pytest.raises(gentl.GentlError, match=r"bench\.state: .* is the virtual board"):
                gentl.Device(library)
            bench.write_bytes(bytes(8))
            with pytest.raises(gentl.GentlError, match="not a bench state"):
                gentl.Device(library)
            bench.write_bytes(bytes(10_000))
            with pytest.raises(gentl.GentlError, match="not a bench state of version 2"):
                gentl.Device(library)
        (camera.cti.parent / "planes.f32").unlink()
        with (
            gentl.Library(camera.cti) as library,
            pytest.raises(gentl.GentlError, match=r"planes\.f32: cannot be opened"),
        ):
            gentl.Device(library)


def test_two_cameras_in_one_process_are_independent():

    def make(serial, width):
        return gentl.blind_camera((2, width), serial=serial)

    with (
        make("one", 3) as one,
        make("other", 4) as other,
        gentl.Library(one.cti) as first,
        gentl.Library(other.cti) as second,
        gentl.Device(first) as a,
        gentl.Device(second) as b,
    ):
        assert (a.get("DeviceSerialNumber"), a.get("Width")) == ("one", 3)
        assert (b.get("DeviceSerialNumber"), b.get("Width")) == ("other", 4)
        a.set("ExposureTime", 50.0)
        assert b.get("ExposureTime") == 10_000.0


def test_a_camera_that_another_process_has_open_is_in_use():
    with gentl.blind_camera() as camera:
        script = (
            "import sys; from tests.simulator import gentl_client as gentl\n"
            "library = gentl.Library(sys.argv[1]); device = gentl.Device(library)\n"
            "print('open', flush=True); sys.stdin.readline(); device.close(); library.close()"
        )
        other = subprocess.Popen(
            [sys.executable, "-c", script, str(camera.cti)],
            cwd=Path(__file__).parents[2],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert other.stdout.readline() == "open\n"
        with gentl.Library(camera.cti) as library:
            with pytest.raises(gentl.GentlError, match="in use by another process"):
                gentl.Device(library)
            other.communicate("\n", timeout=60)
            assert other.returncode == 0
            gentl.Device(library)


def test_a_camera_whose_folder_was_removed_is_not_replaced_by_the_bare_one():
    camera = gentl.blind_camera()
    library = gentl.Library(camera.cti)
    camera.close()
    with pytest.raises(gentl.GentlError, match=r"camera\.control: cannot be opened"):
        gentl.Device(library)
    library.close()


def test_a_library_loaded_by_a_relative_path_finds_its_camera(monkeypatch, tmp_path):
    with gentl.blind_camera(serial="here") as camera:
        monkeypatch.chdir(camera.cti.parent)
        library = gentl.Library("./sgp.cti")
        monkeypatch.chdir(tmp_path)
        assert library.device_id() == b"here"
        library.close()
