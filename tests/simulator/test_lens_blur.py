"""The point-spread function: blurred edges in closed form, energy, defocus with depth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import norm

from acquisition import DataError, Lights
from simulator import (
    Ball,
    Box,
    ChromeSphere,
    Even,
    Lens,
    Optics,
    Scene,
    bench_camera,
    bench_sensor,
    find_mirrored_lights,
    render,
    scene_named,
)
from simulator._render.blur import blur
from simulator._render.mirror import image_depth_mm

CAMERA = bench_camera(160, 120)
ABOVE = Lights(directions=np.array([[0.0, 0.0, 1.0]]))
SLANTED = Lights(directions=np.array([[-1.0, 0.0, 1.0]]) / np.sqrt(2))


def scene(lens, lights=ABOVE, **more):
    dark = {"board": Even(0.5), "ambient": 0.0, "surroundings": 0.0}
    return Scene(None, lights, lens, bench_sensor(), 1.0, **dark | more)


def edge(x, place, sigma):
    """Return a step that a Gaussian and the area of a pixel blur."""

    def integral(t):
        return t * norm.cdf(t / sigma) + sigma * norm.pdf(t / sigma)

    return integral(x - place + 0.5) - integral(x - place - 0.5)


def test_a_blurred_edge_is_the_closed_form():
    """The edge of a flat, black box, nearly along the columns, at all positions in a pixel."""
    lens = Lens.of(CAMERA, sharp=False)
    box = Box((-50.0, 0.0), (100.0, 400.0, 1e-6), turn_deg=-1.0, albedo=0.0)
    rows = np.arange(20, 100)
    image = render(scene(lens, clutter=(box,))).planes[0, rows] / 0.5
    pixel = 600.0 / CAMERA.K[0, 0]
    y = (59.5 - rows) * pixel
    turn = np.radians(-1.0)
    along = (y - 50.0 * np.sin(turn)) / np.cos(turn)
    place = 79.5 + (-50.0 + 50.0 * np.cos(turn) - along * np.sin(turn)) / pixel
    x = np.arange(160.0)
    expected = edge(x, place[:, None], lens.blur_px)
    near = np.abs(x - place[:, None]) < 5
    assert np.abs(image - expected)[near].max() < 0.045
    assert np.sqrt(np.mean((image - expected)[near] ** 2)) < 0.015
    shifts = [
        least_squares(lambda p, row=row, on=on: edge(x[on], *p) - row[on], [at, 0.7]).x[0] - at
        for row, at, on in zip(image, place, near, strict=True)
    ]
    assert np.abs(shifts).max() < 0.05
    assert abs(np.mean(shifts)) < 0.005


def test_the_edge_of_a_shadow_is_blurred_where_it_is():
    lens = Lens.of(CAMERA, sharp=False)
    box = Box((-20.0, 0.0), (10.0, 400.0, 30.0), albedo=0.0)
    row = render(scene(lens, SLANTED, clutter=(box,))).planes[0, 60]
    pixel = 600.0 / CAMERA.K[0, 0]
    place = 79.5 + 15.0 / pixel
    x = np.arange(160.0)
    near = np.abs(x - place) < 6
    expected = edge(x, place, lens.blur_px) * 0.5 / np.sqrt(2)
    assert np.abs(row - expected)[near].max() < 0.05 * 0.5


def test_uniform_radiance_stays_uniform_at_all_depths():
    """Balls as bright as the board are invisible in ambient light, however they are defocused."""
    lens = Lens.of(CAMERA, sharp=False, optics=Optics(f_number=0.5))
    balls = (Ball((0.0, 0.0, 40.0), 40.0, 0.5), Ball((90.0, 30.0, 20.0), 20.0, 0.5))
    rendering = render(scene(lens, ambient=1.0, clutter=balls))
    assert lens.circle_px(np.array([520.0]))[0] > 2.5
    np.testing.assert_allclose(rendering.ambient, 0.5, rtol=1e-5)


@pytest.mark.parametrize("circle", [0.3, 1.0, 2.0, 3.7, 9.0])
def test_a_point_becomes_a_disc_with_the_variance_of_the_circle_of_confusion(circle):
    image = np.zeros((1, 41, 41), np.float32)
    image[0, 20, 20] = 1.0
    blur(image, np.full((41, 41), circle, np.float32), 0.7)
    across = image[0].sum(axis=0)
    assert image.sum() == pytest.approx(1.0, abs=1e-5)
    place = np.arange(41) - 20
    assert (across * place).sum() == pytest.approx(0.0, abs=1e-5)
    assert (across * place**2).sum() == pytest.approx(0.49 + circle**2 / 16, abs=0.03 * circle)


def test_light_is_conserved_and_truth_stays_sharp():
    soft = scene_named("coin-with-spheres", width=200, height=160, leds=3)
    soft = replace(soft, lens=replace(soft.lens, sharp=False))
    sharp = replace(soft, lens=replace(soft.lens, sharp=True))
    one, two = render(sharp), render(soft)
    sums = [r.planes.sum(axis=(1, 2), dtype=float) for r in (one, two)]
    np.testing.assert_allclose(sums[1], sums[0], rtol=1e-3)
    assert np.abs(one.planes - two.planes).max() > 0.05 * 0.42
    for name in ("normals", "height_mm", "albedo", "mask", "shadows", "sphere_masks"):
        np.testing.assert_array_equal(getattr(one.truth, name), getattr(two.truth, name))
    np.testing.assert_array_equal(one.truth.highlights_px, two.truth.highlights_px)


def test_circle_of_confusion_is_the_aperture_seen_from_the_point():
    """Rays through the rim of the aperture and a point meet the plane of focus that far apart."""
    lens = Lens.of(bench_camera(), sharp=False, optics=Optics(4.0, 25.0, 580.0))
    depths = np.array([500.0, 580.0, 620.0])
    aperture, focal_px = 25.0 / 4.0, lens.camera.K[0, 0]
    on_focus = aperture * np.abs(580.0 - depths) / depths
    np.testing.assert_allclose(lens.circle_px(depths), on_focus * focal_px / 580.0, rtol=1e-12)
    assert not replace(lens, sharp=True).circle_px(depths).any()
    wider = Lens.of(bench_camera(2448, 2048), sharp=False)
    assert wider.blur_px == pytest.approx(np.hypot(0.7, 0.42 * 0.55e-3 * 8 * 5000 / 16))


def test_highlights_are_defocused_at_the_depth_of_the_virtual_image():
    """A distant light on the axis has its image half a radius behind the front of the sphere."""
    ball = ChromeSphere((0.0, 0.0, 40.0), 40.0)
    lens = Lens.of(CAMERA, sharp=False, optics=Optics(f_number=0.5, focus_mm=540.0))
    top = np.array([[0.0, 0.0, 80.0]])
    np.testing.assert_allclose(image_depth_mm(lens, ball, top, np.inf), 540.0)
    # A near light's image is nearer: 1/i = 1/400 + 1/20.
    np.testing.assert_allclose(image_depth_mm(lens, ball, top, 400.0), 520 + 400 / 21)
    focused = scene(lens, spheres=(ball,))
    assert find_mirrored_lights(focused).circle_px[0, 0] == pytest.approx(0.0, abs=1e-9)
    on_board = replace(focused, lens=replace(lens, optics=Optics(f_number=0.5)))
    circle = find_mirrored_lights(on_board).circle_px[0, 0]
    assert circle == pytest.approx(32 * CAMERA.K[0, 0] * (1 / 540 - 1 / 600))
    peaks = [render(s).planes[0].max() for s in (focused, on_board)]
    # A wide disc spreads the light; the sum stays.
    assert peaks[0] > 1.2 * peaks[1]
    sums = [render(s).planes[0].sum(dtype=float) for s in (focused, on_board)]
    assert sums[1] == pytest.approx(sums[0], rel=1e-3)


def test_the_colours_of_a_mosaic_do_not_mix():
    """Red light leaves green and blue pixels dark, although the lens blurs the mosaic."""
    lens = Lens.of(CAMERA, sharp=False, cfa="RGGB")
    red = Lights(directions=ABOVE.directions, intensities=np.array([[1.0, 1e-9, 1e-9]]))
    box = Box((0.0, 0.0), (50.0, 50.0, 10.0), albedo=(0.9, 0.1, 0.1))
    plane = render(scene(lens, red, clutter=(box,))).planes[0]
    assert plane[::2, ::2].min() > 0
    assert max(plane[1::2].max(), plane[::2, 1::2].max()) < 1e-8


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Optics(f_number=0.0), "f_number"),
        (lambda: Optics(focus_mm=float("nan")), "focus_mm"),
        (lambda: Lens.of(CAMERA, optics=Optics(focus_mm=10.0)), "within the focal length"),
        (
            lambda: render(
                scene(Lens.of(CAMERA, sharp=False, optics=Optics(0.02, focus_mm=300.0)))
            ),
            "out of focus by",
        ),
    ],
)
def test_impossible_optics_are_refused(make, message):
    with pytest.raises(DataError, match=message):
        make()
