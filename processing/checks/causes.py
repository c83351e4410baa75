"""What may be wrong with a recording: its columns, its size, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from processing.checks.derivatives import OF_IMAGES, REFLECTANCE, Columns
from rig.arrays import Float64

# Expected sizes of parameters, in the units of their columns: light of a lamp, bright parts,
# logarithms, blocks, radians, shares of the distance of the lights, reciprocal sizes of the object.
_AMBIENT, _SIDEWAYS, _OFFSET, _CURVE, _GAIN = 0.2, 0.03, 0.1, 0.35, 0.1
_SHIFT, _TREND, _TURN, _PLACE, _NEAR = 2.0, 0.15, 0.1, 0.1, 1.0
_REFLECTANCE, _HEIGHT_MM, _TONE = 1.0, 50.0, 0.1
# Hypotheses with parameters of each image, of which others are special cases.
_STRENGTHS, _SHIFTED = ("light-brightness",), ("image-shifted",)


class Kind(NamedTuple):
    """What a cause is called.

    Parameters
    ----------
    noun
        What it is: "room light".
    text
        What is wrong; ``{size}`` stands for its size with its unit.
    unit
        Unit of the size.
    scale
        The size in this unit, of one in the unit of the columns; 0 stands for the size of a block
        in pixels.
    remedy
        What to do.
    """

    noun: str
    text: str
    unit: str
    scale: float
    remedy: str


KINDS = {
    "ambient-light": Kind(
        "room light",
        "room light of {size} of a lamp's light reaches the object",
        "%",
        100,
        "record in the dark, subtract a dark frame, or estimate the ambient light",
    ),
    "ambient-light-changes": Kind(
        "changing room light",
        "room light reaches the object and changes from image to image, by {size} of a lamp's "
        "light",
        "%",
        100,
        "record in the dark",
    ),
    "black-level": Kind(
        "an offset of all samples",
        "the samples have an offset of {size} of the bright parts",
        "%",
        100,
        "subtract the black level or a dark frame",
    ),
    "transfer-curve-doubtful": Kind(
        "another transfer curve",
        "the samples follow the light to the power of {size} of what was assumed",
        "",
        1,
        "state the transfer curve",
    ),
    "tone-curve": Kind(
        "a tone curve",
        "a tone curve changes dark and bright samples by up to {size} of white, in opposite ways",
        "%",
        100,
        "use raw images, or images without a picture style",
    ),
    "light-brightness": Kind(
        "wrong strengths of the lights",
        "the strengths of the lights are off by {size}",
        "%",
        100,
        "calibrate the strengths, or estimate them",
    ),
    "brightness-gradient": Kind(
        "strengths that change from one side to the other",
        "the strengths of the lights change by {size} from one side to the other",
        "%",
        100,
        "calibrate the strengths, or estimate them",
    ),
    "lights-fading": Kind(
        "fading lights",
        "the light changes by {size} from the first to the last image",
        "%",
        100,
        "let the lamps warm up, or estimate the strengths",
    ),
    "image-shifted": Kind(
        "shifted images",
        "images are shifted by {size}",
        "px",
        0,
        "fix the camera and the object, and record again",
    ),
    "images-drift": Kind(
        "a drift of the images",
        "the images drift by {size} from the first to the last",
        "px",
        0,
        "fix the camera and the object, and record again",
    ),
    "images-moved": Kind(
        "a movement during the recording",
        "camera or object moved by {size} during the recording",
        "px",
        0,
        "fix the camera and the object, and record again",
    ),
    "lights-tilted": Kind(
        "a turn of all lights",
        "all lights are turned by {size}",
        "deg",
        180 / np.pi,
        "check the frame of the lights, or calibrate them again",
    ),
    "lights-turned": Kind(
        "a turn of all lights about the line of sight",
        "all lights are turned by {size} about the line of sight, counter-clockwise",
        "deg",
        1,
        "check the frame of the lights, or turn the images",
    ),
    "lights-not-distant": Kind(
        "near lights",
        "the lights are about {size} away, not distant: their light falls off over the object",
        "mm",
        1,
        "give their distance, or a calibration with positions",
    ),
    "lights-displaced": Kind(
        "displaced lights",
        "all lights, or the principal point of the camera, are displaced by {size} of the distance "
        "of the lights",
        "%",
        100,
        "check the principal point and the frame of the lights",
    ),
    "light-distance": Kind(
        "a wrong distance of the lights",
        "all lights are {size} of their distance too high or too low",
        "%",
        100,
        "check the working distance and the focal length",
    ),
}


MOVEMENTS = {"image-shifted", "images-drift", "images-moved"}
# What is wrong with single images, and what to do.
IMAGE_KINDS = {
    "images-swapped": ("images in another order", "check the order of the files"),
    "image-duplicate": ("repeated images", "restore the missing ones, or leave them out"),
    "image-turned": ("images not in the position of the others", "turn the files"),
    "light-moved": ("lamps at other places", "calibrate them again, or leave them out"),
    "image-striped": ("images with foreign rows", "record them again, or leave them out"),
    "image-clipped": ("clipped images", "check exposure and white level, or leave them out"),
    "image-disagrees": (
        "images that do not agree with the others",
        "look at them, record them again, or leave them out",
    ),
}


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A cause as contrasts of columns.

    Parameters
    ----------
    name
        Name of the cause.
    basis
        ``(Q, q)``.
    widths
        ``(q,)`` expected sizes.
    general
        Names of the hypotheses with parameters of each image of which this is a special case.
    first
        First image that it is about.
    """

    name: str
    basis: Float64
    widths: Float64
    general: tuple[str, ...] = ()
    first: int = 0


def nuisances_of(columns: Columns) -> tuple[Float64, Float64]:
    """Return the columns of height and reflectance, and their expected sizes."""
    heights = [
        name for name in ("height", "tilt right", "tilt up", "dome") if name in columns.names
    ]
    basis = columns.select(*heights, *REFLECTANCE)
    widths = [_HEIGHT_MM] * len(heights) + [_REFLECTANCE] * len(REFLECTANCE)
    return basis, np.array(widths)


def hypotheses_of(columns: Columns, unit: Float64) -> list[Hypothesis]:
    """Return all causes, those of one name together.

    Parameters
    ----------
    columns
        The derivatives.
    unit
        ``(N, 3)`` directions of the lights.
    """
    found: list[Hypothesis] = []

    def add(
        name: str, basis: Float64, *widths: float, of: Sequence[str] = (), first: int = 0
    ) -> None:
        found.append(Hypothesis(name, basis, np.resize(widths, basis.shape[1]), tuple(of), first))

    select: Callable[..., Float64] = columns.select
    count = len(unit)
    gains, room, right, down = (columns.images(kind) for kind in OF_IMAGES)
    time = np.linspace(0, 1, count)
    ambient = select("ambient", "ambient right", "ambient up")
    # Strengths of all images imitate simpler causes on even objects.
    changing = "ambient-light-changes"
    add("ambient-light", ambient, _AMBIENT, _SIDEWAYS, _SIDEWAYS, of=[*_STRENGTHS, changing])
    add(changing, room, _AMBIENT)
    add("black-level", select("offset"), _OFFSET, of=_STRENGTHS)
    add("transfer-curve-doubtful", select("curve"), _CURVE, of=_STRENGTHS)
    if "tone" in columns.names:
        add("tone-curve", select("tone"), _TONE, of=_STRENGTHS)
    add("light-brightness", gains, _GAIN)
    add("brightness-gradient", gains @ unit[:, :2], _TREND, of=_STRENGTHS)
    add("lights-fading", (gains @ time)[:, None], _TREND, of=_STRENGTHS)
    add("image-shifted", np.hstack([right, down]), _SHIFT)
    drift = np.stack([right @ time, down @ time], axis=1)
    add("images-drift", drift, _SHIFT, of=_SHIFTED)
    for first in range(2, count - 1, max(1, count // 12)):
        after = (np.arange(count) >= first).astype(np.float64)
        basis = np.stack([right @ after, down @ after], axis=1)
        add("images-moved", basis, _SHIFT, of=_SHIFTED, first=first)
    add("lights-tilted", select("turn x", "turn y"), _TURN)
    if "near" in columns.names:
        add("lights-not-distant", select("near", "near height"), _NEAR)
    else:
        add("lights-displaced", select("shift x", "shift y"), _PLACE)
        add("light-distance", select("shift z"), _PLACE)
    return found
