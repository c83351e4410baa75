"""Pixel formats, bit by bit from the producer via harvesters to an array."""

import contextlib
import time

import numpy as np
import pytest
from harvesters.core import Harvester
from harvesters.util.pfnc import symbolics

from acquisition import NoiseModel
from simulator.camera import GentlCamera, GentlDevice, ImageFormation
from tests.simulator import gentl_client as gentl

SIZE = (12, 20)
SUFFIXES = {
    "8": 8, "10": 10, "10p": 10, "10Packed": 10, "12": 12, "12p": 12, "12Packed": 12, "16": 16,
}  # fmt: skip
MOSAICS = {None: "Mono", "RGGB": "BayerRG", "GRBG": "BayerGR", "GBRG": "BayerGB", "BGGR": "BayerBG"}


def camera(frame, bits, cfa=None, **device):
    noise = NoiseModel(1.0, 0.0, 0.0, bits)
    return GentlCamera(
        lambda led: frame,
        size=frame.shape,
        leds=0,
        precomposed=True,
        formation=ImageFormation(noise, cfa=cfa),
        device=GentlDevice(**device),
    )


@contextlib.contextmanager
def acquirer_of(opened):
    harvester = Harvester()
    try:
        harvester.add_file(str(opened.cti), check_existence=True, check_validity=True)
        harvester.update()
        acquirer = harvester.create()
        yield acquirer
        acquirer.destroy()
    finally:
        harvester.reset()


def grab(acquirer, name):
    nodes = acquirer.remote_device.node_map
    nodes.TriggerMode.value = "On"
    nodes.ExposureTime.value = 20.0
    nodes.PixelFormat.value = name
    acquirer.start()
    nodes.TriggerSoftware.execute()
    with acquirer.fetch(timeout=5) as buffer:
        component = buffer.payload.components[0]
        size = component.height, component.width
        if name.endswith("10Packed"):
            # harvesters 1.4.3 assumes 10 bits per sample and truncates the rest; the format has 12.
            raw = buffer.module.raw_buffer
            pixels = samples(bytes(raw), name, size[0] * size[1]).reshape(size)
        else:
            pixels = component.data.reshape(size).copy()
        stated = component.data_format
    acquirer.stop()
    assert stated == name
    return pixels


@pytest.mark.parametrize("cfa", MOSAICS)
def test_every_format_arrives_bit_for_bit(cfa):
    frame = np.random.default_rng(3).integers(0, 2**16, SIZE, np.uint16)
    with camera(frame, 16, cfa) as opened, acquirer_of(opened) as acquirer:
        names = acquirer.remote_device.node_map.PixelFormat.symbolics
        assert names == tuple(MOSAICS[cfa] + suffix for suffix in SUFFIXES)
        for name, bits in zip(names, SUFFIXES.values(), strict=True):
            seen = grab(acquirer, name)
            np.testing.assert_array_equal(seen, frame >> (16 - bits), name)


def samples(data: bytes, name: str, count: int) -> np.ndarray:
    """Unpack samples one by one according to the definition (PFNC 2.4; GigE Vision 2)."""
    if not name.endswith("Packed"):
        bits = int(name.rstrip("p")[-2:])
        number = int.from_bytes(data, "little")
        return np.array([number >> (bits * i) & (2**bits - 1) for i in range(count)])
    low = int(name.removesuffix("Packed")[-2:]) - 8
    result = []
    for i in range(0, len(data), 3):
        first, both, second = data[i : i + 3]
        result.append(first << low | both & (2**low - 1))
        result.append(second << low | both >> 4 & (2**low - 1))
    return np.array(result[:count])


@pytest.mark.parametrize("name", ["10p", "12p", "10Packed", "12Packed"])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (5, 7), (4, 4), (7, 6)])
@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_packed_formats_of_any_size_follow_their_definition(name, size, cfa):
    frame = np.random.default_rng(4).integers(0, 2**12, size, np.uint16)
    with (
        camera(frame, 12, cfa) as opened,
        gentl.Library(opened.cti) as library,
        gentl.Device(library) as device,
    ):
        device.set("TriggerMode", "On")
        device.set("PixelFormat", MOSAICS[cfa] + name)
        device.start()
        shot = device.shoot()
        assert symbolics[shot.format] == MOSAICS[cfa] + name
        assert shot.filled == len(shot.data) == device.get("PayloadSize")
        expected = frame >> (12 - SUFFIXES[name])
        np.testing.assert_array_equal(samples(shot.data, name, frame.size), expected.ravel())


@pytest.mark.parametrize(
    ("bits", "name"),
    [
        pytest.param(8, "Mono8", id="8 bits"),
        pytest.param(10, "Mono10", id="10 bits"),
        pytest.param(12, "Mono12", id="12 bits"),
        pytest.param(14, "Mono16", id="14 bits"),
        pytest.param(16, "Mono16", id="16 bits"),
    ],
)
def test_a_camera_starts_with_the_format_of_its_bit_depth(bits, name):
    frame = np.random.default_rng(5).integers(0, 2**bits, SIZE, np.uint16)
    with camera(frame, bits) as opened, acquirer_of(opened) as acquirer:
        assert acquirer.remote_device.node_map.PixelFormat.value == name
        np.testing.assert_array_equal(grab(acquirer, name), frame)
        # A wider format has the same values in its low bits.
        np.testing.assert_array_equal(grab(acquirer, "Mono16"), frame)


@pytest.mark.parametrize("name", ["Mono8", "Mono12p", "Mono16"])
def test_a_part_of_the_sensor(name):
    frame = np.random.default_rng(6).integers(0, 2**16, SIZE, np.uint16)
    with camera(frame, 16) as opened, acquirer_of(opened) as acquirer:
        nodes = acquirer.remote_device.node_map
        nodes.Width.value, nodes.Height.value = 8, 5
        assert (nodes.OffsetX.max, nodes.OffsetY.max) == (12, 7)
        nodes.OffsetX.value, nodes.OffsetY.value = 11, 7
        expected = frame[7:12, 11:19] >> (16 - SUFFIXES[name.removeprefix("Mono")])
        np.testing.assert_array_equal(grab(acquirer, name), expected)


def test_frames_of_five_megapixels_arrive_at_the_rate_of_the_camera():
    frame = np.random.default_rng(7).integers(0, 2**12, (2048, 2448), np.uint16)
    opened = camera(frame, 12, frame_rate_hz=20.0)
    with opened, gentl.Library(opened.cti) as library, gentl.Device(library) as device:
        device.set("ExposureTime", 5000.0)
        device.start()
        first = device.fetch()
        busy = time.process_time()
        frames = [device.take(5.0)]
        for _ in range(10):
            device.queue(frames[-1])
            frames.append(device.take(5.0))
        busy = time.process_time() - busy
        assert (first.pixels == frame).all()
        # 10 frames take half a second; the limit is a fifth of a core.
        assert busy < 0.1
        assert device.library is library
