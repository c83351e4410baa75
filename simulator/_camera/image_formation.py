"""How the virtual cameras form an image from light."""

from __future__ import annotations

from dataclasses import dataclass

from acquisition import NoiseModel
from rig import short_repr
from simulator._scene.lamps import Lamps


@dataclass(frozen=True)
class ImageFormation:
    """How a virtual camera forms an image from the light that it sees.

    Parameters
    ----------
    noise
        Model of the sensor.
    seed
        Seed of noise, flicker, PWM phase and shake.
    noisy
        If False, frames have no shot noise and no read noise.
    cfa
        Colour filters of the first 2 x 2 pixels of the planes row by row, for example ``RGGB``;
        None for monochrome.
    lamps
        Behaviour of the LEDs over time. Their clock is the sum of all exposure times triggered so
        far, so that the same shots give the same frames at any speed of the host.
    shake_px
        Standard deviation, along each axis, of the image's position in a frame.
    sensor_seed
        Seed of the sensor's fixed pattern, if ``noise`` has one.
    """

    noise: NoiseModel
    seed: int = 0
    noisy: bool = True
    cfa: str | None = None
    lamps: Lamps = Lamps()
    shake_px: float = 0.0
    sensor_seed: int = 0

    __repr__ = short_repr
