"""One imperfect recording: the error of its result, and what the program says about it."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields
from inspect import signature
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from acquisition import DataError, angle_deg
from benchmarks.imperfections.recordings import NAN, Recording
from benchmarks.imperfections.remedies import Remedy
from calibration import EstimateError
from processing import Reconstruction, reconstruct
from rig.arrays import Bool, Float32
from sgp.stages import with_options


@dataclass(frozen=True)
class Outcome:
    """The result of a recording.

    Parameters
    ----------
    error_deg, error_mm
        Mean angle between normals and truth, and root mean square of the error of heights without
        their mean; NaN if the truth is not known.
    change_deg
        Mean angle between these normals and those of the clean recording.
    sigma_deg
        Standard deviation of the normals with which the verdict compares.
    answer
        Answer of the verdict, or ``refused``.
    causes
        Names of the causes of the verdict, the most harmful first; each with its alternatives
        after ``/``.
    not_excluded
        Names of the causes that these images cannot show, as the verdict lists them.
    codes
        Codes of all notices.
    remedy
        The options that the remedy of the first cause names.
    remedied_deg
        Mean angle between normals and truth with these options.
    text
        Texts of the verdict's notices, or why the recording was refused.
    """

    error_deg: float = NAN
    error_mm: float = NAN
    change_deg: float = NAN
    sigma_deg: float = NAN
    answer: str = "refused"
    causes: str = ""
    not_excluded: str = ""
    codes: str = ""
    remedy: str = ""
    remedied_deg: float = NAN
    text: str = ""

    def columns(self) -> dict[str, str]:
        values = (f"{value:.4g}" if isinstance(value, float) else value for value in astuple(self))
        return dict(zip((field.name for field in fields(self)), values, strict=True))

    @classmethod
    def of(cls, columns: dict[str, str]) -> Outcome:
        """Return an outcome from its columns."""
        values = {
            field.name: float(columns[field.name]) if field.type == "float" else columns[field.name]
            for field in fields(cls)
        }
        return cls(**values)  # type: ignore[arg-type]


class Trial:
    """Reconstructions of one scene, the first of which is clean.

    Parameters
    ----------
    clean
        The clean recording.
    """

    def __init__(self, clean: Recording) -> None:
        self.clean = clean
        self._normals: Float32 | None = None
        self._valid: Bool | None = None

    def outcome(self, recording: Recording) -> Outcome:
        """Reconstruct a recording, and compare it with its truth and with the clean result."""
        try:
            result = _reconstructed(recording)
        except (DataError, EstimateError) as error:
            return Outcome(text=str(error)[:_TEXT])
        if self._normals is None:
            self._normals, self._valid = result.normals.normals, result.valid
        verdict, _ = with_options(result.verdict, ())
        remedy = Remedy.of(verdict.causes[0]) if verdict.causes else Remedy()
        return Outcome(
            error_deg=_error_deg(result, recording),
            error_mm=_error_mm(result, recording),
            change_deg=self._change_deg(result),
            sigma_deg=verdict.sigma_deg,
            answer=verdict.answer,
            causes=" ".join("/".join((one.name, *one.alternatives)) for one in verdict.causes),
            not_excluded=" ".join(verdict.not_excluded),
            codes=" ".join(sorted({notice.code for notice in result.warnings})),
            remedy=remedy.options,
            remedied_deg=_remedied_deg(recording, remedy) if remedy.options else NAN,
            text="; ".join(notice.text for notice in verdict.notices)[:_TEXT],
        )

    def _change_deg(self, result: Reconstruction) -> float:
        if self._normals is None or self._valid is None:
            return NAN
        both = result.valid & self._valid
        return _mean_angle(result.normals.normals[both], self._normals[both])


# Characters of a text that are kept.
_TEXT = 300


def _reconstructed(recording: Recording, remedy: Remedy | None = None) -> Reconstruction:
    with TemporaryDirectory() as folder:
        return recording.reconstructed(Path(folder) / "images", remedy)


def _remedied_deg(recording: Recording, remedy: Remedy) -> float:
    """Return the error with the options of a remedy; 90 if they are refused or do not exist."""
    if not remedy.keywords.keys() <= signature(reconstruct).parameters.keys():
        return 90.0
    try:
        return _error_deg(_reconstructed(recording, remedy), recording)
    except (DataError, EstimateError):
        return 90.0


def _error_deg(result: Reconstruction, recording: Recording) -> float:
    if recording.normals is None:
        return NAN
    seen = recording.mask & result.valid
    return _mean_angle(result.normals.normals[seen], recording.normals[seen])


def _error_mm(result: Reconstruction, recording: Recording) -> float:
    if recording.height_mm is None or result.surface is None or result.surface.unit != "mm":
        return NAN
    off = (result.surface.height - recording.height_mm)[recording.mask]
    return float(np.nanstd(off))


def _mean_angle(first: Float32, second: Float32) -> float:
    return float(np.mean(angle_deg(first, second))) if len(first) else NAN
