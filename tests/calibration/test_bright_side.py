"""The border of a black cloth that a ball mirrors is not seen where the surroundings are bright."""

import numpy as np
import pytest

from calibration.spheres import Ellipse, SphereImage, find_highlights
from calibration.spheres.outline.joint_edge import bright_support
from calibration.spheres.outline.outline_confirmation import in_all_images

CENTRE, RADIUS, BORDER = (100.0, 100.0), 60.0, 44.0


def ball(cloth, ground=0.4, images=4):
    """Return images of a ball on a black cloth left of a column, and on a bright ground.

    The ball mirrors a lit room inside a circle, and around it what is next to the ball.
    """
    rows, columns = np.mgrid[:200, :200]
    far = np.hypot(columns - CENTRE[0], rows - CENTRE[1])
    outside = np.where(columns < cloth, 0.001, ground)
    image = outside + np.clip(RADIUS + 0.5 - far, 0, 1) * (0.6 * outside - outside)
    lit = np.clip(BORDER + 0.5 - far, 0, 1) * (columns < cloth)
    image = image + lit * (0.3 - image)
    values = np.repeat(image[None], images, axis=0)
    for k in range(images):
        values[k] += 40 * np.exp(-0.5 * ((columns - 90 - 6 * k) ** 2 + (rows - 100) ** 2))
    noise = np.random.default_rng(1).normal(size=values.shape) * 0.002
    return (values + noise).astype(np.float32)


@pytest.mark.parametrize(
    ("cloth", "radius", "seen"),
    [
        pytest.param(85, BORDER, False, id="the border, on the bright side"),
        pytest.param(85, RADIUS, True, id="the outline"),
        pytest.param(-1, RADIUS, True, id="the outline, bright all around"),
    ],
)
def test_what_is_seen_where_the_surroundings_are_bright(cloth, radius, seen):
    support = bright_support(ball(cloth), Ellipse(CENTRE, (radius, radius)))
    assert support > 0.8 if seen else support < 0.25


@pytest.mark.parametrize(
    "outline",
    [
        pytest.param(Ellipse(CENTRE, (RADIUS, RADIUS)), id="black all around"),
        pytest.param(Ellipse.circle(200.0, 100.0, RADIUS), id="at the frame"),
    ],
)
def test_without_bright_surroundings_nothing_is_decided(outline):
    assert np.isnan(bright_support(ball(220), outline))


def test_the_outline_around_a_border_is_found():
    values = ball(85)
    border = Ellipse(CENTRE, (BORDER, BORDER))
    sphere = SphereImage(border, np.zeros((0, 2)), 0.5, find_highlights(values, border))
    found = in_all_images(values, sphere)
    assert found.outline.circle_px == pytest.approx((*CENTRE, RADIUS), abs=0.3)
