"""Guided synthesis: grain along directions, periods by a scale map, parts chosen by a guide."""

import numpy as np
import pytest

from acquisition import DataError
from processing import NormalMap, synthesize_onto

PERIOD, PATCH = 12.0, 24
SIDE = 128


def waves(side=SIDE):
    """Return waves along X."""
    x = np.tile(np.arange(side), (side, 1))
    slope = 0.3 * np.sin(2 * np.pi * x / PERIOD)
    return NormalMap.from_vectors(np.dstack([slope, 0 * slope, np.ones_like(slope)]))


def flat(rows=120, columns=140):
    return NormalMap.from_vectors(np.tile([0.0, 0, 1], (rows, columns, 1)))


def lines_deg(x, y, sigma=8):
    """Return the local direction of vectors whose sign is arbitrary."""
    from cv2 import GaussianBlur

    double = (x + 1j * y) ** 2
    return (
        np.degrees(
            np.arctan2(
                GaussianBlur(double.imag, (0, 0), sigma), GaussianBlur(double.real, (0, 0), sigma)
            )
        )
        / 2
    )


def apart_deg(a, b):
    return np.abs((a - b + 90) % 180 - 90)


def test_waves_follow_a_painted_direction():
    """Slopes lie along the direction, and so does the change from crest to trough."""
    y, x = np.mgrid[:120, :140]
    field = 30 + 60 * np.sin(x / 90) + 20 * np.cos(y / 70)
    made = synthesize_onto(waves(), flat(), patch=PATCH, direction_deg=field).detail.normals
    slopes = made[..., :2].astype(np.float64)
    assert np.median(apart_deg(lines_deg(slopes[..., 0], slopes[..., 1]), field)) < 3
    along = np.radians(field)
    height = slopes[..., 0] * np.cos(along) + slopes[..., 1] * np.sin(along)
    down, right = np.gradient(height)
    inside = (slice(8, -8), slice(8, -8))
    assert np.median(apart_deg(lines_deg(right, -down), field)[inside]) < 5
    # Without the field, the waves are along X.
    plain = synthesize_onto(waves(), flat(), patch=PATCH).detail.normals
    assert not plain[..., 1].any()


@pytest.mark.parametrize("axis_deg", [0.0, 60.0])
def test_waves_follow_the_largest_curvature_of_a_cylinder(axis_deg):
    """It is across the axis. One half of the target is a plane and takes the direction over."""
    y, x = np.mgrid[55:-56:-1, -60:61] / 100.0
    across = np.radians(axis_deg + 90)
    lean = np.clip(np.cos(across) * x + np.sin(across) * y, -0.6, 0.1)
    vectors = np.dstack([lean * np.cos(across), lean * np.sin(across), np.sqrt(1 - lean * lean)])
    target = NormalMap.from_vectors(vectors)
    made = synthesize_onto(waves(), target, patch=PATCH, direction_deg="curvature")
    made = made.detail.normals.astype(np.float64)
    found = apart_deg(lines_deg(made[..., 0], made[..., 1]), axis_deg + 90)
    assert np.quantile(found, 0.9) < 5


def test_periods_scale_with_the_map():
    scale = np.tile(np.where(np.arange(240) < 120, 0.75, 1.5), (60, 1))
    made = synthesize_onto(waves(), flat(60, 240), patch=PATCH, scale=scale).detail.normals[..., 0]
    for part, factor in ((slice(0, 110), 0.75), (slice(130, 240), 1.5)):
        values = made[:, part] * np.hanning(110)
        power = np.square(np.abs(np.fft.rfft(values, 4096))).sum(axis=0)
        assert 4096 / np.argmax(power) == pytest.approx(factor * PERIOD, rel=0.03)


def halves(rows, columns):
    """Return 0 on the left, 1 on the right."""
    return np.tile((np.arange(columns) >= columns // 2).astype(float), (rows, 1))


@pytest.mark.parametrize("options", [{}, {"rotate": True, "mirror": True}], ids=["plain", "turned"])
def test_a_guide_chooses_the_part_of_the_exemplar(options):
    """The exemplar is rough on its right half; the target asks for it on its left half."""
    noise = np.random.default_rng(3).normal(size=(80, 96, 3))
    rough = halves(80, 96)
    exemplar = NormalMap.from_vectors(noise * (0.02 + 0.28 * rough)[..., None] + [0, 0, 1])
    made = synthesize_onto(
        exemplar, flat(70, 160), patch=16, guide=1 - halves(70, 160), exemplar_guide=rough,
        **options,
    ).detail.normals  # fmt: skip
    steep = np.hypot(made[..., 0], made[..., 1])
    wanted = np.hypot(*np.moveaxis(exemplar.normals[..., :2], -1, 0))
    assert steep[:, :70].mean() == pytest.approx(wanted[rough > 0].mean(), rel=0.1)
    assert steep[:, 90:].mean() == pytest.approx(wanted[rough == 0].mean(), rel=0.25)


SMALL = np.zeros((119, 140))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"direction_deg": SMALL}, "direction map has 140 x 119 pixels, but 140 x 120"),
        ({"direction_deg": np.zeros((120, 140, 3))}, "direction map has another shape"),
        ({"direction_deg": np.full((120, 140), np.nan)}, "no number at 16800 pixels"),
        ({"scale": SMALL + 1}, "scale map has 140 x 119"),
        ({"scale": np.zeros((120, 140))}, "scale map has values from 0 to 0: use 0.1 to 10"),
        ({"guide": np.zeros((120, 140))}, "requires two maps"),
        ({"exemplar_guide": np.zeros((SIDE, SIDE))}, "requires two maps"),
        ({"guide": SMALL, "exemplar_guide": np.eye(SIDE)}, "guide of the target has 140 x 119"),
        (
            {"guide": np.zeros((120, 140)), "exemplar_guide": SMALL},
            "guide of the exemplar has 140 x 119 pixels, but 128 x 128",
        ),
        (
            {"guide": np.zeros((120, 140)), "exemplar_guide": np.ones((SIDE, SIDE))},
            "the same everywhere",
        ),
        ({"guide_weight": 0.0}, "a weight of 0 of the guide"),
    ],
)
def test_bad_guidance(options, message):
    with pytest.raises(DataError, match=message):
        synthesize_onto(waves(), flat(), patch=PATCH, **options)
