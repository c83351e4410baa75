"""A disk that loses what was not flushed when the power fails.

Files are real, so that the code under test reads them as always. Every change of them is also noted
in a model of what is certain to be on the disk: the content of a file up to its last fsync, and the
names of a folder up to its last fsync. After `power_loss` the files are those of one of the states
that the model allows: of the later writes any part, the last of them torn or ending in zeros, and
of the later names of each folder the first ones.
"""

from __future__ import annotations

import errno
import os
import random
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

DiskFault = Literal["full", "read-only", "flush-fails", "slow", "short-write"]
# Share of the last writes that are torn; share of these whose missing part has zeros.
_TORN, _ZEROS = 0.7, 0.4


@dataclass(eq=False)
class _Node:
    """A file or folder."""

    is_folder: bool
    # Of a file: all of it, what is certain, and the changes since then.
    content: bytearray = field(default_factory=bytearray)
    certain: bytes = b""
    writes: list[tuple[int, bytes]] = field(default_factory=list)
    # Of a folder: its names now, and those that are certain.
    names: dict[str, _Node] = field(default_factory=dict)
    certain_names: dict[str, _Node] = field(default_factory=dict)


@dataclass(eq=False)
class _Change:
    """A change of names that is not certain yet; it happens in all its folders or in none."""

    parts: list[tuple[_Node, str, _Node | None]]


class Disk:
    """The changes of files below one folder, as `rig.host.filesystem` has them.

    Parameters
    ----------
    root
        Existing empty folder.
    generator
        Chooses what a power loss leaves.
    step
        Called before each change with its name; may raise.
    pause
        Lets time pass, in seconds.
    program
        Returns the program that runs now; one with a true ``dead`` has no open files.
    """

    def __init__(
        self,
        root: Path,
        generator: random.Random,
        step: Callable[[str], None],
        pause: Callable[[float], None],
        program: Callable[[], object] = lambda: None,
    ) -> None:
        self.root = root
        self._random = generator
        self._step = step
        self._pause = pause
        self._program = program
        self._top = _Node(True)
        self._changes: list[_Change] = []
        self._open: dict[int, tuple[_Node, os.stat_result, object]] = {}
        self.faults: dict[DiskFault, float] = {}
        self.replaced: list[str] = []  # files of frames that are another frame now

    def repair(self) -> bool:
        """End all faults; return whether the disk was full, or nearly so."""
        was_full = "full" in self.faults
        self.faults.clear()
        return was_full

    def open_file(self, path: str | Path, flags: int, mode: int = 0o777) -> int:
        """As `os.open`."""
        changes = bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        self._step(f"open {Path(path).name if self._holds(path) else 'a path outside'}")
        self.close_all(of_dead=True)
        if changes:
            self._refuse(path)
        known = self._node(path)
        descriptor = os.open(path, flags, mode)
        if changes and known is None and self._holds(path):
            known = _Node(False)
            self._change((path, known))
        if known is not None and (changes or known.is_folder):
            self._open[descriptor] = known, os.fstat(descriptor), self._program()
        else:
            self._open.pop(descriptor, None)
        return descriptor

    def close(self, descriptor: int) -> None:
        """As `os.close`."""
        self._step("close")
        self._open.pop(descriptor, None)
        os.close(descriptor)

    def write(self, descriptor: int, data: bytes | memoryview) -> int:
        """As `os.write`."""
        node, *_ = self._open.get(descriptor, (None,))
        at = len(node.content) if node is not None else 0
        return self._write(descriptor, bytes(data), at, os.write)

    def write_at(self, descriptor: int, data: bytes | memoryview, offset: int) -> int:
        """As `os.pwrite`."""
        return self._write(
            descriptor, bytes(data), offset, lambda to, piece: os.pwrite(to, piece, offset)
        )

    def fsync(self, descriptor: int) -> None:
        """As `os.fsync`."""
        self._step("fsync")
        if seconds := self.faults.pop("slow", 0):
            self._pause(seconds)
            self._step("fsync ends")
        if self.faults.pop("flush-fails", None) is not None:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        node, *_ = self._open.get(descriptor, (None,))
        if node is None:
            return
        node.certain, node.writes = bytes(node.content), []
        if node.is_folder:
            self._make_certain(node)

    def replace(self, path: str | Path, target: str | Path) -> None:
        """As `os.replace`."""
        self._step(f"rename to {Path(target).name}")
        self._refuse(target)
        os.replace(path, target)
        node, other = self._node(path), self._node(target)
        if node and other and Path(target).parent.name == "frames":
            self.replaced.append(Path(target).name)
        if node is not None:
            self._change((path, None), (target, node))

    rename = replace

    def unlink(self, path: str | Path) -> None:
        """As `os.unlink`."""
        self._step(f"unlink {Path(path).name}")
        self._refuse(path)
        os.unlink(path)
        self._change((path, None))

    rmdir = unlink

    def mkdir(self, path: str | Path, mode: int = 0o777) -> None:
        """As `os.mkdir`."""
        self._step(f"mkdir {Path(path).name}")
        self._refuse(path)
        os.mkdir(path, mode)
        self._change((path, _Node(True)))

    def close_all(self, *, of_dead: bool = False) -> None:
        """Close what programs, or only dead ones, have left open, as the operating system does."""
        for descriptor, (_, opened, program) in list(self._open.items()):
            if of_dead and not getattr(program, "dead", False):
                continue
            del self._open[descriptor]
            # A reader may have closed it without this class, and the number may be in use again.
            with suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), opened):
                    os.close(descriptor)

    def power_loss(self) -> None:
        """Leave only what is certain, and some of what is not."""
        last = {id(folder): 0 for change in self._changes for folder, _, _ in change.parts}
        for key in last:
            mine = [c for c in self._changes if any(id(f) == key for f, _, _ in c.parts)]
            last[key] = self._random.randint(0, len(mine))
        kept: list[_Change] = []
        for change in self._changes:
            if all(last[id(folder)] > 0 for folder, _, _ in change.parts):
                kept.append(change)
                for folder, _, _ in change.parts:
                    last[id(folder)] -= 1
            else:  # and no later one in these folders
                for folder, _, _ in change.parts:
                    last[id(folder)] = 0
        for change in kept:
            _apply(change, certain=True)
        self._changes.clear()
        for name in list(os.listdir(self.root)):
            path = self.root / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        self._restore(self._top, self.root)

    def shown(self) -> dict[str, bytes | None]:
        """Return the content of all files by path as the model has them; None for folders."""
        return dict(self._shown(self._top, ""))

    def _shown(self, node: _Node, prefix: str) -> list[tuple[str, bytes | None]]:
        found: list[tuple[str, bytes | None]] = []
        for name, child in node.names.items():
            path = f"{prefix}{name}"
            if child.is_folder:
                found += [(path, None), *self._shown(child, f"{path}/")]
            else:
                found.append((path, bytes(child.content)))
        return found

    def rot(self, path: Path, at: int) -> None:
        """Change one byte of a file on the disk."""
        node = self._node(path)
        if node is None or not node.content:
            return
        at %= len(node.content)
        node.content[at] ^= 0x10
        node.certain = bytes(node.content)
        path.write_bytes(node.content)

    def lose(self, path: Path) -> None:
        """Remove a file, as the check of a damaged file system does."""
        folder = self._node(path.parent)
        if folder is not None and self._node(path) is not None:
            self._make_certain(folder)
            _apply(_Change([(folder, path.name, None)]), certain=False)
            _apply(_Change([(folder, path.name, None)]), certain=True)
            path.unlink()

    def _write(
        self, descriptor: int, data: bytes, at: int, call: Callable[[int, bytes], int]
    ) -> int:
        self._step(f"write {len(data)} bytes")
        self._refuse("")
        if self.faults.pop("short-write", None) is not None and len(data) > 1:
            data = data[: self._random.randint(1, len(data) - 1)]
        if "full" in self.faults:
            room = int(self.faults["full"])
            if room <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            data = data[:room]
            self.faults["full"] = room - len(data)
        done = call(descriptor, data)
        node, *_ = self._open.get(descriptor, (None,))
        if node is not None:
            node.content[at : at + done] = data[:done]
            node.writes.append((at, data[:done]))
        return done

    def _refuse(self, path: str | Path) -> None:
        if "read-only" in self.faults:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path) or None)

    def _holds(self, path: str | Path) -> bool:
        return self.root in Path(os.path.abspath(path)).parents

    def _node(self, path: str | Path) -> _Node | None:
        full = Path(os.path.abspath(path))
        if full == self.root:
            return self._top
        if self.root not in full.parents:
            return None
        node: _Node | None = self._top
        for name in full.relative_to(self.root).parts:
            node = node.names.get(name) if node is not None else None
        return node

    def _change(self, *parts: tuple[str | Path, _Node | None]) -> None:
        found = []
        for path, node in parts:
            full = Path(os.path.abspath(path))
            folder = self._node(full.parent)
            if folder is not None:
                found.append((folder, full.name, node))
        change = _Change(found)
        _apply(change, certain=False)
        self._changes.append(change)

    def _make_certain(self, folder: _Node) -> None:
        """Make the changes in a folder certain, and the earlier ones in their other folders."""
        folders = {id(folder)}
        left: list[_Change] = []
        certain: list[_Change] = []
        for change in reversed(self._changes):
            if any(id(one) in folders for one, _, _ in change.parts):
                folders |= {id(one) for one, _, _ in change.parts}
                certain.append(change)
            else:
                left.append(change)
        for change in reversed(certain):
            _apply(change, certain=True)
        self._changes = left[::-1]

    def _restore(self, node: _Node, path: Path) -> None:
        node.names = dict(node.certain_names)
        for name, child in node.names.items():
            if child.is_folder:
                (path / name).mkdir()
                self._restore(child, path / name)
            else:
                child.content = bytearray(child.certain)
                self._keep_some(child)
                child.certain, child.writes = bytes(child.content), []
                (path / name).write_bytes(child.content)

    def _keep_some(self, node: _Node) -> None:
        """Write some of the writes that were not flushed."""
        kept = self._random.randint(0, len(node.writes))
        for number, (at, data) in enumerate(node.writes[:kept]):
            piece = data
            if number == kept - 1 and self._random.random() < _TORN:
                end = self._random.choice((self._random.randint(0, len(data)), len(data) - 1))
                piece = data[:end]
                if self._random.random() < _ZEROS:  # the size is certain before the content
                    piece += bytes(len(data) - end)
            node.content[at : at + len(piece)] = piece


def _apply(change: _Change, *, certain: bool) -> None:
    for folder, name, node in change.parts:
        names = folder.certain_names if certain else folder.names
        if node is None:
            names.pop(name, None)
        else:
            names[name] = node
