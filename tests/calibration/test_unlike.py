"""Highlights whose size differs from the others, and several outlines that may be right."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration import EstimateError
from calibration.spheres import Ellipse, SphereImage, find_highlights
from calibration.spheres.highlights.blobs import usual_size
from calibration.spheres.outline.joint_search import JointNear, best_of, edges_support
from calibration.spheres.outline.outline_confirmation import confirmed
from calibration.spheres.solve.average_directions import orthographic_lights
from calibration.spheres.solve.lost_images import left_out
from calibration.spheres.solve.sphere_calibration import SeenTogether
from tests.calibration.test_sphere_parts import image_of

LIGHTS = 7


def spots(areas, round_=0.01):
    """Return radii of one spot for each light, and standard deviations of their centres."""
    radii_px = np.sqrt(np.array(areas, float) / np.pi)
    radii_px = radii_px.reshape(len(radii_px), -1)
    return radii_px, round_ * radii_px


@pytest.mark.parametrize(
    ("areas", "odd"),
    [
        pytest.param([158, 160, 163, 158, 162, 161, 235], [6], id="a reflection is a part of it"),
        pytest.param([106, 85, 108, 110, 109, 19, 107], [1, 5], id="cut, and a reflection"),
        pytest.param([90, 92, 94, 96, 98, 100, np.nan], [], id="alike"),
        pytest.param([20, 90, 35, 92, 48, 89, 91, 90, 90], [0, 2, 4], id="many others"),
        pytest.param([57, 55, 54, 66, 62, 80, 70, 80, 62, 57, 55, 62], [], id="a lamp in a hand"),
        pytest.param([30, 45, 60, 90, 120, 180, 200], [], id="near and far lights"),
    ],
)
def test_sizes_that_differ_enlarge_the_error(areas, odd):
    radii_px, sigma_px = spots(areas)
    off = usual_size(radii_px, sigma_px).part_px(radii_px)
    assert np.flatnonzero(off).tolist() == odd
    twice = usual_size(2 * radii_px, sigma_px).part_px(2 * radii_px)
    np.testing.assert_allclose(twice, 2 * off)  # lengths scale


@pytest.mark.parametrize(
    "areas",
    [
        pytest.param([90, 300, np.nan, np.nan, np.nan, 90, 90], id="four"),
        pytest.param([1, 1.4, 1.9, 2.4, 3.2, 4, 5.6], id="of few pixels"),
        pytest.param([0.8, 0.8, 0.8, 0.8, 0.8, np.nan, 3], id="of single pixels"),
    ],
)
def test_sizes_that_cannot_be_compared(areas):
    assert usual_size(*spots(areas)) is None


@pytest.mark.parametrize(
    "cut", [pytest.param(c, id=f"{c} radii from the middle") for c in (0, 0.5)]
)
def test_the_stated_error_is_that_of_a_disc_of_which_one_side_is_missing(cut):
    """Without the segment beyond a chord at a distance c, the centroid moves by 2/3 s^3 / area."""
    radius = 6.0
    sine = np.sqrt(1 - cut**2)
    area = np.pi - (np.arctan2(sine, cut) - cut * sine)
    moved = radius * (2 / 3) * sine**3 / area
    radii_px, sigma_px = spots([np.pi * radius**2] * 6 + [area * radius**2])
    off = usual_size(radii_px, sigma_px).part_px(radii_px)[6, 0] * np.sqrt(2)
    assert 0.6 < moved / off < 1.6


@pytest.mark.parametrize(
    ("areas", "round_", "known", "elsewhere"),
    [
        pytest.param([90, 91, 92, 89, 90, 40, 210], 0.1, True, [5, 6], id="two others"),
        pytest.param([90, 91, 92, 89, 90, 40, 210], 0.01, True, [], id="round: other lamps"),
        pytest.param([90, 91, 92, 89, 90, 30, 270], 0.01, True, [5, 6], id="round, far smaller"),
        pytest.param([90, 91, 92, 89, 90, 75, np.nan], 0.01, True, [6], id="one not saturated"),
        pytest.param([9, 15, 45, 60, 120, 170, 300], 0.01, False, [], id="lamps of many sizes"),
        pytest.param([9, 15, 45, 60, 120, 170, 300], 0.2, False, range(7), id="not round, either"),
        pytest.param([60, 70, 80, 90, 100, 110, 130], 0.2, False, [], id="noisy contours"),
    ],
)
def test_spots_of_other_sizes_may_be_elsewhere_on_the_sphere(areas, round_, known, elsewhere):
    radii_px, sigma_px = spots(areas, round_)
    size = usual_size(radii_px, sigma_px)
    assert size.known == known
    off = size.elsewhere_px(radii_px, sigma_px, 50.0)[:, 0]
    assert np.flatnonzero(off).tolist() == list(elsewhere)
    assert np.all((off == 0) | ((off > 15) & (off < 25)))  # of 50 px


def ball(last=(40, 0.8)):
    """Return images of a ball with saturated highlights; the last peak is lower or narrower."""
    rows, columns = np.mgrid[:120, :120]
    values = np.full((LIGHTS, 120, 120), 0.1, np.float32)
    for k in range(LIGHTS):
        off = np.hypot(columns - 40 - 7 * k, rows - 50)
        peak, wide = last if k == LIGHTS - 1 else (40, 1.8)
        values[k] += peak * np.exp(-0.5 * (off / wide) ** 2)
    values += np.random.default_rng(0).normal(size=values.shape) * 0.002
    return np.where(values >= 1, np.nan, values).astype(np.float32)


def lights_of(values):
    """Return the lights that the highlights on the ball give; that of L06 has another size."""
    outline = Ellipse.circle(60.0, 60.0, 50.0)
    highlights = find_highlights(values, outline)
    assert list(highlights.unlike) == [6]
    sphere = SphereImage(outline, outline.point(np.arange(6.0)), 1.0, highlights, np.eye(3) * 0.01)
    names = tuple(f"L{k:02d}" for k in range(LIGHTS))
    shown = SeenTogether(names, np.full((LIGHTS, 3), np.nan), [sphere], [0], ("",), [True])
    return orthographic_lights(shown, []), names


def test_a_lamp_that_is_less_bright_keeps_its_light():
    result, names = lights_of(ball(last=(6, 1.8)))
    [notice] = result.warnings
    assert notice.code == "highlights-unlike"
    assert "L06" in notice.text
    assert result.lights.ids == names


def test_a_light_whose_highlight_on_a_single_ball_is_of_another_size_is_left_out():
    result, names = lights_of(ball())
    [notice] = result.warnings
    assert notice.code == "lights-left-out"
    assert notice.text.startswith("left out light L06: the highlight on the sphere at (60, 60) px")
    assert result.lights.ids == names[:6]
    assert len(result.highlights_px) == len(result.used) == len(result.residuals_deg) == 6


def test_angular_reflections_of_many_sizes_are_refused():
    values = np.full((LIGHTS, 120, 120), 0.1, np.float32)
    for k in range(LIGHTS):
        x, size = 30 + 7 * k, 3 + 2 * k
        values[k, 50 : 50 + size, x : x + 2 + k // 2] = 2
        values[k, 50 : 52 + k // 2, x : x + size] = 2
        values[k] = cv2.GaussianBlur(values[k], (0, 0), 0.6)
    values = np.where(values >= 1, np.nan, values).astype(np.float32)
    outline = Ellipse.circle(60.0, 60.0, 50.0)
    highlights = find_highlights(values, outline)
    sphere = SphereImage(outline, outline.point(np.arange(6.0)), 1.0, highlights, np.eye(3) * 0.01)
    names = tuple(f"L{k:02d}" for k in range(LIGHTS))
    shown = SeenTogether(names, np.full((LIGHTS, 3), np.nan), [sphere], [0], ("",), [True])
    with pytest.raises(EstimateError, match=r"\(60, 60\) px: the bright spots under most lights"):
        orthographic_lights(shown, [])


def test_of_several_spots_the_one_of_the_usual_size_is_the_highlight():
    """Under light 2 a larger reflection shines, and under light 4 one of similar brightness."""
    rows, columns = np.mgrid[:120, :120]
    values = np.nan_to_num(ball(), nan=1.0)
    for k, wide in ((2, 2.6), (4, 1.2)):
        off = np.hypot(columns - 65, (rows - 80) / 1.6)
        values[k] += 40 * np.exp(-0.5 * (off / wide) ** 2)
    values = np.where(values >= 1, np.nan, values).astype(np.float32)
    found = find_highlights(values, Ellipse.circle(60.0, 60.0, 50.0))
    places = np.column_stack([40 + 7.0 * np.arange(LIGHTS), np.full(LIGHTS, 50.0)])
    np.testing.assert_allclose(found.pixels, places, atol=0.1)
    assert not found.ambiguous.any()
    assert found.unlike == (6,)


def near(radius_px, support, x=50.0):
    outline = Ellipse.circle(x, 50.0, radius_px)
    return JointNear(outline, np.zeros((0, 2)), support, support, 0.8, np.eye(3) * 0.01)


@pytest.mark.parametrize(
    ("found", "best", "stated_px"),
    [
        pytest.param([near(40, 0.7)], 0, (0.09, 0.11), id="one"),
        pytest.param([near(40, 0.7), near(40.2, 0.6)], 0, (0.1, 0.3), id="nearly the same"),
        pytest.param([near(40, 0.7), near(60, 0.3)], 0, (0.1, 1), id="noise around it"),
        pytest.param([near(65, 0.48), near(75, 0.48)], 1, (2, 5), id="it mirrors a circle"),
        pytest.param([near(65, 0.7), near(75, 0.48)], 0, (0.2, 2), id="one is much better"),
        pytest.param([near(65, 0.5), near(65, 0.5, 58.0)], 0, (3, 6), id="not decided"),
    ],
)
def test_outlines_that_the_images_cannot_separate_are_in_the_stated_error(found, best, stated_px):
    chosen = best_of(found)
    assert chosen.outline is found[best].outline
    largest = np.sqrt(np.linalg.eigvalsh(chosen.covariance_px2)[-1])
    assert stated_px[0] < largest < stated_px[1]
    assert best_of([]) is None


def test_a_lone_ball_states_how_far_mirror_image_and_edges_differ():
    rows, columns = np.mgrid[:120, :120]
    inside = np.clip(40.5 - np.hypot(columns - 60, rows - 60), 0, 1)
    values = (0.3 - 0.25 * np.repeat(inside[None], 4, axis=0)).astype(np.float32)
    values += np.random.default_rng(0).normal(size=values.shape).astype(np.float32) * 0.002
    wrong = Ellipse.circle(60.0, 61.5, 41.0)
    highlights = find_highlights(values, wrong)
    lone = SphereImage(wrong, wrong.point(np.arange(6.0)), 1.0, highlights, np.eye(3) * 1.0)
    (stated,) = confirmed(values, [lone])
    assert np.array([0, -1.5, -1.0]) @ np.linalg.solve(stated.covariance_px2, [0, -1.5, -1.0]) < 2
    # Several spheres on one plane confirm each other, and so does a plane without doubt.
    assert confirmed(values, [lone, lone]) == [lone, lone]
    sure = replace(lone, on_plane=True)
    assert confirmed(values, [sure]) == [sure]
    assert edges_support(values, Ellipse.circle(60.0, 60.0, 40.5))
    assert not edges_support(values, Ellipse.circle(60.0, 60.0, 46.0))


@pytest.mark.parametrize(
    ("poor", "whose"),
    [
        pytest.param([3], "its image", id="one light"),
        pytest.param([3, 4], "their images", id="two lights"),
    ],
)
def test_messages_agree_with_the_number_of_lights(poor, whose):
    names = [f"L{k:02d}" for k in range(20)]
    none = np.array([], np.intp)
    (notice,) = left_out(names, none, np.array(poor), [image_of()])
    assert f"; {whose} cannot be used with this calibration: " in notice.text
    with pytest.raises(EstimateError, match=f"or leave out {whose}$"):
        left_out(names[:5], none, np.array(poor), [image_of()])
