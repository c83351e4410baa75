"""The outline of a sphere from its edge, against the simulator's ground truth."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calibration.spheres.highlights.spots import reduce_stack
from calibration.spheres.outline.limb_fit import _texture, fit_limb
from calibration.spheres.outline.surroundings import Balls, MirroredPlane
from simulator import ChromeSphere, Lens, render, scene_named
from simulator.shapes import Checker, Even, Gradient

SIZE, CENTRE, RADIUS = (400, 320), (-20.0, 15.0, 20.0), 20.0


def recorded(board, **of_lens):
    scene = scene_named("spheres", width=SIZE[0], height=SIZE[1], leds=6, seed=3)
    scene = replace(
        scene,
        lens=Lens(scene.lens.camera, sharp=False, **of_lens),
        board=board,
        spheres=(ChromeSphere(CENTRE, RADIUS),),
        clutter=(),
    )
    rendering = render(scene)
    values = (rendering.planes + rendering.ambient) * np.float32(5.0)
    values += np.random.default_rng(1).normal(0, 2e-3, values.shape).astype(np.float32)
    values[values >= 1] = np.nan
    return values, rendering.truth.camera


@pytest.fixture(scope="module")
def even():
    return recorded(Even(0.4))


def true_ball(camera):
    """Return the ball in the image; its radius is that across the direction to the middle."""
    ray = np.array(CENTRE) - camera.centre_mm
    distance = float(np.linalg.norm(ray))
    cosine, sine = -ray[2] / distance, RADIUS / distance
    size = camera.focal_px * sine / np.sqrt(cosine**2 - sine**2)
    return Balls(camera.project(np.array([CENTRE])), np.array([size]))


def fitted(values, camera, off=(0.0, 0.0, 0.0)):
    """Return the fit from a start that is off, and its errors in x, y and radius."""
    truth = true_ball(camera)
    start = Balls(truth.axes_px + np.array(off[:2]), truth.radii_px + off[2])
    fit = fit_limb(values, MirroredPlane(values, reduce_stack(values), camera), start)
    if fit is None:
        return None, None
    error = np.append(fit.ball.axes_px - truth.axes_px, fit.ball.radii_px - truth.radii_px)
    return fit, error


@pytest.mark.parametrize("off", [(0, 0, 0), (0.6, -0.5, 0.4), (-0.4, 0.7, -0.6)])
def test_an_even_board(even, off):
    fit, error = fitted(*even, off)
    sigma = np.sqrt(np.diag(fit.covariance_px2))
    assert np.abs(error).max() < 0.02
    assert np.all(sigma < 0.04)
    assert np.all(np.abs(error) < 3.5 * sigma)


def test_a_slope_of_albedo_does_not_move_the_outline():
    # With depths on the ball instead of in the image, the radius is wrong by .06 px.
    _, error = fitted(*recorded(Gradient(0.1, 0.7, 160.0, 30.0)))
    assert np.abs(error).max() < 0.02


def test_what_one_image_shows_alone_does_not_move_the_outline(even):
    # A reflection next to the edge, and the hard edge of a shadow that touches it.
    values, camera = even
    truth = true_ball(camera)
    y, x = np.indices(values.shape[1:])
    away = np.hypot(x - truth.axes_px[0, 0], y - truth.axes_px[0, 1]) - truth.radii_px[0]
    spoiled = values.copy()
    spoiled[2][(np.abs(away - 2) < 2) & (x > truth.axes_px[0, 0])] += 0.3
    spoiled[5][(away > 1) & (y > truth.axes_px[0, 1])] *= 0.2
    _, error = fitted(spoiled, camera)
    assert np.abs(error).max() < 0.02


def test_blur_is_measured(even):
    wide, error = fitted(*recorded(Even(0.4), psf_sigma_px=1.3))
    assert np.abs(error).max() < 0.05
    assert 0.4 < wide.blur_px - fitted(*even)[0].blur_px < 0.7


@pytest.mark.parametrize("amplitude", [0.1, 0.2, 0.4])
def test_the_scatter_is_that_of_an_uneven_edge(even, amplitude):
    """The images are warped, so that the edge is a wave; its robust deviation is known."""
    values, camera = even
    truth = true_ball(camera)
    y, x = np.indices(values.shape[1:], np.float32) - truth.axes_px[0, ::-1, None, None]
    radius = np.hypot(x, y)
    near = np.exp(-(((radius - truth.radii_px[0]) / 12) ** 4))
    wave = 1 - amplitude * np.sin(5 * np.arctan2(y, x)) * near / np.maximum(radius, 1)
    places = (truth.axes_px[0, :, None, None] + wave * (x, y)).astype(np.float32)
    warped = [cv2.remap(image, *places, cv2.INTER_CUBIC) for image in values]
    fit, _ = fitted(np.stack(warped), camera)
    assert fit.scatter_px == pytest.approx(1.4826 * np.sqrt(0.5) * amplitude, rel=0.15)
    assert 0 < fitted(*even)[0].scatter_px < 0.03


def test_print_is_stated_as_an_error():
    fit, error = fitted(*recorded(Checker(0.1, 0.7, 6.0)))
    if fit is not None:
        sigma = np.sqrt(np.diag(fit.covariance_px2))
        assert sigma.max() > 0.05
        assert np.all(np.abs(error) < 3.5 * sigma)


def test_no_outline(even):
    values, camera = even
    dark = np.zeros_like(values)
    assert fitted(dark, camera)[0] is None
    flat = np.full_like(values, 0.2)
    assert fitted(flat, camera)[0] is None
    cut = Balls(np.array([[3.0, 3.0]]), np.array([40.0]))
    plane = MirroredPlane(values, reduce_stack(values), camera)
    assert fit_limb(values, plane, cut) is None


def test_texture_is_what_all_lights_show_alike():
    """Relative to the brightness; residuals of single lights are noise, also of bright ones."""
    rng = np.random.default_rng(5)
    level = rng.uniform(0.1, 2.0, (12, 60, 1))
    print_, noise = rng.normal(0, 0.05, (60, 20)), rng.normal(0, 0.05, (12, 60, 20))
    seen, weights = level * np.ones(20), 1 / level[..., 0] ** 2
    assert _texture(level * (print_ + noise), seen, weights) == pytest.approx(0.05, rel=0.05)
    assert _texture(level * noise, seen, weights) < 0.004
