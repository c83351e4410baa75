"""A GenICam camera that sees what the virtual board lights: a library in a folder of its own."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
import numpy.typing as npt

from acquisition import NoiseModel
from rig import CameraError
from simulator._camera.gentl_control import (
    AUTOMATICS,
    CONTENT_FRAMES,
    CONTENT_PLANES,
    FAULT_KINDS,
    FAULTS,
    MAX_LEDS,
    MAX_PATH,
    ControlFile,
)
from simulator._camera.sensor import fixed_pattern
from simulator._owned_folder import OwnedFolder
from simulator._scene.lamps import Lamps
from simulator._scene.lens import CFAS
from simulator.gentl import build

GentlPlanes = Callable[[int | None], npt.NDArray[Any] | None]
GentlFault = Literal["lost", "late", "incomplete", "doubled", "missed", "unplug", "underrun"]
Automatic = Literal["exposure", "gain", "white", "gamma"]
_STEADY = Lamps()


@dataclass(frozen=True)
class GentlCounts:
    """What a virtual GenICam camera has done since it was made.

    Parameters
    ----------
    exposures
        Begun; each took a block id.
    delivered
        Buffers that went to the client.
    dropped
        Exposures without a buffer: lost by a fault, none queued, or stopped before.
    missed
        Triggers that began no exposure: too soon after another, or none was armed.
    """

    exposures: int
    delivered: int
    dropped: int
    missed: int


class GentlCamera:
    """A virtual GenICam camera: a folder with a GenTL producer and what it sees.

    Any GenICam program can open its ``cti``. It has the sensor, the light and, for the same shots,
    the very frames of `VirtualCamera`, within the rounding of one grey value. The frames are
    composed by the library, which needs no Python while it runs.

    Parameters
    ----------
    planes
        For an LED, ``(H, W)`` float32 photons per microsecond that its light alone yields; for
        None those of the ambient light; None where there is none. All are asked for at once.
    size
        (H, W).
    leds
        How many LEDs have a plane.
    noise
        The sensor.
    bench_state_path
        The file in which the virtual board tells light and trigger pulses, and is told exposures.
        None for no board: only the ambient light.
    seed, noisy, cfa, lamps, shake_px, sensor_seed
        See `VirtualCamera`.
    serial
        Serial number, up to 63 letters.
    frame_rate_hz
        The greatest, 0.1 to 1e6: triggers that come sooner are missed.
    readout_us
        Time from the first to the last row read, microseconds.
    shutter
        ``global``: all rows are exposed together. ``rolling``: each row so much later that the
        last one is ``readout_us`` behind the first.
    precomposed
        True: what ``planes`` yields are grey values ``(H, W)`` uint16, delivered as they are for
        the LED that burned longest. For speed.
    first_block_id
        After each start of the acquisition: GigE Vision counts from 1, USB3 Vision from 0.
    automatics
        Which are switched on at power-up.
    stuck
        Automatics that take a new setting and do not obey.
    without_nodes
        Nodes that this camera lacks.
    most_buffers
        How many buffers its stream takes, 1 to 256.
    temperature_c
        Of the device, degrees Celsius.

    Attributes
    ----------
    cti : Path
        The GenTL producer; it has this one camera.
    serial : str
        The camera's serial number.

    Raises
    ------
    CompilerError
        If the library has to be built and cannot.
    CameraError
        If an argument cannot be or a plane is of another size or type.
    """

    def __init__(
        self,
        planes: GentlPlanes,
        *,
        size: tuple[int, int],
        leds: int,
        noise: NoiseModel,
        bench_state_path: Path | None = None,
        seed: int = 0,
        noisy: bool = True,
        cfa: str | None = None,
        lamps: Lamps = _STEADY,
        shake_px: float = 0.0,
        sensor_seed: int = 0,
        serial: str = "virtual-camera",
        frame_rate_hz: float = 1000.0,
        readout_us: float = 0.0,
        shutter: Literal["global", "rolling"] = "global",
        precomposed: bool = False,
        first_block_id: int = 0,
        automatics: Collection[Automatic] = (),
        stuck: Collection[Automatic] = (),
        without_nodes: Collection[str] = (),
        most_buffers: int = 256,
        temperature_c: float = 40.0,
    ) -> None:
        self.serial = serial
        self._check(cfa is None or cfa in CFAS, f"cfa {cfa!r} is not one of {', '.join(CFAS)}")
        self._check(0 <= shake_px <= 8, f"a shake of {shake_px} px cannot be: 0 to 8")
        self._check(0 <= leds <= MAX_LEDS, f"{leds} LEDs cannot be: 0 to {MAX_LEDS}")
        self._check(all(1 <= n <= 65535 for n in size), f"a size of {size} cannot be")
        self._check(0.1 <= frame_rate_hz <= 1e6, f"{frame_rate_hz} Hz cannot be: 0.1 to 1e6")
        self._check(0 <= readout_us <= 1e7, f"a readout of {readout_us} us cannot be: 0 to 1e7")
        self._check(1 <= most_buffers <= 256, f"{most_buffers} buffers cannot be: 1 to 256")
        bench = b"" if bench_state_path is None else str(bench_state_path.absolute()).encode()
        self._check(len(bench) < MAX_PATH, f"the path of the bench state is too long: {bench!r}")
        name = serial.encode()
        self._check(0 < len(name) < 64, "a serial number has 1 to 63 letters")
        hidden = "".join(f"{node}," for node in without_nodes).encode()
        self._check(len(hidden) < 256, "too many nodes are left out: 255 letters with their commas")
        library = build()
        self._owned = OwnedFolder("sgp-camera-")
        self._folder = self._owned.path
        self.cti = Path(shutil.copy(library, self._folder))
        self._size = size
        self._write_planes(planes, leds, np.uint16 if precomposed else np.float32)
        pattern = fixed_pattern(noise, size, seed=sensor_seed)
        if pattern is not None:
            pattern.maps.tofile(self._folder / "pattern.f32")
        self._control = ControlFile(self._folder / "camera.control")
        fields = self._control.fields
        fields.height, fields.width = size
        fields.leds = leds
        fields.content = CONTENT_FRAMES if precomposed else CONTENT_PLANES
        fields.bit_depth = noise.bit_depth
        fields.noisy = noisy
        fields.rolling = shutter == "rolling"
        fields.block_base = first_block_id
        fields.autos = sum(AUTOMATICS[automatic] for automatic in set(automatics))
        fields.stuck = sum(AUTOMATICS[automatic] for automatic in set(stuck))
        fields.patterned = pattern is not None
        fields.most_buffers = most_buffers
        fields.seed = seed
        fields.cfa = (cfa or "").encode()
        fields.serial = name
        fields.hidden = hidden
        fields.bench_path = bench
        fields.readout_us = readout_us
        fields.frame_period_us = 1e6 / frame_rate_hz
        fields.shake_px = shake_px
        for item in ("electrons_per_dn", "read_noise_e", "black_level_dn", "quantum_efficiency",
                     "dark_current_e_per_s"):  # fmt: skip
            setattr(fields, item, getattr(noise, item))
        fields.full_well_e = math.inf if noise.full_well_e is None else noise.full_well_e
        for item in ("warm_up", "warm_up_s", "flicker", "pwm_duty"):
            setattr(fields, item, getattr(lamps, item))
        fields.pwm_hz = lamps.pwm_hz or 0.0
        for led in lamps.dead:
            if led < MAX_LEDS:
                fields.dead[led] = 1
        fields.temperature_c = temperature_c
        fields.plugged = 1

    def set_fault(
        self, frame: int | Literal["next"], kind: GentlFault, *, late_ms: float = 0.0
    ) -> None:
        """Let something go wrong with one frame.

        Parameters
        ----------
        frame
            Which exposure since the camera was made, counted from 0, or the next one.
        kind
            ``lost``: never comes. ``late``: comes ``late_ms`` later, and so do all behind it.
            ``incomplete``: half of its rows. ``doubled``: comes twice. ``missed``: its trigger is
            not seen. ``unplug``: the camera is unplugged instead of exposing. ``underrun``: finds
            no free buffer, as on a computer that does not return them in time.
        late_ms
            Of a late frame, milliseconds.

        Raises
        ------
        CameraError
            If there are too many faults that have not struck yet.
        """
        self._check(kind in get_args(GentlFault), f"no fault is called {kind!r}")
        for fault in self._fields.faults:
            if not fault.armed:
                fault.at = -1 if frame == "next" else frame
                fault.late_ns = round(late_ms * 1e6)
                fault.kind = FAULT_KINDS[kind]
                fault.armed = 1
                return
        raise CameraError(f"camera {self.serial}: more than {FAULTS} faults are waiting")

    def unplug(self) -> None:
        """Take the camera away: who has it open finds it dead, until opened again."""
        self._fields.plugged = 0
        self._fields.unplugs += 1

    def replug(self) -> None:
        """Bring the camera back."""
        self._fields.plugged = 1

    def set_temperature(self, temperature_c: float) -> None:
        """Let the device have another temperature, degrees Celsius."""
        self._fields.temperature_c = temperature_c

    def counts(self) -> GentlCounts:
        """Return what the camera has done so far."""
        fields = self._fields
        return GentlCounts(fields.exposures, fields.delivered, fields.dropped, fields.missed)

    def close(self) -> None:
        """Remove the folder; closing twice does nothing. Close what has the camera open before."""
        if self._owned.open:
            self._control.close()
            self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _fields(self) -> Any:
        self._check(self._owned.open, "is closed")
        return self._control.fields

    def _check(self, sound: bool, complaint: str) -> None:
        if not sound:
            raise CameraError(f"camera {self.serial}: {complaint}")

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
                    f"the plane of LED {led} is {plane.dtype} of shape {plane.shape}, wanted "
                    f"{np.dtype(kind)} of {self._size}",
                )
                file.seek(index * bytes_each)
                file.write(np.ascontiguousarray(plane).data)
            file.truncate((leds + 1) * bytes_each)
