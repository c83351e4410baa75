"""What a training consists of: the network, the surfaces, the steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from sgp.training.pairs import Domain
from sgp.training.rdn import RdnSize

Scale = Literal[2, 4]
PresetName = Literal["small", "paper"]


@dataclass(frozen=True)
class Preset:
    """Everything that a training needs besides scale, domain and seed.

    Parameters
    ----------
    blocks, convolutions, growth, features, upsampling
        As in `RdnSize`.
    surfaces, rugged
        Number of random surfaces, and of rugged ones for the second part of the training, of
        `side` x `side` pixels each.
    crop
        Side of a crop in pixels of high resolution, for each factor of `scale` if
        `crop_of_low` is set.
    batch
        Crops per step.
    steps
        Steps of Adam (Kingma and Ba 2015).
    first
        Share of the steps in the first part, on the random surfaces. In the second part, all
        surfaces are used, Adam starts again, and the rate is halved.
    rate
        Learning rate.
    falling
        In each part, the rate rises for 50 steps and falls to 0 as half a cosine; otherwise it is
        constant.
    """

    blocks: int
    convolutions: int
    growth: int
    features: int
    upsampling: Literal["convolved", "direct"]
    surfaces: int
    rugged: int
    crop: int
    crop_of_low: bool
    batch: int
    steps: int
    first: float
    rate: float
    falling: bool
    side: int = 240

    def at(self, scale: Scale) -> Preset:
        """Return the preset of a scale: without a second part where it is not used."""
        if scale in RUGGED_SCALES:
            return self
        return replace(self, rugged=0, steps=round(self.first * self.steps), first=1.0)

    def size(self, scale: Scale) -> RdnSize:
        """Return the sizes of the network for a scale."""
        return RdnSize(
            scale, self.blocks, self.convolutions, self.growth, self.features, self.upsampling
        )

    def low_crop(self, scale: Scale) -> int:
        """Return the side of a crop at low resolution."""
        return self.crop if self.crop_of_low else self.crop // scale


# Networks of these scales are trained and judged on rugged surfaces, too.
RUGGED_SCALES: tuple[Scale, ...] = (4,)

PRESETS: dict[PresetName, Preset] = {
    # Up to fifteen CPU minutes at scale 4, nine to ten at scale 2.
    "small": Preset(5, 3, 32, 32, "direct", 900, 600, 24, True, 8, 8400, 5 / 7, 1e-3, True),
    # The settings of the paper, and the network as published. The paper names no number of steps.
    "paper": Preset(16, 8, 64, 64, "convolved", 353, 0, 192, False, 16, 200_000, 1, 1e-4, False),
}

# Seeds of random surfaces. Each surface belongs to one of these sets; crops never divide it.
HELD_OUT = range(128)  # judged after a training
CORRECTED = range(200, 456)  # their errors correct the predicted deviations
REPORTED = range(1000, 1128)  # judged once, for the figures in documents
FIRST_TRAINED, TRAINED_PER_SEED = 100_000, 100_000


@dataclass(frozen=True)
class Task:
    """One training: all that its result depends on.

    Parameters
    ----------
    scale, domain
        What the network enlarges, and by how much.
    seed
        Seed of surfaces, first weights and crops.
    preset_name
        Key of `PRESETS`.
    steps
        Steps, instead of those of the preset.
    """

    scale: Scale
    domain: Domain
    seed: int
    preset_name: PresetName
    steps: int

    @property
    def preset(self) -> Preset:
        """The preset, at the scale."""
        return PRESETS[self.preset_name].at(self.scale)

    @property
    def size(self) -> RdnSize:
        """The sizes of the network."""
        return self.preset.size(self.scale)

    @property
    def surfaces(self) -> range:
        """Seeds of the surfaces to train on; they differ between seeds of trainings."""
        return range(self._first, self._first + self.preset.surfaces)

    @property
    def rugged(self) -> range:
        """Seeds of the rugged surfaces to train on."""
        return range(self._first, self._first + self.preset.rugged)

    @property
    def first_steps(self) -> int:
        """Steps of the first part."""
        return round(self.preset.first * self.steps)

    @property
    def _first(self) -> int:
        return FIRST_TRAINED + TRAINED_PER_SEED * self.seed
