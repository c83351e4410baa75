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

With ``--workers 16 --scores scores.jsonl``, 16 processes share the layouts, and a command that was
interrupted continues where it ended, unless the code has changed. The table at the end lists the
seeds of all layouts that fall short.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import cv2
import numpy as np
from harness import command_line
from layout_scores import Score, append_score, read_scores, table
from random_layouts import Layout, layout_of, outline, radius_px, scene_of

from calibration import EstimateError, SphereCalibration, calibrate_spheres, find_spheres
from calibration.spheres import Ellipse, KnownSpheres
from calibration.spheres.geometry.cone import OUTLINE_SIGMA_PX, Cone
from calibration.spheres.solve.joint_refinement import Observation, linearise, predicted_highlights
from calibration.spheres.solve.sphere_positions import place
from rig.arrays import Float64
from simulator import ChromeSphere

OUTLINE_PX, HIGHLIGHT_PX = 0.04, 0.01
# Highlights farther from the middle of a sphere are not used.
FARTHEST_SPOT = 0.85
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


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
    system = linearise(Observation(camera, known, highlights, sigma_px), layout.lights_mm, centres)
    return rms_mm(system.covariance())


def rms_mm(covariances: Float64) -> float:
    """Return the root of the mean trace of covariances."""
    return float(np.sqrt(np.trace(covariances, axis1=1, axis2=2).mean()))


def judge(layout: Layout) -> Score:
    """Calibrate a layout and compare the result with the truth."""
    wanted = layout.wanted()
    score = Score(layout.seed, layout.kind, len(wanted), expected_mm=expected_mm(layout, wanted))
    radii = [sphere.radius_mm for sphere in layout.spheres]
    same = len(set(radii)) == 1
    start = time.process_time()
    result: SphereCalibration | None = None
    try:
        result = calibrate_spheres(
            layout.values, camera=layout.camera, radius_mm=radii[0] if same else radii
        )
        outlines = [sphere.outline for sphere in result.spheres]
    except EstimateError as error:
        score.error = str(error)
    score.cpu_s = time.process_time() - start
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


def code_version() -> str:
    """Return a digest of the code that decides the scores."""
    root = Path(__file__).parent
    digest = hashlib.sha256()
    for room in ("acquisition", "calibration", "simulator"):
        for path in sorted((root.parent / room).rglob("*.py")):
            digest.update(path.read_bytes())
    for name in ("random_layouts.py", "sphere_layouts.py"):
        digest.update((root / name).read_bytes())
    return digest.hexdigest()[:12]


def score_of(seed: int, kind: str, small: bool, cache: Path | None) -> Score:
    """Render and judge one layout; an error of the code is a score, too."""
    try:
        return judge(layout_of(seed, kind, small=small, cache=cache))
    except Exception as error:  # noqa: BLE001 - the other layouts are judged nevertheless
        return Score(seed, kind, error=f"{type(error).__name__}: {error}", failed=True)


def scores_of(
    jobs: list[tuple[int, str]], workers: int, small: bool, cache: Path | None
) -> Iterator[Score]:
    """Yield the scores of layouts, smallest first, as they are finished, the largest layouts first.

    The smallest one is judged before all others, so that one process compiles the kernels.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _start_worker)
    try:
        for some in (jobs[:1], jobs[:0:-1]):
            started = [pool.submit(score_of, *job, small, cache) for job in some]
            for one in as_completed(started):
                yield one.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _start_worker() -> None:
    """Let one core do the work of a process, and let Ctrl-C end it without a traceback."""
    cv2.setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _samples(seed: int, kind: str, small: bool) -> int:
    """Return the number of pixels of a layout under all lights."""
    scene = scene_of(seed, kind, small=small)
    return int(np.prod(scene.lens.size)) * len(np.asarray(scene.lights.positions_mm))


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--board", choices=("plain", "patterned", "both"), default="both")
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--layouts", type=int, default=100, help="layouts of each kind")
    parser.add_argument("--small", action="store_true", help="images of at most 960 x 804 pixels")
    parser.add_argument("--workers", type=int, default=1, help="processes that share the layouts")
    parser.add_argument(
        "--scores", type=Path, help="file of scores; layouts that it contains are not repeated"
    )
    parser.add_argument("--cache", type=Path, help="folder that keeps rendered layouts")
    args = parser.parse_args()
    if args.workers < 1 or args.layouts < 1:
        parser.error("--workers and --layouts must be at least 1")
    if args.cache is not None:
        args.cache.mkdir(parents=True, exist_ok=True)
    kinds = ("plain", "patterned") if args.board == "both" else (args.board,)
    seeds = range(args.first, args.first + args.layouts)
    jobs = [(seed, kind) for kind in kinds for seed in seeds]
    code = code_version() + (" small" if args.small else "")
    known = [] if args.scores is None else read_scores(args.scores, code)
    scores = {(s.seed, s.kind): s for s in known if (s.seed, s.kind) in jobs and not s.failed}
    left = [job for job in jobs if job not in scores]
    # Before the number of threads changes, which compiled kernels do not accept.
    left.sort(key=lambda job: _samples(*job, args.small))
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # of the workers
    try:
        for score in scores_of(left, args.workers, args.small, args.cache) if left else ():
            scores[score.seed, score.kind] = score
            if args.scores is not None:
                append_score(args.scores, code, score)
            print(score.line(), flush=True)
    except (KeyboardInterrupt, BrokenProcessPool) as end:
        cause = "interrupted" if isinstance(end, KeyboardInterrupt) else "a worker was killed"
        kept = "" if args.scores is None else f", {args.scores} has them: repeat the command"
        print(f"{cause}: {len(scores)} of {len(jobs)} layouts are judged{kept}")
        sys.exit(130)
    print(table([scores[job] for job in jobs]))


if __name__ == "__main__":
    main()
