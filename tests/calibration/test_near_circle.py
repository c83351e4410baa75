"""A given circle is refined to the outline, or its error is stated, or it is refused."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import angle_deg
from calibration import EstimateError, calibrate_spheres
from calibration.spheres import Ellipse, fit_ellipse, mask_outlines
from calibration.spheres.outline.mirrored_border import is_mirrored_border
from calibration.spheres.outline.near_circle import outline_near
from calibration.spheres.outline.outline import OutlineImages
from simulator import ChromeSphere, render, scene_named
from simulator.shapes.patterns import Even
from tests.quick_sample import quick

from .uneven_balls import uneven_ball, wrong_circle


def outcome(seed):
    """Return rms error and rms standard deviation of the directions in degrees, None if refused."""
    values, circle, directions = uneven_ball(seed)
    try:
        lights = calibrate_spheres(values, circles=[wrong_circle(seed, circle)]).lights
    except EstimateError:
        return None
    error_deg = angle_deg(lights.unit_directions, directions)
    variances = np.trace(lights.errors.covariances, axis1=1, axis2=2) / 2
    return np.sqrt(np.mean(error_deg**2)), np.degrees(np.sqrt(np.mean(variances)))


# Before, the circle 4 gave an outline whose error was 6 standard deviations, 17 the mirrored
# horizon, 15 px off, 419 what seemed to mirror a plane, 1.7 degrees off, 772 a sharp ellipse, 4
# degrees off with .2 stated, and 895 half an outline, 6 standard deviations off.
@pytest.mark.slow
@pytest.mark.parametrize("seed", quick([4, 17, 419, 772, 895], every=2))
def test_an_uneven_outline_states_its_error_or_is_refused(seed):
    result = outcome(seed)
    assert result is None or result[0] <= 3 * result[1]


@pytest.mark.slow
def test_errors_of_uneven_outlines_are_stated():
    """Of 20 circles that are off by 1 to 12 px, at least 95 %; other seeds than the development."""
    results = [outcome(seed) for seed in range(300, 320)]
    good = [result is None or result[0] <= 3 * result[1] for result in results]
    assert np.mean(good) >= 0.95
    assert sum(result is not None for result in results) >= 7


def rings(*radii, half=False):
    """Return images with sharp rings, of which the lower half may be invisible."""
    rows, columns = np.mgrid[:160, :160]
    distance = np.hypot(columns - 80, rows - 78)
    image = np.full((160, 160), 0.3)
    for level, radius in zip((0.02, 0.15), radii, strict=False):
        image += (level - image) * np.clip(radius + 0.5 - distance, 0, 1)
    if half:
        image[rows > 78] = 0.3
    return OutlineImages(np.repeat(image[None].astype(np.float32), 4, axis=0))


def test_a_sharp_ring_has_no_rival():
    near = outline_near(rings(50.0), Ellipse.circle(82.0, 76.0, 48.0), 5.0)
    assert near.is_sharp
    assert near.outline.centre_px == pytest.approx((80, 78), abs=0.1)
    assert near.outline.radius_px == pytest.approx(50, abs=0.4)


def test_half_a_ring_states_its_covariance():
    near = outline_near(rings(50.0, half=True), Ellipse.circle(82.0, 76.0, 48.0), 5.0)
    assert near.coverage < 0.6
    change = np.array([*near.outline.centre_px, near.outline.radius_px]) - (80, 78, 50)
    sigma = np.sqrt(np.diag(near.covariance_px2) + 0.03**2)
    assert np.all(np.abs(change) < 3 * sigma + 0.4)
    assert near.sigma_px < 1.0


def test_a_ring_inside_a_ring_may_be_a_mirrored_horizon():
    pictures = rings(60.0, 44.0)
    with pytest.raises(EstimateError, match=r"may be the horizon .* outline at \(80, 78, 60\) px"):
        outline_near(pictures, Ellipse.circle(80.0, 78.0, 44.0), 4.4)
    assert outline_near(pictures, Ellipse.circle(80.0, 78.0, 58.0), 5.8).is_sharp


@pytest.mark.parametrize(
    ("reflectance", "inside", "border"),
    [
        pytest.param(0.6, 0.05, True, id="a dark room within what the ball mirrors"),
        pytest.param(0.6, None, False, id="the mirror image reaches farther inside"),
        pytest.param(1.0, 0.05, False, id="no darker ball around the edge"),
    ],
)
def test_the_border_of_what_a_ball_mirrors_is_no_outline(reflectance, inside, border):
    """A ball of 50 px mirrors a bright and a dark half, and a dark room within 38 px."""
    rows, columns = np.mgrid[:160, :160]
    behind = np.where(rows > 70 + 0.2 * columns, 0.08, 0.5)
    distance = np.hypot(columns - 80, rows - 78)
    image = np.where(distance < 50, reflectance * behind, behind)
    if inside is not None:
        image[distance < 38] = inside
    image = image.astype(np.float32)
    assert is_mirrored_border(image, Ellipse.circle(80.0, 78.0, 38.0)) == border
    hidden = is_mirrored_border(image, Ellipse.circle(80.0, 78.0, 38.0), mostly_seen=False)
    assert hidden == border
    for seen in (True, False):
        outline = Ellipse.circle(80.0, 78.0, 50.0)
        assert not is_mirrored_border(image, outline, mostly_seen=seen)


@pytest.mark.parametrize(
    ("rows", "columns"),
    [
        pytest.param(slice(0, 160), slice(0, 160), id="whole"),
        pytest.param(slice(0, 160), slice(60, 160), id="left part cut off"),
        pytest.param(slice(45, 160), slice(0, 160), id="upper part cut off"),
        pytest.param(slice(26, 130), slice(28, 132), id="a frame close to the ball"),
    ],
)
@pytest.mark.parametrize(
    ("radius", "inside", "border"),
    [
        pytest.param(50.0, 0.0, False, id="a ball mirrors a black room in front of a wall"),
        pytest.param(38.0, 0.6, True, id="a ball mirrors the wall around a black room"),
    ],
)
def test_only_a_larger_ball_makes_a_half_hidden_edge_a_border(
    radius, inside, border, rows, columns
):
    """The wall is bright above and black below, where no edge is visible."""
    at = np.mgrid[:160, :160]
    wall = np.where(at[0] > 85 + 0.1 * at[1], 0.0, 0.4)
    distance = np.hypot(at[1] - 80, at[0] - 78)
    image = np.where(distance < 50, inside * wall, wall)
    image[distance < 38] = 0.0
    part = (image[rows, columns] + 1e-4).astype(np.float32)
    edge = Ellipse((80.0 - columns.start, 78.0 - rows.start), (radius, radius))
    assert is_mirrored_border(part, edge, mostly_seen=False) == border


def test_a_small_edge_inside_a_small_ball_is_a_border():
    """The wall is brighter on one side; a ball of 12 px mirrors it around a dark room of 9 px."""
    rows, columns = np.mgrid[:60, :60]
    wall = np.where(columns > 30, 0.5, 0.2)
    distance = np.hypot(columns - 30, rows - 30)
    image = np.where(distance < 12, 0.6 * wall, wall)
    image[distance < 9] = 0.05
    assert is_mirrored_border(image.astype(np.float32), Ellipse.circle(30.0, 30.0, 9.0))


def test_a_circle_on_the_mirrored_horizon_leads_to_the_ball():
    """Before, the outline had 0.76 of the radius, and lights were wrong by 22 degrees."""
    scene = scene_named("spheres", width=320, height=256, leds=8)
    ball = ChromeSphere((-60.0, 40.0, 20.0), 20.0)
    rendering = render(replace(scene, spheres=(ball,), board=Even(0.5), board_radius_mm=400.0))
    (points,) = mask_outlines(rendering.truth.sphere_masks[0])
    x, y, radius = fit_ellipse(points)[0].circle_px
    found = calibrate_spheres(
        rendering.planes, circles=[(x, y, 0.7 * radius)], camera=rendering.truth.camera
    )
    assert found.spheres[0].outline.radius_px == pytest.approx(radius, rel=0.01)
