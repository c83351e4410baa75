"""A GenTL client with access to all functions, including those that harvesters hides."""

import ctypes
import re
import time
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from acquisition import NoiseModel
from simulator.bench import BenchWriter
from simulator.camera import GentlCamera, GentlDevice, ImageFormation
from tests.simulator.camera_options import grouped

NOT_IMPLEMENTED = -1003
RESOURCE_IN_USE = -1004
ACCESS_DENIED = -1005
INVALID_HANDLE = -1006
INVALID_PARAMETER = -1009
IO = -1010
TIMEOUT = -1011
ABORT = -1012
INVALID_ADDRESS = -1015
INVALID_VALUE = -1019

_FRAME_INFOS = {"filled": 9, "width": 10, "height": 11, "block": 16, "format": 20, "start_ns": 28}
_INCOMPLETE = 7
DELIVERED, UNDERRUN = 1, 2
_REGISTER = re.compile(r'<(Int|Float|String)Reg Name="(\w+)"><Address>(0x[0-9a-f]+)</Address>')
_ENTRY = re.compile(r'<EnumEntry Name="(\w+)"><Value>(\d+)</Value>')


class GentlError(Exception):
    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


@contextmanager
def refused(code, match=None):
    """Expect that a call is refused with this error code."""
    with pytest.raises(GentlError, match=match) as caught:
        yield caught
    assert caught.value.code == code


def blind_camera(size=(2, 3), bench=None, **device) -> GentlCamera:
    """Return a camera that sees no light."""
    return GentlCamera(
        lambda led: None,
        size=size,
        leds=0,
        formation=ImageFormation(NoiseModel(1.0, 0.0, 20.0, 12)),
        device=GentlDevice(**device),
        bench_state_path=bench,
    )


@dataclass(frozen=True)
class DeliveredFrame:
    block: int
    start_ns: int
    width: int
    height: int
    format: int
    filled: int
    incomplete: bool
    data: bytes

    @property
    def pixels(self) -> np.ndarray:
        """(H, W) pixels of an unpacked format."""
        kind = np.uint8 if len(self.data) == self.height * self.width else np.uint16
        return np.frombuffer(self.data, kind).reshape(self.height, self.width)


class Library:
    """The loaded and initialised producer with its interface open."""

    def __init__(self, cti) -> None:
        self.c = ctypes.CDLL(str(cti))
        self.call("GCInitLib")
        self.system = self.handle("TLOpen")
        self.call("TLUpdateInterfaceList", self.system, None, ctypes.c_uint64(0))
        self.interface = self.handle("TLOpenInterface", self.system, b"interface0")

    def call(self, name: str, *arguments) -> None:
        code = getattr(self.c, name)(*arguments)
        if code:
            text, size = ctypes.create_string_buffer(1024), ctypes.c_size_t(1024)
            self.c.GCGetLastError(ctypes.byref(ctypes.c_int32()), text, ctypes.byref(size))
            raise GentlError(code, text.value.decode())

    def handle(self, name: str, *arguments) -> ctypes.c_void_p:
        handle = ctypes.c_void_p()
        self.call(name, *arguments, ctypes.byref(handle))
        return handle

    def devices(self) -> int:
        count = ctypes.c_uint32()
        self.call("IFUpdateDeviceList", self.interface, None, ctypes.c_uint64(0))
        self.call("IFGetNumDevices", self.interface, ctypes.byref(count))
        return count.value

    def device_id(self) -> bytes:
        text, size = ctypes.create_string_buffer(256), ctypes.c_size_t(256)
        self.call("IFGetDeviceID", self.interface, 0, text, ctypes.byref(size))
        return text.value

    def close(self) -> None:
        self.call("GCCloseLib")

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Device:
    """The open camera with its stream; nodes are set and read by name."""

    def __init__(self, library: Library, buffers: int = 4) -> None:
        self.library = library
        identity = library.device_id()
        self.handle = library.handle("IFOpenDevice", library.interface, identity, 4)
        self.port = library.handle("DevGetPort", self.handle)
        self.stream = library.handle("DevOpenDataStream", self.handle, b"stream0")
        self.event = library.handle("GCRegisterEvent", self.stream, 1)
        self.xml = self._xml()
        self._registers = {
            name.removesuffix("Reg"): (kind, int(at, 16))
            for kind, name, at in _REGISTER.findall(self.xml)
        }
        self._buffers: dict[int, ctypes.Array] = {}
        self._count = buffers

    def _xml(self) -> str:
        text, size = ctypes.create_string_buffer(256), ctypes.c_size_t(256)
        self.library.call("GCGetPortURL", self.port, text, ctypes.byref(size))
        _, address, length = text.value.decode().partition("?")[0].split(";")
        return self._read(int(address, 16), int(length, 16)).decode()

    def _read(self, address: int, length: int) -> bytes:
        data, size = ctypes.create_string_buffer(length), ctypes.c_size_t(length)
        where = ctypes.c_uint64(address)
        self.library.call("GCReadPort", self.port, where, data, ctypes.byref(size))
        return data.raw

    def _entries(self, node: str) -> dict[str, int]:
        text = re.search(rf'<Enumeration Name="{node}">.*?</Enumeration>', self.xml, re.DOTALL)
        return {name: int(value) for name, value in _ENTRY.findall(text[0])} if text else {}

    def get(self, node: str):
        kind, address = self._registers[node]
        if kind == "String":
            return self._read(address, 64).rstrip(b"\0").decode()
        value = np.frombuffer(self._read(address, 8), "<f8" if kind == "Float" else "<i8")[0]
        names = {value: name for name, value in self._entries(node).items()}
        return names.get(value, value)

    def set(self, node: str, value) -> None:
        kind, address = self._registers[node]
        if isinstance(value, str):
            value = self._entries(node)[value]
        data = np.array([value], "<f8" if kind == "Float" else "<i8").tobytes()
        where, size = ctypes.c_uint64(address), ctypes.c_size_t(8)
        self.library.call("GCWritePort", self.port, where, data, ctypes.byref(size))

    def execute(self, node: str) -> None:
        self.set(node, 1)

    def start(self) -> None:
        size = self.get("PayloadSize")
        for _ in range(self._count):
            memory = ctypes.create_string_buffer(int(size))
            buffer = self.library.handle(
                "DSAnnounceBuffer", self.stream, memory, ctypes.c_size_t(size), None
            )
            self._buffers[buffer.value] = memory
            self.queue(buffer.value)
        self.library.call("DSStartAcquisition", self.stream, 0, ctypes.c_uint64(2**64 - 1))
        self.execute("AcquisitionStart")

    def stop(self) -> None:
        self.execute("AcquisitionStop")
        self.end_stream()

    def end_stream(self) -> None:
        self.library.call("DSStopAcquisition", self.stream, 0)
        self.library.call("DSFlushQueue", self.stream, 4)
        for buffer in self._buffers:
            handle = ctypes.c_void_p(buffer)
            self.library.call("DSRevokeBuffer", self.stream, handle, None, None)
        self._buffers.clear()

    def queue(self, buffer: int) -> None:
        self.library.call("DSQueueBuffer", self.stream, ctypes.c_void_p(buffer))

    def take(self, timeout_s: float) -> int:
        """Wait for the next filled buffer and keep it."""
        data, size = (ctypes.c_void_p * 2)(), ctypes.c_size_t(16)
        timeout = ctypes.c_uint64(round(timeout_s * 1000))
        self.library.call("EventGetData", self.event, data, ctypes.byref(size), timeout)
        return data[0]

    def fetch(self, timeout_s: float = 5.0) -> DeliveredFrame:
        buffer = self.take(timeout_s)
        about = {name: self._info(buffer, what) for name, what in _FRAME_INFOS.items()}
        data = self._buffers[buffer].raw
        incomplete = bool(self._info(buffer, _INCOMPLETE) & 0xFF)
        frame = DeliveredFrame(**about, incomplete=incomplete, data=data)
        self.queue(buffer)
        return frame

    def no_frame_arrives(self, for_s: float = 0.05) -> bool:
        try:
            self.take(for_s)
        except GentlError as error:
            return error.code == TIMEOUT
        return False

    def shoot(self) -> DeliveredFrame:
        self.execute("TriggerSoftware")
        return self.fetch()

    def counter(self, what: int) -> int:
        """Return a 64-bit number from the stream's info."""
        value, size = ctypes.c_uint64(), ctypes.c_size_t(8)
        self.library.call(
            "DSGetInfo", self.stream, what, None, ctypes.byref(value), ctypes.byref(size)
        )
        return value.value

    def _info(self, buffer: int, what: int) -> int:
        value, size = ctypes.c_uint64(), ctypes.c_size_t(8)
        self.library.call(
            "DSGetBufferInfo", self.stream, ctypes.c_void_p(buffer), what, None,
            ctypes.byref(value), ctypes.byref(size),
        )  # fmt: skip
        return value.value

    def close(self) -> None:
        self.library.call("DevClose", self.handle)
        self._buffers.clear()

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Bench:
    """The board's part of a bench state, and cameras with it that this client opens."""

    def __init__(self, path) -> None:
        self.path = path
        self.writer = BenchWriter(path)
        self.opened: list[tuple[Library, GentlCamera]] = []

    def open(self, planes, *, buffers: int = 4, **options) -> Device:
        camera = GentlCamera(planes, **grouped(bench_state_path=self.path, **options))
        library = Library(camera.cti)
        self.opened.append((library, camera))
        return Device(library, buffers)

    def close(self) -> None:
        for library, camera in self.opened:
            library.close()
            camera.close()
        self.writer.close()


def wait_for(happened, timeout_s: float = 5.0) -> None:
    """Wait until a condition is true."""
    until = time.monotonic() + timeout_s
    while not happened():
        assert time.monotonic() < until, "the condition did not become true"
        time.sleep(0.001)
