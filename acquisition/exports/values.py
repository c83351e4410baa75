"""Sample values of an export: as recorded, or linear between black and white level."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from acquisition.source.linear_frames import Linearizer
from acquisition.source.recording_json import Values
from acquisition.source.source import Frame, Source
from acquisition.values.transfer_curve import LINEAR, TransferCurve
from rig import Notice
from rig.arrays import Float32, UInt16

_FULL = 65535


class Samples:
    """Converts the frames of a session to the values that are written.

    Parameters
    ----------
    source
        Session as a source, with upright frames.
    values
        ``raw`` or ``linear``.
    """

    def __init__(self, source: Source, values: Values) -> None:
        self.values = values
        self._source = source
        self._linear = Linearizer(source)

    def whole_numbers(self, frame: Frame) -> UInt16:
        """Return the samples of a 16-bit image; if linear, white and saturated ones are 65535."""
        if self.values == "raw":
            return frame.read().astype(np.uint16)
        signal, saturated = self._linear.signal_and_saturation(frame)
        signal[saturated] = 1.0
        return np.rint(np.clip(signal, 0, 1) * _FULL).astype(np.uint16)

    def floats(self, frame: Frame) -> Float32:
        """Return the samples of a float image; if linear, white is 1 and nothing is clipped."""
        if self.values == "raw":
            return frame.read().astype(np.float32)
        return self._linear.signal(frame)

    def levels(self, layout: str, bit_depth: int) -> dict[str, Any]:
        """Return bit depth, black and white level of the written values, for `CameraRecord`.

        ``bit_depth`` is the bit depth of the session.
        """
        if self.values == "raw":
            return {
                "bit_depth": bit_depth,
                "black_level_dn": self._source.black_level,
                "white_level_dn": self._source.white_level,
            }
        return {"bit_depth": 16, "white_level_dn": 1.0 if layout == "exr" else float(_FULL)}

    @property
    def transfer(self) -> TransferCurve:
        """The transfer curve of the written values."""
        return self._source.transfer if self.values == "raw" else LINEAR

    def subtracted(self, frames: Sequence[Frame]) -> str:
        """Return a text that names what is subtracted from the frames."""
        if self.values == "raw":
            return "nothing"
        names = {self._linear.reference(frame.exposure_us) for frame in frames}
        return " or ".join(sorted(f"{name} frames" if name else "black level" for name in names))

    def warnings(self, frames: Sequence[Frame]) -> list[Notice]:
        """Return warnings for programs that take the values as proportional to light."""
        source = self._source
        kept = []
        if self.transfer != LINEAR:
            text = (
                f"the values are raw and follow the transfer curve of the session "
                f"({self.transfer.name}): export linear values to remove it"
            )
            kept.append(Notice("transfer-curve-kept", text))
        if self.values == "raw" and source.black_level > 0:
            text = (
                f"the values are raw, with a black level of {source.black_level:g}: "
                "export linear values to subtract it"
            )
            kept.append(Notice("black-level-kept", text))
        if self.values == "linear" and self.subtracted(frames) == "black level":
            text = "no dark frames of these exposures: the black level is subtracted instead"
            kept.append(Notice("dark-frames-missing", text))
        return kept
