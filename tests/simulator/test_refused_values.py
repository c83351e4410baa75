"""Values out of range are refused in one line that names them."""

from dataclasses import replace
from functools import partial
from math import inf, nan

import numpy as np
import pytest

from acquisition import CameraModel, DataError, Lights
from simulator import (
    ChromeSphere,
    Lens,
    Scene,
    bench_camera,
    bench_sensor,
    dome_lights,
    render,
    scene_named,
)
from simulator.scene import Ball, Box, Ggx, Lamps, Optics, OrenNayar
from simulator.shapes import (
    BandNoise,
    ChArUco,
    Checker,
    Coin,
    ColourWheel,
    Cork,
    CrackedLeather,
    Even,
    Gradient,
    LizardScales,
    MeshBody,
    Paint,
    Plane,
    Print,
    Ripples,
    SphericalCap,
    StepGauge,
    Textile,
    Weave,
    Wood,
    WoodCarving,
)
from tests.simulator.test_mesh_body import PYRAMID, SIDES

CAMERA = bench_camera(160, 120)
COIN = scene_named("coin", width=64, height=48, leds=4)
SPHERES = scene_named("spheres", width=64, height=48, leds=4)
coin, spheres = partial(replace, COIN), partial(replace, SPHERES)


def leds(*positions, **more):
    return Lights(positions_mm=np.array(positions, float), **more)


def soft(**optics):
    return Lens(CAMERA, sharp=False, optics=Optics(**optics))


def mirror(x, y, z, radius):
    return ChromeSphere((x, y, z), radius)


def bare(*clutter, body=None, **more):
    defaults = {"lights": leds((-150, 0, 150)), "lens": Lens.orthographic(120, 100, 1.0, 200.0)}
    return Scene(
        body, noise=bench_sensor(), electrons_per_us=1.0, clutter=clutter, **defaults | more
    )


REFUSED = [
    # Clutter.
    ("intersects the board", lambda: Ball((0, 0, 1), 2)),
    ("three finite numbers", lambda: Ball((0, 0, nan), 2)),
    ("albedo", lambda: Ball((0, 0, 2), 2, albedo=2.0)),
    ("roughness", lambda: Ball((0, 0, 2), 2, roughness=0.001)),
    ("size_mm", lambda: Box((0, 0), (1, 0, 1))),
    ("not finite", lambda: Box((0, inf), (1, 1, 1))),
    ("clutter 0 overlaps the object", lambda: bare(Ball((0, 0, 5), 5), body=Plane(20.0))),
    (
        "clutter 0 overlaps sphere 0",
        lambda: bare(Box((0, 0), (9, 9, 9)), spheres=(mirror(6, 6, 5, 5),)),
    ),
    ("clutter 0 reaches the camera", lambda: bare(Box((0, 0), (9, 9, 250)))),
    ("inside clutter 0", lambda: bare(Box((0, 0), (9, 9, 100)), lights=leds((1, 1, 90)))),
    ("slopes of", lambda: bare(relief=BandNoise(260.0, 5.0, 4.0))),
    # Grounds.
    ("low", lambda: Cork(low=1.2)),
    ("grain_mm", lambda: Cork(grain_mm=0)),
    ("ring_mm", lambda: Wood(ring_mm=-1)),
    ("angle_deg", lambda: Wood(angle_deg=nan)),
    ("line_mm", lambda: Print(line_mm=0)),
    ("yarn_mm", lambda: Weave(yarn_mm=inf)),
    ("angle_deg", lambda: Checker(angle_deg=nan)),
    ("shift_mm", lambda: Checker(shift_mm=(0, inf))),
    # Patterns.
    ("albedo is 1.1", lambda: Even(1.1)),
    ("albedo is nan", lambda: Even(nan)),
    ("one or three", lambda: Even((0.1, 0.2))),
    ("low is -0.1", lambda: Checker(low=-0.1)),
    ("square_mm is 0.0", lambda: Checker(square_mm=0.0)),
    ("length_mm is -5.0", lambda: Gradient(length_mm=-5.0)),
    ("angle_deg is inf", lambda: Gradient(angle_deg=inf)),
    ("low 0.5, high 0.2", lambda: Paint(0.5, 0.2)),
    ("radius_mm is 0.0", lambda: ColourWheel(radius_mm=0.0)),
    ("must be 2 or more", lambda: ChArUco(1, 5)),
    ("at most 500", lambda: ChArUco(30, 30)),
    ("white is 2.0", lambda: ChArUco(white=2.0)),
    # Materials.
    ("sigma_deg is -1", lambda: OrenNayar(-1.0)),
    ("sigma_deg is nan", lambda: OrenNayar(nan)),
    ("roughness is 0", lambda: Ggx(0.0)),
    ("roughness is 1.2", lambda: Ggx(1.2)),
    ("f0 is -0.1", lambda: Ggx(0.3, -0.1)),
    # Lamps.
    ("warm_up -1", lambda: Lamps(warm_up=-1.0)),
    ("warm_up_s 0 s", lambda: Lamps(warm_up_s=0.0)),
    ("flicker is -0.1", lambda: Lamps(flicker=-0.1)),
    ("flicker is 0.3", lambda: Lamps(flicker=0.3)),
    ("flicker is nan", lambda: Lamps(flicker=nan)),
    ("pwm_hz 0", lambda: Lamps(pwm_hz=0.0)),
    ("pwm_hz is inf", lambda: Lamps(pwm_hz=inf)),
    ("pwm_duty 0", lambda: Lamps(pwm_duty=0.0)),
    ("pwm_duty 1.1", lambda: Lamps(pwm_duty=1.1)),
    ("not be negative", lambda: Lamps(dead=(-1,))),
    # Lenses.
    ("pixels is invalid", lambda: Lens()),
    ("pixels is invalid", lambda: Lens.orthographic(0, 5, 1, 1)),
    ("pixel_mm is -1", lambda: Lens.orthographic(5, 5, -1, 1)),
    ("height_mm is nan", lambda: Lens.orthographic(5, 5, 1, nan)),
    ("one or the other", lambda: Lens(bench_camera(), width=3)),
    ("give working_distance_mm", lambda: Lens(CameraModel(CAMERA.K, 64, 64))),
    ("within 0..1", lambda: Lens(bench_camera(), vignetting=1.2)),
    ("positive", lambda: Lens(bench_camera(), psf_sigma_px=0)),
    ("not one of RGGB", lambda: Lens(bench_camera(), cfa="RGB")),
    # Optics.
    ("f_number", lambda: Optics(f_number=0.0)),
    ("focus_mm", lambda: Optics(focus_mm=nan)),
    ("within the focal length", lambda: soft(focus_mm=10)),
    ("out of focus by", lambda: render(bare(lens=soft(f_number=0.02, focus_mm=300)))),
    # Meshes.
    ("no faces", lambda: MeshBody(PYRAMID, np.zeros((0, 3), int))),
    ("vertex 4 is not finite", lambda: MeshBody(np.where(PYRAMID == 3, nan, PYRAMID), SIDES)),
    ("vertex 4 is not finite", lambda: MeshBody(np.where(PYRAMID == 3, inf, PYRAMID), SIDES)),
    ("does not exist", lambda: MeshBody(PYRAMID, SIDES + 1)),
    ("does not exist", lambda: MeshBody(PYRAMID, SIDES - 1)),
    (
        "1 of 5 faces have no area, the first one is face 4",
        lambda: MeshBody(PYRAMID, [*SIDES, [0, 0, 1]]),
    ),
    (r"expected \(V, 3\)", lambda: MeshBody(PYRAMID[:, :2], SIDES)),
    ("triples", lambda: MeshBody(PYRAMID, SIDES.astype(float))),
    # Surfaces.
    ("radius_mm is -1.0", lambda: Plane(-1.0)),
    ("height_mm is nan", lambda: Plane(10.0, nan)),
    ("wavelength_mm is 0.0", lambda: Ripples(10.0, 0.1, 0.0)),
    ("not exceed radius_mm", lambda: SphericalCap(10.0, 10.1)),
    ("outline is 'oval'", lambda: Plane(10.0, outline="oval")),
    ("amplitude_mm is 0.0", lambda: LizardScales(10.0, 0.0)),
    ("scale_mm is -2", lambda: LizardScales(10.0, scale_mm=-2)),
    ("yarn_mm is 0.0", lambda: Textile(10.0, yarn_mm=0.0)),
    ("plate_mm is inf", lambda: CrackedLeather(10.0, plate_mm=inf)),
    ("seed is -1", lambda: WoodCarving(10.0, seed=-1)),
    ("two or more", lambda: StepGauge(10.0, (1.0,))),
    ("two or more", lambda: StepGauge(10.0, (1.0, nan))),
    ("less than the width", lambda: StepGauge(10.0, edge_mm=9.0)),
    ("rms_mm is -0.1", lambda: BandNoise(10.0, -0.1)),
    ("relief_mm is -1", lambda: Coin(80.0, relief_mm=-1)),
    # Scenes and their lights.
    ("unknown scene 'teapot'.*coin", lambda: scene_named("teapot")),
    ("no relief", lambda: scene_named("charuco", amplitude_mm=1.0)),
    ("amplitude is -1", lambda: scene_named("noise", amplitude_mm=-1.0)),
    ("must not exceed", lambda: scene_named("sphere", amplitude_mm=70.0)),
    ("no pixels", lambda: scene_named("coin", width=0)),
    ("no pixels", lambda: scene_named("coin", height=-3)),
    ("0 LEDs", lambda: scene_named("coin", leds=0)),
    ("radius -450", lambda: dome_lights(radius_mm=-450)),
    ("radius of -5", lambda: ChromeSphere((0, 0, 5), -5)),
    ("three finite", lambda: ChromeSphere((0, 0), 5)),
    ("reflectance", lambda: ChromeSphere((0, 0, 5), 5, 1.2)),
    ("low 0.5, high 0.2", lambda: Paint(0.5, 0.2)),
    ("low 0.5, high 1.2", lambda: Paint(0.5, 1.2)),
    ("LED L00 is below the surface", lambda: coin(lights=leds((0, 0, 5.0)))),
    ("LED L01 is below the surface", lambda: coin(lights=leds((0, 0, 400.0), (300, 0, -1.0)))),
    ("LED L00 points away", lambda: coin(lights=leds((0, 0, 400.0), axes=[[0, 0, 1]]))),
    ("light L01 is below", lambda: coin(lights=Lights(directions=[[0, 0, 1], [1, 0, 0]]))),
    ("LED L00 is inside sphere 2", lambda: spheres(lights=leds(SPHERES.spheres[2].centre_mm))),
    ("sphere 0 overlaps the object", lambda: coin(spheres=(mirror(85, 0, 12, 12),))),
    (
        "spheres 0 and 1 overlap",
        lambda: spheres(spheres=(mirror(0, 0, 12, 12), mirror(20, 0, 12, 12))),
    ),
    ("sphere 0 intersects the board", lambda: spheres(spheres=(mirror(0, 0, 5, 12),))),
    ("sphere 0 reaches the camera", lambda: spheres(spheres=(mirror(0, 0, 300, 300),))),
    ("inside the object", lambda: coin(lens=Lens(replace(COIN.camera, working_distance_mm=8.0)))),
    ("folds the image", lambda: Lens(replace(COIN.camera, distortion=np.array([-5.0])))),
    ("working distance", lambda: Lens(CameraModel(COIN.camera.K, 64, 48))),
    ("board_radius_mm is 0.0", lambda: coin(board_radius_mm=0.0)),
    ("electrons_per_us is 0.0", lambda: coin(electrons_per_us=0.0)),
    ("ambient is nan", lambda: coin(ambient=nan)),
    ("soft_shadow_samples is 0", lambda: coin(soft_shadow_samples=0)),
    ("led_radius_mm is -2.0", lambda: coin(led_radius_mm=-2.0)),
    (
        "4096 images of 16384 x 16384 pixels requires .* GiB",
        lambda: render(scene_named("coin", width=16384, height=16384, leds=4096)),
    ),
    (
        "the object hides part of sphere 0",
        lambda: render(coin(body=Plane(60.0, 120.0), spheres=(mirror(69, 0, 8, 8),))),
    ),
]


@pytest.mark.parametrize(("message", "make"), REFUSED)
def test_a_value_out_of_range_is_refused_in_one_line(message, make):
    with pytest.raises(DataError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
