"""Compare estimators of the centres of drawn highlights: saturated, streaked, with glare, noisy.

Each image has one highlight on a ball of 100 px radius: a disc of light blurred by the lens, far
above saturation, with a halo, the rays of a star (four, six or eight, of equal or random lengths),
one-sided glare, a shared reflection of the room, noise, and the sRGB curve with JPEG compression if
it is saturated. Further rows have a streak of the sensor in one direction, a broad veil around the
spot, or a ghost next to it. The columns are the rms error in pixels of the centroid weighted above
half of white, of the plain threshold at 98 % and of `find_highlights`, the rms angles between their
lights and the true one in degrees, the worst error in pixels, and the mean of the squares of the
errors in standard deviations (x and y together). A row in which the plain threshold is better is
marked. Seeds from 1000 on are reported; lower seeds were used to choose constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from harness import command_line
from scipy.ndimage import gaussian_filter

from acquisition import angle_deg
from calibration.spheres import Ellipse, find_highlights, orthographic_directions
from rig.arrays import Float32, Float64

SIZE, RADIUS_PX, LIGHTS = 221, 100.0, 12
OUTLINE = Ellipse((110.0, 110.0), (RADIUS_PX, RADIUS_PX))


@dataclass(frozen=True)
class Kind:
    """What a row of the table draws.

    Parameters
    ----------
    name
        For the table.
    core_px
        Smallest and largest radius of the core where it crosses white, or the sigma of a peak
        below white.
    peak
        Smallest and largest brightness of the core, 1 at white.
    rays, glare
        Whether there are rays, and one-sided glare.
    jpeg
        Smallest and largest quality; None for 12 bits without compression.
    streak, veil, ghost
        Whether there is a streak through the spot, a veil with half of white on average, and a
        ghost 2 to 4 radii of the core away, which may be saturated.
    """

    name: str
    core_px: tuple[float, float]
    peak: tuple[float, float]
    rays: bool = False
    glare: bool = False
    jpeg: tuple[int, int] | None = None
    streak: bool = False
    veil: bool = False
    ghost: bool = False


KINDS = (
    Kind("peak 0.5 of white, sigma 0.7-1.5 px", (0.7, 1.5), (0.5, 0.5)),
    Kind("peak 0.5, with rays and glare", (0.7, 1.5), (0.5, 0.5), rays=True, glare=True),
    Kind("core 1-2 px", (1, 2), (2, 30)),
    Kind("core 1-2 px, rays, JPEG", (1, 2), (2, 30), rays=True, jpeg=(85, 96)),
    Kind("core 2-4 px", (2, 4), (3, 100)),
    Kind("core 2-4 px, rays", (2, 4), (3, 100), rays=True),
    Kind("core 2-4 px, rays, glare, JPEG", (2, 4), (3, 100), True, True, (85, 96)),
    Kind("core 4-8 px, rays", (4, 8), (10, 1000), rays=True),
    Kind("core 4-8 px, glare", (4, 8), (10, 1000), glare=True),
    Kind("core 4-8 px, rays, glare, JPEG", (4, 8), (10, 1000), True, True, (85, 96)),
    Kind("core 8-14 px, rays, glare, JPEG", (8, 14), (10, 1000), True, True, (85, 96)),
    Kind("core 4-8 px, streak", (4, 8), (10, 1000), streak=True),
    Kind("core 4-8 px, streak, JPEG", (4, 8), (10, 1000), jpeg=(85, 96), streak=True),
    Kind("core 4-8 px, veil", (4, 8), (10, 1000), veil=True),
    Kind("core 4-8 px, veil, streak, JPEG", (4, 8), (10, 1000), False, False, (85, 96), True, True),
    Kind("core 2-4 px, ghost", (2, 4), (3, 100), ghost=True),
    Kind("core 4-8 px, ghost, JPEG", (4, 8), (10, 1000), jpeg=(85, 96), ghost=True),
)


def draw(kind: Kind, seed: int) -> tuple[Float32, Float64]:
    """Return images ``(LIGHTS, SIZE, SIZE)``, NaN where saturated, and the centres (x, y)."""
    rng = np.random.default_rng(seed)
    room = gaussian_filter(rng.normal(0, 1, (SIZE, SIZE)), 12)
    room = 0.06 + 0.04 * room / np.abs(room).max()
    turn, distance = rng.uniform(0, 2 * np.pi, LIGHTS), RADIUS_PX * rng.uniform(0, 0.6, LIGHTS)
    centres = 110 + np.column_stack([distance * np.cos(turn), distance * np.sin(turn)])
    images = [_image(kind, centre, room, rng) for centre in centres]
    return np.array(images, np.float32), centres


def _image(kind: Kind, centre: Float64, room: Float64, rng: np.random.Generator) -> Float64:
    y, x = np.indices((SIZE, SIZE)) - centre[::-1, None, None]
    turn, ratio = rng.uniform(0, np.pi), rng.uniform(0.85, 1.0)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    r = np.hypot(along * np.sqrt(ratio), across / np.sqrt(ratio))
    core_px = rng.uniform(*kind.core_px)
    peak = float(np.exp(rng.uniform(*np.log(kind.peak))))
    sigma = core_px if peak < 1 else core_px / np.sqrt(2 * np.log(peak))
    light = peak * np.exp(-((r / sigma) ** 2) / 2)
    light += min(0.002 * peak, 0.3) / (1 + (r / (2 * core_px)) ** 2) ** 1.5
    if kind.rays:
        light += _rays(x, y, core_px, 1.0 if peak > 1 else 0.03 * peak, rng)
    if kind.glare:
        side = rng.uniform(0, 2 * np.pi)
        away, width = core_px * rng.uniform(1, 2.5), core_px * rng.uniform(1.5, 4)
        square = (x - away * np.cos(side)) ** 2 + (y - away * np.sin(side)) ** 2
        strength = 1.0 if peak > 1 else 0.1 * peak
        light += rng.uniform(0.1, 0.5) * strength * np.exp(-square / (2 * width**2))
    if kind.streak:
        light += _streak(along, across, core_px, rng)
    if kind.veil:
        # Its centre is not that of the spot.
        side, away = rng.uniform(0, 2 * np.pi), core_px * rng.uniform(0.5, 2)
        square = (x - away * np.cos(side)) ** 2 + (y - away * np.sin(side)) ** 2
        light += rng.uniform(0.3, 0.7) / (1 + square / (3 * core_px) ** 2) ** 1.5
    if kind.ghost:
        side, away = rng.uniform(0, 2 * np.pi), core_px * rng.uniform(2.2, 4)
        square = (x - away * np.cos(side)) ** 2 + (y - away * np.sin(side)) ** 2
        light += rng.uniform(0.3, 1.5) * np.exp(-square / (2 * (0.5 * core_px) ** 2))
    light += room
    if kind.jpeg is None:
        light += rng.normal(0, np.sqrt(0.002**2 + 1e-4 * np.clip(light, 0, 1)))
        seen = np.round(np.clip(light, 0, 1) * 4095) / 4095
        return np.where(seen >= 1, np.nan, seen)
    light = np.clip(light + rng.normal(0, 0.004, light.shape), 0, 1)
    curve = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(*kind.jpeg))]
    coded = cv2.imencode(".jpg", np.round(255 * curve).astype(np.uint8), quality)[1]
    seen = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE).astype(np.float64) / 255
    linear = np.where(seen < 0.04045, seen / 12.92, ((seen + 0.055) / 1.055) ** 2.4)
    return np.where(seen >= 1, np.nan, linear)


def _rays(
    x: Float64, y: Float64, core_px: float, strength: float, rng: np.random.Generator
) -> Float64:
    """Return rays, above the strength up to a few radii of the core; half of them are unequal."""
    count = int(rng.choice([4, 6, 8]))
    first = rng.uniform(0, 2 * np.pi)
    equal = rng.random() < 0.5
    length = core_px * rng.uniform(1.2, 3.5)
    width = max(0.12 * core_px, 0.5) * rng.uniform(0.7, 1.5)
    total = np.zeros_like(x)
    for k in range(count):
        angle = first + 2 * np.pi * k / count + (0 if equal else rng.normal(0, 0.15))
        own = length if equal else length * rng.uniform(0.3, 1.3)
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        shape = 2 * np.exp(-np.clip(along, 0, None) * np.log(2) / own)
        total += strength * np.where(along > 0, shape, 0) * np.exp(-((across / width) ** 2) / 2)
    return total


def _streak(along: Float64, across: Float64, core_px: float, rng: np.random.Generator) -> Float64:
    """Return a streak in one direction, above white up to some radii of the core on one side."""
    long, short = core_px * rng.uniform(2, 6), core_px * rng.uniform(0.2, 2)
    width = core_px * rng.uniform(0.15, 0.4)
    falls = np.exp(-np.abs(along) * np.log(2) / np.where(along > 0, long, short))
    return np.asarray(2 * falls * np.exp(-((across / width) ** 2) / 2))


def weighted_centroid(image: Float64) -> Float64:
    """Return the centroid of the blob, weighted by the excess over half of white."""
    return _centroid(np.nan_to_num(image, nan=1.0), 0.5, weighted=True)


def threshold(image: Float64) -> Float64:
    """Return the centroid of the pixels above 98 %, of the maximum if that is below white."""
    filled = np.nan_to_num(image, nan=1.0)
    return _centroid(filled, 0.98 * min(float(filled.max()), 1.0), weighted=False)


def _centroid(filled: Float64, level: float, *, weighted: bool) -> Float64:
    level = min(level, 0.98 * float(filled.max()))
    _, regions = cv2.connectedComponents((filled >= level).astype(np.uint8))
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    y, x = np.nonzero(regions == np.argmax(sizes))
    weight = filled[y, x] - level + 1e-12 if weighted else np.ones(len(x))
    return np.array([np.average(x, weights=weight), np.average(y, weights=weight)])


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="images / 12 for each row")
    parser.add_argument("--first", type=int, default=1000)
    options = parser.parse_args()
    print(f"{'':34}        rms px                rms degrees")
    print(f"{'':34} weighted  98 %  contour  weighted  98 %  contour  worst  chi2  found")
    for kind in KINDS:
        errors: list[list[Float64]] = [[], [], []]
        angles: list[list[float]] = [[], [], []]
        pulls: list[float] = []
        missed = 0
        for seed in range(options.first, options.first + options.seeds):
            images, centres = draw(kind, seed)
            found = find_highlights(images, OUTLINE)
            right = orthographic_directions(OUTLINE, centres)
            for i, (image, centre) in enumerate(zip(images, centres, strict=True)):
                whole = image.astype(float)
                for n, at in enumerate(
                    (weighted_centroid(whole), threshold(whole), found.pixels[i])
                ):
                    if np.isfinite(at[0]):
                        errors[n].append(at - centre)
                        seen = orthographic_directions(OUTLINE, at)
                        angles[n].append(float(angle_deg(seen, right[i])))
                if not found.found[i]:
                    missed += 1
                    continue
                pulls.extend((found.pixels[i] - centre) / found.sigma_px[i])
        rms = [float(np.sqrt(np.mean(np.square(e).sum(axis=1)))) for e in errors]
        deg = [float(np.sqrt(np.nanmean(np.square(a)))) for a in angles]
        worst = float(np.linalg.norm(errors[2], axis=1).max())
        total = options.seeds * LIGHTS
        print(
            f"{kind.name:34} {rms[0]:7.3f} {rms[1]:6.3f} {rms[2]:8.3f} {deg[0]:9.3f} {deg[1]:6.3f} "
            f"{deg[2]:8.3f} {worst:7.3f} {np.mean(np.square(pulls)):5.2f}  {total - missed}/{total}"
            f"{'  the threshold is better' * (rms[1] < rms[2])}"
        )


if __name__ == "__main__":
    main()
