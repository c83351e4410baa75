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
from rig.arrays import AnyArray, Float32, Float64, Int32

Record = dict[str, AnyArray]

_WHOLE, _HEAD = slice(None), 4
_SOLUTION, _LABELS = np.dtype(np.float64), np.dtype(np.int32)


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
            self.remove(folder)
            plan = self.complete("plan", rows=rows)
        self.blocks = plan_blocks(size[0], int(plan["rows"]))
        form = (size[0], 2, size[1]), np.dtype(np.float32)
        self.weights = BandFile(folder / "weights.raw", *form)

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

    def solution(self, number: int, after: int, rows: slice = _WHOLE) -> Float64:
        """Return rows ``(h, W)`` of the solution of a block after some rounds."""
        return self._read(f"solution-{number}-{after}", number, _SOLUTION, rows)

    def write_solution(self, number: int, after: int, u: Float64) -> None:
        """Write the solution of a block after some rounds."""
        self._write(f"solution-{number}-{after}", number, np.asarray(u, _SOLUTION))

    def remove_solution(self, number: int, after: int) -> None:
        """Remove the solution of a block after some rounds, if it is there."""
        self._path(f"solution-{number}-{after}").unlink(missing_ok=True)

    def labels(self, number: int, rows: slice = _WHOLE) -> Int32:
        """Return rows ``(h, W)`` of the parts of a block."""
        return self._read(f"labels-{number}", number, _LABELS, rows)

    def write_labels(self, number: int, labels: Int32) -> None:
        """Write the parts of a block."""
        self._write(f"labels-{number}", number, np.asarray(labels, _LABELS))

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

    def remove_weights(self) -> None:
        """Remove the weights, after the last round."""
        self.weights.close()
        self.weights.path.unlink(missing_ok=True)

    @staticmethod
    def remove(folder: Path) -> None:
        """Remove the files of all steps."""
        for pattern in ("step-*.npz", "solution-*.raw", "labels-*.raw", "weights.raw"):
            for path in folder.glob(pattern):
                path.unlink()

    def _read(self, name: str, number: int, kind: np.dtype[Any], rows: slice) -> AnyArray:
        form, path = self._form(number), self._path(name)
        size = path.stat().st_size if path.is_file() else None
        if size != math.prod(form) * kind.itemsize:
            what = "was deleted" if size is None else "has another size"
            raise DamagedMapsError(path, f"{what} since it was computed")
        with closing(BandFile(path, form, kind)) as file:
            if name in self._unchecked:
                self._check(path, name, file[:])
            return file[rows]

    def _write(self, name: str, number: int, values: AnyArray) -> None:
        with closing(BandFile(self._path(name), self._form(number), values.dtype)) as file:
            file[:] = values
            file.sync()
        self._fresh[name] = _checksum(values)

    def _check(self, path: Path, name: str, values: AnyArray) -> None:
        """Compare what an earlier process wrote with its checksum, once."""
        if self._unchecked.pop(name, None) not in (None, _checksum(values)):
            raise DamagedMapsError(path, "was changed since it was computed")

    def _form(self, number: int) -> tuple[int, int]:
        rows = self.blocks.blocks[number].rows
        return rows.stop - rows.start, self._width

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.raw"


def _head(data: bytes) -> bytes:
    """Return the first bytes of a file of a record: their checksum."""
    return zlib.crc32(data).to_bytes(_HEAD, "little")


def _checksum(values: AnyArray) -> int:
    return zlib.crc32(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
