"""Crossings of masks, the image in which outlines are searched for, and steps along radii."""

import cv2
import numpy as np
import pytest

from calibration import EstimateError
from calibration.spheres import Ellipse, mask_outlines
from calibration.spheres.outline import outline
from calibration.spheres.outline.outline import (
    _fit,
    _steepest,
    _white,
    outline_image,
    refine_outline,
)


def rows_of(points):
    return sorted(map(tuple, np.asarray(points).tolist()))


@pytest.mark.parametrize(
    ("x0", "y0"),
    [(5, 4), (0, 4), (5, 0), (14, 4), (5, 9), (0, 0), (14, 9), (1, 1)],
)
def test_the_outline_of_a_rectangle(x0, y0):
    """Crossings are half-way between pixels; the frame is not an outline."""
    mask = np.zeros((20, 24))
    mask[y0 : y0 + 11, x0 : x0 + 10] = 1
    (points,) = mask_outlines(mask)
    expected = [
        *((x, y) for x in (x0 - 0.5, x0 + 9.5) if 0 < x < 23 for y in range(y0, y0 + 11)),
        *((x, y) for y in (y0 - 0.5, y0 + 10.5) if 0 < y < 19 for x in range(x0, x0 + 10)),
    ]
    assert rows_of(points) == rows_of(expected)


def test_a_region_within_the_box_of_another_has_its_own_outline():
    mask = np.zeros((40, 40), bool)
    mask[2:38, 2:8] = mask[2:8, 2:38] = True
    mask[20:30, 20:30] = True
    large, small = mask_outlines(mask)
    np.testing.assert_array_equal(np.min(large, axis=0), [1.5, 1.5])
    assert len(large) == 4 * 36
    assert len(small) == 40
    np.testing.assert_array_equal([small.min(axis=0), small.max(axis=0)], [[19.5] * 2, [29.5] * 2])


def test_crossings_are_interpolated():
    mask = np.zeros((12, 12))
    mask[1:11, 2:10] = 0.9
    mask[1:11, 1] = 0.2
    mask[1:11, 10] = 0.4
    (points,) = mask_outlines(mask)
    sides = points[(points[:, 1] == 5)]
    np.testing.assert_allclose(sorted(sides[:, 0]), [1 + 0.3 / 0.7, 9 + 0.4 / 0.5])


def test_a_pixel_of_exactly_a_half_is_one_crossing():
    mask = np.zeros((12, 12))
    mask[1:11, 2:10] = 0.9
    mask[1:11, [1, 10]] = 0.5
    (points,) = mask_outlines(mask)
    assert sorted(points[points[:, 1] == 5, 0]) == [1, 10]


@pytest.mark.parametrize(("last", "regions"), [(9, 0), (10, 1)])
def test_regions_below_60_pixels_are_ignored(last, regions):
    mask = np.zeros((30, 30), bool)
    mask[4:9, 4:10] = True  # 30 px
    mask[12:18, 4:14] = True
    mask[17, 4 + last :] = False
    assert len(mask_outlines(mask)) == regions


@pytest.mark.parametrize(
    ("count", "mean"), [(1, 1), (2, 2), (3, 2), (5, 3.5), (10, 7.5), (11, 8), (20, 14.5)]
)
def test_the_upper_mean_is_that_of_the_brighter_half_without_the_brightest_tenth(count, mean):
    """Light k has the brightness k; of 20 lights, 11 to 18 count."""
    levels = np.random.default_rng(0).permutation(count) + 1
    values = np.tile(levels[:, None, None] / 32, (1, 70, 9)).astype(np.float32)
    np.testing.assert_allclose(outline_image(values), 1.01 * mean / 32, rtol=1e-6)


def test_the_offset_is_twenty_times_the_noise():
    noise = np.random.default_rng(1).normal(0, 0.01, (1, 400, 400))
    slope = np.linspace(0.2, 0.6, 400)
    image = outline_image((slope + noise).astype(np.float32))
    assert image.mean() - slope.mean() == pytest.approx(0.2, rel=0.015)
    assert image.min() > 0.3


def test_dark_images_have_a_logarithm():
    assert outline_image(np.zeros((3, 9, 9), np.float32)).min() > 0


def test_saturated_samples_are_white():
    values = np.full((1, 70, 70), 0.5, np.float32)
    values[0, 10:30, 10:30] = np.nan
    image = outline_image(values)
    assert image[20, 20] - image[50, 50] == pytest.approx(0.5)
    values[0, 40:60, 40:60] = -3.0
    image = outline_image(1000 * values)
    assert image[20, 20] == image[5, 5]
    assert image[20, 20] - image[50, 50] == pytest.approx(500)


@pytest.mark.parametrize(
    ("values", "white"),
    [
        pytest.param(np.linspace(0, 0.7, 100), 1.0, id="below 1"),
        pytest.param(np.linspace(0, 1000, 1001), 990.0, id="another scale"),
        pytest.param([np.nan, np.inf, 7.0], 7.0, id="one is finite"),
        pytest.param([np.nan, np.nan], 1.0, id="all saturated"),
    ],
)
def test_white_is_1_or_the_99th_percentile(values, white):
    assert _white(np.array(values, np.float32).reshape(-1, 1, 1)) == pytest.approx(white)


def target(shape, centre, *steps):
    """Return an image with a step at each (radius, ratio), a little blurred."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    distance = np.hypot(columns - centre[0], rows - centre[1])
    image = np.ones(shape)
    for radius, ratio in steps:
        image *= np.where(distance < radius, ratio, 1)
    return cv2.GaussianBlur(image, (0, 0), 0.6).astype(np.float32)


@pytest.mark.parametrize(("radius", "count"), [(5.0, 90), (20.0, 125), (100.0, 628), (1000.0, 720)])
def test_one_radius_per_pixel(radius, count):
    angles, offsets, seen = _steepest(
        np.ones((60, 60), np.float32), Ellipse.circle(30, 30, radius), 4.0
    )
    assert len(angles) == len(offsets) == len(seen) == count
    np.testing.assert_allclose(angles, np.linspace(0, 2 * np.pi, count + 1)[:-1])
    assert not seen.any()


@pytest.mark.parametrize("ratio", [3.0, 0.3], ids=["bright", "dark"])
@pytest.mark.parametrize("radius", [36.0, 38.0, 42.0])
def test_the_steepest_step_is_where_the_outline_is(radius, ratio):
    """A stronger step 10 px away is out of reach."""
    image = target((120, 140), (70, 60), (40.0, ratio), (50.0, 0.1))
    _, offsets, seen = _steepest(image, Ellipse.circle(70, 60, radius), 4.5)
    assert seen.all()
    assert np.abs(offsets - (40 - radius)).max() < 0.8
    assert np.mean(offsets) == pytest.approx(40 - radius, abs=0.4)
    _, offsets, _ = _steepest(image, Ellipse.circle(70, 60, radius), 1.0)
    assert np.abs(offsets).max() <= 1.0


@pytest.mark.parametrize(
    ("step", "seen"), [(0.04, False), (0.08, True), (0.3, True)], ids=["weak", "visible", "clear"]
)
def test_a_step_has_four_times_the_usual_contrast(step, seen):
    """On a slope of 1 % per pixel; a step of 7 % has four times the contrast of the slope."""
    rows, columns = np.mgrid[:120, :140]
    distance = np.hypot(columns - 70, rows - 60)
    step = step * np.clip(distance - 39.5, 0, 1)
    image = np.exp(0.01 * distance + step).astype(np.float32)
    assert np.mean(_steepest(image, Ellipse.circle(70, 60, 40), 4.0)[2]) == pytest.approx(
        float(seen), abs=0.1
    )


@pytest.mark.parametrize(
    ("shape", "centre"),
    [((91, 131), (60, 45)), ((131, 91), (45, 60)), ((131, 131), (40, 90)), ((131, 131), (90, 40))],
)
def test_steps_within_2_5_px_of_the_frame_do_not_count(shape, centre):
    image = target(shape, centre, (44.0, 3.0))
    angles, _, seen = _steepest(image, Ellipse.circle(*centre, 42), 3.0)
    place = centre + 44 * np.column_stack([np.cos(angles), np.sin(angles)])
    room = np.minimum(place, np.array(shape[::-1]) - 1 - place).min(axis=1)
    assert seen[room > 3.1].all()
    assert not seen[room < 1.9].any()
    assert seen.any()
    assert not seen.all()


def test_twelve_points_are_required():
    angles = np.arange(12) / 4
    found = _fit(Ellipse.circle(30, 30, 20), angles, np.full(12, 2.0), 48, None)
    assert found.outline.circle_px == pytest.approx((30, 30, 22))
    assert (len(found.points_px), found.coverage) == (12, 0.25)
    with pytest.raises(EstimateError, match=r"no sphere outline at \(30, 30\) px"):
        _fit(Ellipse.circle(30, 30, 20), angles[1:], np.full(11, 2.0), 48, None)


@pytest.mark.parametrize(("visible", "axes"), [(36, 1), (37, 2)])
def test_more_than_three_quarters_of_the_outline_determine_an_ellipse(visible, axes):
    angles = np.arange(visible) * 2 * np.pi / 48
    flat = Ellipse((30.0, 30.0), (20.5, 20.0))
    ellipse = _fit(flat, angles, np.zeros(visible), 48, None).outline
    assert len(set(ellipse.semi_axes_px)) == axes


def test_a_completely_visible_outline_is_an_ellipse():
    rows, columns = np.mgrid[:120, :140]
    distance = np.hypot((columns - 70.2) / 45, (rows - 60.4) / 40)
    image = cv2.GaussianBlur(np.where(distance < 1, 0.3, 1.0), (0, 0), 0.6).astype(np.float32)
    found = refine_outline(image, Ellipse.circle(70, 60, 42), 6.0)
    assert sorted(found.outline.semi_axes_px) == pytest.approx([40, 45], abs=0.2)
    assert found.outline.centre_px == pytest.approx((70.2, 60.4), abs=0.1)
    assert found.coverage > 0.95
    assert np.abs(found.outline.distance_px(found.points_px)).max() < 1


@pytest.mark.parametrize(
    ("scatter_px", "rivals", "exact"),
    [
        pytest.param(0.0, [], True, id="without rivals"),
        pytest.param(0.0, [Ellipse.circle(70, 60, 48)], True, id="sharp"),
        pytest.param(0.0, [Ellipse.circle(70, 60, 45)], True, id="sharp, the same as a rival"),
        pytest.param(0.6, [Ellipse.circle(70, 60, 48)], True, id="may be sharp"),
        pytest.param(
            0.6,
            [Ellipse.circle(70, 60, 48), Ellipse.circle(70, 60, 45)],
            False,
            id="the same as a rival",
        ),
        pytest.param(1.6, [Ellipse.circle(70, 60, 48)], False, id="rough"),
        pytest.param(1.6, [], True, id="rough, without rivals"),
        pytest.param(6.0, [Ellipse.circle(70, 60, 48)], False, id="rough from the start"),
    ],
)
def test_an_outline_that_cannot_replace_its_rivals_is_not_fitted_exactly(
    monkeypatch, scatter_px, rivals, exact
):
    """Its edges scatter more than those of a sharp one, or it ends where a rival is."""
    count = 283
    points = np.random.default_rng(0).normal(size=count) * scatter_px
    angles = np.arange(count) * 2 * np.pi / count
    monkeypatch.setattr(
        outline,
        "_steepest",
        lambda _image, around, _reach: (
            angles,
            45 - around.radius_px + points,
            np.ones(count, bool),
        ),
    )
    monkeypatch.setattr(outline, "_refine_edges", lambda _image, _guess: "exact")
    found = refine_outline(
        np.zeros((120, 140), np.float32), Ellipse.circle(70, 60, 44), 5.0, rivals
    )
    assert (found == "exact") == exact


@pytest.mark.parametrize(
    ("hidden_px", "share"), [pytest.param(8, 0.8, id="80 %"), pytest.param(45, 0.5, id="half")]
)
def test_the_coverage_is_the_visible_share_of_the_outline(hidden_px, share):
    """An object hides the left part of the disc, up to 1 - cos(share of a circle)."""
    image = target((120, 140), (70, 60), (45.0, 0.3))
    image[:, : 70 - 45 + hidden_px] = 0.6
    found = refine_outline(image, Ellipse.circle(71, 61, 44), 5.0)
    ellipse, coverage = found.outline, found.coverage
    assert coverage == pytest.approx(share, abs=0.08)
    assert ellipse.centre_px == pytest.approx((70, 60), abs=0.25)
    assert ellipse.semi_axes_px == pytest.approx((45, 45), abs=0.25)
    assert len(found.points_px) == pytest.approx(coverage * 2 * np.pi * 45, rel=0.02)
    assert (ellipse.semi_axes_px[0] == ellipse.semi_axes_px[1]) == (share < 0.75)
