"""Random layouts of mirror spheres: which are found, and how wrong are the positions of the lights.

Each seed draws a layout: 1 to 6 spheres of one to three sizes that rest on a plain or a patterned
board, some with a relief, a matte ball, a glossy ball or a box, some cut by the frame. The images
are rendered with the point-spread function of the lens, recorded with two exposures by a 12-bit
sensor, and calibrated with the camera and the radii of all spheres. Only spheres that are
completely visible and have a radius of at least 20 px must be found; other true spheres may be. A
sphere that is found away from every true one is false.

Every line states the standard deviation of the positions that is expected from the true places of
these spheres, if each outline is known to 0.04 px and each highlight to 0.01 px. A layout is
solvable if it is at most 1 mm, so that 2 mm are two standard deviations. The benchmark calculates
it before, and independently of, what the calibration finds.

    python benchmarks/sphere_layouts.py --board patterned --first 5000 --layouts 100
"""

from __future__ import annotations

import argparse
import resource
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from random_layouts import Array, Layout, layout_of, outline, radius_px

from calibration import EstimateError, SphereCalibration, calibrate_spheres, find_spheres
from calibration._spheres.cone import OUTLINE_SIGMA_PX, Cone
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.joint_refinement import KnownSpheres, linearise, predicted_highlights
from calibration._spheres.placed import place
from simulator import ChromeSphere

TOLERABLE_MM = 2.0
SOLVABLE_MM = 1.0
OUTLINE_PX, HIGHLIGHT_PX = 0.04, 0.01
# Highlights farther from the middle of a sphere are not used.
FARTHEST_SPOT = 0.85


@dataclass
class Score:
    """What was found in one layout."""

    seed: int
    kind: str
    wanted: int = 0
    found: int = 0
    missed: list[str] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    expected_mm: float = np.inf
    positions_mm: float = np.nan
    stated_mm: float = np.nan
    warnings: tuple[str, ...] = ()
    error: str = ""
    cpu_s: float = 0.0

    @property
    def solvable(self) -> bool:
        """Return whether positions within 2 mm can be expected."""
        return self.expected_mm <= SOLVABLE_MM

    @property
    def quiet(self) -> bool:
        """Return whether positions were returned without a warning."""
        return bool(np.isfinite(self.positions_mm)) and not self.warnings

    def line(self) -> str:
        """Return one line for people."""
        parts = [f"{self.seed} {self.kind}: {self.found}/{self.wanted} found"]
        if np.isfinite(self.expected_mm):
            parts.append(f"expected {self.expected_mm:.2f} mm")
        if self.missed:
            parts.append("missed " + " ".join(self.missed))
        if self.false:
            parts.append("FALSE " + " ".join(self.false))
        if np.isfinite(self.positions_mm):
            parts.append(f"positions {self.positions_mm:.2f} mm, stated {self.stated_mm:.2f} mm")
        if self.warnings:
            parts.append("warned " + ",".join(self.warnings))
        if self.error:
            parts.append(self.error[:110])
        return "; ".join([*parts, f"{self.cpu_s:.1f} s"])


def expected_mm(layout: Layout, spheres: list[ChromeSphere]) -> float:
    """Return the standard deviation of the positions that true spheres allow, inf if none."""
    if len(spheres) < 2:
        return np.inf
    camera, eye = layout.camera, layout.camera.centre_mm
    centres = np.array([sphere.centre_mm for sphere in spheres])
    radii = np.array([sphere.radius_mm for sphere in spheres])
    distances = np.linalg.norm(centres - eye, axis=1)
    cones = [
        Cone((centre - eye) / distance, radius / distance, np.zeros((3, 3)))
        for centre, radius, distance in zip(centres, radii, distances, strict=True)
    ]
    covariance = place(cones, radii, camera).covariance_mm2 * (OUTLINE_PX / OUTLINE_SIGMA_PX) ** 2
    known = KnownSpheres(centres, radii, covariance)
    highlights = predicted_highlights(camera, centres, radii, layout.lights_mm)
    outlines = [outline(camera, sphere) for sphere in spheres]
    middles = np.array([points.mean(axis=0) for points in outlines])
    reach = FARTHEST_SPOT * np.array([radius_px(points) for points in outlines])
    seen = np.linalg.norm(highlights - middles, axis=-1) < reach
    if seen.sum(axis=1).min() < 2:
        return np.inf
    sigma_px = np.where(seen, HIGHLIGHT_PX, np.inf)
    system = linearise(camera, known, layout.lights_mm, centres, highlights, sigma_px)
    return rms_mm(system.covariance())


def rms_mm(covariances: Array) -> float:
    """Return the root of the mean trace of covariances."""
    return float(np.sqrt(np.trace(covariances, axis1=1, axis2=2).mean()))


def judge(layout: Layout) -> Score:
    """Calibrate a layout and compare the result with the truth."""
    wanted = layout.wanted()
    score = Score(layout.seed, layout.kind, len(wanted), expected_mm=expected_mm(layout, wanted))
    radii = [sphere.radius_mm for sphere in layout.spheres]
    same = len(set(radii)) == 1
    start = cpu_s()
    result: SphereCalibration | None = None
    try:
        result = calibrate_spheres(
            layout.values, camera=layout.camera, radius_mm=radii[0] if same else radii
        )
        outlines = [sphere.outline for sphere in result.spheres]
    except EstimateError as error:
        score.error = str(error)
    score.cpu_s = cpu_s() - start
    if result is None:
        outlines = [sphere.outline for sphere in find_spheres(layout.values)]
    else:
        score.warnings = tuple(warning.code for warning in result.warnings)
        if result.lights.positions_mm is not None:
            off = np.asarray(result.lights.positions_mm) - layout.lights_mm
            score.positions_mm = float(np.linalg.norm(off, axis=1).mean())
            errors = result.lights.errors
            if errors is not None and errors.covariances is not None:
                score.stated_mm = rms_mm(np.asarray(errors.covariances))
    _compare(layout, wanted, outlines, score)
    return score


def _compare(
    layout: Layout, wanted: list[ChromeSphere], outlines: list[Ellipse], score: Score
) -> None:
    """Count found, missed and false spheres."""
    left = list(outlines)
    for sphere, points in layout.outlines():
        centre, size = points.mean(axis=0), radius_px(points)
        near = [
            o
            for o in left
            if np.hypot(*(np.array(o.centre_px) - centre)) < 1 + 0.03 * size
            and abs(o.radius_px / size - 1) < 0.03 + 1 / size
        ]
        if near:
            left.remove(near[0])
            score.found += sphere in wanted
        elif sphere in wanted:
            score.missed.append(f"({centre[0]:.0f},{centre[1]:.0f},r{size:.0f})")
    score.false = [f"({o.centre_px[0]:.0f},{o.centre_px[1]:.0f},r{o.radius_px:.0f})" for o in left]


def cpu_s() -> float:
    """Return the CPU seconds of this process."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def summary(scores: list[Score]) -> str:
    """Return the figures of all layouts of one kind."""
    wanted, found = sum(s.wanted for s in scores), sum(s.found for s in scores)
    false = sum(len(s.false) for s in scores)
    solvable = [s for s in scores if s.solvable]
    several = [s for s in scores if s.wanted > 1]
    quiet = [s for s in scores if s.quiet]
    wrong = [s.seed for s in quiet if s.positions_mm > TOLERABLE_MM]
    warned = [s.seed for s in solvable if not s.quiet]
    misses = [s.seed for s in scores if s.missed or s.false]
    median = np.median([s.positions_mm for s in quiet]) if quiet else np.nan
    return (
        f"{scores[0].kind}: {len(scores)} layouts, {found}/{wanted} found "
        f"({100 * found / max(wanted, 1):.1f} %), {false} false\n"
        f"  without a warning: {_share(solvable)} solvable layouts, {_share(several)} layouts with "
        f"two spheres or more\n"
        f"  solvable, but not without a warning {warned}\n"
        f"  position sets without warning {len(quiet)}, beyond {TOLERABLE_MM:g} mm {wrong}, "
        f"median {median:.2f} mm\n"
        f"  seeds with a missed or a false sphere {misses}\n"
        f"  CPU {np.mean([s.cpu_s for s in scores]):.1f} s mean, "
        f"{max(s.cpu_s for s in scores):.1f} s most"
    )


def _share(scores: list[Score]) -> str:
    """Return how many layouts are calibrated without a warning."""
    quiet = sum(s.quiet for s in scores)
    return f"{quiet} of {len(scores)} ({100 * quiet / max(len(scores), 1):.0f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--board", choices=("plain", "patterned", "both"), default="both")
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--layouts", type=int, default=100, help="layouts of each kind")
    parser.add_argument("--small", action="store_true", help="images of at most 960 x 804 pixels")
    parser.add_argument("--cache", type=Path, help="folder that keeps rendered layouts")
    args = parser.parse_args()
    if args.cache is not None:
        args.cache.mkdir(parents=True, exist_ok=True)
    for kind in ("plain", "patterned") if args.board == "both" else (args.board,):
        scores = []
        for seed in range(args.first, args.first + args.layouts):
            layout = layout_of(seed, kind, small=args.small, cache=args.cache)
            scores.append(judge(layout))
            print(scores[-1].line())
            sys.stdout.flush()
        print(summary(scores))


if __name__ == "__main__":
    main()
