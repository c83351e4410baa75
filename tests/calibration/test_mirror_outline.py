"""The outline of a sphere as the mean of its mirror image and its edge."""

import numpy as np
import pytest

from calibration.spheres.outline.limb_fit import LimbFit
from calibration.spheres.outline.mirror_outline import _combined
from calibration.spheres.outline.surroundings import Balls

CENTRE, SIZE, MIRROR_PX, EDGE_PX = np.array([100.0, 80.0]), 40.0, 0.04, 0.01


def mean_of(off):
    """Return the error and the covariance of the mean if the edge is off by ``off (3,)``."""
    ball = Balls(CENTRE[None], np.array([SIZE]))
    edge = Balls((CENTRE + off[:2])[None], np.array([SIZE + off[2]]))
    limb = LimbFit(edge, np.eye(3) * EDGE_PX**2, 0.9)
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
