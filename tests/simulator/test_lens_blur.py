"""The point-spread function: blurred edges in closed form, energy, defocus with depth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.special import ndtr

from acquisition import Lights
from simulator import ChromeSphere, Lens, Scene, bench_camera, bench_sensor, render, scene_named
from simulator.rendering import find_mirrored_lights
from simulator.rendering.blur import blur
from simulator.rendering.chrome import image_depth_mm
from simulator.rendering.shade import Shader
from simulator.rendering.trace import see
from simulator.scene import Ball, Box, Optics
from simulator.shapes import Checker, Even

CAMERA = bench_camera(160, 120)
ABOVE = Lights(directions=np.array([[0.0, 0.0, 1.0]]))
SLANTED = Lights(directions=np.array([[-1.0, 0.0, 1.0]]) / np.sqrt(2))


def scene(lens, lights=ABOVE, **more):
    dark = {"board": Even(0.5), "ambient": 0.0, "surroundings": 0.0}
    return Scene(None, lights, lens, bench_sensor(), 1.0, **dark | more)


def edge(x, place, sigma):
    """Return a step that a Gaussian and the area of a pixel blur."""

    def integral(t):
        density = np.exp(-((t / sigma) ** 2) / 2) / np.sqrt(2 * np.pi)
        return t * ndtr(t / sigma) + sigma * density

    return integral(x - place + 0.5) - integral(x - place - 0.5)


def test_a_blurred_edge_is_the_closed_form():
    """The edge of a flat, black box, nearly along the columns, at all positions in a pixel."""
    lens = Lens(CAMERA, sharp=False)
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
    lens = Lens(CAMERA, sharp=False)
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
    lens = Lens(CAMERA, sharp=False, optics=Optics(f_number=0.5))
    balls = (Ball((0.0, 0.0, 40.0), 40.0, 0.5), Ball((90.0, 30.0, 20.0), 20.0, 0.5))
    rendering = render(scene(lens, ambient=1.0, clutter=balls))
    assert lens.circle_px(np.array([520.0]))[0] > 2.5
    np.testing.assert_allclose(rendering.ambient, 0.5, rtol=1e-5)


@pytest.mark.parametrize("circle", [0.3, 1.0, 2.0, 3.7, 9.0])
def test_a_point_becomes_a_disc_with_the_variance_of_the_circle_of_confusion(circle):
    image = np.zeros((1, 41, 41), np.float32)
    image[0, 20, 20] = 1.0
    blur(image, np.full((41, 41), 600.0), np.full((41, 41), circle, np.float32), 0.7)
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
    lens = Lens(bench_camera(), sharp=False, optics=Optics(4.0, 25.0, 580.0))
    depths = np.array([500.0, 580.0, 620.0])
    aperture, focal_px = 25.0 / 4.0, lens.camera.K[0, 0]
    on_focus = aperture * np.abs(580.0 - depths) / depths
    np.testing.assert_allclose(lens.circle_px(depths), on_focus * focal_px / 580.0, rtol=1e-12)
    assert not replace(lens, sharp=True).circle_px(depths).any()
    wider = Lens(bench_camera(2448, 2048), sharp=False)
    assert wider.blur_px == pytest.approx(np.hypot(0.7, 0.42 * 0.55e-3 * 8 * 5000 / 16))


def test_highlights_are_defocused_at_the_depth_of_the_virtual_image():
    """A distant light on the axis has its image half a radius behind the front of the sphere."""
    ball = ChromeSphere((0.0, 0.0, 40.0), 40.0)
    lens = Lens(CAMERA, sharp=False, optics=Optics(f_number=0.5, focus_mm=540.0))
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
    lens = Lens(CAMERA, sharp=False, cfa="RGGB")
    red = Lights(directions=ABOVE.directions, intensities=np.array([[1.0, 1e-9, 1e-9]]))
    box = Box((0.0, 0.0), (50.0, 50.0, 10.0), albedo=(0.9, 0.1, 0.1))
    plane = render(scene(lens, red, clutter=(box,))).planes[0]
    assert plane[::2, ::2].min() > 0
    assert max(plane[1::2].max(), plane[::2, 1::2].max()) < 1e-8


def through_an_aperture(scene, fine=8):
    """Return plane and ambient image from ``fine`` x ``fine`` rays per pixel and aperture point.

    The rays of a position in the image meet in the plane of focus.
    """
    lens, margin = scene.lens, 4
    rows, columns = lens.size
    x, y = ((np.arange(-margin * fine, (n + margin) * fine) + 0.5) / fine - 0.5
            for n in (columns, rows))  # fmt: skip
    origins, rays = lens.origins_and_rays(*(v.ravel() for v in np.meshgrid(x, y)))
    radius = lens.optics.focal_length_mm / lens.optics.f_number / 2
    images = np.zeros((2, len(y), len(x)))
    angles = np.arange(6) * np.pi / 3
    # Three rings of equal area.
    points = [(r * np.cos(a + r), r * np.sin(a + r)) for r in np.sqrt([1 / 6, 0.5, 5 / 6])
              for a in angles]  # fmt: skip
    for point in points:
        shift = np.array([*(radius * np.array(point)), 0.0])
        seen = see(scene, origins + shift, np.ascontiguousarray(rays - shift / lens.camera_z_mm))
        albedo = scene.albedo(*seen.points_mm[:, :2].T, seen.on_object, seen.item)
        lit, ambient, _ = Shader(scene, 1.0).shade(seen, albedo, np.full(len(albedo), -1, np.int8))
        for image, light in zip(images, (lit[0], ambient), strict=True):
            image += light.reshape(image.shape) / len(points)
    size = (2, rows + 2 * margin, fine, columns + 2 * margin, fine)
    spread = gaussian_filter(images, (0, lens.blur_px * fine, lens.blur_px * fine))
    return spread.reshape(size).mean(axis=(2, 4))[:, margin:-margin, margin:-margin]


@pytest.mark.slow
@pytest.mark.parametrize(("f_number", "largest", "rms"), [(8.0, 0.05, 0.008), (0.08, 0.1, 0.012)])
def test_an_image_is_that_of_many_rays_through_the_aperture(f_number, largest, rms):
    """Balls, boxes, their shadows, and a board seen directly and in a mirror, also out of focus."""
    lens = Lens(bench_camera(64, 52), sharp=False, optics=Optics(f_number))
    near = Lights(positions_mm=np.array([[-200.0, 100.0, 300.0]]))
    board = Checker(0.3, 0.7, 50.0, angle_deg=10.0)
    things = (Ball((-70.0, 40.0, 40.0), 40.0), Box((50.0, -40.0), (60.0, 40.0, 60.0), 25.0, 0.9))
    mirror = (ChromeSphere((-60.0, -50.0, 40.0), 40.0),)
    inner = (slice(3, -3), slice(3, -3))
    lit = scene(lens, near, board=Even(0.2), clutter=things)
    mirrored = scene(lens, near, board=board, spheres=mirror, ambient=0.5)
    pairs = (
        (render(lit).planes[0], through_an_aperture(lit)[0]),
        (render(mirrored).ambient, through_an_aperture(mirrored)[1]),
    )
    for image, expected in pairs:
        error = (image - expected)[inner] / expected.max()
        assert np.abs(error).max() < largest
        assert np.sqrt(np.mean(error**2)) < rms
