"""Distant lights, colour, lenses and materials in whole renderings, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import CameraModel, DataError, Lights
from simulator import ChromeSphere, Lens, Scene, bench_sensor, render
from simulator.scene import Ggx, Lambert, OrenNayar
from simulator.shapes import Checker, Coin, ColourWheel, Even, Plane, Ripples, SphericalCap
from tests.quick_sample import quick

CAMERA = CameraModel(np.array([[300.0, 0, 70.3], [0, 320.0, 41.8], [0, 0, 1]]), 150, 90, 500.0)
PARALLEL = Lens.orthographic(120, 100, 1.3, 500.0)
DIRECTIONS = np.array([[0.6, 0.0, 0.8], [-0.3, 0.5, 0.4], [0.1, -0.9, 0.15]])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
COLOURS = np.array([[1.2, 0.9, 0.6], [0.8, 1.0, 1.1], [1.0, 1.5, 0.7]])
NEAR = Lights(positions_mm=400.0 * DIRECTIONS + [0, 0, 60], intensities=COLOURS)
DISTANT = Lights(DIRECTIONS, intensities=COLOURS)


def _scene(body, lights, lens=PARALLEL, **more):
    defaults = {"ambient": 0.0, "board_radius_mm": 400.0}
    return Scene(body, lights, lens, bench_sensor(), 1.0, **{**defaults, **more})


@pytest.mark.parametrize("lens", [PARALLEL, Lens(CAMERA)], ids=["parallel", "perspective"])
def test_sphere_under_distant_lights(lens):
    """Radiance is albedo times intensity times n . l, everywhere, to 1e-5."""
    radius = 45.0
    rendering = render(_scene(SphericalCap(radius, radius), DISTANT, lens, pattern=Even(0.7)))
    truth = rendering.truth
    normals = truth.points_mm[truth.mask] / radius
    facing = np.clip(normals @ DIRECTIONS.T, 0, None).T
    assert truth.mask.sum() > 500
    np.testing.assert_allclose(
        rendering.planes[:, truth.mask],
        0.7 * COLOURS.mean(axis=1)[:, None] * facing,
        rtol=1e-5,
        atol=1e-7,
    )
    np.testing.assert_allclose(truth.normals[truth.mask], normals, atol=1e-6)


def test_distant_light_is_the_limit_of_a_near_one():
    body = Ripples(50.0, 1.0, 12.0)
    far = render(_scene(body, Lights(positions_mm=1e8 * DIRECTIONS, intensities=COLOURS)))
    distant = render(_scene(body, DISTANT))
    np.testing.assert_array_equal(distant.truth.shadows, far.truth.shadows)
    np.testing.assert_allclose(distant.planes, far.planes, rtol=1e-5, atol=1e-6)


def test_an_orthographic_lens_sees_the_surface_vertically():
    body = Coin(50.0)
    truth = render(_scene(body, NEAR)).truth
    x, y = np.meshgrid((np.arange(120) - 59.5) * 1.3, (49.5 - np.arange(100)) * 1.3)
    z, zx, zy = body.evaluate(x, y)
    np.testing.assert_array_equal(truth.mask, np.hypot(x, y) <= 50.0)
    np.testing.assert_allclose(truth.height_mm[truth.mask], z[truth.mask], atol=1e-9)
    normals = np.stack([-zx, -zy, np.ones_like(z)], -1) / np.sqrt(1 + zx**2 + zy**2)[..., None]
    np.testing.assert_allclose(truth.normals[truth.mask], normals[truth.mask], atol=1e-7)


@pytest.mark.parametrize("lights", [NEAR, DISTANT], ids=["near", "distant"])
@pytest.mark.parametrize("cfa", quick(["RGGB", "BGGR", "GRBG"], every=3))
def test_each_pixel_of_a_mosaic_has_its_own_channel(cfa, lights):
    """Albedo and intensity of one channel; everything else equals grey paint in white light."""
    wheel = ColourWheel(50.0)
    scene = _scene(Coin(50.0), lights, pattern=wheel, ambient=0.1)
    mosaic = render(replace(scene, lens=replace(PARALLEL, cfa=cfa)))
    white_light = replace(lights, intensities=np.ones((3, 3)))
    white = render(replace(scene, pattern=Even(1.0), lights=white_light))
    mask = mosaic.truth.mask
    y, x = np.mgrid[:100, :120]
    channel = np.array(["RGB".index(letter) for letter in cfa])[2 * (y % 2) + x % 2]
    points = mosaic.truth.points_mm
    albedo = wheel.evaluate(points[..., 0], points[..., 1])
    own = np.take_along_axis(albedo, channel[..., None], axis=-1)[..., 0]
    expected = white.planes * own * COLOURS[:, channel]
    np.testing.assert_allclose(mosaic.planes[:, mask], expected[:, mask], rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(mosaic.ambient[mask], 0.1 * own[mask], rtol=1e-6)
    np.testing.assert_allclose(mosaic.truth.albedo[mask], albedo[mask], rtol=1e-6)


def test_monochrome_camera_sees_the_mean_of_the_colours():
    wheel = ColourWheel(50.0)
    scene = _scene(Coin(50.0), NEAR, pattern=wheel)
    result = render(scene)
    white = render(
        replace(scene, pattern=Even(1.0), lights=replace(NEAR, intensities=np.ones((3, 3))))
    )
    mask, points = result.truth.mask, result.truth.points_mm
    albedo = wheel.evaluate(points[mask][:, 0], points[mask][:, 1])
    expected = white.planes[:, mask] * (COLOURS @ albedo.T) / 3
    np.testing.assert_allclose(result.planes[:, mask], expected, rtol=1e-5, atol=1e-8)


def test_a_chrome_sphere_in_a_mosaic_mirrors_colours():
    """Red paint on the board is visible only in the red pixels of the sphere."""
    lens = replace(Lens(CAMERA), cfa="RGGB")
    scene = _scene(
        None,
        NEAR,
        lens,
        board=Even((0.8, 0.0, 0.0)),
        surroundings=0.0,
        spheres=(ChromeSphere((0.0, 0.0, 30.0), 30.0),),
        led_radius_mm=0.5,
    )
    rendering = render(scene)
    inside = rendering.truth.sphere_masks[0]
    for spot in rendering.truth.highlights_px[0]:
        column, row = np.round(spot).astype(int)
        inside[row - 6 : row + 7, column - 6 : column + 7] = False
    red = np.zeros(inside.shape, bool)
    red[::2, ::2] = True
    assert (rendering.planes[0][inside & red] > 0.01).sum() > 20
    assert rendering.planes[0][inside & ~red].max() == 0


def test_board_has_its_own_pattern():
    lights = Lights(np.array([[0.0, 0.0, 1.0]]))
    plane = render(_scene(Plane(20.0), lights, board=Checker(0.2, 0.6, 15.0))).planes[0]
    x, y = np.meshgrid((np.arange(120) - 59.5) * 1.3, (49.5 - np.arange(100)) * 1.3)
    expected = np.where((np.floor(x / 15) + np.floor(y / 15)) % 2 == 0, 0.6, 0.2)
    expected[np.hypot(x, y) <= 20.0] = 1.0
    clear = np.minimum(*(np.abs(v - 15 * np.round(v / 15)) for v in (x, y))) > 0.65
    np.testing.assert_allclose(plane[clear], expected[clear], rtol=1e-6)


def test_edge_of_a_pattern_is_averaged_over_the_pixel():
    """A pixel with an edge is the weighted mean of both sides, on a slope and in perspective."""
    lights, squares = Lights(np.array([[0.0, 0.0, 1.0]])), Checker(0.2, 0.6, 400.0)
    for lens in (PARALLEL, Lens(CAMERA)):
        truth = render(_scene(Plane(60.0, 20.0, 0.2, 0.1), lights, lens, pattern=squares)).truth
        x = truth.points_mm[..., 0]
        width = np.diff(x, axis=1, prepend=np.nan)
        # The share right of the edge x = 0, above y = 0, where the right square has `high`.
        share = np.clip(x / width + 0.5, 0, 1)
        ask = truth.mask & (truth.points_mm[..., 1] > 3) & np.isfinite(width)
        cut = ask & (share > 0) & (share < 1)
        assert cut.sum() > 10
        np.testing.assert_allclose(truth.albedo[ask], 0.2 + 0.4 * share[ask], atol=0.4 / 16)


def test_vignetting_dims_everything_by_the_field_angle():
    scene = _scene(Coin(50.0), NEAR, Lens(CAMERA), ambient=0.1)
    scene = replace(scene, spheres=(ChromeSphere((85.0, 40.0, 12.0), 12.0),))
    clear, dim = (render(replace(scene, lens=Lens(CAMERA, vignetting=v))) for v in (0.0, 0.7))
    u, v = np.meshgrid(np.arange(150), np.arange(90))
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(CAMERA.K).T
    expected = 1 - 0.7 * (1 - (rays**2).sum(-1) ** -2)
    np.testing.assert_allclose(dim.planes, clear.planes * expected, rtol=1e-5)
    np.testing.assert_allclose(dim.ambient, clear.ambient * expected, rtol=1e-5)
    assert expected.min() < 0.93


def _oren_nayar(material, cos_light, cos_eye, between):
    """Formula with the angles of the publication."""
    squared = np.radians(material.sigma_deg) ** 2
    tilt = [np.arctan2(np.sqrt(1 - c**2), c) for c in (cos_light, cos_eye)]
    alpha, beta = np.maximum(*tilt), np.minimum(*tilt)
    turn = (between - cos_light * cos_eye) / (np.sin(tilt[0]) * np.sin(tilt[1]))
    lobe = np.clip(turn, 0, None) * np.sin(alpha) * np.tan(beta)
    return 1 - 0.5 * squared / (squared + 0.33) + 0.45 * squared / (squared + 0.09) * lobe, 0.0


def _ggx(material, cos_light, cos_eye, between):
    """Formula with the half vector and Smith's two masking functions."""
    half = np.sqrt(2 + 2 * between)
    tan2 = ((cos_light + cos_eye) / half) ** -2 - 1
    d = material.roughness**2 / (np.pi * (1 + tan2) ** -2 * (material.roughness**2 + tan2) ** 2)
    smith = [
        (np.sqrt(1 + material.roughness**2 * (c**-2 - 1)) - 1) / 2 for c in (cos_light, cos_eye)
    ]
    fresnel = [
        material.f0 + (1 - material.f0) * (1 - c) ** 5 for c in (half / 2, cos_light, cos_eye)
    ]
    gloss = np.pi * d * fresnel[0] / (1 + smith[0] + smith[1]) / (4 * cos_light * cos_eye)
    return (1 - fresnel[1]) * (1 - fresnel[2]), gloss


@pytest.mark.parametrize("lights", [NEAR, DISTANT], ids=["near", "distant"])
@pytest.mark.parametrize("lens", [PARALLEL, Lens(CAMERA)], ids=["parallel", "perspective"])
@pytest.mark.parametrize(
    ("material", "formula"),
    [
        pytest.param(OrenNayar(35.0), _oren_nayar, id="oren-nayar"),
        pytest.param(Ggx(0.25, 0.08), _ggx, id="ggx"),
    ],
)
def test_material_shapes_the_object_and_not_the_board(material, formula, lens, lights):
    """The ratio to a Lambertian rendering is the reflectance of the material, point by point."""
    scene = _scene(SphericalCap(45.0, 30.0), lights, lens, pattern=Even(0.6), board=Even(0.3))
    matte, result = (
        render(replace(scene, material=Lambert())),
        render(replace(scene, material=material)),
    )
    mask, truth = result.truth.mask, result.truth
    np.testing.assert_array_equal(result.planes[:, ~mask], matte.planes[:, ~mask])
    points, normals = truth.points_mm[mask], truth.normals[mask].astype(float)
    to_eye = np.array([0, 0, 1.0]) if lens is PARALLEL else np.array([0, 0, 500.0]) - points
    to_eye = to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True)
    for k in range(3):
        to_light = DIRECTIONS[k] if lights is DISTANT else NEAR.positions_mm[k] - points
        to_light = to_light / np.linalg.norm(to_light, axis=-1, keepdims=True)
        cosines = [(a * b).sum(-1) for a, b in ((normals, to_light), (normals, to_eye))]
        lit = (cosines[0] > 0.02) & (cosines[1] < 0.9999) & ~truth.shadows[k][mask]
        cosines = [np.broadcast_to(c, lit.shape)[lit] for c in cosines]
        between = np.broadcast_to((to_light * to_eye).sum(-1), lit.shape)[lit]
        diffuse, gloss = formula(material, *cosines, between)
        np.testing.assert_allclose(
            result.planes[k, mask][lit],
            matte.planes[k, mask][lit] * (diffuse + gloss / 0.6),
            rtol=2e-4,
        )


def test_rows_do_not_depend_on_the_blocks_of_rendering(monkeypatch):
    progress = []
    scene = _scene(
        Coin(40.0), NEAR, Lens(CAMERA), spheres=(ChromeSphere((70.0, 30.0, 12.0), 12.0),)
    )
    whole = render(scene, lambda _, done, total: progress.append((done, total)))
    monkeypatch.setattr("simulator.rendering.canvas.POINTS", 450)
    parts = render(scene, lambda _, done, total: progress.append((done, total)))
    assert progress == [(90, 90)] + [(row, 90) for row in range(3, 91, 3)]
    np.testing.assert_array_equal(parts.planes, whole.planes)
    np.testing.assert_array_equal(parts.truth.shadows, whole.truth.shadows)
    np.testing.assert_array_equal(parts.truth.normals, whole.truth.normals)


def test_a_rendering_that_exceeds_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr("simulator.rendering.renderer.memory_of_computer", lambda: (1, 10**5))
    with pytest.raises(DataError, match=r"3 images of 150 x 90 pixels requires .* GiB"):
        render(_scene(None, NEAR, Lens(CAMERA)))
