"""The synthesisers of sheets, by name, and what they have in common."""

from __future__ import annotations

from typing import Literal, Protocol

from processing.maps.normal_map import NormalMap
from processing.synthesis.pixel_synthesis import efros_leung
from processing.synthesis.sheet_synthesis import Synthesis, synthesize
from rig import Progress

SynthesisMethod = Literal["quilting", "efros-leung"]


class Synthesizer(Protocol):
    """A function that continues a detail component over a sheet.

    The sheet is known everywhere, its vectors have length 1, and the same arguments give the same
    sheet. It raises `DataError` for an exemplar that it cannot continue and for numbers out of
    range, and reports its progress at least once.
    """

    def __call__(
        self,
        exemplar: NormalMap,
        size: tuple[int, int],
        /,
        *,
        patch: int = ...,
        seed: int = 0,
        on_progress: Progress = ...,
    ) -> Synthesis:
        """Return the sheet and its quality."""


SYNTHESIZERS: dict[SynthesisMethod, Synthesizer] = {
    "quilting": synthesize,
    "efros-leung": efros_leung,
}
