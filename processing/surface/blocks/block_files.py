"""The files of blocks: what a process that is killed leaves, and the next one continues."""

from __future__ import annotations

import math
import zlib
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import write_durably
from acquisition.files import BandFile, DamagedMapsError
from processing.surface.blocks.plan import plan_blocks
from rig.arrays import AnyArray, Float32, Float64

Record = dict[str, AnyArray]

_WHOLE, _HEAD = slice(None), 4
_KINDS: dict[str, np.dtype[Any]] = {
    "solution": np.dtype(np.float64),
    "labels": np.dtype(np.int32),
    "flags": np.dtype(np.uint8),
    "doubt": np.dtype(np.float32),
}


class BlockFiles:
    """Solutions, parts and weights of the blocks of a surface, and a record of each step.

    A step is done if its record exists, which is written after its other files are durable. Each
    round writes the solution of a block to a new file, so that it can be repeated after a kill.

    Parameters
    ----------
    folder
        Existing folder.
    size
        Rows and columns of the image.
    rows
        Most rows of a block, as for `plan_blocks`. The steps that an earlier process completed are
        kept if its blocks are not larger.

    Raises
    ------
    DamagedMapsError
        If a file was changed or deleted after its step; also by the methods.
    """

    def __init__(self, folder: Path, size: tuple[int, int], rows: int) -> None:
        self._folder, self._width = folder, size[1]
        # Checksums of files that an earlier process wrote, and of those without a record so far.
        self._unchecked: dict[str, int] = {}
        self._fresh: dict[str, int] = {}
        plan = self.record("plan")
        if plan is None or plan["rows"] > rows:
            remove_steps(folder)
            plan = self.complete("plan", rows=rows)
        self.blocks = plan_blocks(size[0], int(plan["rows"]))
        form = (size[0], 2, size[1]), np.dtype(np.float32)
        self.weights = BandFile(folder / "weights.raw", *form)
        # Steps of a surface that jumps.
        self._steps: BandFile | None = None

    def record(self, name: str) -> Record | None:
        """Return the record of a step; None if it is not done."""
        path = self._folder / f"step-{name}.npz"
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
        if data[:_HEAD] != _head(data[_HEAD:]):
            raise DamagedMapsError(path, "was changed since it was computed")
        with np.load(BytesIO(data[_HEAD:]), allow_pickle=False) as stored:
            record = dict(stored)
        written = zip(record.pop("files"), record.pop("checksums"), strict=True)
        self._unchecked |= {str(file): int(checksum) for file, checksum in written}
        return record

    def complete(self, name: str, **record: Any) -> Record:
        """State that a step is done, and return its record as it is read back."""
        file, written = BytesIO(), self._fresh
        sums = np.array([*written.values()], np.int64)
        np.savez(file, files=np.array([*written], np.str_), checksums=sums, **record)
        data = file.getvalue()
        write_durably(self._folder / f"step-{name}.npz", _head(data) + data)
        self._fresh = {}
        return {key: np.asarray(value) for key, value in record.items()}

    def read(self, name: str, rows: slice = _WHOLE) -> AnyArray:
        """Return rows ``(h, W)`` of a map of a block.

        Parameters
        ----------
        name
            ``labels-2`` for the parts of block 2, ``solution-2-1`` for its solution after a round.
        rows
            Rows of the block.
        """
        (shape, kind), path = self._form(name), self._folder / f"{name}.raw"
        size = path.stat().st_size if path.is_file() else None
        if size != math.prod(shape) * kind.itemsize:
            what = "was deleted" if size is None else "has another size"
            raise DamagedMapsError(path, f"{what} since it was computed")
        with closing(BandFile(path, shape, kind)) as file:
            if name in self._unchecked:
                self._check(path, name, file[:])
            return file[rows]

    def write(self, name: str, values: AnyArray) -> None:
        """Write a map of a block, with a name as for `read`."""
        with closing(BandFile(self._folder / f"{name}.raw", *self._form(name))) as file:
            file[:] = values
            file.sync()
        self._fresh[name] = _checksum(values)

    def core_weights(self, number: int) -> Float32:
        """Return the weights ``(h, 2, W)`` of the core of a block."""
        weights = self.weights[self.blocks.blocks[number].core]
        self._check(self.weights.path, f"weights-{number}", weights)
        return weights

    def write_weights(self, number: int, weights: Float32) -> None:
        """Write the weights of the core of a block."""
        self.weights[self.blocks.blocks[number].core] = weights
        self.weights.sync()
        self._fresh[f"weights-{number}"] = _checksum(weights)

    def write_steps(self, number: int, steps: Float64) -> None:
        """Write the steps ``(h, 2, W)`` of the core of a block of a surface that jumps."""
        self._open_steps()[self.blocks.blocks[number].core] = steps
        self._open_steps().sync()
        self._fresh[f"steps-{number}"] = _checksum(steps)

    def edges_of_jumps(self, rows: slice) -> tuple[Float32, Float32, Float64, Float64]:
        """Return weights and steps of the edges of rows, in a border of one pixel."""
        for number, block in enumerate(self.blocks.blocks):
            if block.core.start < rows.stop and rows.start < block.core.stop:
                self.core_weights(number)
                steps = self._open_steps()
                self._check(steps.path, f"steps-{number}", steps[block.core])
        right, down = (np.pad(self.weights[rows][:, axis], 1) for axis in (0, 1))
        to_right, to_down = (np.pad(self._open_steps()[rows][:, axis], 1) for axis in (0, 1))
        return right, down, to_right, to_down

    def close_weights(self) -> None:
        """Remove weights and steps, after the last round."""
        self.weights.close()
        self.remove("weights")
        if self._steps is not None:
            self._steps.close()
            self.remove("steps")

    def _open_steps(self) -> BandFile:
        if self._steps is None:
            form = self.weights.shape, np.dtype(np.float64)
            self._steps = BandFile(self._folder / "steps.raw", *form)
        return self._steps

    def remove(self, name: str) -> None:
        """Remove a map, if it is there."""
        (self._folder / f"{name}.raw").unlink(missing_ok=True)

    def _check(self, path: Path, name: str, values: AnyArray) -> None:
        """Compare what an earlier process wrote with its checksum, once."""
        if self._unchecked.pop(name, None) not in (None, _checksum(values)):
            raise DamagedMapsError(path, "was changed since it was computed")

    def _form(self, name: str) -> tuple[tuple[int, int], np.dtype[Any]]:
        """Return shape and type of a map of a block."""
        of, number = name.split("-")[:2]
        rows = self.blocks.blocks[int(number)].rows
        return (rows.stop - rows.start, self._width), _KINDS[of]


def remove_steps(folder: Path) -> None:
    """Remove the files of all steps."""
    maps = (f"{kind}-*.raw" for kind in _KINDS)
    for pattern in ("step-*.npz", "weights.raw", "steps.raw", *maps):
        for path in folder.glob(pattern):
            path.unlink()


def _head(data: bytes) -> bytes:
    """Return the first bytes of a file of a record: their checksum."""
    return zlib.crc32(data).to_bytes(_HEAD, "little")


def _checksum(values: AnyArray) -> int:
    return zlib.crc32(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
