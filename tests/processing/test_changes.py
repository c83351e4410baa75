"""Changes between two recordings of a surface: false alarms, detection, sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from acquisition import DataError
from processing import NormalMap
from processing.changes import Changes, find_changes
from processing.registration import Field
from rig.arrays import Float32, Float64
from tests.quick_sample import quick

SIZE = 200, 240
SIGMA = 0.004
BLUR = 0.8
Slopes = tuple[Float64, Float64]


@dataclass(frozen=True)
class Bump:
    """A Gaussian change of height with its middle in the map, blurred by the lens."""

    depth: float
    width: float
    long: bool
    angle_deg: float = 25.0

    def slopes(self) -> Slopes:
        """Return the slopes along columns and rows."""
        row, column = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
        down, right = row - SIZE[0] // 2, column - SIZE[1] // 2
        turn = math.radians(self.angle_deg)
        u = right * math.cos(turn) + down * math.sin(turn)
        v = down * math.cos(turn) - right * math.sin(turn)
        own = self.width / 2.3548
        across = math.hypot(own, BLUR)
        along = 12.0 if self.long else across
        height = -self.depth * (own / across) ** (1 if self.long else 2)
        height = height * np.exp(-0.5 * ((u / along) ** 2 + (v / across) ** 2))
        of_u, of_v = -u / along**2 * height, -v / across**2 * height
        return (
            of_u * math.cos(turn) - of_v * math.sin(turn),
            of_u * math.sin(turn) + of_v * math.cos(turn),
        )


def relief(seed: int, shift: float = 0.0) -> Slopes:
    """Return slopes of a surface with structure from 8 pixels, perhaps shifted to the right."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    slopes = np.zeros((2, *SIZE))
    for _ in range(40):
        k = 2 * math.pi / rng.uniform(8, 40)
        turn, phase = rng.uniform(0, 2 * math.pi, 2)
        wave = 0.03 * np.cos(k * (math.cos(turn) * (column - shift) + math.sin(turn) * row) + phase)
        slopes += np.array([math.cos(turn), math.sin(turn)])[:, None, None] * wave
    return slopes[0], slopes[1]


def field(slopes: Slopes, seed: int, *, albedo: Float64 | None = None) -> Field:
    """Return a recording of slopes along columns and rows, with noise."""
    rng = np.random.default_rng([seed, 5])
    column, row = (of + rng.normal(0, SIGMA, SIZE) for of in slopes)
    vectors = np.dstack([-column, row, np.ones(SIZE)])
    lit = None
    if albedo is not None:
        lit = np.asarray(albedo * np.exp(rng.normal(0, SIGMA, SIZE)), np.float32)
    sigma = np.full(SIZE, math.degrees(SIGMA) * math.sqrt(2), np.float32)
    return Field(NormalMap.from_vectors(vectors), lit, sigma)


def added(*slopes: Slopes) -> Slopes:
    return sum(of[0] for of in slopes), sum(of[1] for of in slopes)  # type: ignore[return-value]


def compared(before: Slopes, after: Slopes, seed: int) -> Changes:
    return find_changes(field(before, seed), field(after, 1000 + seed), blur_px=BLUR)


@pytest.mark.slow
def test_noise_raises_no_more_false_alarms_than_stated() -> None:
    alarms = 0
    for seed in range(8):
        still = relief(seed)
        alarms += bool(compared(still, still, seed).changes)
    # More than 2 of 8 have a probability of less than 1 %.
    assert alarms <= 2


def smooth_errors(slopes: Slopes) -> Slopes:
    """Return what lights that deviate do to slopes, differently in the map."""
    share = np.linspace(0.98, 1.03, SIZE[1])
    return 0.02 + share * slopes[0] + 0.02 * slopes[1], share * slopes[1] - 0.03


def blurred(slopes: Slopes) -> Slopes:
    column, row = (cv2.GaussianBlur(of, (0, 0), 0.4) for of in slopes)
    return column, row


def curl(slopes: Slopes) -> Slopes:
    return -slopes[1], slopes[0]


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize(
    "error",
    [
        pytest.param(lambda seed: smooth_errors(relief(seed)), id="lights"),
        pytest.param(lambda seed: relief(seed, 0.15), id="shift"),
        pytest.param(lambda seed: blurred(relief(seed)), id="blur"),
        pytest.param(
            lambda seed: added(relief(seed), curl(Bump(0.3, 3, long=False).slopes())),
            id="no surface has this curl",
        ),
    ],
)
def test_errors_of_recordings_are_no_changes(error: object, seed: int) -> None:
    found = compared(relief(seed), error(seed), seed)  # type: ignore[operator]
    assert not found.changes


@pytest.mark.parametrize(
    "bump",
    [
        pytest.param(Bump(0.06, 2, long=True), id="scratch, 2 px"),
        pytest.param(Bump(0.06, 4, long=True, angle_deg=110), id="scratch, 4 px"),
        pytest.param(Bump(-0.06, 2, long=True), id="ridge"),
        pytest.param(Bump(0.15, 5, long=False), id="spot"),
    ],
)
def test_a_change_is_found_with_its_size(bump: Bump) -> None:
    for seed in range(2):
        still = relief(seed)
        found = compared(still, added(still, bump.slopes()), seed)
        assert len(found.changes) == 1
        change = found.changes[0]
        assert change.kind == "surface"
        assert math.hypot(change.row - SIZE[0] // 2, change.column - SIZE[1] // 2) < 12
        assert abs(change.height_px + bump.depth) < 2 * change.height_sigma_px < abs(bump.depth)
        assert abs(change.width_px - bump.width) < 2 * change.width_sigma_px
        assert found.significant[change.row, change.column]
        assert np.sign(found.z[change.row, change.column]) == -np.sign(bump.depth)


@pytest.mark.parametrize(("share", "least", "most"), quick([(1.0, 5, 6), (0.4, 0, 1)], every=2))
def test_the_level_of_detection_is_the_smallest_change_that_is_found(
    share: float, least: int, most: int
) -> None:
    level = next(one for one in compared(relief(0), relief(0), 0).levels if one.width_px == 2)
    found = 0
    for seed in range(6):
        still = relief(seed)
        bump = Bump(share * level.scratch, 2, long=True, angle_deg=30.0 * seed)
        found += bool(compared(still, added(still, bump.slopes()), seed).changes)
    assert least <= found <= most


def test_a_spot_of_paint_is_a_change_of_the_albedo() -> None:
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    spot = 1 - 0.03 * np.exp(-0.5 * ((row - 80) ** 2 + (column - 60) ** 2) / 2.0**2)
    still, even = relief(1), np.full(SIZE, 0.5)
    found = find_changes(field(still, 1, albedo=even), field(still, 2, albedo=even * spot))
    (change,) = found.changes
    assert change.kind == "albedo"
    assert (change.row, change.column) == pytest.approx((80, 60), abs=2)
    assert change.albedo_factor == pytest.approx(0.97, abs=3 * change.albedo_sigma + 0.01)


def test_a_recording_is_not_compared_with_itself() -> None:
    one = field(relief(1), 1)
    with pytest.raises(DataError, match="of the same recording"):
        find_changes(one, one)


def test_the_factor_of_a_wide_patch_of_paint() -> None:
    patch = np.ones(SIZE)
    patch[60:85, 40:65] = 0.8
    still, even = relief(1), np.full(SIZE, 0.5)
    found = find_changes(field(still, 1, albedo=even), field(still, 2, albedo=even * patch))
    (change,) = found.changes
    assert change.kind == "albedo"
    assert change.albedo_factor == pytest.approx(0.8, abs=2 * change.albedo_sigma + 0.02)


def test_an_edge_of_paint_that_is_sampled_differently_is_no_change() -> None:
    row, column = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    still = np.zeros(SIZE), np.zeros(SIZE)

    def striped(offset_px: Float64 | float) -> Float64:
        return np.asarray(0.7 + 0.2 * np.tanh(8 * np.sin((row - offset_px) / 8)), np.float64)

    displaced = 0.2 * np.exp(-0.5 * ((row - 101) ** 2 + (column - 120) ** 2) / 3**2)
    before, after = field(still, 1, albedo=striped(0)), field(still, 2, albedo=striped(displaced))
    assert not find_changes(before, after).changes


def test_a_smaller_false_alarm_raises_the_threshold_and_the_level() -> None:
    pair = field(relief(0), 0), field(relief(0), 1)
    often, rarely = (find_changes(*pair, false_alarm=rate) for rate in (0.05, 0.001))
    assert often.threshold < rarely.threshold
    assert all(a.scratch < b.scratch for a, b in zip(often.levels, rarely.levels, strict=True))


def _without(one: Field, **changed: Float32 | None) -> Field:
    parts = {"albedo": one.albedo, "sigma_deg": one.sigma_deg} | changed
    return Field(one.normal_map, **parts)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rate", "edit", "message"),
    [
        (0.05, {"sigma_deg": None}, "requires the error bars"),
        (0.05, {"sigma_deg": np.full(SIZE, np.nan, np.float32)}, "no pixel"),
        (1.5, {}, "not between 0 and 1"),
    ],
)
def test_bad_input_is_refused(rate: float, edit: dict[str, Float32 | None], message: str) -> None:
    one = field(relief(0), 0)
    with pytest.raises(DataError, match=message):
        find_changes(one, _without(one, **edit), false_alarm=rate)
