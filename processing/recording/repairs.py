"""What is done about images that the others contradict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from processing.checks.scheme_check import SchemeCheck
from rig import Notice, pluralize
from rig.arrays import Float64


@dataclass(frozen=True)
class Repairs:
    """Images on another scale than stated, and images to leave out.

    Parameters
    ----------
    factors
        How many times as bright as stated the light of an image is, by its index. Such an image is
        divided by its factor, because nothing else is wrong with it.
    left_out
        Indices of the images to leave out, each with the reason.
    """

    factors: Mapping[int, float] = field(default_factory=dict)
    left_out: Mapping[int, str] = field(default_factory=dict)

    def scales(self, count: int) -> Float64:
        """Return the factors ``(count,)`` of all images, 1 for the others."""
        scales = np.ones(count)
        scales[list(self.factors)] = list(self.factors.values())
        return scales

    def kept(self, count: int) -> list[int]:
        """Return the images of ``count`` that are not left out."""
        return [i for i in range(count) if i not in self.left_out]

    def notices(self, ids: Sequence[str]) -> list[Notice]:
        """Return what is done, and why."""
        found = []
        if self.factors:
            listed = ", ".join(f"{ids[i]} ({size:.2f} times)" for i, size in self._in_order())
            noun = pluralize(len(self.factors), "image is", "images are")
            text = f"{noun} brighter or darker than stated, and divided by a factor: {listed}"
            found.append(Notice("images-rescaled", text, ", ".join(ids[i] for i in self.factors)))
        if self.left_out:
            listed = ", ".join(f"{ids[i]} ({why})" for i, why in self.left_out.items())
            noun = pluralize(len(self.left_out), "image is", "images are")
            text = f"{noun} left out because the others contradict them: {listed}"
            found.append(Notice("images-excluded", text, ", ".join(ids[i] for i in self.left_out)))
        return found

    def _in_order(self) -> list[tuple[int, float]]:
        return sorted(self.factors.items())


def repairs_of(check: SchemeCheck) -> Repairs:
    """Return the repairs of what a comparison found; none if it is not known what is right."""
    if check.undecided:
        return Repairs()
    scaled = {one.image: one.size for one in check.found if one.kind == "brightness"}
    others = {one.image: one.text for one in check.found if one.kind != "brightness"}
    return Repairs(scaled, others)
