"""Normals straight from the frames of a camera against `photometric_stereo`."""

import numpy as np
import pytest

from acquisition import DataError, Lights
from calibration import EstimateError
from processing import StereoMaps, normals_of_frames, photometric_stereo

DIRECTIONS = [[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1], [1, 1, 2]]
FRAMES = np.random.default_rng(44).integers(70, 4096, (5, 16, 20)).astype(np.uint16)
DARK = np.linspace(60, 68, 320).reshape(16, 20)


def test_frames_give_the_normals_of_linear_values():
    intensities = [1, 2, 0.5, 1, 3]
    lights = Lights(DIRECTIONS, intensities=[[level] * 3 for level in intensities])
    gain = np.array([1, 2, 4, 1, 0.5])
    factor = np.asarray(gain / intensities, np.float32)[:, None, None]
    linear = (FRAMES.astype(np.float32) - DARK.astype(np.float32)) * factor
    linear[FRAMES >= 4000] = np.nan
    mask = np.ones((16, 20), bool)
    mask[:, 9] = False
    part = slice(2, 15), slice(3, 17)
    expected = photometric_stereo(linear[:, *part], lights, mask[part], method="ls")
    out = StereoMaps.empty((13, 14))
    out.normals[:], out.used[:] = 7, 7
    for frames in (FRAMES, np.asfortranarray(FRAMES), FRAMES.astype(">u2"), FRAMES.astype(float)):
        maps = normals_of_frames(
            frames, lights, dark=DARK, gain=gain, saturation=4000, region=(3, 2, 14, 13),
            mask=mask, out=out,
        )  # fmt: skip
        assert maps is out
        assert np.array_equal(maps.normals, expected.normal_map.normals)
        assert np.array_equal(maps.albedo, expected.albedo)
        assert np.array_equal(maps.used, expected.used)


def test_near_lights_take_the_points_of_the_region():
    lights = Lights(positions_mm=300 * np.array(DIRECTIONS))
    y, x = np.mgrid[8:-8:16j, -10:10:20j]
    points = np.stack([x, y, 0 * x], axis=2)
    whole = normals_of_frames(FRAMES, lights, points_mm=points)
    part = normals_of_frames(FRAMES, lights, points_mm=points, region=(4, 3, 7, 9))
    assert np.array_equal(part.normals, whole.normals[3:12, 4:11])
    assert whole.used.all()


LIGHTS = Lights(DIRECTIONS)
SMALL = StereoMaps.empty((4, 4))
WRONG = {
    "four frames": ({"frames": FRAMES[:4]}, "4 frames for 5 lights"),
    "one frame": ({"frames": FRAMES[0]}, r"\(N, H, W\), not uint16 of shape \(16, 20\)"),
    "complex": ({"frames": FRAMES * 1j}, "not complex128"),
    "region": ({"region": (10, 0, 11, 4)}, "x 10, y 0, 11 x 4 px is not inside frames of 20 x 16"),
    "empty region": ({"region": (0, 0, 0, 4)}, "not inside"),
    "dark image": ({"dark": DARK[1:]}, r"dark image of shape \(15, 20\)"),
    "dark NaN": ({"dark": np.nan}, "dark level is not finite"),
    "saturation": ({"dark": 64, "saturation": 64}, "saturation of 64 is not above"),
    "saturation NaN": ({"saturation": np.nan}, "saturation of nan is not above"),
    "gains": ({"gain": [1, 2]}, r"gain of shape \(2,\) does not fit 5 frames"),
    "gain 0": ({"gain": 0}, "not a finite number above 0"),
    "mask": ({"mask": np.ones((3, 3), bool)}, r"mask must be .* not bool of shape \(3, 3\)"),
    "empty mask": ({"mask": np.zeros((16, 20), bool)}, "no pixel in the region"),
    "maps": ({"out": SMALL}, r"map normals must be .* \(16, 20, 3\)"),
    "method": ({"method": "l2"}, "'l2' is not a method"),
    "no points": ({"lights": Lights(positions_mm=np.array(DIRECTIONS))}, "need surface points"),
    "points": (
        {"lights": Lights(positions_mm=np.array(DIRECTIONS)), "points_mm": DARK},
        r"points of shape \(16, 20\)",
    ),
    "coplanar": (
        {"frames": FRAMES[:3], "lights": Lights([[1, 0, 1], [0, 0, 1], [-1, 0, 1]])},
        "plane",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_frames_give_one_clear_line(name):
    changed, message = WRONG[name]
    given = {"frames": FRAMES, "lights": LIGHTS} | changed
    kind = EstimateError if name == "coplanar" else DataError
    with pytest.raises(kind, match=message) as caught:
        normals_of_frames(given.pop("frames"), given.pop("lights"), **given)
    assert "\n" not in str(caught.value)


def test_lights_of_another_type_are_refused():
    with pytest.raises(TypeError, match="lights must be a Lights"):
        normals_of_frames(FRAMES, np.array(DIRECTIONS))
