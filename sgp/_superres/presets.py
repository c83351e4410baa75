"""What a training consists of: the network, the surfaces, the steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sgp._superres.pairs import Domain
from sgp._superres.rdn import RdnSize

Scale = Literal[2, 4]
PresetName = Literal["small", "paper"]


@dataclass(frozen=True)
class Preset:
    """Everything that a training needs besides scale, domain and seed.

    Parameters
    ----------
    blocks, convolutions, growth, features, upsampling
        As in `RdnSize`.
    surfaces
        Number of random surfaces, of `side` x `side` pixels each.
    crop
        Side of a crop in pixels of high resolution, for each factor of `scale` if
        `crop_of_low` is set.
    batch
        Crops per step.
    steps
        Steps of Adam (Kingma and Ba 2015).
    rate
        Learning rate.
    falling
        The rate rises for 50 steps and falls to 0 as half a cosine; otherwise it is constant.
    """

    blocks: int
    convolutions: int
    growth: int
    features: int
    upsampling: Literal["convolved", "direct"]
    surfaces: int
    crop: int
    crop_of_low: bool
    batch: int
    steps: int
    rate: float
    falling: bool
    side: int = 240

    def size(self, scale: Scale) -> RdnSize:
        """Return the sizes of the network for a scale."""
        return RdnSize(
            scale, self.blocks, self.convolutions, self.growth, self.features, self.upsampling
        )

    def low_crop(self, scale: Scale) -> int:
        """Return the side of a crop at low resolution."""
        return self.crop if self.crop_of_low else self.crop // scale


PRESETS: dict[PresetName, Preset] = {
    # Nine to ten CPU minutes.
    "small": Preset(5, 3, 32, 32, "direct", 900, 24, True, 8, 6000, 1e-3, True),
    # The settings of the paper, and the network as published. The paper names no number of steps.
    "paper": Preset(16, 8, 64, 64, "convolved", 353, 192, False, 16, 200_000, 1e-4, False),
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
        """The preset."""
        return PRESETS[self.preset_name]

    @property
    def size(self) -> RdnSize:
        """The sizes of the network."""
        return self.preset.size(self.scale)

    @property
    def surfaces(self) -> range:
        """Seeds of the surfaces to train on; they differ between seeds of trainings."""
        first = FIRST_TRAINED + TRAINED_PER_SEED * self.seed
        return range(first, first + self.preset.surfaces)
