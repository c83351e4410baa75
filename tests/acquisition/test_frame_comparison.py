"""Two frames of the same light: shift, gain, focus, and what does not fit."""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations

import cv2
import numpy as np
import pytest

from acquisition import DataError
from acquisition.comparison import FrameComparison, compare_frames
from rig.arrays import Float64, UInt16
from simulator import open_rig_seeing, render, scene_named
from simulator.rigs import BenchFlaws
from tests.cases import cases

HEIGHT, WIDTH = 160, 224
BLACK, WHITE, ELECTRONS_PER_DN, READ_E = 64.0, 4095.0, 4.0, 8.0
LEVELS = {"black_level_dn": BLACK, "white_level_dn": WHITE}
# Waves with all directions, none shorter than 7 pixels: known between the pixels, too.
_RNG = np.random.default_rng(4)
WAVES = [
    (*(2 * np.pi / period * np.array([np.cos(turn), np.sin(turn)])), phase)
    for period, turn, phase in zip(
        _RNG.uniform(7, 60, 40), _RNG.uniform(0, np.pi, 40), _RNG.uniform(0, 6, 40), strict=True
    )
]


@cache
def relief(
    right: float = 0.0, down: float = 0.0, seed: int | None = None, step: float = 1.0
) -> Float64:
    """Return the light of a relief whose content was moved, 0 to about 2000 DN above black."""
    waves = WAVES
    if seed is not None:
        order = np.random.default_rng(seed).permutation(len(WAVES))
        waves = [(WAVES[i][0], -WAVES[i][1], WAVES[i][2] + i) for i in order]
    x, y = (step * np.arange(length) for length in (WIDTH, HEIGHT))
    # The waves exp(i (a x + b y + c)) are products of a column and a row.
    columns = np.exp([1j * (b * (y - down) + c) for _, b, c in waves])
    rows = np.exp([1j * a * (x - right) for a, *_ in waves])
    light: Float64 = 1000 + 100 * (columns.T @ rows).imag
    light.setflags(write=False)
    return light


def photographed(light: Float64, seed: int) -> UInt16:
    """Return samples of a sensor with shot noise, read noise and saturation."""
    electrons = np.maximum(light, 0) * ELECTRONS_PER_DN
    rng = np.random.default_rng(seed)
    signal = rng.poisson(electrons) + rng.normal(0, READ_E, light.shape)
    return np.rint(np.clip(BLACK + signal / ELECTRONS_PER_DN, 0, WHITE)).astype(np.uint16)


def compared(first: Float64, second: Float64, seed: int = 0, **options: bool) -> FrameComparison:
    shot = photographed(first, 2 * seed), photographed(second, 2 * seed + 1)
    return compare_frames(*shot, **LEVELS, **options)


SHIFTS = {
    "none": (0.0, 0.0),
    "a hundredth": (0.01, -0.01),
    "a half": (0.5, 0.5),
    "sub-pixel": (-0.3, 0.8),
    "some pixels": (2.4, -3.7),
    "far": (31.2, -17.6),
}


@cases(("right", "down"), SHIFTS)
@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_shift_and_gain_are_found_within_their_deviations(right, down, gain):
    found = compared(relief(), gain * relief(right, down))
    assert found.comparable
    assert found.same_object
    assert found.shift_px == pytest.approx((right, down), abs=0.04)
    for got, true, sigma in zip(found.shift_px, (right, down), found.shift_sigma_px, strict=True):
        assert sigma < 0.03
        assert abs(got - true) < 4 * sigma
    assert found.gain == pytest.approx(gain, abs=max(4 * found.gain_sigma, 0.001))
    assert found.focus == pytest.approx(1, abs=0.01)


def test_standard_deviations_are_those_of_repeated_frames():
    """Dim frames, so that noise and not interpolation decides."""
    first, second = 0.02 * relief(), 0.02 * relief(0.4, -0.2)
    found = [compared(first, second, seed) for seed in range(12)]
    shifts = np.array([one.shift_px for one in found])
    stated = np.array([one.shift_sigma_px for one in found]).mean(axis=0)
    assert np.all(np.abs(shifts.mean(axis=0) - (0.4, -0.2)) < 0.03)
    assert np.all(shifts.std(axis=0, ddof=1) < 1.7 * stated)
    assert np.all(shifts.std(axis=0, ddof=1) > 0.4 * stated)
    gains = np.array([one.gain for one in found])
    assert 0.3 < gains.std(ddof=1) / np.mean([one.gain_sigma for one in found]) < 1.7


def test_frames_without_noise_agree_exactly():
    found = compare_frames(*2 * [relief().astype(np.float32)])
    assert found.shift_px == (0, 0)
    assert (found.gain, found.other_fraction) == (1, 0)
    assert found.focus == pytest.approx(1)


@pytest.mark.parametrize("sigma_px", [0.6, 1.0, 1.5])
def test_the_focus_is_the_contrast_of_the_finest_structure(sigma_px):
    """Waves of 8 pixels: blur multiplies their contrast by exp(-(2 pi sigma / 8)^2 / 2)."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    waves = 1000 + 300 * (np.sin(x * np.pi / 4) + np.cos(y * np.pi / 4))
    blurred = np.asarray(cv2.GaussianBlur(waves, (0, 0), sigma_px))
    found = compared(waves, blurred)
    expected = math.exp(-((2 * np.pi * sigma_px / 8) ** 2) / 2)
    assert found.focus == pytest.approx(expected, abs=max(0.01, 4 * found.focus_sigma))
    assert compared(blurred, waves).focus == pytest.approx(1 / expected, rel=0.03)


def test_noise_is_not_sharpness():
    """Little light, and half of it: the differences of the second frame are mostly noise."""
    found = compared(0.1 * relief(), 0.05 * relief())
    assert found.focus == pytest.approx(1, abs=4 * found.focus_sigma)
    assert found.focus_sigma < 0.1


def with_patch(image: Float64, patch: Float64, box: tuple[int, int, int, int]) -> Float64:
    left, top, right, bottom = box
    changed = image.copy()
    changed[top:bottom, left:right] = patch[top:bottom, left:right]
    return changed


BOX = (96, 48, 160, 112)
OTHERS = {
    "a part moved by three pixels": with_patch(relief(), relief(3, 0), BOX),
    "another part": with_patch(relief(), relief(seed=1), BOX),
    "a part is gone": with_patch(relief(), np.full((HEIGHT, WIDTH), 1000.0), BOX),
    "a part is in shadow": with_patch(relief(), 0.5 * relief(), BOX),
}


@cases("second", OTHERS)
@pytest.mark.parametrize("move", [0.0, 1.6])
def test_a_part_that_does_not_fit_is_located(second, move):
    second = np.asarray(
        cv2.warpAffine(second, np.float64([[1, 0, move], [0, 1, 0]]), (WIDTH, HEIGHT))
    )
    found = compared(relief(), second)
    assert not found.same_object
    assert found.other_fraction == pytest.approx(64 * 64 / (HEIGHT * WIDTH), rel=0.4)
    assert found.other_box is not None
    assert np.abs(np.subtract(found.other_box, BOX)).max() <= 10
    assert found.shift_px == pytest.approx((move, 0), abs=0.06)
    assert found.gain == pytest.approx(1, abs=0.01)


def turned(degrees: float) -> Float64:
    turn = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), degrees, 1)
    return np.asarray(
        cv2.warpAffine(relief(), turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    )


SWAPPED = {
    "another relief": relief(seed=2),
    "mirrored": relief()[:, ::-1],
    "upside down": relief()[::-1],
    "enlarged": relief(step=0.7),
    "turned": turned(20),
    "a white card": np.full((HEIGHT, WIDTH), 1000.0),
}


@cases("second", SWAPPED)
def test_another_object_is_named(second):
    found = compared(relief(), second)
    assert found.comparable
    assert not found.same_object
    assert found.other_fraction > 0.4
    if found.other_fraction > 0.5:
        assert np.isnan(found.shift_px).all()


def test_every_frame_of_the_same_object_fits():
    """False alarms: none in 20 pairs of different brightness."""
    first, second = relief()[:80, :112], relief(0.2, 0.1)[:80, :112]
    for seed in range(0, 40, 2):
        level = 1.5 * 0.85**seed
        found = compared(level * first, level * second, seed)
        assert found.same_object, (seed, found)


UNLIT = {
    "the second": (relief(), 0 * relief(), 0.0),
    "the first": (0 * relief(), relief(), math.nan),
    "both": (0 * relief(), 0 * relief(), math.nan),
    "both saturated": (9 * relief() + 9000, 9 * relief() + 9000, math.nan),
}


@cases(("first", "second", "gain"), UNLIT)
def test_frames_without_usable_light_are_not_compared(first, second, gain):
    found = compared(first, second)
    assert not found.comparable
    assert not found.same_object
    assert np.isnan([*found.shift_px, *found.shift_sigma_px, found.focus]).all()
    assert found.gain == pytest.approx(gain, abs=0.001, nan_ok=True)


def test_saturated_parts_are_left_out():
    bright = 2.6 * relief()
    found = compared(bright, np.where(bright > WHITE - BLACK, 2 * bright, bright))
    assert 0.5 < found.judged_fraction < 0.95
    assert found.same_object
    assert found.shift_px == pytest.approx((0, 0), abs=0.02)
    assert found.gain == pytest.approx(1, abs=0.002)


def test_an_even_surface_has_no_shift():
    """Light that falls off over the frame does not move with the surface."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    card = 2000 / (1 + ((x - 200) ** 2 + y**2) / 300**2)
    found = compared(card, 0.97 * card)
    assert found.same_object
    assert np.isnan(found.shift_px).all()
    assert found.gain == pytest.approx(0.97, abs=0.001)


@pytest.mark.parametrize(("right", "down"), [(0.6, -0.4), (3.0, -5.0)])
def test_a_mosaic_moves_by_odd_pixels_too(right, down):
    filters = np.tile([[0.5, 1.0], [1.0, 0.7]], (HEIGHT // 2, WIDTH // 2))
    found = compared(filters * relief(), filters * relief(right, down), mosaic=True)
    assert found.same_object
    assert found.shift_px == pytest.approx((right, down), abs=0.06)
    assert found.focus == pytest.approx(1, abs=0.01)


def test_colours_are_averaged():
    shades = (0.5, 1.0, 0.7)
    first = np.dstack([photographed(s * relief(), i) for i, s in enumerate(shades)])
    second = np.dstack([photographed(s * relief(1.5, 0), 9 + i) for i, s in enumerate(shades)])
    found = compare_frames(first, second, **LEVELS)
    assert found.same_object
    assert found.shift_px == pytest.approx((1.5, 0), abs=0.03)


WRONG = {
    "another size": ((40, 50), (40, 51), "50 x 40 samples and 51 x 40 samples"),
    "another number of channels": ((40, 50), (40, 50, 3), "50 x 40 samples and 50 x 40 x 3"),
    "two channels": ((40, 50, 2), (40, 50, 2), "one or three channels"),
    "too small": ((15, 50), (15, 50), "at least 16 rows and columns"),
}


@cases(("one", "two", "says"), WRONG)
def test_frames_that_cannot_be_compared_are_refused(one, two, says):
    with pytest.raises(DataError, match=says):
        compare_frames(np.ones(one, np.uint16), np.ones(two, np.uint16))


@pytest.mark.usefixtures("simulated_world")
def test_a_stand_that_shakes_is_measured():
    """Simulated frames: the scatter of the shifts is that of the stand."""
    view = render(scene_named("coin", width=128, height=96, leds=2))
    with open_rig_seeing(
        view, realtime=False, camera="inside", flaws=BenchFlaws(shake_px=0.4)
    ) as rig:
        frames = [rig.shoot(1, 20_000.0).frame.pixels for _ in range(9)]
        white = float(rig.camera.info.white_dn)
    found = [compare_frames(frames[0], one, white_level_dn=white) for one in frames[1:]]
    assert all(one.same_object for one in found)
    shifts = np.array([one.shift_px for one in found])
    assert 0.2 < shifts.std(axis=0, ddof=1).mean() < 0.7
    assert all(max(one.shift_sigma_px) < 0.05 for one in found)


@pytest.mark.usefixtures("simulated_world")
def test_other_simulated_objects_do_not_fit():
    frames = {}
    for name in ("coin", "leather", "textile", "scales", "spheres"):
        view = render(scene_named(name, width=224, height=160, leds=4))
        with open_rig_seeing(view, realtime=False, camera="inside") as rig:
            frames[name] = [rig.shoot(1, 20_000.0).frame.pixels for _ in range(2)]
            white = float(rig.camera.info.white_dn)
    assert all(compare_frames(*pair, white_level_dn=white).same_object for pair in frames.values())
    for one, other in combinations(frames, 2):
        found = compare_frames(frames[one][0], frames[other][0], white_level_dn=white)
        assert found.other_fraction > 0.1, (one, other)
