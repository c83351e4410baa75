"""Options of relightable images."""

from __future__ import annotations

from dataclasses import dataclass

from cyclopts import Parameter

import processing


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RelightOptions:
    """Options for fitting functions of the direction of the light.

    Parameters
    ----------
    basis
        ptm (polynomial with 6 coefficients), hsh4 or hsh9 (hemispherical harmonics with 4 or 9).
    colours
        lrgb (one function per pixel and a colour that it is multiplied by) or rgb (one function per
        channel, for coloured highlights; the files are about twice as large).
    values
        display (samples of the sRGB curve, as viewers show them) or linear (proportional to light,
        for further computation).
    """

    basis: processing.LightBasis = "ptm"
    colours: processing.RelightColours = "lrgb"
    values: processing.RelightValues = "display"
