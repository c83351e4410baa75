"""Control charts of a series of calibrations: stable ones, single lights, all lights, bad input."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from acquisition import DataError, LightErrors, Lights
from acquisition.values import Calibrated
from calibration.comparison import FALSE_ALARM, light_drift, order_by_date

COUNT = 36
SIGMA_RAD, SIGMA = 1e-3, 0.004


def series(
    seed: int = 0,
    number: int = 10,
    *,
    count: int = COUNT,
    turned: np.ndarray | None = None,
    strengths: np.ndarray | None = None,
    common: Rotation | None = None,
    since: int = 6,
    near: bool = False,
) -> list[Lights]:
    """Return calibrations of a dome; what is given changes from the calibration ``since`` on."""
    rng = np.random.default_rng(seed)
    towards = rng.normal(size=(count, 3)) * [1, 1, 0.5] + [0, 0, 1.2]
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    bright = rng.uniform(0.7, 1.3, count)
    found = []
    for k in range(number):
        now = towards + (turned if turned is not None and k >= since else 0)
        now = Rotation.from_rotvec(rng.normal(0, 2e-4, 3)).apply(now)
        if common is not None and k >= since:
            now = common.apply(now)
        now = now + rng.normal(0, SIGMA_RAD, (count, 3))
        seen = bright * np.exp(rng.normal(0, SIGMA, count)) * rng.uniform(0.5, 2)
        if strengths is not None:
            seen = seen * strengths[k]
        if near:
            found.append(Lights(positions_mm=450 * now, intensities=seen))
        else:
            found.append(Lights(directions=now, intensities=seen))
    return found


@pytest.mark.parametrize("near", [False, True])
def test_stable_series_are_within_their_limits(near: bool) -> None:
    alarms = 0
    for seed in range(6):
        drift = light_drift(series(seed, near=near))
        alarms += drift.moved or bool(drift.beyond.any())
        assert drift.warnings == () or alarms
    assert alarms <= 1


def test_limits_have_the_size_that_the_scatter_implies() -> None:
    drift = light_drift(series(count=100))
    tests = 3 * 10 * 100
    # Of a deviation from a median; two-sided for a number, exponential for two coordinates.
    more = np.sqrt(1 + np.pi / 2 / 10)
    strength = -ndtri(FALSE_ALARM / tests / 2) * SIGMA * more
    assert np.median(drift.strength_limit_percent) == pytest.approx(100 * strength, rel=0.06)
    more *= np.sqrt(200 / 197)
    direction = np.sqrt(-2 * np.log(FALSE_ALARM / tests)) * np.degrees(SIGMA_RAD) * more
    assert np.median(drift.direction_limit_deg) == pytest.approx(direction, rel=0.06)


def test_a_light_that_fades() -> None:
    fading = np.ones((10, COUNT))
    fading[:, 7] = 0.97 ** np.arange(10)
    drift = light_drift(series(strengths=fading), [f"c{k}" for k in range(10)])
    assert np.flatnonzero(drift.beyond).tolist() == [7]
    assert not drift.moved
    assert np.ptp(drift.strength_percent[:, 7]) == pytest.approx(28, abs=3)
    (notice,) = drift.warnings
    assert notice.code == "lights-drifted"
    assert notice.text.startswith("1 light of 36 is beyond the limits: L07 (strength +")
    assert " in c0, -" in notice.text
    assert notice.text.endswith(" in c9): calibrate it again")


@pytest.mark.parametrize("near", [False, True])
def test_a_light_that_turns(near: bool) -> None:
    start = np.asarray(series()[0].unit_directions)
    across = np.zeros((COUNT, 3))
    across[7] = np.cross(start[7], [0, 0, 1])
    across[7] *= np.radians(0.5) / np.linalg.norm(across[7])
    drift = light_drift(series(turned=across, near=near))
    assert np.flatnonzero(drift.beyond).tolist() == [7]
    assert not drift.moved
    (notice,) = drift.warnings
    assert "L07 (turned by 0." in notice.text
    assert "most between calibration 6 and calibration 7): calibrate it again" in notice.text


@pytest.mark.parametrize("near", [False, True])
def test_all_lights_that_turn_are_one_cause(near: bool) -> None:
    turn = Rotation.from_rotvec(np.radians([0, 0.3, 0]))
    drift = light_drift(series(common=turn, near=near))
    assert drift.moved
    assert not drift.beyond.any()
    (notice,) = drift.warnings
    assert notice.code == "lights-moved-together"
    assert notice.text.startswith("all lights turned together by 0.")
    assert "most between calibration 6 and calibration 7: the camera, the board" in notice.text
    change = drift.common_deg[6:].mean() + drift.common_deg[:6].mean()
    assert change == pytest.approx(0.25, abs=0.1)  # lights near the axis turn less
    # A light that also fades is named, too.
    fading = np.ones((10, COUNT))
    fading[8:, 3] = 0.5
    codes = [one.code for one in light_drift(series(common=turn, strengths=fading)).warnings]
    assert codes == ["lights-moved-together", "lights-drifted"]


def test_most_lights() -> None:
    changed = np.ones((10, COUNT))
    changed[7:, :24] = np.linspace(0.5, 0.8, 24)
    drift = light_drift(series(strengths=changed))
    assert drift.beyond.sum() > COUNT / 2
    assert drift.warnings[0].text.endswith(": calibrate all lights again")


def test_allowed_deviations() -> None:
    fading = np.ones((10, COUNT))
    fading[:, 7] = 0.97 ** np.arange(10)
    assert not light_drift(series(strengths=fading), least_percent=20).beyond.any()
    turn = Rotation.from_rotvec(np.radians([0, 0.3, 0]))
    assert not light_drift(series(common=turn), least_deg=0.4).moved


def test_stated_deviations_widen_the_limits_of_their_calibration() -> None:
    calibrations = series()
    spread = np.tile(np.eye(2) * (10 * SIGMA_RAD) ** 2, (COUNT, 1, 1))
    errors = LightErrors(covariances=spread, intensity_std=np.full(COUNT, 0.1))
    calibrations[4] = replace(calibrations[4], errors=errors)
    drift = light_drift(calibrations)
    for limits in (drift.direction_limit_deg, drift.strength_limit_percent):
        assert limits[4].min() > 3 * np.delete(limits, 4, axis=0).max()


@pytest.mark.parametrize(("share", "named"), [(1, []), (0.5, []), (0.1, ["series-scattered"])])
def test_a_scatter_beyond_what_is_stated_is_named(share: float, named: list[str]) -> None:
    stated = np.tile(np.eye(2) * (share * SIGMA_RAD) ** 2, (COUNT, 1, 1))
    calibrations = [replace(one, errors=LightErrors(covariances=stated)) for one in series()]
    drift = light_drift(calibrations)
    assert not drift.beyond.any()
    assert [one.code for one in drift.warnings] == named


def test_strengths_that_were_not_measured() -> None:
    calibrations = series(number=5)
    for k in (1, 3):
        calibrations[k] = replace(calibrations[k], intensities=None)
    drift = light_drift(calibrations)
    assert np.isfinite(drift.strength_percent).all(axis=1).tolist() == [1, 0, 1, 0, 1]
    calibrations[0] = replace(calibrations[0], intensities=None)
    drift = light_drift(calibrations)
    assert np.isnan(drift.strength_ratio).all()
    assert not drift.beyond.any()


def test_short_series_and_few_lights() -> None:
    drift = light_drift(series(number=3))
    assert [one.code for one in drift.warnings] == ["series-short"]
    assert f"found from {drift.common_limit_deg:.2g} deg on" in drift.warnings[0].text
    assert drift.common_limit_deg > 2 * light_drift(series(number=12)).common_limit_deg
    few = light_drift(series(count=4))
    assert np.isnan(few.common_ratio).all()
    assert not few.moved


def test_lists_in_another_order() -> None:
    calibrations = series()
    changed = [*calibrations[:4], calibrations[4].take([35, *range(35)]), *calibrations[5:]]
    drift = light_drift(changed)
    assert drift.ids == calibrations[0].ids
    expected = light_drift(calibrations).offsets_deg
    np.testing.assert_allclose(drift.offsets_deg, expected, atol=1e-9)


def dated(calibrations: list[Lights], days: list[int | None]) -> list[Lights]:
    start = datetime(2026, 1, 5, tzinfo=UTC)
    return [
        one if day is None else replace(one, calibrated=Calibrated(start + timedelta(days=day)))
        for one, day in zip(calibrations, days, strict=True)
    ]


def test_the_order_of_time() -> None:
    calibrations = series(number=3)
    names = ["a", "b", "c"]
    assert order_by_date(calibrations, names) == ([0, 1, 2], False)
    assert order_by_date(dated(calibrations, [5, 1, 3]), names) == ([1, 2, 0], True)
    assert order_by_date(dated(calibrations, [1, None, 3]), names) == ([0, 1, 2], False)
    with pytest.raises(DataError, match="c is older than a, which is given first, and b has no"):
        order_by_date(dated(calibrations, [5, None, 3]), names)
    with pytest.raises(DataError, match="a and c state the same date, 2026-01-10 00:00:00: give"):
        order_by_date(dated(calibrations, [5, 1, 5]), names)


def test_what_cannot_be_compared() -> None:
    calibrations = series(number=3)
    names = ["a.json", "b.json", "c.json"]

    def refused(changed: Lights, message: str) -> None:
        with pytest.raises(DataError, match=message):
            light_drift([*calibrations[:2], changed], names)

    refused(calibrations[2].take(range(30)), "a.json and c.json: the first .* 36 lights, the sec")
    refused(calibrations[0], "a.json and c.json have the same lights: give each calibration once")
    near = replace(calibrations[2], directions=None, positions_mm=calibrations[2].directions)
    refused(near, "a.json has directions, c.json positions: give one kind")
    order = [1, 0, *range(2, COUNT)]
    swapped = replace(calibrations[2].take(order), ids=calibrations[0].ids)
    refused(swapped, "c.json has another order than a.json: LED 0 and 1 are swapped")
    with pytest.raises(DataError, match="a series needs 3 calibrations or more"):
        light_drift(calibrations[:2])
