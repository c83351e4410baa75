"""Synthesis of sheets of detail that are larger than memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import replace as changed
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import BandStore, MapRows
from processing._normal_map import NormalMap, check_normal_map
from processing._synthesis.exemplar import CLASSES
from processing._synthesis.quilting import Quilt
from processing._synthesis.seam_steps import CutSteps, cut_steps, part_in_middle
from processing._synthesis.softened_cuts import softened_bands, softening_share
from processing._synthesis.spectrum_match import KERNEL, filtered_bands, matching_kernel
from processing._synthesis.strips import CORRECTED_ROWS, Begun
from rig import Progress, no_progress

Form = tuple[tuple[int, ...], type[np.generic]]


@dataclass(frozen=True, eq=False)
class StoredSynthesis:
    """A synthesised detail component that is larger than memory.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors, known everywhere, whose rows are read on request.
    labels
        ``(H, W)`` uint8 as in `Synthesis`, whose rows are read on request.
    patch, overlap, tileable
        As in `Synthesis`.
    store
        The files of the maps, which `BandStore.remove` deletes.
    """

    normals: MapRows
    labels: MapRows
    patch: int
    overlap: int
    tileable: bool
    store: BandStore

    def __repr__(self) -> str:
        height, width = self.labels.shape
        return f"StoredSynthesis({width} x {height} px, patch={self.patch}, overlap={self.overlap})"

    @property
    def steps(self) -> CutSteps:
        """As in `Synthesis`."""
        return cut_steps(self.normals, self.labels, wrapped=self.tileable)

    def middle(self) -> NormalMap:
        """Return the part in the middle that `texture_figures` measures."""
        part: npt.NDArray[np.float32] = part_in_middle(self.normals)
        return NormalMap(part, np.ones(part.shape[:2], np.bool_))


def synthesize_on_disk(
    exemplar: NormalMap,
    size: tuple[int, int],
    path: Path,
    *,
    identity: Mapping[str, object],
    replace: bool = False,
    patch: int = 48,
    overlap: int | None = None,
    seed: int = 0,
    rotate: bool = False,
    mirror: bool = False,
    tileable: bool = False,
    on_progress: Progress = no_progress,
) -> StoredSynthesis:
    """Continue a detail component over a sheet as `synthesize` does, with the sheet in files.

    The values are those of `synthesize`. Strips of 16 rows of patches, and bands of corrected
    rows, that are on the disk are not computed again if the process is killed and the function is
    called with the same identity. The memory is that of `least_memory_of_synthesis`.

    Parameters
    ----------
    exemplar, size, patch, overlap, seed, rotate, mirror, tileable
        As for `synthesize`.
    path
        Future result. The maps are in a hidden folder next to it, see `BandStore`, until the
        caller removes them.
    identity
        What the result depends on, see `BandStore`.
    replace
        Begin again if there are maps of another identity.
    on_progress
        Receives the stages ``preparing`` and ``synthesising``, the latter with numbers of patches,
        and ``correcting``, in rows.

    Raises
    ------
    DataError
        As `synthesize` and `BandStore`.
    StorageError
        If the disk refuses a write; what is complete stays.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap, synthesize_on_disk
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(64, 64, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> synthesize_on_disk(rough, (100, 150), Path("sheet/map"), identity={}, patch=16)
    StoredSynthesis(150 x 100 px, patch=16, overlap=4)
    """
    check_normal_map("exemplar", exemplar)
    quilt = Quilt.of(
        exemplar, size, patch, overlap, seed, rotate=rotate, mirror=mirror, tileable=tileable,
        on_progress=on_progress,
    )  # fmt: skip
    sheet = _Sheet(quilt)
    store = BandStore(path, identity, sheet.forms, replace=replace, units=sheet.units)
    with store.filling():
        sheet.quilt(store, on_progress)
        sheet.correct(store, exemplar, on_progress)
    return StoredSynthesis(store["sheet"], store["labels"], patch, quilt.overlap, tileable, store)


class _Sheet:
    """The steps of a sheet in files: strips, the share of cuts, softening, the filter, filtering.

    Softened rows are written to another file than that of the patches, and filtered rows back to
    the first, so that a step can be repeated.
    """

    def __init__(self, quilt: Quilt) -> None:
        self._quilt, self._strips = quilt, len(quilt.strips)
        self._bands = -(-quilt.size[0] // CORRECTED_ROWS)

    @property
    def units(self) -> int:
        """Number of steps."""
        return self._strips + 2 * (1 + self._bands)

    @property
    def forms(self) -> dict[str, Form]:
        """Shapes and types of the maps."""
        (height, width), patch = self._quilt.size, self._quilt.patch
        vectors = (height, width, 3), np.float32
        # What the next strip begins with, for even and odd strips, then the sheet's upper rows.
        edges = 3 * patch, width
        return {
            "sheet": vectors,
            "softened": vectors,
            "labels": ((height, width), np.uint8),
            "edges": ((*edges, 3), np.float32),
            "edge_labels": (edges, np.uint8),
            # After each strip: number of patches, and uses of classes.
            "uses": ((self._strips, 1 + CLASSES), np.float64),
            "share": ((1,), np.float64),
            # The first row is 0 without a filter.
            "kernel": ((KERNEL[0] + 1, KERNEL[1]), np.float32),
        }

    def quilt(self, store: BandStore, on_progress: Progress) -> None:
        """Place the patches of the strips that are missing."""
        begun = self._begun(store, min(_complete(store), self._strips))
        if begun.strips == self._strips:
            return
        for after in self._quilt.fill(store["sheet"], store["labels"], begun, on_progress):
            strip = after.strips - 1
            if not strip:
                self._write_edge(store, 2, after.upper, after.upper_labels)
            self._write_edge(store, strip % 2, after.normals, after.labels)
            state = np.zeros((1, 1 + CLASSES))
            state[0, 0], state[0, 1 : 1 + len(after.uses)] = after.placed, after.uses
            store["uses"][strip : strip + 1] = state
            store.complete(slice(strip, strip + 1))

    def _begun(self, store: BandStore, strips: int) -> Begun:
        nothing = self._quilt.nothing()
        if not strips or strips == self._strips:
            return changed(nothing, strips=strips)
        state = store["uses"][strips - 1 : strips][0]
        before = self._quilt.strips[strips - 1]
        rows = before.rows - before.done
        upper = min(self._quilt.patch, self._quilt.strips[0].done)
        return Begun(
            strips,
            state[1 : 1 + len(nothing.uses)],
            int(state[0]),
            *self._edge(store, (strips - 1) % 2, rows),
            *self._edge(store, 2, upper),
        )

    def _edge(
        self, store: BandStore, slot: int, rows: int
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint8]]:
        part = slice(slot * self._quilt.patch, slot * self._quilt.patch + rows)
        return store["edges"][part], store["edge_labels"][part]

    def _write_edge(
        self,
        store: BandStore,
        slot: int,
        normals: npt.NDArray[np.float32],
        labels: npt.NDArray[np.uint8],
    ) -> None:
        first = slot * self._quilt.patch
        part = slice(first, first + len(labels))
        store["edges"][part], store["edge_labels"][part] = normals, labels

    def correct(self, store: BandStore, exemplar: NormalMap, on_progress: Progress) -> None:
        """Soften the cuts and filter the sheet, as far as this is missing."""
        wrapped, height = self._quilt.tileable, self._quilt.size[0]
        sheet, softened, labels = store["sheet"], store["softened"], store["labels"]
        done = _complete(store) - self._strips
        on_progress("correcting", self._rows(done), 2 * height)
        if done < 1:
            store["share"][0:1] = softening_share(sheet, labels)
            done = self._count(store, done)
        share = float(store["share"][:][0])
        if done < 1 + self._bands:
            # A share of 0 copies the rows.
            for rows, band in softened_bands(sheet, labels, share, wrapped=wrapped, begin=done - 1):
                softened[rows] = band if share else sheet[rows]
                done = self._count(store, done)
                on_progress("correcting", self._rows(done), 2 * height)
        if done < 2 + self._bands:
            kernel = matching_kernel(softened, exemplar)
            found = np.zeros((KERNEL[0] + 1, KERNEL[1]), np.float32)
            if kernel is not None:
                found[0], found[1:] = 1, kernel
            store["kernel"][:] = found
            done = self._count(store, done)
        kernel = store["kernel"][:]
        begin = done - 2 - self._bands
        if begin == self._bands:
            return
        if not kernel[0, 0]:
            bands = (slice(top, top + CORRECTED_ROWS) for top in range(0, height, CORRECTED_ROWS))
            for rows in list(bands)[begin:]:
                sheet[rows] = softened[rows]
                done = self._count(store, done)
            return
        for rows, band in filtered_bands(softened, kernel[1:], wrapped=wrapped, begin=begin):
            sheet[rows] = band
            done = self._count(store, done)
            on_progress("correcting", self._rows(done), 2 * height)

    def _count(self, store: BandStore, done: int) -> int:
        """Name one more step after the strips in the journal, and return how many are complete."""
        store.complete(slice(self._strips + done, self._strips + done + 1))
        return done + 1

    def _rows(self, done: int) -> int:
        """Return the rows that are corrected after some steps."""
        softened, filtered = done - 1, done - 2 - self._bands
        height = self._quilt.size[0]
        return sum(
            min(max(bands, 0) * CORRECTED_ROWS, height)
            for bands in (min(softened, self._bands), filtered)
        )


def _complete(store: BandStore) -> int:
    """Return the number of steps that are complete; each follows the one before."""
    missing = store.missing()
    return missing[0].start if missing else max((rows.stop for rows in store.done), default=0)
