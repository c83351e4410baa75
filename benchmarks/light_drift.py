"""Series of calibrations: how often does a stable one raise an alarm, and what is found in others?

Each seed draws a dome of LEDs at 450 mm and calibrates it several times. Positions err by 0.4 mm
across and 0.8 mm along the line of sight, strengths by 0.36 %; the complete dome turns by 0.02
degrees about each axis and shifts by 0.1 mm between calibrations. A row has the share of series
with an alarm about the lights together and about single lights, and in how many the cause was named
without another one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from harness import command_line
from scipy.spatial.transform import Rotation

from acquisition import LightErrors, Lights
from calibration.comparison import light_drift

LIGHT = 7  # the one that fades or turns
# What is stated of the errors: the truth, half of it, nothing.
SETUPS: dict[str, dict[str, Any]] = {
    "10 x 36, positions": {},
    "10 x 36, directions": {"near": False},
    "10 x 36, errors stated half": {"stated": 0.5},
    "10 x 36, no errors stated": {"stated": 0.0},
    "3 x 36": {"number": 3},
    "20 x 36": {"number": 20},
    "10 x 6": {"count": 6},
}


def dome(count: int, rng: np.random.Generator) -> np.ndarray:
    """Return positions of LEDs in three rings, in mm."""
    around = 2 * np.pi * np.arange(count) / max(count / 3, 1)
    rise = np.radians(np.resize([30, 50, 70], count))
    ring = [np.cos(rise) * np.cos(around + rise), np.cos(rise) * np.sin(around + rise)]
    return 450 * np.stack([*ring, np.sin(rise)], axis=1) + rng.normal(0, 4, (count, 3))


def series(
    seed: int,
    *,
    number: int = 10,
    count: int = 36,
    near: bool = True,
    stated: float = 1.0,
    fault: str = "",
) -> list[Lights]:
    """Return calibrations of a dome, in which a light fades or turns, or all turn (``fault``)."""
    rng = np.random.default_rng(seed)
    places, strengths = dome(count, rng), rng.uniform(0.7, 1.3, count)
    towards = places / np.linalg.norm(places, axis=1, keepdims=True)
    covariances = 0.4**2 * (np.eye(3) + 3 * np.einsum("ni,nj->nij", towards, towards))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    calibrations = []
    for k in range(number):
        turn = Rotation.from_rotvec(np.radians(rng.normal(0, 0.02, 3)))
        late = k >= 6
        if fault == "all turn" and late:
            turn = Rotation.from_rotvec(np.radians(0.3) * axis) * turn
        now, bright = places.copy(), strengths.copy()
        if fault == "one turns" and late:
            across = np.cross(towards[LIGHT], [0, 0, 1])
            now[LIGHT] += 450 * np.tan(np.radians(0.5)) * across / np.linalg.norm(across)
        if fault == "one fades":
            bright[LIGHT] *= 0.97**k
        now = turn.apply(now) + rng.normal(0, 0.1, 3)
        now += np.array([rng.multivariate_normal(np.zeros(3), one) for one in covariances])
        seen = bright * np.exp(rng.normal(0, 0.0036, count)) * rng.uniform(0.8, 1.2)
        errors = LightErrors(
            covariances=covariances * stated**2, intensity_std=0.003 * stated * seen
        )
        lights = Lights(positions_mm=now, intensities=seen, errors=errors if stated else None)
        calibrations.append(lights if near else lights.distant())
    return calibrations


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    seeds = parser.parse_args()
    faults = ["one fades", "one turns", "all turn"]
    rows = [(setup, "", kinds) for setup, kinds in SETUPS.items()]
    rows += [(s, fault, SETUPS[s]) for fault in faults for s in list(SETUPS)[:2]]
    print(
        f"{'series':30}{'fault':12}{'together':>9}{'single':>8}{'any':>6}{'named':>7}{'limits':>24}"
    )
    for setup, fault, kinds in rows:
        found = []
        for seed in range(seeds.first, seeds.first + seeds.seeds):
            drift = light_drift(series(seed, fault=fault, **kinds))
            only = drift.beyond.tolist() == [n == LIGHT for n in range(len(drift.ids))]
            named = drift.moved and not drift.beyond.any() if fault == "all turn" else only
            figures = (
                drift.common_limit_deg,
                np.median(drift.direction_limit_deg),
                np.median(drift.strength_limit_percent),
            )
            any_light = bool(drift.beyond.any())
            found.append((drift.moved, any_light, drift.moved or any_light, named, *figures))
        together, single, alarm, named, *limits = np.mean(found, axis=0)
        said = "{:.3f} deg {:.3f} deg {:.2f} %".format(*limits)
        print(
            f"{setup:30}{fault:12}{together:9.2f}{single:8.2f}{alarm:6.2f}"
            f"{(f'{named:7.2f}' if fault else '       ')}  {said}",
            flush=True,
        )


if __name__ == "__main__":
    main()
