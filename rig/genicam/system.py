"""Management of Harvesters: one per GenTL producer and process, shared by its open cameras.

A second Harvester for the same producer sees no devices, and an update of the device list closes
every open camera. There is therefore one Harvester per producer, updated once, and reset after its
last camera has been closed.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import struct
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from genicam import gentl
from harvesters.core import Harvester, ParameterKey, ParameterSet

from rig._errors import CameraError
from rig.files.guard import MAX_BINARY_BYTES, UnreadableError, read_bounded
from rig.genicam.buffers import LEAST
from rig.genicam.errors import GENICAM_ERRORS, in_words

_TAKEN: tuple[type[Exception], ...] = (gentl.AccessDeniedException, gentl.ResourceInUseException)
# harvesters assumes that it has parsed the camera's XML, and fails with these errors if not.
_CREATION_ERRORS: tuple[type[Exception], ...] = (*GENICAM_ERRORS, AssertionError, AttributeError)
_log = logging.getLogger("rig.genicam")
# Silent by default: relevant errors are raised as exceptions.
_log.addHandler(logging.NullHandler())
# Every producer exports this function, so the file contains its name.
_ENTRY_POINT = b"GCInitLib\0"
_ELF_MAGIC = b"\x7fELF"
_PT_LOAD = 1


@dataclass(frozen=True)
class FoundCamera:
    """A camera that a GenTL producer offers; texts that it does not report are empty."""

    cti: Path
    vendor: str
    model: str
    serial: str

    def __str__(self) -> str:
        return f"{self.serial or '(no serial number)'} ({self.vendor} {self.model})"


@dataclass
class _System:
    """The Harvester of one producer, and the number of its users."""

    harvester: Any
    users: int = 0
    found: list[FoundCamera] = field(default_factory=list)


_systems: dict[Path, _System] = {}
# Reentrant: a signal handler that closes the rig may interrupt the thread that opens it.
_lock = threading.RLock()


class OpenDevice:
    """An open camera of a producer: harvesters' image acquirer, which `close` releases.

    Attributes
    ----------
    acquirer
        harvesters' ``ImageAcquirer``.
    found
        The producer's description of the camera.
    """

    def __init__(self, acquirer: Any, found: FoundCamera) -> None:
        self.acquirer = acquirer
        self.found = found
        self._given_back = False

    def close(self) -> None:
        """Release the camera; closing twice does nothing.

        Raises
        ------
        CameraError
            If the producer fails while closing. Everything has been released then.
        """
        if self._given_back:
            return
        self._given_back = True
        with _lock:
            try:
                _destroy(self.acquirer)
            except GENICAM_ERRORS as error:
                raise CameraError(
                    f"camera {self.found.serial}: did not close properly ({in_words(error)})"
                ) from error
            finally:
                system = _systems[self.found.cti]
                # The Harvester would otherwise keep it for its own lifetime.
                with contextlib.suppress(ValueError):
                    system.harvester.image_acquirers.remove(self.acquirer)
                _release(self.found.cti)


def open_device(
    ctis: Sequence[str | Path], *, serial: str | None = None, model: str | None = None
) -> OpenDevice:
    """Open the one camera of these producers that has this serial number and model.

    Parameters
    ----------
    ctis
        GenTL producers (.cti files).
    serial, model
        As the camera reports them; None for any.

    Raises
    ------
    CameraError
        If a producer cannot be used; if no camera, or more than one, matches (the message lists
        those found); or if the camera does not open.
    """
    paths = _resolved(ctis)
    with _in_use(paths) as cameras:
        index, found = _pick(cameras, paths, serial, model)
        acquirer = _create(_systems[found.cti].harvester, index, found)
        _systems[found.cti].users += 1
        return OpenDevice(acquirer, found)


def find_cameras(ctis: Sequence[str | Path]) -> tuple[FoundCamera, ...]:
    """Return the cameras that these GenTL producers offer, without opening any.

    Raises
    ------
    CameraError
        If a producer cannot be used.

    Examples
    --------
    >>> from rig.genicam import find_cameras
    >>> find_cameras([])
    ()
    """
    with _in_use(_resolved(ctis)) as cameras:
        return tuple(camera for _, camera in cameras)


@contextlib.contextmanager
def _in_use(paths: Sequence[Path]) -> Iterator[list[tuple[int, FoundCamera]]]:
    """Yield the cameras of these producers, each with its index there, and release them after."""
    with _lock, contextlib.ExitStack() as used:
        cameras: list[tuple[int, FoundCamera]] = []
        for path in paths:
            system = _use(path)
            used.callback(_release, path)
            cameras += enumerate(system.found)
        yield cameras


def _resolved(ctis: Sequence[str | Path]) -> list[Path]:
    return list(dict.fromkeys(Path(cti).expanduser().resolve() for cti in ctis))


def _use(path: Path) -> _System:
    system = _systems.get(path)
    if system is None:
        check_cti(path)
        harvester = Harvester(config=ParameterSet({ParameterKey.LOGGER: _log}))
        try:
            harvester.add_file(str(path))
            harvester.update()
            found = [_found(path, info.property_dict) for info in harvester.device_info_list]
        except GENICAM_ERRORS as error:
            # Usually the same failure again.
            with contextlib.suppress(*GENICAM_ERRORS):
                harvester.reset()
            raise CameraError(f"{path}: this GenTL producer fails ({in_words(error)})") from error
        system = _systems[path] = _System(harvester, found=found)
    system.users += 1
    return system


def _release(path: Path) -> None:
    system = _systems[path]
    system.users -= 1
    if system.users == 0:
        del _systems[path]
        try:
            system.harvester.reset()
        except GENICAM_ERRORS as error:
            raise CameraError(
                f"{path}: this GenTL producer did not close properly ({in_words(error)})"
            ) from error


def _found(path: Path, said: dict[str, Any]) -> FoundCamera:
    vendor, model, serial = (
        str(said.get(key) or "") for key in ("vendor", "model", "serial_number")
    )
    return FoundCamera(path, vendor, model, serial)


def _pick(
    cameras: Sequence[tuple[int, FoundCamera]],
    paths: Sequence[Path],
    serial: str | None,
    model: str | None,
) -> tuple[int, FoundCamera]:
    where = ", ".join(map(str, paths))
    if not cameras:
        raise CameraError(
            f"{where}: no camera found; check its cable and power, and that no other program has "
            "it open"
        )
    meant = [
        (index, camera)
        for index, camera in cameras
        if serial in (None, camera.serial) and model in (None, camera.model)
    ]
    if len(meant) == 1:
        return meant[0]
    listed = ", ".join(str(camera) for _, camera in cameras)
    if meant:
        raise CameraError(
            f"{where}: {len(meant)} cameras found, choose one by serial number: {listed}"
        )
    wanted = " ".join(part for part in (model, serial) if part is not None)
    raise CameraError(f"{where}: no camera {wanted}; found: {listed}")


def _create(harvester: Any, index: int, found: FoundCamera) -> Any:
    config = ParameterSet(
        {
            ParameterKey.ENABLE_AUTO_CHUNK_DATA_UPDATE: False,
            ParameterKey.NUM_BUFFERS_FOR_FETCH_CALL: LEAST,
        }
    )
    try:
        with _handler_of_ctrl_c_kept():
            acquirer = harvester.create(index, config=config)
    except _TAKEN as error:
        raise CameraError(
            f"camera {found}: another program has it open; end that program"
        ) from error
    except _CREATION_ERRORS as error:
        raise CameraError(f"camera {found}: cannot be opened ({in_words(error)})") from error
    if not acquirer.is_valid():
        # Ctrl-C arrived before its handler was restored: harvesters then destroys the camera.
        raise KeyboardInterrupt
    return acquirer


@contextlib.contextmanager
def _handler_of_ctrl_c_kept() -> Iterator[None]:
    """Restore the handler of SIGINT, which harvesters replaces permanently on the main thread."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        # None stands for a handler that Python did not set and cannot restore.
        if threading.current_thread() is threading.main_thread() and handler is not None:
            signal.signal(signal.SIGINT, handler)


def _destroy(acquirer: Any) -> None:
    # genicam's chunk adapter is kept alive by its own finalizer, and with it a whole node map.
    release = getattr(getattr(acquirer, "_chunk_adapter", None), "_finalizer", None)
    # For an unplugged camera this fails, but the rest does not.
    with contextlib.suppress(*GENICAM_ERRORS):
        acquirer.stop()
    try:
        # Its ``destroy`` alone would leave a finalizer that also keeps it alive.
        with acquirer:
            pass
    finally:
        if release is not None:
            release()


def check_cti(path: Path) -> None:
    """Check that a file is a GenTL producer and can be loaded; this process must not be using it.

    Raises
    ------
    CameraError
        If there is no such file, it cannot be read, is cut short, or is not a GenTL producer.
    """
    try:
        content = read_bounded(path, MAX_BINARY_BYTES)
    except FileNotFoundError as error:
        raise CameraError(
            f"{path}: no such GenTL producer; give the path of the .cti file that came with the "
            "camera's driver"
        ) from error
    except UnreadableError as error:
        raise CameraError(f"{path}: cannot be read as a GenTL producer ({error})") from error
    if content[:4] == _ELF_MAGIC and _elf_is_cut_short(content):
        raise CameraError(f"{path}: this GenTL producer is cut short; install the driver again")
    if _ENTRY_POINT not in content:
        raise CameraError(f"{path}: not a GenTL producer; give the driver's .cti file")
    producer = gentl.GenTLProducer.create_producer()
    try:
        producer.open(str(path))
        producer.close()
    except gentl.GenericException as error:
        raise CameraError(
            f"{path}: this GenTL producer cannot be loaded ({in_words(error)}); install the driver "
            "again"
        ) from error


def _elf_is_cut_short(content: bytes) -> bool:
    """Return whether segments extend beyond the end: mapping them would kill the process."""
    wide, order = content[4:5] == b"\x02", ">" if content[5:6] == b"\x02" else "<"
    header, entry = ("16s2HI3QI3H", "2I4Q") if wide else ("16s2HI3II3H", "6I")
    try:
        fields = struct.unpack_from(order + header, content)
        table_at, entry_size, entries = fields[5], fields[9], fields[10]
        for index in range(entries):
            segment = struct.unpack_from(order + entry, content, table_at + index * entry_size)
            kind, at, size = segment[0], segment[2 if wide else 1], segment[5 if wide else 4]
            if kind == _PT_LOAD and at + size > len(content):
                return True
    except struct.error:
        return True
    return False
