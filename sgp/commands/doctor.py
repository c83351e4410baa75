"""``sgp doctor``: check this computer without touching the rig."""

from __future__ import annotations

import os
import platform
import re
import shutil
import stat
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import acquisition
import rig
from sgp.cli.entry import PACKAGES, foreign_package
from sgp.cli.options import SourceOptions
from sgp.cli.terminal import wrapped
from sgp.results import Result
from sgp.rigs import chosen_rig, config_path, default_rig

_State = Literal["ok", "warning", "error"]
# GenTL's variable with the folders of producers, for 64-bit programs.
_GENTL = "GENICAM_GENTL64_PATH"
# Every producer exports this function, so the file contains its name.
_GENTL_ENTRY = b"GCInitLib\0"
# A session of 36 LEDs with 5 Mpx takes 0.4 GB.
_LOW_DISK, _NO_DISK = 5e9, 0.5e9
# A run of 12 images of 24 Mpx needs 2.5 GB.
_LOW_MEMORY, _LOW_FREE = 3.5e9, 1e9
# More than most compiled kernels take.
_KERNEL_BYTES = 1_000_000


@dataclass(frozen=True)
class _Found:
    """What one check found; the text names the remedy unless the state is ``ok``."""

    name: str
    state: _State
    text: str

    def lines(self) -> list[str]:
        """Return lines of at most 80 columns, also for files; paths that are longer are broken."""
        parts = re.sub(r"\S{60}(?=\S)", r"\g<0> ", self.text)
        return wrapped(f"{self.state:<8} {self.name:<10} {parts}", 80).split("\n")


_Findings = Iterator[tuple[_State, str]]


def doctor(*, compile_kernels: Annotated[bool, Parameter("--compile")] = False) -> Result:
    """Check versions, compiler, camera drivers, serial ports, disk, memory and name clashes.

    No port is opened and no LED is switched. The exit code is 3 if a check found an error; warnings
    do not count.

    For example:

        sgp doctor

    Parameters
    ----------
    compile_kernels
        Compile the kernels of the common commands now, which takes some minutes, so that no command
        waits for them later: simulated scenes are recorded and processed in a temporary folder.
    """
    found = [one for name, check in _CHECKS.items() for one in _guarded(name, check)]
    if compile_kernels:
        found += _guarded("kernels", _compile)
    counts = {state: sum(one.state == state for one in found) for state in ("error", "warning")}
    several = [f"{n} {state}{'s' * (n > 1)}" for state, n in counts.items() if n]
    return Result(
        metrics={"checks": [asdict(one) for one in found]},
        summary=[
            *(line for one in found for line in one.lines()),
            ", ".join(several) or "nothing needs attention",
        ],
        ok=counts["error"] == 0,
        failing_code=3,
    )


def _guarded(name: str, check: Callable[[], _Findings]) -> Iterator[_Found]:
    """Yield what a check finds; a check that fails itself is a warning."""
    try:
        for state, text in check():
            yield _Found(name, state, text)
    except Exception as error:  # noqa: BLE001 - the other checks must run
        reason = " ".join(str(error).split()) or type(error).__name__
        yield _Found(name, "warning", f"cannot be checked ({reason})")


def _versions() -> _Findings:
    yield (
        "ok",
        f"sgp {acquisition.files.software_version()}, Python {platform.python_version()}, "
        f"{platform.system()} {platform.machine()}, in {sys.prefix}",
    )
    from importlib.metadata import PackageNotFoundError, requires, version

    try:
        required = requires(acquisition.files.SOFTWARE) or []
    except PackageNotFoundError:
        yield "warning", "sgp is not installed as a package: install it (pipx install .)"
        return
    present = {}
    for line in required:
        match = re.match(r"([A-Za-z0-9._-]+)[^;>]*(?:>=\s*([0-9.]+))?", line)
        if match is None or "extra =" in line.partition(";")[2]:
            continue
        name, least = match[1], match[2] or "0"
        try:
            present[name] = version(name)
        except PackageNotFoundError:
            yield "error", f"{name} is missing: install it (pip install '{name}>={least}')"
            continue
        if _numbers(present[name]) < _numbers(least):
            text = f"{name} {present[name]} is too old: pip install '{name}>={least}'"
            yield "error", text
    yield "ok", ", ".join(f"{name} {number}" for name, number in sorted(present.items()))


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version.partition("+")[0])[:3])


def _names() -> _Findings:
    clean = True
    for finding in _clashes():
        clean = False
        yield finding
    if clean:
        yield "ok", "no other package or program has our names"


def _clashes() -> _Findings:
    from importlib.metadata import packages_distributions

    complaint = foreign_package()
    if complaint is not None:
        yield "error", complaint
    provided = packages_distributions()
    for name in PACKAGES:
        for other in sorted(set(provided.get(name, ())) - {acquisition.files.SOFTWARE}):
            yield (
                "warning",
                f"the package {other} also contains {name}: uninstall it, or install sgp in an "
                "environment of its own (pipx, uv tool)",
            )
    scripts = Path(sysconfig.get_path("scripts"))
    missing = []
    for program in ("sgp", "capture"):
        ours, first = shutil.which(program, path=str(scripts)), shutil.which(program)
        if ours is not None and first is None:
            missing.append(program)
        elif ours is not None and first is not None and not os.path.samefile(first, ours):
            yield "warning", f"{program} on the path is {first}: put {scripts} first in PATH"
    if missing:
        are = f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'}"
        yield "warning", f"{are} not on the path: add {scripts} to PATH"


def _compiler() -> _Findings:
    from simulator.gentl import CompilerError, build

    try:
        yield "ok", f"the virtual GenICam camera is built: {build()}"
    except CompilerError as error:
        yield "warning", f"{error}; until then the simulated rig has a camera in Python"


def _kernels() -> _Findings:
    folder = rig.kernels.kernel_folder()
    if folder is None:
        yield (
            "warning",
            "compiled kernels cannot be kept, so that every run compiles them: set NUMBA_CACHE_DIR "
            "to a folder that can be written",
        )
        return
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_KERNEL_BYTES))
    except OSError as error:
        yield "warning", f"{folder}: {error.strerror}: compiled kernels cannot be kept: free space"
    else:
        yield "ok", f"compiled kernels are kept in {folder} and folders like it"


def _compile() -> _Findings:
    """Use the common commands once."""
    from sgp.commands.compare import compare
    from sgp.commands.demo import demo
    from sgp.commands.normals import normals

    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="sgp-") as place:
        folder = Path(place)
        demo(out=folder / "demo")
        options = SourceOptions(lights=folder / "demo" / "lights.json", distant=True)
        normals(folder / "demo" / "recording", out=folder / "far", options=options)
        compare(folder / "far", folder / "demo" / "normals")
    yield "ok", f"those of the common commands are compiled: {time.monotonic() - began_s:.0f} s"


def _gentl() -> _Findings:
    folders = [Path(name) for name in os.environ.get(_GENTL, "").split(os.pathsep) if name]
    found = 0
    for folder in folders:
        if not folder.is_dir():
            text = f"{_GENTL} names {folder}, which is not a folder: install the camera's driver "
            yield "warning", f"{text}again, or correct the variable"
            continue
        for cti in sorted(folder.glob("*.cti")):
            found += 1
            yield _producer(cti)
    if not found:
        place = f"in {_GENTL}" if folders else f"because {_GENTL} is not set"
        yield (
            "warning",
            f"no GenTL producer was found {place}: install the driver of the camera, and name its "
            ".cti file in the rig file (not needed without a camera)",
        )


def _producer(cti: Path) -> tuple[_State, str]:
    """Return what is known about a producer without loading it, since that could crash."""
    try:
        whole = _GENTL_ENTRY in rig.read_bounded(cti, rig.files.MAX_BINARY_BYTES)
    except (FileNotFoundError, rig.UnreadableError) as error:
        return "warning", f"{cti}: cannot be read ({error}): install the driver again"
    if not whole:
        return "warning", f"{cti}: is not a GenTL producer: install the driver again"
    return "ok", f"{cti}: `sgp rig list --cti` lists its cameras"


def _serial() -> _Findings:
    from serial.tools import list_ports

    ports = sorted(list_ports.comports())
    if not ports:
        yield "ok", "no serial port: plug the LED board in, if this computer has one"
    for port in ports:
        device = port.device
        if sys.platform == "win32" or os.access(device, os.R_OK | os.W_OK):
            yield "ok", f"{device}: {port.description}"
            continue
        # The board is a USB device; the ports of the mainboard may stay closed.
        state: _State = "warning" if port.vid is None else "error"
        yield state, f"{device}: no right to open it: {_how_to_open(device)}"


def _how_to_open(device: str) -> str:
    import grp

    status = os.stat(device)
    group = grp.getgrgid(status.st_gid).gr_name
    if group == "root" or not status.st_mode & stat.S_IWGRP:
        return "add a udev rule that gives its group the right to read and write"
    return f"run `sudo usermod -aG {group} $USER`, then log in again"


def _rig() -> _Findings:
    default = default_rig()
    if default is None:
        yield "ok", f"no default rig (a file {config_path()} or SGP_RIG can name one)"
        return
    config = rig.find_rig_config(chosen_rig(None))
    cti = config.options.get("cti")
    if isinstance(cti, str):
        producer = Path(cti).expanduser()
        state, text = _producer(producer)
        if state != "ok":
            yield "error", f"{default.name}, from {default.origin}: {text}"
            return
    yield "ok", f"{default.name}, from {default.origin}: driver {config.driver}, {config.leds} LEDs"


def _disk() -> _Findings:
    for what, place in (("here", Path.cwd()), ("temporary", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(place).free
        text = f"{place} ({what}): {free / 1e9:.1f} GB free"
        if not os.access(place, os.W_OK):
            yield "warning", f"{text}, but no right to write: choose another folder"
        elif free < _LOW_DISK:
            state: _State = "error" if free < _NO_DISK else "warning"
            yield state, f"{text}: free space, or record to another disk"
        else:
            yield "ok", text


def _memory() -> _Findings:
    total, free = rig.processes.memory_of_computer()
    if total is None:
        yield "ok", f"not known on {platform.system()}; {os.cpu_count()} processors"
        return
    text = f"{total / 1e9:.1f} GB, {os.cpu_count()} processors"
    text += "" if free is None else f", {free / 1e9:.1f} GB available"
    if total < _LOW_MEMORY:
        yield "warning", f"{text}: large images need more (24 Mpx: 2.5 GB): use smaller ones"
    elif free is not None and free < _LOW_FREE:
        yield "warning", f"{text}: close other programs"
    else:
        yield "ok", text


_CHECKS: dict[str, Callable[[], _Findings]] = {
    "versions": _versions,
    "names": _names,
    "compiler": _compiler,
    "kernels": _kernels,
    "gentl": _gentl,
    "serial": _serial,
    "rig": _rig,
    "disk": _disk,
    "memory": _memory,
}
