"""What is done about images that the others contradict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rig import Notice, pluralize
from rig.arrays import Float64


@dataclass(frozen=True)
class Repairs:
    """Images on another scale than stated, and images to leave out.

    Parameters
    ----------
    factors
        How many times as bright as stated the light of an image is, by its name. Such an image is
        divided by its factor, because nothing else is wrong with it.
    left_out
        Names of the images to leave out.
    reasons
        Why, in words.
    """

    factors: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    reasons: str = ""

    def scales(self, ids: Sequence[str]) -> Float64:
        """Return the factors ``(N,)`` of all images, 1 for the others."""
        return np.array([self.factors.get(name, 1.0) for name in ids])

    def kept(self, ids: Sequence[str]) -> list[int]:
        """Return the indices of the images that are not left out."""
        return [i for i, name in enumerate(ids) if name not in self.left_out]

    def notices(self) -> list[Notice]:
        """Return what is done, and why."""
        found = []
        if self.factors:
            listed = ", ".join(f"{name} ({size:.2f} times)" for name, size in self.factors.items())
            noun = pluralize(len(self.factors), "image is", "images are")
            text = f"{noun} brighter or darker than stated, and divided by a factor: {listed}"
            found.append(Notice("images-rescaled", text, ", ".join(self.factors)))
        if self.left_out:
            names = ", ".join(self.left_out)
            noun = pluralize(len(self.left_out), "image is", "images are")
            text = f"{noun} left out because the others contradict them: {names} ({self.reasons})"
            found.append(Notice("images-excluded", text, names))
        return found


def repairs_of(disagreeing: Mapping[str, float | None], reasons: str) -> Repairs:
    """Return the repairs of images that the others contradict.

    Parameters
    ----------
    disagreeing
        Names of images, with the factor of the brightness of those that are only too bright or too
        dark, and None for the others.
    reasons
        What is wrong with them, in words.
    """
    scaled = {name: factor for name, factor in disagreeing.items() if factor is not None}
    return Repairs(scaled, tuple(name for name in disagreeing if name not in scaled), reasons)
