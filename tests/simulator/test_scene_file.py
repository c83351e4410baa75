"""Scene files: written scenes are read back unchanged, and errors are named."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition import (
    CameraModel,
    Lights,
    NoiseModel,
    write_camera,
    write_lights,
)
from simulator import (
    ChromeSphere,
    Lens,
    Scene,
    dome_lights,
    read_scene,
    render,
    scene_named,
    write_scene,
)
from simulator.scene import Ggx, Lambert, Lamps
from simulator.scene.scene_parts import BODIES, MATERIALS, PATTERNS
from simulator.shapes import Checker, Coin, Even, Plane, SphericalCap
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data
from tests.simulator.conftest import SMALL


def test_an_empty_file_is_the_bench_without_object(write):
    scene, bench = read_scene(write("")), scene_named("coin")
    assert scene.body is None
    assert (scene.board, scene.material, scene.lamps) == (bench.board, Lambert(), Lamps())
    np.testing.assert_array_equal(scene.lights.positions_mm, bench.lights.positions_mm)
    np.testing.assert_allclose(scene.lens.camera.K, bench.lens.camera.K, rtol=1e-12)
    assert scene.lens.size == bench.lens.size
    assert scene.noise == bench.noise
    assert scene.electrons_per_us == bench.electrons_per_us


def test_every_table_is_used(write):
    scene = read_scene(
        write(
            """
            electrons_per_us = 0.5
            ambient = 0.01
            shadows = false
            soft_shadow_samples = 4
            [object]
            kind = "coin"
            radius_mm = 60
            relief_mm = 0.8
            [pattern]
            kind = "checker"
            low = [0.1, 0.2, 0.3]
            [material]
            kind = "ggx"
            roughness = 0.2
            [board]
            kind = "even"
            albedo = 0.3
            [[spheres]]
            centre_mm = [90, 70, 10]
            radius_mm = 10
            [lights]
            kind = "ring"
            count = 12
            elevation_deg = 30
            radius_mm = 400
            mu = 0.5
            [lamps]
            flicker = 0.01
            dead = [3]
            [lens]
            kind = "orthographic"
            width = 100
            height = 80
            pixel_mm = 2
            cfa = "RGGB"
            [sensor]
            read_noise_e = 4.0
            bit_depth = 10
            """
        )
    )
    assert scene.body == Coin(60.0, relief_mm=0.8)
    assert scene.pattern == Checker(low=(0.1, 0.2, 0.3))
    assert scene.material == Ggx(roughness=0.2)
    assert scene.board == Even(0.3)
    assert scene.spheres == (ChromeSphere((90.0, 70.0, 10.0), 10.0),)
    assert scene.lamps == Lamps(flicker=0.01, dead=(3,))
    assert (scene.shadows, scene.soft_shadow_samples) == (False, 4)
    assert (scene.electrons_per_us, scene.ambient) == (0.5, 0.01)
    assert (scene.noise.read_noise_e, scene.noise.bit_depth) == (4.0, 10)
    lens = scene.lens
    assert (lens.size, lens.pixel_mm, lens.cfa, lens.camera) == ((80, 100), 2.0, "RGGB", None)
    lights = scene.lights
    assert len(lights) == 12
    np.testing.assert_array_equal(lights.mu, np.full(12, 0.5))
    place = lights.positions_mm
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), 400.0)
    np.testing.assert_allclose(place[:, 2], 200.0)
    # Counterclockwise from the right.
    np.testing.assert_allclose(place[3, :2], [0.0, 400 * np.cos(np.pi / 6)], atol=1e-9)


@pytest.mark.parametrize("kind", [pytest.param(kind, id=kind) for kind in BODIES if kind != "mesh"])
def test_every_kind_of_object_can_be_read(write, tmp_path, kind):
    scene = read_scene(write(f"[object]\nkind = '{kind}'\nradius_mm = 50\n{SMALL}"))
    assert type(scene.body) is BODIES[kind]
    assert scene.body.radius_mm == 50.0
    again = write_scene(tmp_path / "again.toml", scene)[0]
    assert read_scene(again).body == scene.body


@pytest.mark.parametrize("kind", PATTERNS)
def test_every_kind_of_pattern_can_be_read(write, tmp_path, kind):
    text = f"kind = '{kind}'\n" + ("low = 0.2\nhigh = 0.4\n" if kind == "paint" else "")
    scene = read_scene(write(f"[board]\n{text}[pattern]\n{text}{SMALL}"))
    assert type(scene.board) is type(scene.pattern) is PATTERNS[kind]
    again = read_scene(write_scene(tmp_path / "again.toml", scene)[0])
    assert (again.board, again.pattern) == (scene.board, scene.pattern)


def scenes() -> dict[str, Scene]:
    camera = CameraModel(
        np.array([[1400.0, 0.3, 30.0], [0, 1410.0, 26.5], [0, 0, 1]]), 64, 50, 600.0,
        np.array([-0.1, 0.02, 1e-3, -2e-3, 0.01]),
    )  # fmt: skip
    bench = scene_named("coin-with-spheres", width=64, height=50, leds=5, seed=3)
    around = np.linspace(0, 2 * np.pi, 5, endpoint=False)
    distant = Lights(
        directions=np.stack([np.cos(around), np.sin(around), np.full(5, 1.5)], 1),
        intensities=np.linspace(0.3, 1.2, 15).reshape(5, 3),
    )
    sensor = NoiseModel(4.0, 3.0, 20.0, 10, quantum_efficiency=0.6, full_well_e=3000.0, prnu=0.01)
    colour = Checker((0.1, 0.2, 0.3), (0.9, 0.5, 0.4), 7.0)
    plane = replace(bench, body=Plane(60.0, height_mm=2.0), spheres=(), lights=distant)
    return {
        "near and crooked": replace(bench, lens=Lens(camera, vignetting=0.4, cfa="GBRG")),
        "distant and coloured": replace(plane, pattern=colour, noise=sensor),
        "parallel": replace(plane, lens=Lens.orthographic(64, 50, 3.0, 500.0), shadows=False),
        "faulty": replace(plane, material=Ggx(), lamps=Lamps(0.1, flicker=0.02, dead=(1, 4))),
    }


@pytest.mark.parametrize("name", quick(scenes(), every=4))
def test_a_scene_written_and_read_gives_the_same_images(tmp_path, name):
    scene = scenes()[name]
    paths = write_scene(tmp_path / "scene.toml", scene)
    assert all(path.is_file() for path in paths)
    again = read_scene(paths[0])
    assert (again.noise, again.lamps, again.spheres) == (scene.noise, scene.lamps, scene.spheres)
    first, second = render(scene), render(again)
    np.testing.assert_array_equal(first.planes, second.planes)
    np.testing.assert_array_equal(first.ambient, second.ambient)


@settings(max_examples=25)
@given(
    radius=st.floats(1, 200),
    seed=st.integers(0, 2**40),
    low=st.floats(0, 0.5),
    noise=st.floats(0, 50),
    flicker=st.floats(0, 0.29),
)
def test_numbers_are_exact_to_the_last_bit(tmp_path_factory, radius, seed, low, noise, flicker):
    scene = replace(
        scene_named("coin", width=32, height=24, leds=3),
        body=SphericalCap(radius, radius / 3),
        pattern=Checker(low, 1 - low),
        noise=NoiseModel(2.5, noise, 64.0, 12),
        lamps=Lamps(flicker=flicker),
        board=Even(low),
    )
    path = write_scene(tmp_path_factory.mktemp("scene") / "scene.toml", scene)[0]
    again = read_scene(path, seed=seed)
    for name in ("body", "pattern", "noise", "lamps", "board"):
        assert getattr(again, name) == getattr(scene, name)


def test_the_seed_applies_to_tables_without_their_own_seed(write):
    path = write(f"seed = 5\n[object]\nkind='coin'\nradius_mm=50\n[pattern]\nkind='paint'\n"
                 f"low=0.2\nhigh=0.4\nseed=9\n{SMALL}")  # fmt: skip
    scene = read_scene(path)
    assert (scene.body.seed, scene.pattern.seed) == (5, 9)
    np.testing.assert_array_equal(scene.lights.positions_mm, dome_lights(36, seed=5).positions_mm)
    other = read_scene(path, seed=6)
    assert (other.body.seed, other.pattern.seed) == (6, 9)


def test_number_of_lights_and_pixels_can_be_overridden(write):
    path = write("[object]\nkind='plane'\nradius_mm=50\n[lights]\nkind='ring'\ncount=8\n")
    scene, other = read_scene(path), read_scene(path, leds=5, size=(1280, 900))
    assert (len(scene.lights), len(other.lights)) == (8, 5)
    assert other.lens.size == (900, 1280)
    # The corner of the field does not move: x = 146.65 mm, half a pixel beyond the last one.
    for lens in (scene.lens, other.lens):
        _, ray = lens.origins_and_rays(lens.size[1] - 0.5, (lens.size[0] - 1) / 2)
        np.testing.assert_allclose(600 * ray, [293.76 / 2, 0.0, -600.0], atol=1e-9)


def test_files_are_found_relative_to_the_scene_file(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path.parent)
    (tmp_path / "parts").mkdir()
    lights = Lights(positions_mm=np.array([[100.0, 0, 400], [0, 90, 380]]), ids=("east", "north"))
    write_lights(tmp_path / "parts" / "lights.json", lights)
    write_camera(tmp_path / "parts" / "camera.json", scene_named("coin", width=40).lens.camera)
    trimesh.creation.box(extents=(2.0, 1.0, 1.0)).export(tmp_path / "parts" / "box.obj")
    scene = read_scene(
        write(
            "[object]\nkind='mesh'\nfile='parts/box.obj'\nradius_mm=50\nsmooth=false\n"
            "[lights]\nkind='file'\nfile='parts/lights.json'\n"
            "[lens]\nkind='file'\nfile='parts/camera.json'\n"
        )
    )
    np.testing.assert_array_equal(scene.lights.positions_mm, lights.positions_mm)
    assert scene.lights.ids == ("L00", "L01"), "LEDs are named by their number"
    assert scene.lens.size == (512, 40)
    # The radius is half the diagonal of the footprint; the height of the box is half its length.
    assert scene.body.top_mm == pytest.approx(50 / np.hypot(1, 0.5))


def test_a_mesh_is_written_in_its_final_position(write, tmp_path):
    trimesh.creation.icosphere(subdivisions=2, radius=3.0).export(tmp_path / "ball.ply")
    scene = read_scene(
        write(
            "[object]\nkind='mesh'\nfile='ball.ply'\nradius_mm=40\nturn_deg=[20,30,0]\n"
            f"[lights]\nkind='dome'\ncount=3\n{SMALL}"
        )
    )
    paths = write_scene(tmp_path / "other.toml", scene)
    assert {path.name for path in paths} == {"other.toml", "other.lights.json", "other.ply"}
    again = read_scene(paths[0])
    np.testing.assert_allclose(again.body.vertices_mm, scene.body.vertices_mm, atol=1e-4)
    assert again.body.smooth == scene.body.smooth


@needs_data
def test_a_real_mesh_is_on_the_board(write):
    file = DATA / "meshes" / "stanford-bunny.obj"
    scene = read_scene(write(f"[object]\nkind='mesh'\nfile='{file}'\nradius_mm=60\n{SMALL}"))
    assert scene.body.vertices_mm[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert scene.body.radius_mm == pytest.approx(60.0)


def test_every_kind_of_material_can_be_read(write):
    for kind, material in MATERIALS.items():
        assert read_scene(write(f"[material]\nkind = '{kind}'\n{SMALL}")).material == material()
