"""Metering on a rig with exactly known light, and on the simulated rig."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import CapturePlan, DataError
from acquisition.metering import LightLevel, MeteringGoal, meter
from acquisition.metering.light_level import better_exposure_us, light_level, stepped_us
from rig import CameraFrame, CameraInfo, Rig, RigError, Shot
from rig.arrays import Float64
from tests.quick_sample import quick

BLACK_DN = 64.0
WHITE_DN = 4095.0
# Grey values above black per microsecond and unit of strength: a ramp over the whole frame.
RAMP = np.tile(np.linspace(0.0, 0.2, 200), (50, 1))


@dataclass
class NumberRig:
    """The part of a rig that `meter` uses, with exactly known light."""

    strengths: dict[int, float]
    room: float = 0.0
    step_us: float = 0.0
    range_us: tuple[float, float] = (10.0, 10e6)
    noise_dn: float = 2.0
    ramp: Float64 = field(default_factory=lambda: RAMP)
    shots: list[tuple[int | None, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        low_us, high_us = self.range_us
        info = CameraInfo("M", "E", "42", 200, 50, "Mono12", 12, None, low_us, high_us)
        self.camera = SimpleNamespace(info=info)
        self.board = SimpleNamespace(identity=SimpleNamespace(max_hold_ms=60_000))
        self.config = SimpleNamespace(name="numbers")
        self._random = np.random.default_rng(7)

    def shoot(self, led: int | None, exposure_us: float, gain_db: float = 0.0) -> Shot:
        assert self.range_us[0] <= exposure_us <= self.range_us[1]
        self.shots.append((led, exposure_us))
        real_us = exposure_us
        if self.step_us:
            real_us = max(self.step_us, round(exposure_us / self.step_us) * self.step_us)
        light = 0.0 if led is None else self.strengths[led]
        grey = BLACK_DN + 10 ** (gain_db / 20) * real_us * (self.ramp * light + self.room)
        grey += self._random.normal(0, self.noise_dn, grey.shape)
        pixels = np.clip(np.rint(grey), 0, WHITE_DN).astype(np.uint16)
        return Shot(CameraFrame(pixels, 0, 0, real_us, gain_db, None), led, None)


def metered(rig: NumberRig, plan: CapturePlan, **goal: Any) -> Any:
    return meter(cast(Rig, rig), plan, MeteringGoal(**goal))


def plan_of(*leds: int, **others: Any) -> CapturePlan:
    return CapturePlan(repeat=False, **{"leds": leds, "exposures_us": (20_000.0,), **others})


def expected_us(strength: float, fraction: float = 0.7, percentile: float = 99.5) -> float:
    """Return the exposure at which the ramp's percentile is at a fraction of the range."""
    return fraction * (WHITE_DN - BLACK_DN) / (0.2 * percentile / 100 * strength)


@pytest.mark.parametrize(
    "goal",
    [
        pytest.param({}, id="default"),
        pytest.param({"percentile": 90.0, "max_clipped_fraction": 0.1}, id="90th"),
        pytest.param({"fraction": 0.3}, id="darker"),
        pytest.param({"fraction": 0.9}, id="brighter"),
        pytest.param({"start_us": 100.0}, id="from-short"),
        pytest.param({"start_us": 900_000.0}, id="from-long"),
    ],
)
def test_every_light_gets_the_exposure_it_needs(goal: dict[str, float]) -> None:
    strengths = {0: 1.0, 3: 0.5, 5: 4.0, 6: 0.97}
    found = metered(NumberRig(strengths), plan_of(*strengths), **goal)
    for light in found.lights:
        wanted = expected_us(
            strengths[light.led], goal.get("fraction", 0.7), goal.get("percentile", 99.5)
        )
        assert light.state == "ok"
        assert found.plan.exposure_us(light.led, 0) == pytest.approx(wanted, rel=0.03)
        assert light.level == pytest.approx(goal.get("fraction", 0.7), rel=0.03)
    assert found.warnings == ()
    assert abs(found.black_dn - BLACK_DN) <= 1


def test_one_exposure_for_all_suits_the_brightest() -> None:
    found = metered(NumberRig({0: 1.0, 1: 3.0, 2: 0.5}), plan_of(0, 1, 2), each=False)
    assert found.plan.exposures_by_led == {}
    assert found.plan.exposures_us[0] == pytest.approx(expected_us(3.0), rel=0.03)


def test_brackets_keep_their_ratio_and_share_exposures() -> None:
    plan = plan_of(0, 1, 2, exposures_us=(20_000.0, 400.0), gain_db=6.0)
    found = metered(NumberRig({0: 0.1, 1: 0.1, 2: 0.3}), plan)
    assert list(found.plan.exposures_by_led) == [2]
    for led in plan.leds:
        long_us, short_us = (found.plan.exposure_us(led, bracket) for bracket in (0, 1))
        assert long_us / short_us == pytest.approx(50, rel=0.013)
    assert found.plan.exposure_us(0, 0) == pytest.approx(expected_us(0.1 * 10**0.3), rel=0.03)


def test_brackets_that_would_be_the_same_are_refused() -> None:
    rig = NumberRig({0: 1.0}, range_us=(5000.0, 1e6))
    with pytest.raises(DataError, match=r"bracket 2 of LED 0 would have .* bracket, 5000 us"):
        metered(rig, plan_of(0, exposures_us=(20_000.0, 400.0, 40.0)))


def test_saturation_of_a_small_part_limits_the_exposure() -> None:
    ramp = RAMP.copy()
    ramp[:, -1] = 4.0  # half a per cent of the frame is twenty times as bright as the rest
    rig = NumberRig({0: 1.0}, ramp=ramp)
    free = metered(rig, plan_of(0), percentile=99.0, max_clipped_fraction=0.006)
    assert free.lights[0].clipped_fraction == pytest.approx(0.005)
    assert free.plan.exposures_us[0] == pytest.approx(expected_us(1.0, percentile=99), rel=0.03)
    for bound in (
        metered(rig, plan_of(0), percentile=99.0, max_clipped_fraction=0.001),
        metered(rig, plan_of(0, max_clipped_fraction=0.001), percentile=99.0),
    ):
        assert bound.lights[0].state == "ok"
        assert bound.lights[0].clipped_fraction <= 0.001
        # The longest possible exposure: the bright part is just below saturation.
        assert 4.0 * bound.plan.exposures_us[0] == pytest.approx(0.95 * 4031, rel=0.03)


@pytest.mark.parametrize(
    "room",
    [
        pytest.param(0.0, id="dark-room"),
        pytest.param(0.001, id="dim-room"),
        pytest.param(0.2, id="room-as-bright-as-the-LEDs"),
    ],
)
def test_a_dead_led_is_left_out_and_reported(room: float) -> None:
    plan = plan_of(2, 0, 1, 3)
    found = metered(NumberRig({0: 1.0, 1: 0.0, 2: 0.0, 3: 0.5}, room=room), plan)
    assert found.dead_leds == (2, 1)
    assert found.plan.leds == (0, 3)
    assert [light.state for light in found.lights] == ["dead", "ok", "dead", "ok"]
    assert len(found.warnings) == 2
    assert "LED 2 gives no light" in str(found.warnings[0])


def test_a_weak_light_is_not_dead() -> None:
    found = metered(NumberRig({0: 1.0, 1: 0.002}, room=0.0005), plan_of(0, 1))
    assert found.dead_leds == ()
    assert [light.state for light in found.lights] == ["ok", "too dark"]
    assert found.plan.exposure_us(1, 0) == 1_000_000.0
    assert "reaches" in str(found.warnings[0])


def test_no_light_at_all_is_an_error_of_the_rig() -> None:
    with pytest.raises(RigError, match=r"no LED of rig numbers gives light .* lens cap"):
        metered(NumberRig({0: 0.0, 1: 0.0}), plan_of(0, 1))


def test_too_much_light_is_reported() -> None:
    found = metered(NumberRig({0: 1.0, 1: 50_000.0}), plan_of(0, 1))
    assert [light.state for light in found.lights] == ["ok", "too bright"]
    assert found.plan.exposure_us(1, 0) == 10.0
    assert "LED 1 is saturated at the shortest exposure of 0.01 ms" in str(found.warnings[0])


def test_a_camera_with_coarse_steps_gets_the_nearest_exposure() -> None:
    # 21 ms would be exact; the camera supports 16 or 32 ms.
    strength = expected_us(1.0) / 21_000
    found = metered(NumberRig({0: strength}, step_us=16_000.0), plan_of(0))
    assert found.lights[0].state == "coarse"
    assert found.lights[0].level == pytest.approx(0.7 * 16 / 21, rel=0.01)


def test_few_shots_none_of_them_longer_than_allowed() -> None:
    strengths = {led: 1.0 + 0.02 * led for led in range(36)}
    rig = NumberRig(strengths)
    found = metered(rig, plan_of(*strengths), longest_us=50_000.0)
    assert max(us for _, us in rig.shots) <= 50_000
    assert sum(light.shots for light in found.lights) <= 2.5 * 36
    # LEDs of similar brightness share an exposure and so a dark frame.
    assert len(found.plan.distinct_exposures_us) < 30


def test_results_can_be_stored_as_json() -> None:
    found = metered(NumberRig({0: 1.0, 1: 0.0}), plan_of(0, 1))
    details = json.loads(json.dumps(found.details(), allow_nan=False))
    assert details["dead_leds"] == [1]
    assert details["percentile"] == 99.5
    assert details["lights"][0]["exposure_us"] == found.plan.exposures_us[0]


@pytest.mark.parametrize(
    "values",
    [
        pytest.param({"percentile": 0.0}, id="percentile-0"),
        pytest.param({"percentile": 101.0}, id="percentile-101"),
        pytest.param({"fraction": 1.0}, id="full-scale"),
        pytest.param({"max_clipped_fraction": -0.1}, id="negative-clipping"),
        pytest.param({"start_us": float("inf")}, id="endless"),
        pytest.param({"longest_us": float("nan")}, id="no-number"),
    ],
)
def test_a_goal_that_is_out_of_range(values: dict[str, Any]) -> None:
    with pytest.raises(DataError, match=next(iter(values))):
        MeteringGoal(**values)


@given(st.floats(1.0, 1e7), st.floats(1.0, 50.0))
def test_steps_are_near_and_in_range(exposure_us: float, low_us: float) -> None:
    stepped = stepped_us(exposure_us, low_us, 2e6)
    assert low_us <= stepped <= 2e6
    if low_us < exposure_us < 2e6:
        # Half a step is 1.2 %, and three digits add up to .5 %: 135 becomes 137.
        assert stepped == pytest.approx(exposure_us, rel=0.0171)
    assert stepped_us(stepped, low_us, 2e6) == stepped


@given(st.data())
def test_levels_are_counted_exactly(data: st.DataObject) -> None:
    values = data.draw(st.lists(st.integers(0, 4095), min_size=1, max_size=60))
    percentile = data.draw(st.sampled_from([1.0, 50.0, 99.5, 100.0]))
    goal = MeteringGoal(percentile=percentile)
    pixels = np.array(values, np.uint16)[None, :]
    level = light_level(pixels, 10.0, goal, black_dn=64.0, white_dn=4095.0)
    ranked = sorted(values)
    at_least = [v for v in ranked if sum(w <= v for w in ranked) >= percentile / 100 * len(ranked)]
    assert level.level_dn == at_least[0] - 64
    assert level.mean_dn == pytest.approx(np.mean(values) - 64)
    assert level.clipped_fraction == pytest.approx(np.mean(np.array(values) == 4095))


def test_a_saturated_frame_only_shows_that_less_is_needed() -> None:
    goal = MeteringGoal()
    assert better_exposure_us(LightLevel(800.0, 4031.0, 4031.0, 900.0, 0.02), goal, 4031.0) == 400
    assert better_exposure_us(LightLevel(800.0, 4031.0, 4031.0, 4000.0, 0.9), goal, 4031.0) == 100
    dark = better_exposure_us(LightLevel(800.0, 0.0, 0.0, 0.0, 0.0), goal, 4031.0)
    assert dark == 800 * 32


@pytest.mark.usefixtures("simulated_world")
@pytest.mark.parametrize(
    ("scene", "seed", "cfa", "gain_db"),
    quick(
        [
            pytest.param("coin", 11, None, 0.0, id="coin"),
            pytest.param("spheres", 12, None, 0.0, id="chrome"),
            pytest.param("scales", 13, "RGGB", 0.0, id="scales-in-colour"),
            pytest.param("white-plane", 14, None, 12.0, id="white-plane-with-gain"),
        ],
        every=4,
    ),
)
def test_on_the_simulated_rig_the_percentile_is_within_3_per_cent(
    scene: str, seed: int, cfa: str | None, gain_db: float
) -> None:
    from simulator import open_rig_seeing, render, scene_named

    made = scene_named(scene, width=160, height=128, leds=8, seed=seed)
    rendering = render(replace(made, lens=replace(made.lens, cfa=cfa)))
    plan = CapturePlan(
        repeat=False, leds=tuple(range(8)), exposures_us=(20_000.0, 800.0), gain_db=gain_db
    )
    with open_rig_seeing(rendering, seed=seed, realtime=False, camera="inside") as rig:
        found = meter(rig, plan)
        assert found.dead_leds == ()
        for led in plan.leds:
            pixels = rig.shoot(led, found.plan.exposure_us(led, 0), gain_db).frame.pixels
            level = (np.percentile(pixels, 99.5) - 64) / (4095 - 64)
            assert level == pytest.approx(0.7, rel=0.03), f"LED {led}"
            assert np.mean(pixels == 4095) <= 0.005
