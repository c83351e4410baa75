"""Which balls count as mirrors, errors by slopes of the plane, and the mean with the edge."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.spheres.highlights.spots import reduce_stack
from calibration.spheres.outline.limb_fit import LimbFit
from calibration.spheres.outline.mirror_outline import _combined, _MirrorFit
from calibration.spheres.outline.mirror_search import accepted
from calibration.spheres.outline.surroundings import Balls, Likeness, MirroredPlane

BALL = Balls(np.array([[50.0, 40.0]]), np.array([20.0]))


def likeness(*share, contrast=5.0, seen=1.0):
    """Return how well balls mirror the plane."""
    ones = np.ones(len(share))
    return Likeness(np.array(share), contrast * ones, seen * ones)


@pytest.mark.parametrize(
    ("best", "others", "counts"),
    [
        pytest.param(likeness(0.95), (0.1, 0.2), True, id="a sphere"),
        pytest.param(likeness(0.51), (0.3, 0.0), True, id="a sphere between others"),
        pytest.param(likeness(0.49), (0.0, 0.0), False, id="too little is explained"),
        pytest.param(likeness(0.82), (0.78, 0.3), False, id="a larger ball explains as much"),
        pytest.param(likeness(0.82), (0.3, 0.78), False, id="a smaller ball explains as much"),
        pytest.param(likeness(0.82), (0.61, 0.61), True, id="just enough less"),
        pytest.param(likeness(0.95, seen=0.34), (0.1, 0.2), False, id="too little is in the image"),
        pytest.param(likeness(0.95, contrast=1.9), (0.1, 0.2), False, id="nothing to explain"),
    ],
)
def test_a_mirror_explains_much_and_much_more_than_other_radii(best, others, counts):
    compared = []

    def compare(balls):
        compared.append(balls)
        return likeness(*others)

    mirror = accepted(SimpleNamespace(compare=compare), BALL, best)
    assert (mirror is not None) == counts
    for balls in compared:
        assert balls.radii_px == pytest.approx([18.8, 21.2])
        assert balls.axes_px == pytest.approx(np.repeat(BALL.axes_px, 2, axis=0))


class LinearPlane:
    """A plane whose differences are linear in place, radius and slopes, seen over a sector."""

    def __init__(self, seed, sector, camera_known=True):
        self._seed, self._sector, self.camera_known = seed, sector, camera_known

    def differences(self, balls, depths, spokes, *_):
        rng = np.random.default_rng(self._seed)
        angle = np.tile(np.arange(spokes) * (2 * np.pi / spokes), len(depths))
        unknowns = np.column_stack([balls.axes_px, balls.radii_px, 100 * balls.slopes])
        waves = [np.cos(angle), np.sin(angle), np.ones_like(angle)]
        # Slopes act like a shift, but not quite.
        waves += [np.cos(angle) + 0.3 * np.cos(2 * angle), np.sin(angle) + 0.3 * np.sin(2 * angle)]
        noise = rng.normal(0, 0.1, (3, 1, len(angle)))
        part = np.array([1.0, 0.7, -0.5])[:, None, None] * (unknowns @ np.array(waves))
        return part + noise, np.tile(angle < self._sector, (len(unknowns), 1))


@pytest.mark.parametrize("sector", [2 * np.pi, 0.6 * np.pi], ids=["whole", "part"])
@pytest.mark.parametrize("seed", range(4))
def test_the_errors_contain_how_far_the_slopes_moved_the_place(seed, sector):
    """The oracle: without slopes, the same least squares puts the ball elsewhere."""
    slopes = np.random.default_rng(seed).normal(0, 0.01, 2)
    fit = _MirrorFit(LinearPlane(seed, sector), np.array([0.0, 0.0, 30.0, *slopes]), 0.9)
    with_slopes = fit.covariance()
    normal, _ = fit._normal()
    moved = np.linalg.solve(normal[:3, :3], normal[:3, 3:] @ slopes)
    fit._camera_known = False
    without = fit.covariance()
    assert with_slopes - without == pytest.approx(np.outer(moved, moved), rel=1e-6, abs=1e-12)


def test_over_a_part_of_the_limb_slopes_move_the_place_more():
    added = []
    for sector in (2 * np.pi, 0.6 * np.pi):
        fit = _MirrorFit(LinearPlane(1, sector), np.array([0.0, 0.0, 30.0, 0.01, 0.01]), 0.9)
        with_slopes = fit.covariance()
        fit._camera_known = False
        added.append(np.trace(with_slopes - fit.covariance()))
    assert added[1] > added[0] > 0


def test_an_unknown_camera_does_not_say_how_large_slopes_can_be():
    plane = LinearPlane(1, 2 * np.pi, camera_known=False)
    flat, steep = (
        _MirrorFit(plane, np.array([0.0, 0.0, 30.0, slope, 0.0]), 0.9) for slope in (0.0, 0.01)
    )
    # The differences change with the slope, their derivatives do not.
    steep._first, steep.scale = flat._first, flat.scale
    assert steep.covariance() == pytest.approx(flat.covariance())


def test_few_spokes_have_no_errors():
    fit = _MirrorFit(LinearPlane(1, 0.4), np.array([0.0, 0.0, 30.0, 0.0, 0.0]), 0.9)
    assert fit.covariance() is None


@pytest.mark.parametrize("lights", [3, 12])
@pytest.mark.parametrize("period_px", [np.inf, 4.4, 2.5])
def test_a_fine_texture_is_no_noise(lights, period_px):
    """On a weave of 4.4 px, noise was overestimated 14 times, and spheres were missed."""
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:120, :160]
    albedo = 0.4 + 0.3 * np.sin(2 * np.pi * (columns + 0.6 * rows) / period_px)
    shading = [1 + 0.5 * np.cos(k + columns / 60) * np.sin(rows / 50) for k in range(lights)]
    values = np.array([albedo * one for one in shading]) + rng.normal(0, 0.004, (lights, 120, 160))
    values = values.astype(np.float32)
    assert MirroredPlane(values, reduce_stack(values)).noise == pytest.approx(0.004, rel=0.1)


CENTRE, SIZE, MIRROR_PX, EDGE_PX = np.array([100.0, 80.0]), 40.0, 0.04, 0.01


def mean_of(off):
    """Return the error and the covariance of the mean if the edge is off by ``off (3,)``."""
    ball = Balls(CENTRE[None], np.array([SIZE]))
    edge = Balls((CENTRE + off[:2])[None], np.array([SIZE + off[2]]))
    limb = LimbFit(edge, np.eye(3) * EDGE_PX**2, 0.9, 0.02)
    mean, covariance = _combined(ball, np.eye(3) * MIRROR_PX**2, limb)
    return np.append(mean.axes_px[0] - CENTRE, mean.radii_px - SIZE), covariance


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("off_px", "share", "sigma_px"),
    [
        pytest.param(0.02, 0.936, 0.0101, id="they agree: the inverse covariances are the weights"),
        pytest.param(-0.11, 0.936, 0.0101, id="within the usual"),
        pytest.param(0.2, 0.991, 0.0104, id="they differ: the mirror image counts less"),
        pytest.param(-0.5, 0.0, MIRROR_PX, id="a contradiction: not the edge of this ball"),
    ],
)
def test_mirror_image_and_edge(axis, off_px, share, sigma_px):
    off = np.zeros(3)
    off[axis] = off_px
    error, covariance = mean_of(off)
    assert error == pytest.approx(share * off, abs=1e-3)
    assert np.sqrt(covariance[axis, axis]) == pytest.approx(sigma_px, rel=0.01)
    others = np.delete(np.arange(3), axis)
    assert np.all(covariance[others, others] <= MIRROR_PX**2)
