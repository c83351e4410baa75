"""lights.json version 2: covariances, standard deviations, and with what lights were calibrated."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition import (
    CameraModel,
    DataError,
    LightErrors,
    Lights,
    Setup,
    read_lights,
    write_lights,
)
from acquisition.values import Calibrated, UsedSphere, tangent_basis
from tests.acquisition.test_lights_files import near_lights as lights_alone
from tests.cases import cases

GOLDEN_NEAR = """\
{
 "format": "sgp-lights",
 "version": 2,
 "lights": [
  {"id": "L00", "position_mm": [0.0, 30.0, 40.0], "intensity": [1.0, 2.0, 3.0], \
"axis": [0.0, 0.0, -1.0], "mu": 0.5, \
"covariance_mm2": [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.25]], \
"intensity_std": [0.01, 0.02, 0.03], "axis_std_deg": 0.5, "mu_std": 0.125, \
"residual_px": 0.07, "spheres": 3},
  {"id": "L07", "position_mm": [-100.0, 0.25, 300.0], "intensity": [1.0, 1.0, 1.0], \
"axis": [0.0, 0.6, -0.8], "mu": 1.0}
 ],
 "calibrated": {"time_utc": "2026-11-22T14:41:34Z", "rig": "dome one", \
"camera": {"vendor": "Maker", "model": "M2", "serial": "40012345"}, \
"intrinsics": {"K": [[5000.0, 0.0, 1223.5], [0.0, 5000.0, 1023.5], [0.0, 0.0, 1.0]], \
"distortion": [0.1, 0.0, 0.0, 0.0, 0.0], "width": 2448, "height": 2048, \
"working_distance_mm": 600.0}, \
"spheres": [{"centre_px": [800.5, 900.25], "radius_px": 167.0, \
"centre_mm": [-50.0, 10.0, 20.0], "radius_mm": 20.0}]},
 "provenance": {"command": "sgp calibrate spheres"}
}
"""
GOLDEN_DISTANT = """\
{
 "format": "sgp-lights",
 "version": 2,
 "lights": [
  {"id": "chrome.0", "direction": [0.6, 0.0, 0.8], "intensity": [1.0, 1.0, 1.0], \
"covariance_rad2": [[1e-06, 2e-07], [2e-07, 4e-06]], "spheres": 1},
  {"id": "chrome.1", "direction": [0.0, 0.0, 1.0], "intensity": [1.0, 1.0, 1.0], "spheres": 1}
 ],
 "calibrated": {"time_utc": "2026-11-22T14:41:34.250000Z", \
"spheres": [{"centre_px": [100.0, 90.0], "radius_px": 40.0}]},
 "provenance": {}
}
"""
NAN = float("nan")


def near_lights() -> Lights:
    K = np.array([[5000, 0, 1223.5], [0, 5000, 1023.5], [0, 0, 1]])
    camera = CameraModel(K, 2448, 2048, 600.0, np.array([0.1]))
    covariance = [[0.04, 0.01, 0], [0.01, 0.09, 0], [0, 0, 0.25]]
    return replace(
        lights_alone(),
        errors=LightErrors(
            covariances=np.array([covariance, np.full((3, 3), NAN)]),
            intensity_std=np.array([[0.01, 0.02, 0.03], [NAN] * 3]),
            axis_std_deg=np.array([0.5, NAN]),
            mu_std=np.array([0.125, NAN]),
            residual_px=np.array([0.07, NAN]),
            spheres=np.array([3, 0]),
        ),
        calibrated=Calibrated(
            datetime(2026, 11, 22, 14, 41, 34, tzinfo=UTC),
            Setup("dome one", "Maker", "M2", "40012345", camera),
            (UsedSphere((800.5, 900.25), 167.0, (-50.0, 10.0, 20.0), 20.0),),
        ),
    )


def distant_lights() -> Lights:
    east = timezone(timedelta(hours=2))
    return Lights(
        directions=np.array([[3, 0, 4], [0, 0, 1]]),
        ids=("chrome.0", "chrome.1"),
        errors=LightErrors(
            covariances=np.array([[[1e-6, 2e-7], [2e-7, 4e-6]], np.full((2, 2), NAN)]),
            spheres=np.array([1, 1]),
        ),
        calibrated=Calibrated(
            datetime(2026, 11, 22, 16, 41, 34, 250000, tzinfo=east),
            spheres=(UsedSphere((100, 90), 40),),
        ),
    )


def assert_same_errors(one: LightErrors | None, other: LightErrors | None) -> None:
    assert (one is None) == (other is None)
    for field in fields(LightErrors):
        first, second = getattr(one, field.name, None), getattr(other, field.name, None)
        assert (first is None) == (second is None), field.name
        if first is not None:
            np.testing.assert_array_equal(first, second)


@cases(
    ("lights", "golden", "provenance"),
    {
        "near": (near_lights(), GOLDEN_NEAR, {"command": "sgp calibrate spheres"}),
        "distant": (distant_lights(), GOLDEN_DISTANT, {}),
    },
)
def test_golden(tmp_path: Path, lights: Lights, golden: str, provenance: dict[str, Any]) -> None:
    path = tmp_path / "lights.json"
    write_lights(path, lights, provenance)
    assert path.read_text() == golden
    back = read_lights(path)
    assert_same_errors(back.errors, lights.errors)
    now, before = back.calibrated, lights.calibrated
    assert now is not None
    assert before is not None
    assert now.time_utc == before.time_utc
    assert now.setup.rig == before.setup.rig
    assert now.setup.camera_serial == before.setup.camera_serial
    assert [repr(sphere) for sphere in now.spheres] == [repr(sphere) for sphere in before.spheres]
    lens = before.setup.intrinsics
    if lens is not None:
        assert now.setup.intrinsics is not None
        np.testing.assert_array_equal(now.setup.intrinsics.K, lens.K)
        np.testing.assert_array_equal(now.setup.intrinsics.distortion, lens.distortion)
        assert now.setup.intrinsics.working_distance_mm == lens.working_distance_mm
    # The second writing gives the same bytes.
    write_lights(path, back, provenance)
    assert path.read_text() == golden


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4), near=st.booleans())
def test_every_digit_is_kept(tmp_path: Path, seed: int, count: int, near: bool) -> None:
    rng = np.random.default_rng(seed)
    size = 3 if near else 2
    roots = rng.normal(0, 10.0 ** rng.integers(-6, 3), (count, size, size))
    covariances = roots @ roots.transpose(0, 2, 1)
    known = rng.random((5, count)) < 0.6
    deviations = np.where(known, rng.random((5, count)), NAN)
    lights = Lights(
        **{"positions_mm" if near else "directions": rng.normal(0, 100, (count, 3))},
        errors=LightErrors(
            covariances=np.where(known[0][:, None, None], covariances, NAN),
            intensity_std=deviations[1],
            axis_std_deg=deviations[2] if near else None,
            mu_std=deviations[3] if near else None,
            residual_px=deviations[4],
            spheres=rng.integers(0, 5, count),
        ),
    )
    path = tmp_path / "lights.json"
    write_lights(path, lights)
    assert_same_errors(read_lights(path).errors, lights.errors)


def changed(golden: str = GOLDEN_NEAR, **changes: object) -> str:
    file = json.loads(golden)
    for name, value in changes.items():
        target = file["calibrated"] if name in file["calibrated"] else file["lights"][0]
        target[name] = value
    return json.dumps(file)


IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


@cases(
    ("text", "match"),
    {
        "calibrated in version 1": (
            changed().replace('"version": 2', '"version": 1'),
            "unknown key 'calibrated': version 1",
        ),
        "covariance in version 1": (
            changed(GOLDEN_DISTANT)
            .replace('"version": 2', '"version": 1')
            .replace('"calibrated"', '"provenance"', 1)
            .replace(', "provenance": {}', ""),
            "unknown key 'lights.0.covariance_rad2': version 1",
        ),
        "text": (changed().replace('"version": 2', '"version": "2"'), "version '2' of"),
        "2 x 2": (changed(covariance_mm2=[[1, 0], [0, 1]]), "lights.0.covariance_mm2"),
        "not symmetric": (
            changed(covariance_mm2=[[1, 2, 0], [0, 1, 0], [0, 0, 1]]),
            "the covariance of light L00 is not symmetric",
        ),
        "negative eigenvalue": (
            changed(covariance_mm2=[[1, 2, 0], [2, 1, 0], [0, 0, 1]]),
            "the covariance of light L00 has a negative eigenvalue",
        ),
        "negative variance": (
            changed(covariance_mm2=[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
            "L00 has a negative eigenvalue",
        ),
        "NaN": (changed(covariance_mm2=IDENTITY).replace("[[1,", "[[NaN,"), "finite"),
        "infinite": (changed(covariance_mm2=IDENTITY).replace("[[1,", "[[1e999,"), "finite"),
        "covariance of a direction": (
            changed(covariance_rad2=[[1, 0], [0, 1]]),
            "a light with a position has no covariance_rad2",
        ),
        "covariance of a position": (
            changed(GOLDEN_DISTANT, covariance_mm2=IDENTITY),
            "a light with a direction has no covariance_mm2",
        ),
        "mu of a direction": (changed(GOLDEN_DISTANT, mu_std=0.1), "direction has no mu_std"),
        "one number": (changed(intensity_std=0.1), "lights.0.intensity_std"),
        "negative axis": (changed(axis_std_deg=-0.1), "lights.0.axis_std_deg"),
        "words": (changed(mu_std="small"), "lights.0.mu_std"),
        "negative residual": (changed(residual_px=-1), "lights.0.residual_px"),
        "no sphere": (changed().replace('"spheres": 3', '"spheres": 0'), "lights.0.spheres"),
        "key": (changed(residuals_px=0), "unknown key 'lights.0.residuals_px'"),
        "no zone": (changed(time_utc="2026-11-22T14:41:34"), "calibrated.time_utc"),
        "no time": (changed(time_utc="today"), "calibrated.time_utc"),
        "camera key": (changed(camera={"name": "M2"}), "'calibrated.camera.name'"),
        "intrinsics": (
            changed().replace("[5000.0, 0.0, 1223.5]", "[-5000.0, 0.0, 1223.5]"),
            "focal lengths",
        ),
        "radius": (changed().replace('"radius_px": 167.0', '"radius_px": 0'), "radius_px"),
    },
)
def test_refused(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "lights.json"
    path.write_text(text)
    with pytest.raises(DataError, match=match) as caught:
        read_lights(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@cases(
    ("errors", "match"),
    {
        "number of covariances": ({"covariances": np.eye(3)[None]}, "shape"),
        "directions": ({"covariances": np.ones((2, 2, 2))}, "2 x 3 x 3"),
        "negative": ({"covariances": -np.ones((2, 3, 3))}, "light L00 has a neg"),
        "intensities": ({"intensity_std": np.ones(3)}, "intensity: .*2 lights"),
        "infinite": ({"mu_std": np.array([0.1, np.inf])}, "mu of light L07"),
        "residual": ({"residual_px": np.array([-1, 0])}, "residual of light L00"),
        "half a sphere": ({"spheres": np.array([1.5, 2])}, "whole numbers"),
    },
)
def test_errors_of_other_lights_are_refused(errors: dict[str, Any], match: str) -> None:
    with pytest.raises(DataError, match=match):
        replace(near_lights(), errors=LightErrors(**errors))


def test_errors_stay_with_their_lights() -> None:
    lights = near_lights()
    second = lights.take([1, 0])
    assert second.errors is not None
    assert second.errors.spheres is not None
    assert second.errors.spheres.tolist() == [0, 3]
    assert second.calibrated is lights.calibrated
    assert lights.take([1]).errors is None  # the values of this light are not known
    assert replace(lights, errors=LightErrors()).errors is None


@pytest.mark.parametrize(
    "direction", [[0, 0, 1], [0, 0, -1], [0.6, 0, 0.8], [1, -2, -3], [1, 2, 3], [0, 1, 0]]
)
def test_tangent_basis(direction: list[float]) -> None:
    unit = np.array(direction) / np.linalg.norm(direction)
    first, second = tangent_basis([direction])[0]
    np.testing.assert_allclose(np.cross(first, second), unit, atol=1e-15)
    assert np.linalg.norm(first) == pytest.approx(1)
    assert first @ second == pytest.approx(0, abs=1e-15)
    # The smallest rotation has its axis in the plane of X and Y: it leaves this axis unchanged.
    pole = np.array([0, 0, np.sign(unit[2]) or 1])
    axis = np.cross(pole, unit)
    if np.linalg.norm(axis) > 0:
        turned = axis[0] * first + pole[2] * axis[1] * second
        np.testing.assert_allclose(turned, axis, atol=1e-15)


def test_covariance_of_the_direction_of_a_position() -> None:
    lights = near_lights()
    assert lights.errors is not None
    assert lights.errors.covariances is not None
    rng = np.random.default_rng(0)
    covariance = lights.errors.covariances[0] * 1e-4
    drawn = rng.multivariate_normal([0, 30, 40], covariance, 20_000)
    units = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    distant = lights.distant()
    assert distant.errors is not None
    assert distant.errors.covariances is not None
    assert distant.errors.axis_std_deg is None
    basis = tangent_basis(distant.unit_directions)[0]
    expected = np.cov((units - distant.unit_directions[0]) @ basis.T, rowvar=False)
    scale = np.abs(expected).max()
    got = distant.errors.covariances[0] * 1e-4
    np.testing.assert_allclose(got, expected, atol=0.05 * scale)
