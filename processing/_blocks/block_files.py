"""The files of blocks: what a process that is killed leaves, and the next one continues."""

from __future__ import annotations

from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from acquisition import BandFile, write_durably
from processing._blocks.plan import plan_blocks

Array = npt.NDArray[Any]
Double = npt.NDArray[np.float64]
Labels = npt.NDArray[np.int32]
Record = dict[str, Array]

_WHOLE = slice(None)


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
        Most rows of a block, as for `plan_blocks`.
    resume
        Keep the steps that an earlier process completed, and its blocks if they are not larger.
        Otherwise, all steps are removed.
    """

    def __init__(self, folder: Path, size: tuple[int, int], rows: int, *, resume: bool) -> None:
        self._folder, self._width = folder, size[1]
        plan = self.record("plan") if resume else None
        if plan is None or plan["rows"] > rows:
            self.remove()
            plan = self.complete("plan", rows=rows)
        self.blocks = plan_blocks(size[0], int(plan["rows"]))
        form = (size[0], 2, size[1]), np.dtype(np.float32)
        self.weights = BandFile(folder / "weights.raw", *form)

    def record(self, name: str) -> Record | None:
        """Return the record of a step; None if it is not done."""
        try:
            data = (self._folder / f"step-{name}.npz").read_bytes()
        except FileNotFoundError:
            return None
        with np.load(BytesIO(data), allow_pickle=False) as stored:
            return dict(stored)

    def complete(self, name: str, **record: Any) -> Record:
        """State that a step is done, and return its record as it is read back."""
        data = BytesIO()
        np.savez(data, **record)
        write_durably(self._folder / f"step-{name}.npz", data.getbuffer())
        return {key: np.asarray(value) for key, value in record.items()}

    def solution(self, number: int, after: int, rows: slice = _WHOLE) -> Double:
        """Return rows ``(h, W)`` of the solution of a block after some rounds."""
        with closing(self._solution(number, after)) as file:
            return np.asarray(file[rows], np.float64)

    def write_solution(self, number: int, after: int, u: Double) -> None:
        """Write the solution of a block after some rounds."""
        with closing(self._solution(number, after)) as file:
            file[:] = u
            file.sync()

    def remove_solution(self, number: int, after: int) -> None:
        """Remove the solution of a block after some rounds, if it is there."""
        self._path(f"solution-{number}-{after}").unlink(missing_ok=True)

    def labels(self, number: int, rows: slice = _WHOLE) -> Labels:
        """Return rows ``(h, W)`` of the parts of a block."""
        with closing(self._labels(number)) as file:
            return np.asarray(file[rows], np.int32)

    def write_labels(self, number: int, labels: Labels) -> None:
        """Write the parts of a block."""
        with closing(self._labels(number)) as file:
            file[:] = labels
            file.sync()

    def remove_weights(self) -> None:
        """Remove the weights, after the last round."""
        self.weights.close()
        self.weights.path.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the files of all steps."""
        for pattern in ("step-*.npz", "solution-*.raw", "labels-*.raw", "weights.raw"):
            for path in self._folder.glob(pattern):
                path.unlink()

    def _solution(self, number: int, after: int) -> BandFile:
        return self._file(f"solution-{number}-{after}", number, np.dtype(np.float64))

    def _labels(self, number: int) -> BandFile:
        return self._file(f"labels-{number}", number, np.dtype(np.int32))

    def _file(self, name: str, number: int, kind: np.dtype[Any]) -> BandFile:
        rows = self.blocks.blocks[number].rows
        return BandFile(self._path(name), (rows.stop - rows.start, self._width), kind)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.raw"
