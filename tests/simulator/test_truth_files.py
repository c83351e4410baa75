"""Ground truth of a session: the ordinary readers read all values of all files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from acquisition import DataError, StorageError, read_camera, read_image, read_lights, read_mask
from simulator import Lens, Rendering, read_scene, render, save_truth, scene_named
from simulator.scene import Lamps

EXPOSURES_US = (4_000.0,)


@pytest.fixture(scope="module")
def rendering():
    return render(scene_named("coin-with-spheres", width=80, height=64, leds=4))


@pytest.fixture(scope="module")
def truth(rendering):
    return rendering.truth


@pytest.fixture(scope="module")
def saved(rendering, tmp_path_factory):
    folder = tmp_path_factory.mktemp("session") / "derived" / "truth"
    facts = {"seed": 7, "name": "coin"}
    return folder, save_truth(folder, rendering, exposures_us=EXPOSURES_US, facts=facts)


def changed(rendering, **fields) -> Rendering:
    return replace(rendering, truth=replace(rendering.truth, **fields))


def test_maps(truth, saved):
    folder, paths = saved
    np.testing.assert_array_equal(read_image(folder / "normals.exr"), truth.normals)
    np.testing.assert_array_equal(read_image(folder / "albedo.exr"), truth.albedo)
    np.testing.assert_array_equal(read_mask(folder / "mask.png"), truth.mask)
    height, depth = (read_image(folder / f"{name}.exr") for name in ("height", "depth"))
    np.testing.assert_allclose(height, truth.height_mm, atol=1e-6)
    # The bench camera is 600 mm above the board, and heights are relative to the board.
    np.testing.assert_allclose(depth + height, np.where(truth.mask, 600.0, np.nan), atol=1e-4)
    assert all(path.exists() for path in paths.values())


def test_shadows_are_white_and_named_after_their_light(rendering, tmp_path):
    shadows = np.zeros((4, 64, 80), np.bool_)
    for light, shadow in enumerate(shadows):
        shadow[10 * light : 10 * light + 7, 20:50] = True
    save_truth(tmp_path, changed(rendering, shadows=shadows), exposures_us=EXPOSURES_US)
    names = sorted(path.name for path in (tmp_path / "shadows").iterdir())
    assert names == [f"L0{light}.png" for light in range(4)]
    for light, shadow in enumerate(shadows):
        picture = read_image(tmp_path / "shadows" / f"L0{light}.png")
        np.testing.assert_array_equal(picture, np.where(shadow, 255, 0))


def test_the_bound_depends_on_exposure_times_and_dead_leds(rendering, truth, saved, tmp_path):
    bound = read_image(saved[0] / "cramer_rao.exr")[truth.mask]
    assert (bound > 0).all()
    # If shot noise dominates, four times the light halves the error; if read noise dominates, it
    # quarters it.
    save_truth(tmp_path / "long", rendering, exposures_us=(4 * EXPOSURES_US[0],))
    gain = bound / read_image(tmp_path / "long" / "cramer_rao.exr")[truth.mask]
    assert 1.9 < np.median(gain[np.isfinite(gain)]) < 4.0
    # With three of four lights, the bound is larger but finite; with two, it is infinite.
    for dead, finite in (((1,), True), ((1, 2), False)):
        folder = tmp_path / f"without{len(dead)}"
        scene = replace(rendering.scene, lamps=Lamps(dead=dead))
        save_truth(folder, replace(rendering, scene=scene), exposures_us=EXPOSURES_US)
        less = read_image(folder / "cramer_rao.exr")[truth.mask]
        values = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        assert values["dead_leds"] == list(dead)
        assert np.isfinite(less).any() == finite
        assert (less >= bound * (1 - 1e-6)).all()


def test_lights_camera_and_scene(rendering, truth, saved):
    folder, _ = saved
    lights = read_lights(folder / "lights.json")
    for name in ("positions_mm", "axes", "mu", "intensities"):
        np.testing.assert_array_equal(getattr(lights, name), getattr(truth.lights, name))
    assert lights.ids == truth.lights.ids
    camera = read_camera(folder / "camera.json")
    np.testing.assert_array_equal(camera.K, truth.camera.K)
    assert camera.working_distance_mm == 600.0
    again = render(read_scene(folder / "scene.toml"))
    np.testing.assert_array_equal(again.planes, rendering.planes)


def test_spheres_and_sensor(truth, saved):
    folder, _ = saved
    values = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    assert (values["format"], values["version"]) == ("sgp-truth", 1)
    assert (values["seed"], values["name"]) == (7, "coin")
    assert values["sensor"]["read_noise_e"] == truth.noise.read_noise_e
    assert len(values["spheres"]) == 4
    for index, sphere in enumerate(values["spheres"]):
        assert sphere["radius_mm"] == 12.0
        assert sphere["centre_mm"] == list(truth.sphere_centres_mm[index])
        np.testing.assert_array_equal(sphere["highlights_px"], truth.highlights_px[index])
        mask = read_mask(folder / f"sphere_{index}.png")
        np.testing.assert_array_equal(mask, truth.sphere_masks[index])


def test_a_highlight_that_is_not_visible_is_null(rendering, truth, tmp_path):
    places = truth.highlights_px.copy()
    places[1, 2] = np.nan
    save_truth(tmp_path, changed(rendering, highlights_px=places), exposures_us=EXPOSURES_US)
    spheres = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))["spheres"]
    assert spheres[1]["highlights_px"][2] is None
    assert None not in spheres[0]["highlights_px"]


def test_without_an_object_there_are_no_maps(tmp_path):
    rendering = render(scene_named("spheres", width=80, height=64, leds=3))
    paths = save_truth(tmp_path, rendering, exposures_us=EXPOSURES_US)
    names = {path.name for path in tmp_path.iterdir()}
    spheres = {f"sphere_{i}.png" for i in range(4)}
    others = {"truth.json", "lights.json", "camera.json", "scene.toml", "scene.lights.json"}
    assert names == others | spheres
    assert {path.name for path in paths.values()} == names - {"scene.lights.json"}


def test_an_orthographic_lens_has_neither_depth_nor_camera(rendering, tmp_path):
    parallel = changed(rendering, lens=Lens.orthographic(80, 64, 2.5, 600.0))
    assert parallel.truth.depth_mm is None
    paths = save_truth(tmp_path, parallel, exposures_us=EXPOSURES_US)
    assert not {"depth", "camera"} & paths.keys()
    assert {"height", "normals", "cramer_rao"} <= paths.keys()


def test_points_project_to_their_pixels(truth):
    rows, columns = np.nonzero(truth.mask)
    points = truth.points_mm[truth.mask]
    np.testing.assert_allclose(points[:, 2], truth.height_mm[truth.mask], atol=1e-9)
    # Pinhole: focal length times offset over depth; y is up in the scene and down in the image.
    K, depth = truth.camera.K, 600.0 - points[:, 2]
    np.testing.assert_allclose(K[0, 2] + K[0, 0] * points[:, 0] / depth, columns, atol=1e-9)
    np.testing.assert_allclose(K[1, 2] - K[1, 1] * points[:, 1] / depth, rows, atol=1e-9)


@pytest.mark.parametrize("name", ["coin", "sphere", "scales", "step-gauge", "tilted-plane"])
def test_the_truth_agrees_with_the_images(name):
    """Solve the normals from the planes at the true points with the light model of `Lights`."""
    rendering = render(scene_named(name, width=120, height=96, leds=16, sharp=True))
    truth = rendering.truth
    lit = ~truth.shadows[:, truth.mask]
    signal = rendering.planes[:, truth.mask].astype(np.float64)
    np.testing.assert_array_equal(signal > 0, lit)
    vectors = truth.lights.vectors_at(truth.points_mm[truth.mask])
    vectors *= truth.lights.intensities[:, :1, None]
    squared = np.einsum("nki,nkj,nk->kij", vectors, vectors, lit)
    solvable = (lit.sum(axis=0) >= 4) & (np.linalg.cond(squared) < 1e4)
    assert solvable.mean() > 0.99
    right = np.einsum("nki,nk->ki", vectors, signal)[solvable]
    solved = np.linalg.solve(squared[solvable], right[..., None])[..., 0]
    true = truth.normals[truth.mask][solvable]
    sine = np.linalg.norm(np.cross(solved, true), axis=1)
    assert np.degrees(np.arctan2(sine, (solved * true).sum(axis=1))).max() < 1e-4
    albedo = np.linalg.norm(solved, axis=1) / truth.electrons_per_us
    np.testing.assert_allclose(albedo, truth.albedo[truth.mask][solvable], rtol=1e-5)


@pytest.mark.parametrize(
    ("exposures_us", "error", "words"),
    [
        pytest.param((), DataError, "exposure times", id="no exposure"),
        pytest.param((0.0,), DataError, "exposure times", id="zero exposure"),
        pytest.param(EXPOSURES_US, StorageError, "file", id="a file in the way"),
    ],
)
def test_refusals(rendering, tmp_path, exposures_us, error, words):
    folder = tmp_path / "file"
    if error is StorageError:
        folder.write_text("in the way")
    with pytest.raises(error, match=words):
        save_truth(folder, rendering, exposures_us=exposures_us)
    assert not (folder / "truth.json").exists()
