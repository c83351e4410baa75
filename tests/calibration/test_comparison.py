"""Two calibrations of the same lights: differences, common motion, exchanged lights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from acquisition import DataError, LightErrors, Lights, Setup
from acquisition.values import Calibrated
from calibration import compare_lights
from calibration.comparison import compare_with_rig, light_drift
from rig import RigConfig
from rig.arrays import Float64
from tests.calibration.conftest import codes
from tests.cases import cases
from tests.quick_sample import quick


def dome(count: int, seed: int = 0) -> Lights:
    """Return lights on three rings of a dome, 450 mm from the origin, up to some millimetres."""
    rng = np.random.default_rng(seed)
    rows = np.arange(count)
    rise = np.radians(np.array([30, 50, 70])[rows % 3])
    around = 2 * np.pi * rows / count
    towards = [np.cos(rise) * np.cos(around), np.cos(rise) * np.sin(around), np.sin(rise)]
    return Lights(positions_mm=450 * np.stack(towards, axis=1) + rng.normal(0, 4, (count, 3)))


def ring(count: int) -> Lights:
    around = 2 * np.pi * np.arange(count) / count
    flat = np.stack([np.cos(around), np.sin(around), np.ones(count)], axis=1)
    return Lights(positions_mm=300 * flat)


def turned(angle_deg: float, axis: tuple[float, float, float]) -> Float64:
    unit = np.array(axis) / np.linalg.norm(axis)
    return np.asarray(Rotation.from_rotvec(np.radians(angle_deg) * unit).as_matrix())


def at(lights: Lights, vectors: Float64) -> Lights:
    if lights.near:
        return replace(lights, positions_mm=vectors, axes=None)
    return Lights(directions=vectors, ids=lights.ids)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 40), near=st.booleans())
def test_a_calibration_equals_itself(seed: int, count: int, near: bool) -> None:
    lights = dome(count, seed)
    lights = replace(lights, intensities=np.random.default_rng(seed).uniform(0.1, 9, (count, 3)))
    lights = lights if near else lights.distant()
    found = compare_lights(lights, lights)
    assert found.angle_deg.max() == pytest.approx(0, abs=1e-12)
    assert near == (found.distance_mm is not None)
    if found.distance_mm is not None:
        assert not found.distance_mm.any()
    assert found.intensity_factor == 1
    assert not found.intensity_percent.any()
    assert found.same_order
    assert found.motion is None
    assert found.warnings == ()


@settings(max_examples=10)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(5, 20),
    angle=st.floats(0.05, 60),
    axis=st.tuples(*[st.floats(-1, 1)] * 2, st.floats(0.2, 1)),
    near=st.booleans(),
)
def test_a_turn_of_the_whole_is_named(
    seed: int, count: int, angle: float, axis: tuple[float, float, float], near: bool
) -> None:
    before = dome(count, seed) if near else dome(count, seed).distant()
    vectors = before.unit_directions if before.positions_mm is None else before.positions_mm
    found = compare_lights(before, at(before, vectors @ turned(angle, axis).T))
    assert codes(found) == ["lights-moved-together"]
    assert "turned together by" in str(found.warnings[0])
    assert found.motion is not None
    assert found.motion.angle_deg == pytest.approx(angle, abs=1e-3)
    np.testing.assert_allclose(found.motion.axis, axis / np.linalg.norm(axis), atol=1e-4)
    assert found.rest_deg.max() < 1e-4
    assert found.same_order


SWAPPED = np.array([0, 1, 2, 3, 4, 5, 6, 8, 7, 9, 10, 11])
CYCLE = np.array([0, 2, 3, 1, 4, 5, 6, 7, 8, 9, 10, 11])
SHUFFLED = np.array([5, 8, 0, 11, 1, 3, 9, 4, 10, 2, 7, 6])


@pytest.mark.parametrize("near", quick([True, False], every=2))
@pytest.mark.parametrize("noise", [0, 1e-3], ids=["exact", "noise"])
@cases(
    ("change", "expected", "words"),
    {
        "nothing": (lambda v: v, [], ""),
        "swap": (lambda v: v[SWAPPED], ["lights-swapped"], "LED 7 and 8 are swapped"),
        "cycle of three": (
            lambda v: v[CYCLE],
            ["lights-swapped"],
            "LED 1, 2 and 3 are exchanged: LED 1 is at the place of LED 2",
        ),
        "shuffled": (lambda v: v[SHUFFLED], ["lights-swapped"], "12 of 12 are at"),
        "rev": (lambda v: v[::-1], ["lights-reversed"], "L00 is at the place of L"),
        "mirrored x": (lambda v: v * [-1, 1, 1], ["lights-flipped"], "left and right are exch"),
        "mirrored y": (lambda v: v * [1, -1, 1], ["lights-flipped"], "top and bottom are exch"),
        "swap and turn": (
            lambda v: v[SWAPPED] @ turned(5, (0, 0, 1)).T,
            ["lights-swapped", "lights-moved-together"],
            "turned together by",
        ),
        "mirrored and turned": (
            lambda v: v * [1, -1, 1] @ turned(5, (0, 0, 1)).T,
            ["lights-flipped", "lights-moved-together"],
            "turned together by",
        ),
    },
)
def test_the_cause_is_named(
    near: bool, noise: float, change: Callable[[Float64], Float64], expected: list[str], words: str
) -> None:
    before = dome(12) if near else dome(12).distant()
    vectors = before.unit_directions if before.positions_mm is None else before.positions_mm
    length = np.linalg.norm(vectors, axis=1).mean()
    drawn = np.random.default_rng(1).normal(0, noise * length, vectors.shape)
    found = compare_lights(before, at(before, change(vectors) + drawn))
    assert codes(found) == expected
    assert words in " ".join(map(str, found.warnings))
    assert found.rest_deg.max() < max(1e-6, 4 * np.degrees(noise))


def test_a_light_that_moved_alone_is_the_worst() -> None:
    before = dome(12)
    assert before.positions_mm is not None
    moved = before.positions_mm.copy()
    moved[4] += [0, 3, 4]
    found = compare_lights(before, at(before, moved))
    assert codes(found) == []
    assert found.worst_first[0] == 4
    assert found.distance_mm is not None
    np.testing.assert_allclose(found.distance_mm, np.where(np.arange(12) == 4, 5, 0), atol=1e-12)
    whole = compare_lights(before, at(before, moved @ turned(3, (1, 2, 3)).T + [9, 0, -4]))
    assert codes(whole) == ["lights-moved-together"]
    assert whole.rest_mm is not None
    assert np.argmax(whole.rest_mm) == 4
    assert whole.rest_mm[4] == pytest.approx(5, abs=0.1)


def test_a_turned_regular_ring_is_a_turn_and_not_another_order() -> None:
    before = ring(12)
    assert before.positions_mm is not None
    found = compare_lights(before, at(before, before.positions_mm @ turned(30, (0, 0, 1)).T))
    assert codes(found) == ["lights-moved-together"]


def test_a_shift_is_named_as_a_shift() -> None:
    before = dome(12)
    assert before.positions_mm is not None
    found = compare_lights(before, at(before, before.positions_mm + np.array([3, 0, -4])))
    assert found.motion is not None
    assert found.motion.angle_deg < 1e-6
    np.testing.assert_allclose(found.motion.shift_mm, [3, 0, -4], atol=1e-9)
    assert "shifted together by 5 mm, (3, 0, -4)" in str(found.warnings[0])


@pytest.mark.parametrize("near", [True, False])
def test_noise_alone_is_no_cause(near: bool) -> None:
    before = dome(36) if near else dome(36).distant()
    vectors = before.unit_directions if before.positions_mm is None else before.positions_mm
    for seed in range(3):
        rng = np.random.default_rng(seed)
        after = vectors + rng.normal(0, 0.4 if near else 1e-3, vectors.shape)
        assert codes(compare_lights(before, at(before, after))) == []
        # A common shift that is certain, but explains few of the differences.
        shift = np.array([0.3, 0, 0]) / (1 if near else 400)
        assert codes(compare_lights(before, at(before, after + shift))) == []


def test_only_the_exchange_that_the_data_require_is_named() -> None:
    positions = np.array(dome(12).positions_mm)
    positions[1] = positions[0] + [0.24, 0.18, 0]
    before = at(dome(12), positions)
    order = np.array([1, 0, 2, 3, 4, 5, 6, 8, 7, 9, 10, 11])
    noise = np.random.default_rng(0).normal(0, 0.4, positions.shape)
    noise[:2] = 0
    found = compare_lights(before, at(before, positions[order] + noise))
    assert found.exchanged == (("L07", "L08"),)


def test_intensities_differ_after_removing_their_common_factor() -> None:
    before = replace(dome(5), intensities=np.array([1, 2, 3, 4, 5.0]))
    strong = np.array([1, 2, 3, 4, 5.0])[:, None] * 1.5 * np.ones(3)
    strong[3, 1] *= 0.9
    found = compare_lights(before, replace(before, intensities=strong))
    assert found.intensity_factor == pytest.approx(1.5)
    np.testing.assert_allclose(found.intensity_percent, [0, 0, 0, -10, 0], atol=1e-12)
    assert found.worst_first[0] == 3
    errors = LightErrors(intensity_std=np.array([0.03, 0.06, 0.09, 0.12, 0.15]))
    known = compare_lights(
        replace(before, errors=errors), replace(before, intensities=strong, errors=errors)
    )
    relative = np.hypot(0.12 / 4, 0.12 / (4 * 1.5 * 0.9))
    np.testing.assert_allclose(known.intensity_deviations[3], -np.log(0.9) / relative)
    assert np.isnan(found.intensity_deviations).all()
    for one, other in ((dome(5), before), (before, dome(5)), (dome(5), dome(5))):
        unknown = compare_lights(one, other)
        assert np.isnan(unknown.intensity_factor)
        assert np.isnan(unknown.intensity_percent).all()


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 6, 12, 36])
@pytest.mark.parametrize("near", [True, False])
def test_noise_and_one_moved_light_are_rarely_taken_for_a_motion(count: int, near: bool) -> None:
    before = dome(count) if near else dome(count).distant()
    vectors = before.unit_directions if before.positions_mm is None else before.positions_mm
    named = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        after = vectors + rng.normal(0, 0.4 if near else 1e-3, vectors.shape)
        if seed % 2:
            after[rng.integers(count)] += np.array([20, 10, -5]) * (1 if near else 3e-3)
        named += codes(compare_lights(before, at(before, after)))
    assert len(named) <= (0 if count >= 12 else 4)


def test_deviations_of_positions() -> None:
    before = dome(12)
    assert before.positions_mm is not None
    covariances = np.tile(np.diag([1, 4, 9.0]), (12, 1, 1))
    covariances[2] = np.nan
    first = replace(before, errors=LightErrors(covariances=covariances))
    second = replace(before, errors=LightErrors(covariances=3 * covariances))
    moved = before.positions_mm.copy()
    moved[4] += [2, 4, 60]
    moved[2] += 1
    found = compare_lights(first, replace(second, positions_mm=moved))
    # The covariance of the difference is four times the first one: standard deviations 2, 4, 6.
    assert found.deviations[4] == pytest.approx(np.sqrt(1 + 1 + 100))
    assert np.isnan(found.deviations[2])
    assert found.deviations[0] == 0
    assert codes(found) == ["lights-changed"]
    assert "1 light of 12 differs" in str(found.warnings[0])
    assert "L04 (10.1)" in str(found.warnings[0])
    assert np.isnan(compare_lights(before, second).deviations).all()
    # A light of which no error is possible.
    exact = LightErrors(covariances=np.zeros((12, 3, 3)))
    sure = compare_lights(
        replace(before, errors=exact), replace(before, positions_mm=moved, errors=exact)
    )
    assert np.isposinf(sure.deviations[4])
    assert sure.deviations[0] == 0


def test_deviations_of_directions_have_the_distribution_that_they_state() -> None:
    before = dome(12).distant()
    sigma = 2e-3
    errors = LightErrors(covariances=np.tile(sigma**2 / 2 * np.eye(2), (12, 1, 1)))
    before = replace(before, errors=errors)
    rng = np.random.default_rng(0)
    squares = []
    for _ in range(20):
        after = at(before, before.unit_directions + rng.normal(0, sigma, (12, 3)))
        found = compare_lights(before, replace(after, errors=errors))
        squares.extend(found.deviations**2)
        assert codes(found) == []
    # Chi-square with two degrees of freedom: mean 2, standard error 2 / sqrt(240).
    assert np.mean(squares) == pytest.approx(2, abs=0.4)


@cases(
    ("other", "match"),
    {
        "kind": (dome(12).distant(), "calibration has positions, the second d"),
        "number": (dome(11), "the first calibration has 12 lights, the second 11"),
        "names": (
            replace(dome(12), ids=tuple(f"L{n:02d}" for n in range(1, 13))),
            "name their lights differently: the second has no L00",
        ),
    },
)
def test_refused(other: Lights, match: str) -> None:
    with pytest.raises(DataError, match=match) as caught:
        compare_lights(dome(12), other)
    assert "\n" not in str(caught.value)


CALIBRATED = Calibrated(datetime.now(UTC))


@pytest.mark.parametrize("calibrated", [True, False])
def test_lights_that_a_calibration_left_out_are_named(calibrated: bool) -> None:
    """35 of 36 lights, then another 35; without `calibrated`, names may only be the order."""
    whole = replace(dome(36), calibrated=CALIBRATED if calibrated else None)
    first = whole.take([n for n in range(36) if n != 20])
    moved = np.asarray(whole.positions_mm) + np.array([0, 0, 2])
    second = replace(whole, positions_mm=moved, axes=None).take([*range(35, 7, -1), *range(7)])
    cases = [(whole, first, ["L20"]), (first, whole, ["L20"]), (first, second, ["L07", "L20"])]
    for a, b, missing in cases:
        if not calibrated:
            with pytest.raises(DataError, match="compare calibrations of the same lights"):
                compare_lights(a, b)
            continue
        found = compare_lights(a, b)
        said = " ".join(n.text for n in found.warnings if n.code == "lights-not-compared")
        assert found.ids == tuple(name for name in whole.ids if name not in missing)
        assert all(name in said for name in missing)
        assert found.distance_mm is not None
        assert found.distance_mm == pytest.approx(2 if b is second else 0)
        assert found.same_order


def test_calibrations_with_few_lights_in_common_are_refused() -> None:
    whole = replace(dome(12), calibrated=CALIBRATED)
    for few in (range(5), [0]):
        with pytest.raises(DataError, match="has 12 lights, the second"):
            compare_lights(whole, whole.take(list(few)))
    renamed = replace(whole, ids=tuple(f"L{n}" for n in range(7, 19)))
    with pytest.raises(DataError, match="the second has no L00"):
        compare_lights(whole, renamed)


def test_lights_are_matched_by_name() -> None:
    before = dome(12)
    found = compare_lights(before, before.take(SHUFFLED.tolist()))
    assert found.angle_deg.max() == 0
    renamed = replace(before, ids=tuple(f"photo{n}.jpg" for n in range(12)))
    assert codes(compare_lights(before, renamed)) == ["lights-matched-by-order"]


@cases(
    ("then", "now", "named"),
    {
        "the same": (Setup(rig="dome"), Setup(rig="dome"), []),
        "not stated": (Setup(rig="dome"), Setup(camera_serial="7"), []),
        "another rig": (Setup(rig="dome"), Setup(rig="arc"), ["setups-differ"]),
        "another camera": (Setup(camera_serial="7"), Setup(camera_serial="8"), ["setups-differ"]),
    },
)
def test_calibrations_of_another_rig_or_camera_are_named(
    then: Setup, now: Setup, named: list[str]
) -> None:
    a, b = (replace(dome(12), calibrated=Calibrated(setup=one)) for one in (then, now))
    assert codes(compare_lights(a, b)) == named
    moved = [replace(b, positions_mm=b.positions_mm + by) for by in ([[1, 0, 0]], [[0, 1, 0]])]
    said = [one for one in light_drift([a, *moved]).warnings if one.code == "setups-differ"]
    assert len(said) == 2 * len(named)


def config(positions: Float64) -> RigConfig:
    rows = tuple(tuple(row) for row in positions.tolist())
    return RigConfig(name="dome one", driver="bench", leds=len(rows), led_positions_mm=rows)


@pytest.mark.parametrize("near", [True, False])
def test_lights_against_a_rig_file(near: bool) -> None:
    lights = dome(36) if near else dome(36).distant()
    positions = dome(36).positions_mm
    assert positions is not None
    rough = np.round(positions / 10) * 10
    assert codes(compare_with_rig(lights, config(rough))) == []
    assert codes(compare_with_rig(lights.take(range(5, 30)), config(rough))) == []
    swapped = rough.copy()
    swapped[[7, 8]] = swapped[[8, 7]]
    found = compare_with_rig(lights, config(swapped))
    assert codes(found) == ["lights-swapped"]
    assert "LED 7 and 8 are swapped" in str(found.warnings[0])
    rough[20] += [80, 0, -60]
    found = compare_with_rig(lights, config(rough))
    assert codes(found) == (["lights-changed"] if near else [])
    assert not near or "L20" in str(found.warnings[0])


def test_directions_that_were_measured_next_to_the_origin_do_not_contradict_a_rig_file() -> None:
    positions = dome(36).positions_mm
    assert positions is not None
    seen = Lights(directions=positions - np.array([90, -70, 20]))
    assert codes(compare_with_rig(seen, config(positions))) == []
    swapped = positions.copy()
    swapped[[7, 8]] = swapped[[8, 7]]
    assert codes(compare_with_rig(seen, config(swapped))) == ["lights-swapped"]
    quarter = config(positions @ turned(90, (0, 0, 1)))
    assert codes(compare_with_rig(seen, quarter)) == ["lights-moved-together"]


@cases(
    ("lights", "rig", "match"),
    {
        "none": (dome(6), RigConfig(name="r", driver="b"), "no led_positions_mm"),
        "more LEDs": (dome(6), config(np.eye(3) * 100), "light L03 is not one of the 3 LEDs"),
        "names": (replace(dome(2), ids=("a", "b")), config(np.eye(3) * 100), "light a is not"),
        "twice": (
            replace(dome(2), ids=("L00", "L00_E1")),
            config(np.eye(3) * 100),
            "two lights belong to LED 0",
        ),
    },
)
def test_rig_file_refused(lights: Lights, rig: RigConfig, match: str) -> None:
    with pytest.raises(DataError, match=match):
        compare_with_rig(lights, rig)
