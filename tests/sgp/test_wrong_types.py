"""Arguments of a wrong type are refused in plain words, at the entrance of the library."""

from __future__ import annotations

import numpy as np
import pytest

import acquisition
import calibration
import processing
import rig
from acquisition import Lights
from processing import NormalMap

FACING = np.zeros((20, 20, 3), np.float32) + np.float32([0, 0, 1])
MAP = NormalMap(FACING, np.ones((20, 20), bool))
BYTES = np.zeros((3, 20, 20), np.uint8)
MASK = np.ones((20, 20), bool)
LIGHTS = Lights(np.eye(3))
RAW = "must be linear values of a floating-point type, not uint8"

CASES = {
    "separate an array": (lambda: processing.separate(FACING), "normal_map must be a NormalMap"),
    "combine arrays": (lambda: processing.combine(FACING, MAP), "shape must be a NormalMap"),
    "combine an array": (lambda: processing.combine(MAP, FACING), "detail must be a NormalMap"),
    "transfer an array": (lambda: processing.transfer(FACING, MAP), "source must be a NormalMap"),
    "transfer to an array": (lambda: processing.transfer(MAP, FACING), "target must be a NormalM"),
    "transfer a part": (lambda: processing.transfer_local(FACING, MAP), "source must be a Norma"),
    "integrate an array": (lambda: processing.integrate(FACING), "not a ndarray: NormalMap.from"),
    "error of an array": (lambda: processing.angular_error(FACING, MAP), "estimate must be a Nor"),
    "ssim of arrays": (lambda: processing.ssim(MAP, FACING), "b must be a NormalMap"),
    "write an array": (lambda: processing.write_normals("nowhere", FACING), "must be a NormalMap"),
    "mesh of an array": (lambda: processing.height_mesh(MASK), "HeightMap, not a ndarray: integr"),
    "write a height": (lambda: processing.write_mesh("x.ply", MASK), "height_map must be a Height"),
    "profile of arrays": (lambda: processing.height_profile(MASK, MASK), "target must be a Height"),
    "reconstruct a path": (lambda: processing.reconstruct("x"), "must be a Source, not a str: acq"),
    "stack of a path": (lambda: calibration.linear_stack("x"), "source must be a Source"),
    "raw values": (lambda: processing.photometric_stereo(BYTES, LIGHTS, MASK), f"values {RAW}"),
    "masked frames": (
        lambda: processing.normals_of_frames(np.ma.array(BYTES), LIGHTS),
        r"not be a masked array: give frames.filled\(saturation\)",
    ),
    "maps as an array": (
        lambda: processing.normals_of_frames(BYTES, LIGHTS, out=FACING),
        "out must be a StereoMaps",
    ),
    "filter by name": (
        lambda: processing.separate(MAP, shape_filter="box"),
        "shape_filter must be a ShapeFilter",
    ),
    "transfer by name": (
        lambda: processing.transfer(MAP, MAP, shape_filter="box"),
        "shape_filter must be a ShapeFilter",
    ),
    "camera by path": (
        lambda: processing.integrate(MAP, camera="camera.json"),
        "camera must be a CameraModel, not a str: acquisition.read_camera",
    ),
    "plain directions": (
        lambda: processing.photometric_stereo(BYTES.astype(float), np.eye(3), MASK),
        r"lights must be a Lights, not a ndarray: Lights\(directions\)",
    ),
    "vectors of an image": (
        lambda: NormalMap.from_vectors(BYTES.reshape(20, 20, 3)),
        r"from -1 to 1, not uint8, which encodes them: read_normals\(path\)",
    ),
    "mask of raw values": (lambda: processing.maps.object_mask(BYTES), f"values {RAW}"),
    "spheres in raw values": (lambda: calibration.calibrate_spheres(BYTES), f"stack {RAW}"),
    "raw card": (lambda: calibration.MatteSurface(BYTES, FACING, MASK), RAW),
    "write directions": (lambda: acquisition.write_lights("x.json", np.eye(3)), "lights must be a"),
    "write a matrix": (lambda: acquisition.write_camera("x.json", np.eye(3)), "camera must be a"),
    "LED True": (lambda: rig.messages.check_led(True), "an LED number must be an int, not True"),
    "LED 3.0": (lambda: rig.messages.check_led(3.0), "an LED number must be an int, not 3.0"),
    "LED as text": (lambda: rig.messages.check_led("3"), "an LED number must be an int, not '3'"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_type_is_named(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, message = CASES[case]
    with pytest.raises(TypeError, match=message):
        call()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("led", [None, 0, np.int64(3), np.uint8(7)])
def test_integers_of_any_kind_are_led_numbers(led):
    rig.messages.check_led(led)


@pytest.mark.parametrize("led", [True, 1.0, "1"])
def test_a_rig_refuses_other_led_numbers_before_the_board_sees_them(simulated_rig, led):
    with pytest.raises(TypeError, match="an LED number must be an int"):
        simulated_rig.shoot(led, 1000.0)
    assert simulated_rig.shoot(1, 1000.0).led == 1
