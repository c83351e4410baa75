"""A rotated or mirrored camera: sessions keep its frames, sources turn them upright."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from acquisition import (
    Calibrations,
    CapturePlan,
    DataError,
    Labels,
    Session,
    read_image,
    read_source,
    record,
    write_png,
)
from acquisition.session import Manifest
from acquisition.session.manifest import parse_manifest
from calibration import linear_stack
from rig import Mounting, RigConfig
from simulator import open_rig_seeing, render, save_truth, scene_named
from tests.quick_sample import quick

pytestmark = pytest.mark.usefixtures("simulated_world")
LEDS = 3
PLAN = CapturePlan(repeat=False, leds=(0, 1, 2), exposures_us=(9000.0,))
MOUNTINGS = [
    Mounting(rotation_deg=turn, mirror=mirror)
    for turn in (0, 90, 180, 270)
    for mirror in (False, True)
]


@pytest.fixture(scope="module")
def renderings():
    def made(cfa):
        scene = scene_named("coin", width=47, height=38, leds=LEDS)
        return render(replace(scene, lens=replace(scene.lens, cfa=cfa)))

    return {cfa: made(cfa) for cfa in (None, "RGGB")}


def recorded(rendering, folder, mounting):
    config = RigConfig(name="x", driver="simulated", leds=LEDS, mounting=mounting, settle_ms=0)
    with open_rig_seeing(rendering, config, noisy=False, realtime=False) as rig:
        session = record(
            rig,
            PLAN,
            folder,
            Labels(operator="Ada", object_name="coin"),
            calibrations=Calibrations(
                camera_model=rendering.truth.camera, sensor=rendering.truth.noise
            ),
        )
    save_truth(folder / "derived" / "truth", rendering, exposures_us=PLAN.exposures_us)
    return session


@pytest.mark.parametrize(
    ("cfa", "mounting"), quick(product((None, "RGGB"), MOUNTINGS), every=9), ids=str
)
def test_the_stack_is_upright_however_the_camera_is_mounted(tmp_path, renderings, cfa, mounting):
    plain = recorded(renderings[cfa], tmp_path / "plain", Mounting())
    turned = recorded(renderings[cfa], tmp_path / "turned", mounting)
    assert turned.manifest.mounting == mounting
    one, other = read_source(plain.folder), read_source(turned.folder)
    assert other.size == one.size == (38, 47)
    assert other.cfa == one.cfa == cfa
    assert other.camera is not None
    assert other.camera.size == other.size
    np.testing.assert_array_equal(other.mask, one.mask)
    np.testing.assert_array_equal(other.normals_truth, one.normals_truth)
    for frame, same in zip(one.frames, other.frames, strict=True):
        assert same.shape == same.read().shape
        np.testing.assert_array_equal(same.read(), frame.read())
    stack, upright = linear_stack(one).values, linear_stack(other).values
    np.testing.assert_array_equal(upright, stack)


def test_the_files_contain_the_raw_frames(tmp_path, renderings):
    mounting = Mounting(rotation_deg=90, mirror=True)
    plain = recorded(renderings[None], tmp_path / "plain", Mounting())
    turned = recorded(renderings[None], tmp_path / "turned", mounting)
    assert (turned.manifest.camera.width, turned.manifest.camera.height) == (38, 47)
    one, other = (read_image(s.folder / "frames" / "L01_E0.tif") for s in (plain, turned))
    assert other.shape == (47, 38)
    np.testing.assert_array_equal(mounting.upright(other), one)


def test_a_mask_belongs_to_the_upright_image(tmp_path, renderings):
    turned = recorded(renderings[None], tmp_path / "s", Mounting(rotation_deg=90))
    mask = np.zeros((38, 47), np.uint8)
    mask[5, 40] = 255
    write_png(tmp_path / "mask.png", mask)
    source = read_source(turned.folder, mask_path=tmp_path / "mask.png")
    assert np.argwhere(source.mask).tolist() == [[5, 40]]
    write_png(tmp_path / "lying.png", mask.T.copy())
    with pytest.raises(DataError, match=r"lying\.png: a mask of 38 x 47"):
        read_source(turned.folder, mask_path=tmp_path / "lying.png")


def test_the_manifest_has_a_mounting_only_if_there_is_one(tmp_path, renderings):
    recorded(renderings[None], tmp_path / "plain", Mounting())
    recorded(renderings[None], tmp_path / "turned", Mounting(rotation_deg=180))
    plain, turned = ((tmp_path / name / "session.toml") for name in ("plain", "turned"))
    assert b"mounting" not in plain.read_bytes()
    data = turned.read_bytes()
    assert b"[rig.mounting]\nrotation_deg = 180\nmirror = false\n" in data
    assert Session.open(turned.parent).manifest.mounting == Mounting(rotation_deg=180)
    assert isinstance(parse_manifest(data, turned), Manifest)
    with pytest.raises(DataError, match="rotation_deg"):
        parse_manifest(data.replace(b"180", b"181"), turned)


def test_a_camera_model_of_the_rotated_image_is_refused(tmp_path, renderings):
    rendering = renderings[None]
    config = RigConfig(name="x", driver="x", leds=LEDS, mounting=Mounting(rotation_deg=90))
    lying = replace(rendering.truth.camera, width=38, height=47)
    with (
        open_rig_seeing(rendering, config, noisy=False, realtime=False) as rig,
        pytest.raises(DataError, match=r"for 38 x 47 pixels, .* upright images of 47 x 38"),
    ):
        record(
            rig,
            PLAN,
            tmp_path / "s",
            Labels(operator="a", object_name="b"),
            calibrations=Calibrations(camera_model=lying),
        )
    assert not (tmp_path / "s").exists()
