"""Registration of two fields of one object: placements, errors and fields that do not fit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition import DataError
from acquisition.values import angle_deg
from calibration import EstimateError
from processing import NormalMap
from processing.registration import Field, PlaneModel, Registration, register_fields
from rig.arrays import Float64
from tests.cases import cases
from tests.quick_sample import quick

SIZE = (200, 240)
WAVES = 150
Waves = NDArray[np.complex128]


def turned(degrees: float, size: float = 1.0) -> Float64:
    """Return a turn from right to down about the middle of a field."""
    angle = math.radians(degrees)
    c, s = size * math.cos(angle), size * math.sin(angle)
    middle = np.array([SIZE[1] - 1, SIZE[0] - 1]) / 2
    linear = np.array([[c, -s], [s, c]])
    return np.vstack([np.column_stack([linear, middle - linear @ middle]), [0, 0, 1]])


def shift(right: float, down: float) -> Float64:
    return np.array([[1, 0, right], [0, 1, down], [0, 0, 1.0]])


def bend(x: Float64, y: Float64, size_px: float) -> tuple[Float64, Float64]:
    """Return smooth shifts, as by the parallax of a relief."""
    return size_px * np.sin(y / 60), size_px * np.cos(x / 70 + 1) * np.sin(y / 90)


def sums(
    place: Float64, number: Float64, weights: tuple[Waves, ...], bent_px: float
) -> tuple[Waves, ...]:
    """Return weighted sums of the waves ``exp(i number @ (x, y))``, where each pixel is placed."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    if not bent_px and (place[2] == (0, 0, 1)).all():
        # Rows and columns are factors of each wave.
        step = np.exp(1j * place[:2].T @ number)
        of_rows, of_columns = step[1] ** rows[:, :1], step[2] * step[0] ** columns[0, :, None]
        return tuple((of_rows * weight) @ of_columns.T for weight in weights)
    x, y, w = np.tensordot(place, np.stack([columns, rows, np.ones_like(rows)]), 1)
    x, y = x / w, y / w
    right, down = bend(x, y, bent_px)
    waves = np.exp(1j * np.tensordot(np.stack([x + right, y + down], axis=2), number, 1))
    return tuple(waves @ weight for weight in weights)


def field_at(
    place: Float64,
    *,
    seed: int = 1,
    noise_deg: float = 0.2,
    paint: bool = True,
    bent_px: float = 0.0,
) -> Field:
    """Return a field whose pixel p shows the point ``place @ p`` of an unlimited relief.

    The relief is a sum of plane waves, so that slopes are exact anywhere. The axes of the field
    turn with it.
    """
    waves = np.random.default_rng(seed)
    length = np.exp(waves.uniform(np.log(6), np.log(50), WAVES))
    around = waves.uniform(0, 2 * np.pi, WAVES)
    phase = np.exp(1j * waves.uniform(0, 2 * np.pi, (2, WAVES))) / math.sqrt(WAVES)
    number = 2 * np.pi / length * np.stack([np.cos(around), np.sin(around)])
    weights = 0.3 * phase[0] * np.cos(around), 0.3 * phase[0] * np.sin(around), phase[1]
    found = sums(place, number, weights, bent_px)
    right, down, strength = found[0].real, found[1].real, found[2].imag
    angle = math.atan2(place[1, 0], place[0, 0])
    c, s = math.cos(angle), math.sin(angle)
    # Slopes along the axes of the field, the second one up.
    slope_x, slope_y = c * right + s * down, s * right - c * down
    noise = np.random.default_rng([seed, round(1e4 * abs(place[0, 2]))])
    normals = np.dstack([-slope_x, -slope_y, np.ones_like(slope_x)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    normals += np.radians(noise_deg) / math.sqrt(2) * noise.normal(size=normals.shape)
    albedo = None
    if paint:
        albedo = (0.5 * np.exp(0.2 * strength)).astype(np.float32)
    return Field(NormalMap.from_vectors(normals), albedo)


def error_px(found: Registration, truth: Float64) -> float:
    rows, columns = (one.astype(float) for one in np.nonzero(found.common))
    x, y, w = truth @ np.stack([columns, rows, np.ones_like(rows)])
    right, down = found.at(columns, rows)
    return math.sqrt(float(np.mean((right - x / w) ** 2 + (down - y / w) ** 2)))


PERSPECTIVE = turned(10) @ np.array([[1, 0.01, 0], [0, 1.02, 0], [5e-5, -4e-5, 1.0]])


@cases(
    "place, model",
    {
        "by whole pixels": (shift(12, -7), "rigid"),
        "by parts of a pixel": (shift(0.3, 0.62), "rigid"),
        "turned a little": (turned(1.3), "rigid"),
        "turned": (turned(-57) @ shift(10, 5), "rigid"),
        "upside down": (turned(180) @ shift(-4, 9), "rigid"),
        "enlarged": (turned(25, 1.3), "similarity"),
        "seen at an angle": (PERSPECTIVE, "homography"),
        "half of the field": (shift(120, 3), "rigid"),
    },
)
@pytest.mark.parametrize("paint", quick([True, False], every=2), ids=["paint", "bare"])
def test_a_placement_is_found(place: Float64, model: PlaneModel, paint: bool) -> None:
    first, second = field_at(np.eye(3), paint=paint), field_at(place, paint=paint)
    found = register_fields(first, second, model=model, drift=True)
    # A perspective view also has other slopes.
    most = 0.05 if model == "homography" else 0.02
    error = error_px(found, np.linalg.inv(place))
    assert error < most
    assert found.sigma_px < 0.02
    size = math.sqrt(np.linalg.det(np.linalg.inv(place)[:2, :2]))
    assert found.enlargement == pytest.approx(size, rel=2e-4 if model != "homography" else 0.05)
    if model != "homography":
        assert found.drift is None
        assert error < 5 * found.sigma_px
        back = found.resampled(second).normal_map
        both = back.mask & found.common
        assert angle_deg(back.normals[both], first.normal_map.normals[both]).mean() < 0.35
        assert found.holds[found.common].all()


def test_a_tilt_turns_the_normals() -> None:
    first = field_at(np.eye(3))
    angle = math.radians(2)
    c, s = math.cos(angle), math.sin(angle)
    tilt = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    other = field_at(turned(30))
    vectors = other.normal_map.normals @ tilt.T
    second = replace(other, normal_map=NormalMap.from_vectors(vectors))
    found = register_fields(first, second, model="rigid")
    about_z = np.array([[0.5 * math.sqrt(3), -0.5, 0], [0.5, 0.5 * math.sqrt(3), 0], [0, 0, 1]])
    assert np.abs(found.rotation - tilt @ about_z).max() < math.radians(0.1)
    assert abs(found.turn_deg - 30) < 0.1


@cases("bent_px", {"little": 0.1, "much": 0.5})
def test_a_smooth_drift_is_found(bent_px: float) -> None:
    first, second = field_at(np.eye(3)), field_at(turned(20), bent_px=bent_px)
    found = register_fields(first, second, model="rigid", drift=True)
    assert found.drift is not None
    # Positions of the first that each pixel of the second shows.
    rows, columns = (one[30:-30, 30:-30].astype(float) for one in np.mgrid[: SIZE[0], : SIZE[1]])
    x, y, _ = np.tensordot(turned(20), np.stack([columns, rows, np.ones_like(rows)]), 1)
    right, down = bend(x, y, bent_px)
    x, y = x + right, y + down
    inside = (x > 10) & (x < SIZE[1] - 10) & (y > 10) & (y < SIZE[0] - 10)
    error = np.hypot(*np.subtract(found.at(x, y), (columns, rows)))[inside]
    without = replace(found, drift=None)
    bare = np.hypot(*np.subtract(without.at(x, y), (columns, rows)))[inside]
    assert np.sqrt(np.mean(error**2)) < 0.35 * np.sqrt(np.mean(bare**2))


def test_where_a_registration_does_not_hold() -> None:
    first, second, foreign = field_at(np.eye(3)), field_at(shift(3, 2)), field_at(turned(0), seed=5)
    normals = second.normal_map.normals.copy()
    normals[64:136, 64:136] = foreign.normal_map.normals[64:136, 64:136]
    found = register_fields(first, replace(second, normal_map=NormalMap.from_vectors(normals)))
    assert not found.holds[70:126, 70:126].any()
    assert found.holds[found.common].mean() > 0.8
    assert error_px(found, shift(-3, -2)) < 0.02


def mirrored(field: Field) -> Field:
    normals = field.normal_map.normals[:, ::-1] * np.float32([-1, 1, 1])
    return Field(NormalMap.from_vectors(normals), field.albedo[:, ::-1].copy())  # type: ignore[index]


@cases(
    "second, message",
    {
        "another object": (lambda: field_at(np.eye(3), seed=9), "nothing in common"),
        "no overlap": (lambda: field_at(shift(500, 0)), "nothing in common"),
        "mirrored": (lambda: mirrored(field_at(np.eye(3))), "one of the two fields is mirrored"),
        "only noise": (
            lambda: field_at(shift(5, 5), noise_deg=80, paint=False),
            "nothing in common",
        ),
    },
)
def test_fields_that_do_not_fit(second: Callable[[], Field], message: str) -> None:
    with pytest.raises(EstimateError, match=message):
        register_fields(field_at(np.eye(3)), second())


def test_a_start_far_away() -> None:
    with pytest.raises(EstimateError, match="too little in common"):
        register_fields(field_at(np.eye(3)), field_at(shift(5, 5)), start=shift(180, 150))


def test_maps_of_other_shape() -> None:
    field = field_at(np.eye(3))
    with pytest.raises(DataError, match=r"albedo has shape \(2, 3\)"):
        replace(field, albedo=np.ones((2, 3), np.float32))
