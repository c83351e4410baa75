"""Spheres that are marked by masks or circles: which marks count, and how much of them is seen."""

import numpy as np
import pytest

from acquisition import DataError
from calibration import EstimateError
from calibration.spheres import Ellipse, Highlights, SphereImage, recording
from calibration.spheres.outline.near_circle import NearOutline
from calibration.spheres.propose import sphere_marks as marked
from calibration.spheres.propose.sphere_marks import (
    _check_disc,
    _coverage,
    circled_spheres,
    masked_spheres,
)

VALUES = np.zeros((3, 120, 160), np.float32)


@pytest.mark.parametrize(("points", "share"), [(200, 0.5), (396, 0.99), (400, 1.0), (800, 1.0)])
def test_a_circle_crosses_eight_rows_and_columns_per_pixel_of_its_radius(points, share):
    outline = Ellipse.circle(0.0, 0.0, 50.0)
    assert _coverage(outline, np.zeros((points, 2))) == pytest.approx(share)


@pytest.mark.parametrize(
    ("axes", "off_px", "accepted"),
    [
        pytest.param((40, 40), 2.9, True, id="rough"),
        pytest.param((40, 40), 3.1, False, id="rougher than 1 px and 5 % of the radius"),
        pytest.param((60, 40), 0.0, True, id="an axis ratio of 1.5"),
        pytest.param((61, 40), 0.0, False, id="a larger axis ratio"),
        pytest.param((40, 61), 0.0, False, id="a larger axis ratio, upright"),
        pytest.param((58, 40), 3.5, False, id="the shorter axis counts"),
        pytest.param((10, 20), 9.0, False, id="long and rough"),
    ],
)
def test_the_edge_of_a_mask_is_nearly_a_circle(axes, off_px, accepted):
    """Half of the points are outside the ellipse by ``off_px``, the others inside."""
    outline = Ellipse((70.0, 60.0), (float(axes[0]), float(axes[1])), 20.0)
    angles = np.arange(0, 2 * np.pi, 0.02)
    circle = outline.point(angles)
    normal = outline.unit(circle) @ np.linalg.inv(outline.matrix)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sign = np.where(np.arange(len(angles)) % 2, 1, -1)[:, None]
    points = circle + off_px * sign * normal
    if accepted:
        _check_disc(outline, points)
        return
    with pytest.raises(EstimateError, match=r"mask at \(70, 60\) px is not the disc of a sphere"):
        _check_disc(outline, points)


def cut_off(x, a, b):
    """Return the mask of an ellipse that the left side of the frame cuts off."""
    rows, columns = np.mgrid[:120, :160]
    return ((columns - x) / a) ** 2 + ((rows - 60) / b) ** 2 < 1


def test_half_a_disc_is_a_circle():
    (image,) = masked_spheres(VALUES, [cut_off(0.0, 45.0, 45.0)])
    assert image.outline.centre_px == pytest.approx((0, 60), abs=0.3)
    assert image.outline.semi_axes_px == pytest.approx((45, 45), abs=0.3)
    assert image.coverage == pytest.approx(0.5, abs=0.02)
    assert image.points_px.shape == (len(image.points_px), 2)


def test_two_thirds_of_a_long_ellipse_are_not_a_sphere():
    """Two thirds do not determine an ellipse, and they are not a circle."""
    with pytest.raises(EstimateError, match="not the disc of a sphere"):
        masked_spheres(VALUES, [cut_off(25.0, 59.0, 40.0)])


def test_each_region_of_each_mask_is_a_sphere():
    rows, columns = np.mgrid[:120, :160]
    first, second, third = (
        np.hypot(columns - x, rows - y) < 15 for x, y in ((30, 30), (90, 40), (60, 90))
    )
    images = masked_spheres(VALUES, [third, first | second])
    centres = [image.outline.centre_px for image in images]
    np.testing.assert_allclose(centres, [(60, 90), (30, 30), (90, 40)], atol=0.05)


@pytest.mark.parametrize(
    ("mask", "error", "says"),
    [
        pytest.param(np.ones((160, 120)), DataError, r"\(160, 120\) does not fit", id="shape"),
        pytest.param(np.zeros((120, 160)), EstimateError, "mask is empty", id="empty"),
        pytest.param(np.ones((120, 160)), EstimateError, "covers the complete image", id="full"),
    ],
)
def test_a_wrong_mask_is_refused(mask, error, says):
    with pytest.raises(error, match=says):
        masked_spheres(VALUES, [mask])


@pytest.mark.parametrize(
    "circle", [(9, 9, 0), (9, 9, -4), (np.nan, 9, 9), (9, np.inf, 9), (9, 9, np.nan)]
)
def test_an_invalid_circle_is_refused(circle):
    with pytest.raises(DataError, match="is invalid"):
        circled_spheres(VALUES, [circle])


def test_a_very_small_circle_is_valid():
    with pytest.raises(EstimateError, match="no sphere outline"):
        circled_spheres(VALUES, [(9, 9, 0.5)])


@pytest.mark.parametrize(("radius", "reach_px"), [(10.0, 4.0), (60.0, 6.0), (100.0, 10.0)])
def test_a_circle_may_be_wrong_by_a_tenth_of_the_radius(monkeypatch, radius, reach_px):
    outline = Ellipse((60.0, 50.0), (30.0, 29.0))

    def refine(images, guess, reach):
        assert images.upper.shape == VALUES.shape[1:]
        assert guess == Ellipse.circle(70.0, 55.0, radius)
        assert reach == pytest.approx(reach_px)
        return NearOutline(outline, np.zeros((5, 2)), 0.8, None)

    monkeypatch.setattr(marked, "outline_near", refine)
    (image,) = circled_spheres(VALUES, [(70, 55, radius)])
    assert (image.outline, image.coverage, image.points_px.shape) == (outline, 0.8, (5, 2))


@pytest.mark.parametrize(
    ("other", "same"),
    [
        pytest.param((50.0, 60.0, 30.0), True, id="the same outline"),
        pytest.param((79.0, 60.0, 30.0), True, id="overlapping"),
        pytest.param((50.0, 60.0, 12.0), True, id="inside"),
        pytest.param((81.0, 60.0, 30.0), False, id="one that hides a part of the other"),
        pytest.param((63.0, 60.0, 12.0), False, id="a small ball in front of a large one"),
        pytest.param((111.0, 60.0, 30.0), False, id="side by side"),
    ],
)
def test_a_sphere_counts_once(monkeypatch, other, same):
    """Two marks of one sphere would count as independent, and halve the stated variance."""
    highlights = Highlights(
        np.full((len(VALUES), 2), 60.0), np.zeros(len(VALUES), bool), np.full(len(VALUES), 0.05)
    )
    images = [
        SphereImage(Ellipse.circle(x, y, radius), np.full((9, 2), x), 1.0, highlights)
        for x, y, radius in ((50.0, 60.0, 30.0), other)
    ]
    monkeypatch.setattr(recording, "circled_spheres", lambda *_: images)
    if same:
        with pytest.raises(
            DataError, match=r"two marks are the sphere at \(50, 60\) px: mark it once"
        ):
            recording.seen_in(VALUES, None, [(50, 60, 30), other], None, None)
        return
    assert len(recording.seen_in(VALUES, None, [(50, 60, 30), other], None, None).images) == 2


def test_an_uneven_outline_is_a_warning_and_not_left_out(monkeypatch):
    """One sphere that is left out refuses positions; one that is only uneven gives directions."""
    angles = np.linspace(0, 2 * np.pi, 60)
    circle = Ellipse.circle(70.0, 55.0, 30.0)
    points = circle.point(angles, 1 + 0.05 * np.sin(20 * angles))
    highlights = Highlights(
        np.full((len(VALUES), 2), 60.0), np.zeros(len(VALUES), bool), np.full(len(VALUES), 0.05)
    )
    image = SphereImage(circle, points, 0.9, highlights)
    monkeypatch.setattr(recording, "circled_spheres", lambda *_: [image])
    seen = recording.seen_in(VALUES, None, [(70, 55, 30)], None, None)
    assert seen.left_out == []
    assert [notice.code for notice in seen.doubts] == ["outline-uneven"]
