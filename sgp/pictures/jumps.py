"""Write pictures of the jumps of a surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import processing

JUMP_RIGHT, JUMP_DOWN = 85, 170
_OUTSIDE = (0, 0, 0)
_CRUMB = (255, 255, 255)
_LARGEST = (128, 128, 128)
# Of the other pieces in turn: colours that colour-blind people distinguish too (Okabe and Ito).
_OTHERS = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)


def write_jumps(folder: Path, jumps: processing.surface.Jumps) -> dict[str, Path]:
    """Write discontinuity.png, jumps.png and parts.png; return the files.

    discontinuity.png is the doubt, white at a jump. jumps.png is 85 at a pixel with a jump to its
    right neighbour, 170 with one to its lower neighbour, and 255 with both. In parts.png the
    largest piece is gray, the others, whose heights are guesses, are coloured, and crumbs at jumps
    are white.
    """
    outputs = {name: folder / f"{name}.png" for name in ("discontinuity", "jumps", "parts")}
    outside = np.isnan(jumps.doubt)
    doubt = np.where(outside, 0, np.rint(255 * jumps.doubt)).astype(np.uint8)
    acquisition.write_png(
        outputs["discontinuity"], doubt, description="doubt that the surface is connected, 0..255"
    )
    acquisition.write_png(
        outputs["jumps"],
        (JUMP_RIGHT * jumps.right + JUMP_DOWN * jumps.down).astype(np.uint8),
        description="jumps to the right neighbour 85, to the lower one 170, to both 255",
    )
    numbers = np.where(outside, 0, jumps.pieces + 2)  # crumbs are 1
    cycled = np.where(numbers > 2, 3 + (numbers - 3) % len(_OTHERS), numbers)
    table = np.array([_OUTSIDE, _CRUMB, _LARGEST, *_OTHERS], np.uint8)
    acquisition.write_png(
        outputs["parts"],
        table[cycled],
        srgb=True,
        description="pieces between jumps: the largest gray, guessed heights coloured",
    )
    return outputs
