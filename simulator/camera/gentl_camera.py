"""A GenICam camera that sees the LEDs of the virtual board: a GenTL producer in its own folder."""

from __future__ import annotations

import ctypes
import math
import mmap
import shutil
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from rig import CameraError
from rig.arrays import AnyArray
from simulator.bench.owned_folder import OwnedFolder
from simulator.camera.sensor import ImageFormation, fixed_pattern
from simulator.gentl import build
from simulator.scene.lens import CFAS

GentlPlanes = Callable[[int | None], AnyArray | None]
GentlFault = Literal["lost", "late", "incomplete", "doubled", "missed", "unplug", "underrun"]
Automatic = Literal["exposure", "gain", "white", "gamma"]
FAULTS = 256
MAX_LEDS = 1024
MAX_PATH = 1024
# Kinds have the numbers of `simulator/gentl/control.h`.
FAULT_KINDS = {kind: number for number, kind in enumerate(get_args(GentlFault), start=1)}
AUTOMATICS = {"exposure": 1, "gain": 2, "white": 4, "gamma": 8}
CONTENT_PLANES, CONTENT_FRAMES = 1, 2
_CONTROL_VERSION = 1


class _Fault(ctypes.Structure):
    _fields_ = [
        ("at", ctypes.c_int64),
        ("late_ns", ctypes.c_int64),
        ("kind", ctypes.c_uint32),
        ("armed", ctypes.c_uint32),
    ]


def _listed(kind: Any, names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


class _Layout(ctypes.Structure):
    """The control file of a camera: `simulator/gentl/control.h` in Python; change both together.

    The library checks magic, version and size before it uses the rest.
    """

    _fields_ = [
        ("magic", ctypes.c_char * 8),
        *_listed(ctypes.c_uint32, "version size width height leds content bit_depth noisy rolling"),
        *_listed(ctypes.c_uint32, "block_base autos stuck patterned most_buffers"),
        ("seed", ctypes.c_uint64),
        ("cfa", ctypes.c_char * 8),
        ("serial", ctypes.c_char * 64),
        ("hidden", ctypes.c_char * 256),
        ("bench_path", ctypes.c_char * MAX_PATH),
        *_listed(ctypes.c_double, "readout_us frame_period_us shake_px"),
        *_listed(ctypes.c_double, "electrons_per_dn read_noise_e black_level_dn"),
        *_listed(ctypes.c_double, "quantum_efficiency full_well_e dark_current_e_per_s"),
        *_listed(ctypes.c_double, "warm_up warm_up_s flicker pwm_hz pwm_duty"),
        ("dead", ctypes.c_uint8 * MAX_LEDS),
        ("temperature_c", ctypes.c_double),
        *_listed(ctypes.c_uint32, "plugged unplugs"),
        *_listed(ctypes.c_uint64, "exposures delivered dropped missed"),
        ("faults", _Fault * FAULTS),
    ]


SIZE = ctypes.sizeof(_Layout)


class ControlFile:
    """The mapped file: its fields are attributes of ``fields`` and shared with the library."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(SIZE))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), SIZE)
        self.fields: Any = _Layout.from_buffer(self._map)
        self.fields.magic = b"SGPCAMRA"
        self.fields.version = _CONTROL_VERSION
        self.fields.size = SIZE

    def close(self) -> None:
        """Close the file and set ``fields`` to None."""
        self.fields = None
        self._map.close()


@dataclass(frozen=True)
class GentlCounts:
    """Counters of a virtual GenICam camera since it was made.

    Parameters
    ----------
    exposures
        Exposures that began; each has a block id.
    delivered
        Buffers that were delivered to the client.
    dropped
        Exposures without a buffer: lost by a fault, no buffer queued, or acquisition stopped.
    missed
        Triggers that began no exposure: too soon after another one, or the camera was not armed.
    """

    exposures: int
    delivered: int
    dropped: int
    missed: int


@dataclass(frozen=True)
class GentlDevice:
    """The device of a virtual GenICam camera: timing, buffers, and what it lacks.

    Parameters
    ----------
    serial
        Serial number, up to 63 characters.
    frame_rate_hz
        Maximum frame rate, 0.1 to 1e6: triggers that arrive sooner are missed.
    readout_us
        Time between reading the first and the last row, microseconds.
    shutter
        ``global``: all rows are exposed together. ``rolling``: rows are exposed one after the
        other, the last one ``readout_us`` later than the first.
    first_block_id
        Block id of the first frame after each start of the acquisition: GigE Vision counts from 1,
        USB3 Vision from 0.
    automatics
        Automatic functions that are on at power-up.
    stuck
        Automatic functions that accept a new setting but ignore it.
    without_nodes
        Nodes that this camera does not have.
    most_buffers
        Maximum number of buffers of its stream, 1 to 256.
    temperature_c
        Temperature of the device, degrees Celsius.
    """

    serial: str = "virtual-camera"
    frame_rate_hz: float = 1000.0
    readout_us: float = 0.0
    shutter: Literal["global", "rolling"] = "global"
    first_block_id: int = 0
    automatics: Collection[Automatic] = ()
    stuck: Collection[Automatic] = ()
    without_nodes: Collection[str] = ()
    most_buffers: int = 256
    temperature_c: float = 40.0


class GentlCamera(AbstractContextManager["GentlCamera"]):
    """A virtual GenICam camera: a folder with a GenTL producer and the images it sees.

    Any GenICam program can open its ``cti``. It has the same sensor and light as `VirtualCamera`
    and, for the same shots, the same frames to within the rounding of one grey value. The library
    composes the frames; it needs no Python while it runs.

    Parameters
    ----------
    planes
        Function that returns, for an LED, the ``(H, W)`` float32 photons per microsecond of its
        light alone; for None, those of the ambient light. It returns None if there is no light.
        It is called for all LEDs when the camera is made.
    size
        (H, W).
    leds
        Number of LEDs that have a plane.
    formation
        How the image forms from the light: sensor, lamps, colour filters. ``shake_px`` is at most
        8.
    device
        Timing, buffers and other properties of the device.
    bench_state_path
        File to which the virtual board writes light and trigger pulses, and the camera writes its
        exposures. None for no board: the camera sees only the ambient light.
    precomposed
        If True, ``planes`` returns grey values ``(H, W)`` uint16, and the camera delivers those of
        the LED that was on longest without change. This is faster.

    Attributes
    ----------
    cti : Path
        Path of the GenTL producer, which has only this camera.
    serial : str
        The camera's serial number.

    Raises
    ------
    CompilerError
        If the library is not in the cache and cannot be built.
    CameraError
        If an argument is out of range, or a plane has the wrong size or type.
    """

    def __init__(
        self,
        planes: GentlPlanes,
        *,
        size: tuple[int, int],
        leds: int,
        formation: ImageFormation,
        device: GentlDevice = GentlDevice(),
        bench_state_path: Path | None = None,
        precomposed: bool = False,
    ) -> None:
        self.serial = device.serial
        noise, cfa, lamps = formation.noise, formation.cfa, formation.lamps
        self._check(cfa is None or cfa in CFAS, f"cfa {cfa!r} is not one of {', '.join(CFAS)}")
        self._check_within("0..8", shake_px=formation.shake_px)
        self._check_within(f"0..{MAX_LEDS}", leds=leds)
        self._check(
            all(1 <= n <= 65535 for n in size),
            f"size is {size}, height and width must be within 1..65535",
        )
        self._check_within("0.1..1e6", frame_rate_hz=device.frame_rate_hz)
        self._check_within("0..1e7", readout_us=device.readout_us)
        self._check_within("1..256", most_buffers=device.most_buffers)
        bench = b"" if bench_state_path is None else str(bench_state_path.absolute()).encode()
        self._check(len(bench) < MAX_PATH, f"the path of the bench state is too long: {bench!r}")
        name = device.serial.encode()
        self._check(0 < len(name) < 64, "the serial number must have 1 to 63 characters")
        hidden = "".join(f"{node}," for node in device.without_nodes).encode()
        self._check(
            len(hidden) < 256, "without_nodes is too long: at most 255 characters with commas"
        )
        library = build()
        self._owned = OwnedFolder("sgp-camera-")
        self._folder = self._owned.path
        self.cti = Path(shutil.copy(library, self._folder))
        self._size = size
        self._write_planes(planes, leds, np.uint16 if precomposed else np.float32)
        pattern = fixed_pattern(noise, size, seed=formation.sensor_seed)
        if pattern is not None:
            pattern.maps.tofile(self._folder / "pattern.f32")
        self._control = ControlFile(self._folder / "camera.control")
        fields = self._control.fields
        fields.height, fields.width = size
        fields.leds = leds
        fields.content = CONTENT_FRAMES if precomposed else CONTENT_PLANES
        for part, names in (
            (noise, "bit_depth electrons_per_dn read_noise_e black_level_dn quantum_efficiency"),
            (noise, "dark_current_e_per_s"),
            (lamps, "warm_up warm_up_s flicker pwm_duty"),
            (formation, "noisy seed shake_px"),
            (device, "most_buffers readout_us temperature_c"),
        ):
            for item in names.split():
                setattr(fields, item, getattr(part, item))
        fields.rolling = device.shutter == "rolling"
        fields.block_base = device.first_block_id
        fields.autos = sum(AUTOMATICS[automatic] for automatic in set(device.automatics))
        fields.stuck = sum(AUTOMATICS[automatic] for automatic in set(device.stuck))
        fields.patterned = pattern is not None
        fields.cfa = (cfa or "").encode()
        fields.serial, fields.hidden, fields.bench_path = name, hidden, bench
        fields.frame_period_us = 1e6 / device.frame_rate_hz
        fields.full_well_e = math.inf if noise.full_well_e is None else noise.full_well_e
        fields.pwm_hz = lamps.pwm_hz or 0.0
        for led in lamps.dead:
            if led < MAX_LEDS:
                fields.dead[led] = 1
        fields.plugged = 1

    def set_fault(
        self, frame: int | Literal["next"], kind: GentlFault, *, late_ms: float = 0.0
    ) -> None:
        """Add a fault to one frame.

        Parameters
        ----------
        frame
            Number of the exposure since the camera was made, counted from 0, or ``next``.
        kind
            ``lost``: the frame is not delivered. ``late``: it is delivered ``late_ms`` later, and
            so are all frames after it. ``incomplete``: it has half of its rows. ``doubled``: it is
            delivered twice. ``missed``: its trigger has no effect. ``unplug``: the camera is
            unplugged instead of exposing. ``underrun``: there is no free buffer for it, as on a
            computer that does not return buffers in time.
        late_ms
            Delay of a late frame, milliseconds.

        Raises
        ------
        CameraError
            If there are too many faults that have not occurred yet.
        """
        self._check(kind in FAULT_KINDS, f"unknown fault {kind!r}")
        for fault in self._fields.faults:
            if not fault.armed:
                fault.at = -1 if frame == "next" else frame
                fault.late_ns = round(late_ms * 1e6)
                fault.kind = FAULT_KINDS[kind]
                fault.armed = 1
                return
        raise CameraError(
            f"camera {self.serial}: more than {FAULTS} faults are set and have not occurred"
        )

    def unplug(self) -> None:
        """Unplug the camera: it is dead for programs that have it open, until they reopen it."""
        self._fields.plugged = 0
        self._fields.unplugs += 1

    def replug(self) -> None:
        """Plug the camera in again."""
        self._fields.plugged = 1

    def set_temperature(self, temperature_c: float) -> None:
        """Set the temperature of the device, degrees Celsius."""
        self._fields.temperature_c = temperature_c

    def counts(self) -> GentlCounts:
        """Return the camera's counters."""
        fields = self._fields
        return GentlCounts(fields.exposures, fields.delivered, fields.dropped, fields.missed)

    def close(self) -> None:
        """Remove the folder; closing twice does nothing.

        Programs that have the camera open must close it first.
        """
        if self._owned.open:
            self._control.close()
            self._owned.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _fields(self) -> Any:
        self._check(self._owned.open, "is closed")
        return self._control.fields

    def _check(self, valid: bool, complaint: str) -> None:
        if not valid:
            raise CameraError(f"camera {self.serial}: {complaint}")

    def _check_within(self, bounds: str, **values: float) -> None:
        low, high = map(float, bounds.split(".."))
        for name, value in values.items():
            self._check(low <= value <= high, f"{name} is {value}, it must be within {bounds}")

    def _write_planes(self, planes: GentlPlanes, leds: int, kind: type[np.generic]) -> None:
        name = "frames.u16" if kind is np.uint16 else "planes.f32"
        bytes_each = math.prod(self._size) * np.dtype(kind).itemsize
        with (self._folder / name).open("wb") as file:
            for index in range(leds + 1):
                led = index - 1 if index else None
                plane = planes(led)
                if plane is None:
                    continue
                self._check(
                    plane.shape == self._size and plane.dtype == kind,
                    f"the plane of LED {led} is {plane.dtype} of shape {plane.shape}, expected "
                    f"{np.dtype(kind)} of shape {self._size}",
                )
                file.seek(index * bytes_each)
                file.write(np.ascontiguousarray(plane).data)
            file.truncate((leds + 1) * bytes_each)
