"""Precision and recall of shadows, against the shadows of the simulator, in percent.

Scenes of the simulator under near lights with true points, sharp or with the point-spread function
of a lens, and a ball under distant lights in random cast shadows. "attached" and "cast" compare the
kinds of all samples of the object; in the last two columns only samples count that would have at
least 10 standard deviations of their noise without the shadow.

    python benchmarks/sample_kinds.py --seed 1
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from harness import command_line
from normal_uncertainty import FLOOR, SLOPE, Case, ball, recorded, relief

from calibration import StackNoise
from processing import SampleKind, photometric_stereo
from processing.noise.pixel_variances import kinds_of
from processing.stereo import METHODS
from rig.arrays import Bool


def scenes(seed: int, size: int) -> Iterator[tuple[str, Case]]:
    """Yield the scenes and their names."""
    yield "ball, distant, random shadows", ball(np.random.default_rng(seed), size=size, cast=True)
    for name in ("coin", "sphere", "woodcarving", "step-gauge", "scales"):
        yield name, relief(name, width=2 * size, seed=seed)
    for name in ("step-gauge", "scales"):
        yield f"{name}, blurred", relief(name, width=2 * size, seed=seed, sharp=False)


def score(found: Bool, true: Bool) -> str:
    """Return precision and recall."""
    both = np.count_nonzero(found & true)
    shares = (both / max(np.count_nonzero(of), 1) for of in (found, true))
    return " ".join(f"{100 * share:6.1f}" for share in shares)


def main() -> None:
    """Print one row for each scene, method and knowledge of the noise."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=1, help="seed of scenes and noise")
    parser.add_argument("--size", type=int, default=100, help="size of the scenes, pixels")
    options = parser.parse_args()
    print(f"{'precision, recall, %':38} noise     attached      cast          cast, bright")
    for name, case in scenes(options.seed, options.size):
        if case.shadows is None:
            raise AssertionError("every scene has shadows")
        rng = np.random.default_rng([options.seed, len(name)])
        values = recorded(case, np.ones(len(case.lights)), rng)
        vectors = case.lights.vectors_at(np.zeros(3) if case.points_mm is None else case.points_mm)
        vectors = vectors.reshape(
            len(vectors), *((1, 1) if case.points_mm is None else case.mask.shape), 3
        )
        facing = np.einsum(
            "nhwc,hwc->nhw", np.broadcast_to(vectors, (*case.images.shape, 3)), case.normals
        )
        inside = case.mask[None] & np.ones(case.images.shape, bool)
        attached, cast = inside & (facing <= 0), inside & (facing > 0) & case.shadows
        signal = 0.3 * facing
        bright = signal > 10 * np.sqrt(FLOOR + SLOPE * np.maximum(signal, 0))
        for method in METHODS:
            for noise in (StackNoise.of_one_exposure(SLOPE, FLOOR, len(values)), None):
                stereo = photometric_stereo(
                    values,
                    case.lights,
                    case.mask,
                    method=method,
                    points_mm=case.points_mm,
                    noise=noise,
                )
                kinds = kinds_of(values, case.lights, case.mask, stereo, case.points_mm, noise)
                rows = (
                    score(inside & (kinds == SampleKind.ATTACHED), attached),
                    score(inside & (kinds == SampleKind.CAST), cast),
                    score(inside & bright & (kinds == SampleKind.CAST), cast & bright),
                )
                known = "known" if noise is not None else "unknown"
                print(f"{name:30} {method:8} {known:8} {'  '.join(rows)}", flush=True)


if __name__ == "__main__":
    main()
