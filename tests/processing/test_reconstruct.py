"""The complete pipeline as one library call, compared with the simulator's truth."""

import pickle
from dataclasses import replace
from inspect import signature

import numpy as np
import pytest

from acquisition import (
    Calibrations,
    CapturePlan,
    DataError,
    Labels,
    Lights,
    Setup,
    crop,
    downscale,
    read_source,
    record,
    write_png,
)
from acquisition.values import Calibrated
from calibration import EstimateError
from processing import photometric_stereo, reconstruct
from processing.recording.examination import inverted_mask
from rig import Mounting, RigConfig
from simulator import open_rig_seeing, render, save_truth, scene_named
from tests.cases import cases

LEDS = 8
PLAN = CapturePlan(repeat=False, leds=tuple(range(LEDS)), exposures_us=(9000.0,))


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Record a coin under eight near LEDs, with LED 3 dead and a camera mounted sideways."""
    folder = tmp_path_factory.mktemp("session") / "coin"
    rendering = render(scene_named("coin", width=96, height=80, leds=LEDS, sharp=True))
    config = RigConfig(
        name="x",
        driver="simulated",
        leds=LEDS,
        mounting=Mounting(rotation_deg=90, mirror=True),
        settle_ms=0,
    )
    with open_rig_seeing(rendering, config, noisy=False, realtime=False) as rig:
        record(
            rig,
            PLAN,
            folder,
            Labels(operator="Ada", object_name="coin"),
            calibrations=Calibrations(
                lights=rendering.truth.lights,
                camera_model=rendering.truth.camera,
                sensor=rendering.truth.noise,
            ),
        )
    save_truth(folder / "derived" / "truth", rendering, exposures_us=PLAN.exposures_us)
    return folder


def test_a_session_gives_normals_and_height(session):
    source = read_source(session)
    stages = []
    result = reconstruct(source, on_progress=lambda stage, done, total: stages.append(stage))
    assert result.error is not None
    assert result.error.mae_deg < 1.5
    assert result.error.coverage > 0.99
    assert result.surface is not None
    assert result.surface.unit == "mm"
    assert result.lights.near
    assert result.previews[0].shape == source.size
    assert list(dict.fromkeys(stages)) == ["reading", "normals", "height"]
    assert result.near_height is not None
    assert result.near_height.mean_height_mm == pytest.approx(4.7, abs=0.5)


@pytest.mark.slow
def test_a_region_gives_the_normals_of_the_complete_recording(session):
    """The lights are near: a principal point that did not move with the region would show."""
    source = read_source(session)
    whole = reconstruct(source, surface=False)
    rows, columns = source.size
    x, y, width, height = 7, 11, columns - 20, rows - 30
    part = reconstruct(crop(source, x, y, width, height))
    window = np.s_[y : y + height, x : x + width]
    np.testing.assert_array_equal(part.mask, whole.mask[window])
    found, expected = part.normals.normals, whole.normals.normals[window]
    # The mean height is found from another part of the object.
    np.testing.assert_allclose(found, expected, atol=1e-3)
    assert part.surface.points()[..., :2][part.mask] == pytest.approx(
        source.camera.points_on_plane()[window][..., :2][part.mask], abs=1.5
    )


@pytest.mark.slow
def test_a_lower_resolution_stays_close_to_the_truth(session):
    source = read_source(session)
    part = reconstruct(downscale(source, 2))
    assert part.gray_albedo.shape == part.source.size == tuple(n // 2 for n in source.size)
    assert part.error.mae_deg < 3.0
    assert part.surface.pixel_size == pytest.approx(
        2 * reconstruct(source).surface.pixel_size, rel=1e-9
    )


def test_distant_lights_without_a_surface(session):
    result = reconstruct(read_source(session), distant=True, surface=False)
    assert not result.lights.near
    assert result.surface is None


@pytest.mark.slow
def test_a_source_and_its_reconstruction_survive_pickling(session):
    source = read_source(session)
    copy = pickle.loads(pickle.dumps(source))
    np.testing.assert_array_equal(copy.frames[2].read(), source.frames[2].read())
    np.testing.assert_array_equal(
        reconstruct(copy, surface=False).normals.normals,
        reconstruct(source, surface=False).normals.normals,
    )


@pytest.mark.slow
def test_black_images_are_left_out_and_named(session):
    source = read_source(session)
    frames = tuple(
        replace(frame, load=lambda frame=frame: np.zeros_like(frame.read()))
        if frame.light_id == "L03"
        else frame
        for frame in source.frames
    )
    result = reconstruct(replace(source, frames=frames), surface=False)
    assert result.lights.ids == tuple(f"L{i:02d}" for i in range(LEDS) if i != 3)
    # Zeros are below the dark level.
    assert any(": L03" in str(w) for w in result.warnings if w.code == "lights-unlit")
    assert result.error is not None
    assert result.error.mae_deg < 1.5


def test_a_source_without_a_mask_gets_one(session):
    source = replace(read_source(session), mask=None)
    result = reconstruct(source, surface=False)
    truth = read_source(session).mask
    assert np.mean(result.mask == truth) > 0.95
    assert any("the images have no mask" in warning for warning in map(str, result.warnings))


@cases(
    ("change", "error", "words"),
    {
        "no lights": ({"lights": None}, DataError, "give the lights.json"),
        "near without camera": (
            {"camera": None},
            DataError,
            "give a camera with a working distance, or the size of a pixel",
        ),
        "lights behind": ({"lights": "turned"}, EstimateError, "face away from the camera"),
    },
)
def test_sources_that_cannot_be_reconstructed(session, change, error, words):
    source = read_source(session)
    if change.get("lights") == "turned":
        directions = -source.lights.unit_directions
        change = {"lights": Lights(directions=directions, ids=source.lights.ids)}
    with pytest.raises(error, match=words):
        reconstruct(replace(source, **change))


@cases(
    ("rows", "columns", "reported"),
    {
        "inside": (slice(15, 45), slice(15, 45), False),
        "in a corner": (slice(20, 60), slice(15, 60), False),
        "at three borders": (slice(20, 60), slice(0, 60), True),
        "almost everywhere": (slice(2, 58), slice(2, 58), True),
    },
)
def test_a_computed_mask_that_fills_the_frame_is_reported(tmp_path, rows, columns, reported):
    around = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    lights = Lights(np.stack([np.cos(around), np.sin(around), np.full(6, 2.0)], axis=1))
    for number in range(6):
        image = np.full((60, 60), 300, np.uint16)
        image[rows, columns] = 30_000 + 10 * number
        write_png(tmp_path / f"image.{number}.png", image)
    source = read_source(tmp_path, lights=lights)
    codes = [notice.code for notice in reconstruct(source, surface=False).warnings]
    assert ("mask-fills-frame" in codes) == reported
    assert "mask-estimated" in codes


def test_an_inverted_mask_is_part_of_the_verdict(session):
    source = read_source(session)
    inverted = replace(source, mask=~source.mask, normals_truth=None)
    found = reconstruct(inverted, surface=False)
    assert "mask-inverted" in [cause.name for cause in found.verdict.causes]


def test_lights_of_another_camera_are_part_of_the_verdict(session):
    source = read_source(session)
    other = replace(source.camera, K=source.camera.K * [[1.2], [1.2], [1]])
    lights = replace(source.lights, calibrated=Calibrated(setup=Setup(intrinsics=other)))
    found = reconstruct(replace(source, lights=lights), surface=False)
    assert "lights-of-another-camera" in [cause.name for cause in found.verdict.causes]
    assert [one.code for one in found.warnings].count("lights-of-another-camera") == 1


@cases(
    ("given", "inside", "outside", "reported"),
    {
        "the object": ("object", 0.5, 0.01, False),
        "the background of the object": ("background", 0.5, 0.01, True),
        "a dark object on a bright ground": ("object", 0.01, 0.5, False),
        "an object that fills the frame": ("all", 0.5, 0.01, False),
        "a part of the object": ("part", 0.5, 0.01, False),
        "the background, which is as bright": ("background", 0.5, 0.4, False),
        "the background of spheres": ("without spheres", 0.5, 0.01, False),
    },
)
def test_an_inverted_mask_is_named(given, inside, outside, reported):
    shown = np.zeros((60, 60), bool)
    shown[15:45, 15:45] = True
    images = np.where(shown, np.float32(inside), np.float32(outside))[None].repeat(6, axis=0)
    part = shown & (np.arange(60) < 25)
    masks = {"object": shown, "background": ~shown, "all": shown | True, "part": part}
    mask, elsewhere = masks.get(given, ~shown), shown if given == "without spheres" else None
    assert bool(inverted_mask(images, mask, elsewhere)) == reported


@cases(
    ("background", "severity"),
    {"a dark background": (300, "info"), "a gray one": (6000, "warning")},
)
def test_a_computed_mask_is_information_if_the_object_stands_out(tmp_path, background, severity):
    lights = Lights([[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
    for number in range(4):
        image = np.full((60, 60), background, np.uint16)
        image[15:45, 15:45] = 30_000 + 10 * number
        write_png(tmp_path / f"image.{number}.png", image)
    source = read_source(tmp_path, lights=lights)
    found = {one.code: one.severity for one in reconstruct(source, surface=False).warnings}
    assert found["mask-estimated"] == severity


@cases(("black", "severity"), {"few pixels": (9, "info"), "many": (10, "warning")})
def test_a_few_pixels_without_a_normal_are_information(black, severity):
    lights = Lights([[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
    stack = np.full((4, 30, 30), 0.5, np.float32)
    stack.reshape(4, -1)[:, :black] = 0
    mask = np.ones((30, 30), np.bool_)
    (notice,) = photometric_stereo(stack, lights, mask).warnings
    assert (notice.code, notice.severity) == ("pixels-without-normal", severity)


def test_one_method_is_the_default_everywhere():
    from processing.near.near_height import near_height
    from sgp.cli.options import SourceOptions

    functions = (reconstruct, photometric_stereo, near_height)
    defaults = [signature(function).parameters["method"].default for function in functions]
    assert defaults == [SourceOptions().method] * 3 == ["best"] * 3
