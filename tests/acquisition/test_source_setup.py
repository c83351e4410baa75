"""Lights that were calibrated with another rig, camera or lens than that of the images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import CameraModel, Lights, Setup, Source, crop, downscale, read_source, write_png
from acquisition.source import setup_notices, source_setup
from acquisition.values import Calibrated

SIZE = (64, 80)
RIG, CAMERA = "lights-of-another-rig", "lights-of-another-camera"


def lens(focal: float = 160, scale: int = 1, far: float | None = 600, k1: float = 0) -> CameraModel:
    width, height = SIZE[1] * scale, SIZE[0] * scale
    centre = (width - 1) / 2, (height - 1) / 2
    K = np.array([[focal * scale, 0, centre[0]], [0, focal * scale, centre[1]], [0, 0, 1]])
    return CameraModel(K, width, height, far, np.array([k1]))


HERE = Setup("dome", "Maker", "M2", "77", lens())


@pytest.fixture
def source(tmp_path: Path) -> Source:
    write_png(tmp_path / "card.png", np.full(SIZE, 900, np.uint16))
    lights = Lights(directions=np.array([[0, 0, 1.0]]))
    read = read_source(tmp_path / "card.png", lights=lights, camera=lens())
    return replace(read, setup=replace(HERE, intrinsics=None))


def with_lights_of(source: Source, setup: Setup | None) -> Source:
    assert source.lights is not None
    calibrated = None if setup is None else Calibrated(setup=setup)
    return replace(source, lights=replace(source.lights, calibrated=calibrated))


SETUPS = {
    "not recorded": (None, [], ""),
    "nothing known": (Setup(), [], ""),
    "the same": (HERE, [], ""),
    "rig": (replace(HERE, rig="arc"), [RIG], "on the rig arc, the"),
    "rig not known": (replace(HERE, rig=""), [], ""),
    "model": (replace(HERE, camera_model="M3"), [CAMERA], "model M3, now M2"),
    "serial": (replace(HERE, camera_serial="8"), [CAMERA], "number 8, now 77"),
    "serial not known": (replace(HERE, camera_serial=""), [], ""),
    "vendor in other letters": (replace(HERE, camera_vendor="maker"), [], ""),
    "calibrated again": (replace(HERE, intrinsics=lens(160.3)), [], ""),
    "all pixels": (replace(HERE, intrinsics=lens(scale=2)), [], ""),
    "focal": (replace(HERE, intrinsics=lens(158)), [CAMERA], "focal length 158 px at 80"),
    "distortion": (replace(HERE, intrinsics=lens(k1=0.2)), [CAMERA], "rays that differ by"),
    "distance": (replace(HERE, intrinsics=lens(far=590)), [CAMERA], "distance 590 mm, now"),
    "distance not known": (replace(HERE, intrinsics=lens(far=None)), [], ""),
    "everything": (Setup("arc", "Maker", "M3", "8", lens(150)), [RIG, CAMERA], "focal"),
}


@pytest.mark.parametrize(("setup", "codes", "words"), SETUPS.values(), ids=SETUPS)
def test_lights_of_another_setup(
    source: Source, setup: Setup | None, codes: list[str], words: str
) -> None:
    notices = setup_notices(with_lights_of(source, setup))
    assert [notice.code for notice in notices] == codes
    assert all(notice.severity == "warning" for notice in notices)
    assert words in " ".join(map(str, notices))


def test_a_region_and_a_lower_resolution_belong_to_the_same_camera(source: Source) -> None:
    reduced = downscale(crop(source, 10, 6, 60, 50), 3)
    again = source_setup(reduced).intrinsics
    assert again is not None
    np.testing.assert_allclose(again.K, lens().K, atol=1e-12)
    assert again.size == SIZE
    assert setup_notices(with_lights_of(reduced, HERE)) == ()
    other = replace(HERE, intrinsics=lens(158))
    assert len(setup_notices(with_lights_of(reduced, other))) == 1


@pytest.mark.parametrize(
    ("near", "seen", "camera", "named"),
    [
        pytest.param(True, lens(), None, False, id="the same size"),
        pytest.param(True, lens(scale=2), None, True, id="scaled"),
        pytest.param(True, lens(scale=2), lens(), False, id="scaled, with a camera"),
        pytest.param(False, lens(scale=2), None, False, id="directions"),
    ],
)
def test_without_a_camera_images_of_another_size_are_named(
    source: Source, near: bool, seen: CameraModel, camera: CameraModel | None, named: bool
) -> None:
    place = np.array([[0, 0, 400.0]])
    lights = Lights(positions_mm=place) if near else Lights(directions=place)
    bare = replace(source, lights=lights, camera=camera)
    notices = setup_notices(with_lights_of(bare, replace(HERE, intrinsics=seen)))
    assert [notice.code for notice in notices] == [CAMERA] * named
    assert all("images of 160 x 128 pixels, now 80 x 64" in one.text for one in notices)


def test_a_source_without_lights_or_camera(source: Source) -> None:
    assert setup_notices(replace(source, lights=None)) == ()
    bare = replace(source, camera=None, setup=Setup())
    assert source_setup(bare).intrinsics is None
    assert setup_notices(with_lights_of(bare, HERE)) == ()
