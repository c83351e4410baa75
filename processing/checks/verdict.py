"""What is probably wrong with a recording, what it does to the result, and one verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from processing.checks import limits
from processing.checks.causes import KINDS
from rig import Notice, Severity, figure

Answer = Literal["good", "check", "do-not-use"]

# Error of a pixel without a normal.
MISSING_DEG = 90.0


@dataclass(frozen=True)
class Cause:
    """Something that is probably wrong with a recording.

    Parameters
    ----------
    name
        Its name, which is also the code of its notice: ``ambient-light``.
    text
        What is wrong, with its size: "room light reaches 15 +- 0.6 % of the albedo".
    size
        How much, in `unit`; NaN if the cause has no size.
    unit
        Unit of the size.
    sigma
        Standard deviation of the size, in `unit`; NaN if it is not known.
    normals_deg
        How much it changes the normals: root mean square over the object, in degrees. NaN if it
        is not known; 90 if it leaves none, as a pixel without a normal counts elsewhere.
    height_mm
        How much it changes the heights, likewise in mm; NaN if it is not known.
    remedy
        What to do about it: "repeat in the dark, or give --ambient estimate".
    inverts
        Whether it inverts the relief.
    alternatives
        Names of other causes that explain the images nearly as well.
    where
        The images that it is about; empty for all.
    share
        Share 0..1 of the squared residual that it explains; NaN if it is not known.
    """

    name: str
    text: str
    size: float = math.nan
    unit: str = ""
    sigma: float = math.nan
    normals_deg: float = math.nan
    height_mm: float = math.nan
    remedy: str = ""
    inverts: bool = False
    alternatives: tuple[str, ...] = ()
    where: str = ""
    share: float = math.nan

    @property
    def effect(self) -> str:
        """What it does to the result, in words; empty if that is not known."""
        effects = []
        if self.normals_deg == MISSING_DEG:
            effects.append("too few images for normals")
        elif math.isfinite(self.normals_deg):
            effects.append(f"normals change by {figure(self.normals_deg)} deg")
        if math.isfinite(self.height_mm):
            effects.append(f"heights change by {figure(self.height_mm)} mm")
        if self.inverts:
            effects.append("the relief is inverted")
        return ", ".join(effects)

    @property
    def described(self) -> str:
        """What is wrong, other causes that would explain it, and the effect."""
        others = [KINDS[name].noun if name in KINDS else name for name in self.alternatives]
        besides = f", or {' or '.join(others)}" if others else ""
        effect = f" ({self.effect})" if self.effect else ""
        return f"{self.text}{besides}{effect}"

    def forbids(self, least_deg: float) -> bool:
        """Return whether it changes normals by more than this and explains much of the residual."""
        return self.normals_deg > least_deg and not self.share <= limits.LARGE_SHARE

    def matters(self, least_deg: float) -> bool:
        """Return whether it changes normals by more than this, or by an unknown angle.

        Standard deviations follow from the residual: those of a cause of which much of it comes
        are no excuse.
        """
        if self.share > limits.LARGE_SHARE:
            least_deg = limits.LARGE_SHARE_DEG
        return self.inverts or not self.normals_deg <= least_deg


@dataclass(frozen=True)
class Verdict:
    """Whether the results of a recording can be used.

    Parameters
    ----------
    causes
        What is probably wrong, the most harmful first.
    sigma_deg
        Stated standard deviation of the normals: the median, in degrees.
    residual
        Share of the signal that neither the result nor the causes explain.
    noise
        The same share for the best three images whose combinations are all others.
    unexplained_deg
        How much the residual may change the normals, in degrees.
    tried
        Names of the causes that were tried.
    not_excluded
        Names of the causes that these images cannot show.
    least
        Smallest sizes that would have been seen, by the name of the cause, with units.
    """

    causes: tuple[Cause, ...]
    sigma_deg: float
    residual: float
    noise: float
    unexplained_deg: float = 0.0
    tried: tuple[str, ...] = ()
    not_excluded: tuple[str, ...] = ()
    least: Mapping[str, str] = field(default_factory=dict)

    @property
    def answer(self) -> Answer:
        """``good``, ``check``, or ``do-not-use``.

        Examples
        --------
        >>> from processing.checks import Verdict
        >>> Verdict((), sigma_deg=0.3, residual=0.02, noise=0.02).answer
        'good'
        >>> Verdict((), sigma_deg=0.3, residual=0.2, noise=0.02, unexplained_deg=2).answer
        'check'
        """
        forbids = max(limits.FORBIDS_DEG, limits.FORBIDS_SIGMAS * self._sigma_deg)
        if any(cause.inverts or cause.forbids(forbids) for cause in self.causes):
            return "do-not-use"
        return "check" if self.harmful or self._is_unexplained else "good"

    @property
    def matters_deg(self) -> float:
        """The change of normals, in degrees, that a good result does not exceed."""
        largest = min(self._sigma_deg, limits.LARGEST_OF_CAUSES_DEG)
        return max(limits.MATTERS_DEG, limits.MATTERS_SIGMAS * largest)

    @property
    def _is_unexplained(self) -> bool:
        matters = max(limits.MATTERS_DEG, limits.MATTERS_SIGMAS * self._sigma_deg)
        return self.unexplained_deg > matters

    @property
    def _sigma_deg(self) -> float:
        return min(self.sigma_deg, limits.LARGEST_SIGMA_DEG)

    @property
    def harmful(self) -> tuple[Cause, ...]:
        """The causes that change the normals by more, or by an unknown angle."""
        return tuple(cause for cause in self.causes if cause.matters(self.matters_deg))

    @property
    def notices(self) -> tuple[Notice, ...]:
        """The causes and an unexplained residual, for people."""
        matters = self.matters_deg
        found = [_notice(cause, matters) for cause in self.causes]
        if self._is_unexplained:
            text = (
                f"a residual of {self.residual:.1%} of the signal is not explained: no cause found "
                f"among {', '.join(self.tried)}"
            )
            found.append(Notice("residual-unexplained", text))
        return tuple(found)


def _notice(cause: Cause, matters: float) -> Notice:
    text = "; ".join(filter(None, (cause.described, cause.remedy)))
    severity: Severity = "warning" if cause.matters(matters) else "info"
    return Notice(cause.name, text, cause.where, severity)
