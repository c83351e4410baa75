"""Constant light in the images, from images with a closed form."""

import numpy as np
import pytest

from acquisition import DataError, Lights, angle_deg, read_source, write_png
from calibration import EstimateError
from processing import reconstruct
from processing.images.viewing_rays import Parallel
from processing.series.ambient_light import find_ambient_light
from tests.cases import cases
from tests.quick_sample import quick

SIZE = (40, 42)
VIEW = Parallel(1.4, SIZE, ((SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2))
ACROSS, UP, _ = np.moveaxis(VIEW.points_at(0.0), 2, 0)
RADIUS = 34.0
MASK = ACROSS**2 + UP**2 < 26**2
DEPTH = np.sqrt(np.maximum(RADIUS**2 - ACROSS**2 - UP**2, 1))
NORMALS = np.dstack([ACROSS, UP, DEPTH]) / RADIUS
NORMALS /= np.linalg.norm(NORMALS, axis=-1, keepdims=True)
PAINT = 0.5 + 0.2 * np.cos(UP / 5)


def rings(elevations, intensities=None):
    """Return 12 lights at elevations in degrees, in turn."""
    high, turn = np.radians(np.resize(elevations, 12)), np.arange(12) * 2.4
    toward = [np.cos(high) * np.cos(turn), np.cos(high) * np.sin(turn), np.sin(high)]
    names = tuple(f"ball.{i:02d}" for i in range(12))
    return Lights(directions=np.stack(toward, 1), intensities=intensities, ids=names)


STRENGTHS = np.random.default_rng(2).uniform(0.6, 1.5, 12)
DOME = rings((35, 55, 75), STRENGTHS)


def images(lights, level):
    """Return images of a cap with 0.2 % noise, under a uniform sky besides the lights."""
    shading = np.maximum(np.einsum("nc,hwc->nhw", lights.unit_directions, NORMALS), 0)
    light = shading * lights.intensities[:, :1, None] + level * (1 + NORMALS[..., 2]) / 2
    noise = np.random.default_rng(1).normal(1, 0.002, light.shape)
    return np.where(MASK, PAINT * light * noise, 0).astype(np.float32)


def divided(lights, level):
    return images(lights, level) / lights.intensities[:, :1, None].astype(np.float32)


@cases(
    "level",
    dict(zip(("dark", "weak", "strong"), quick([0.0, 0.03, 0.3], every=3), strict=True)),
)
def test_the_level_is_within_its_deviation(level):
    found = find_ambient_light(divided(DOME, level), DOME, MASK, VIEW)
    expected = level / STRENGTHS.mean()
    assert found.sigma < 0.01
    assert found.level == pytest.approx(expected, abs=2 * found.sigma + 0.002)


@cases(
    ("lights", "error", "text"),
    {
        "one elevation": (rings((45,)), EstimateError, "nearly the same elevation"),
        "four lights": (DOME.take(range(4)), EstimateError, "at least 5 are required"),
        "another count": (DOME.take(range(7)), DataError, "12 images for 7 lights"),
    },
)
def test_lights_that_do_not_determine_it_are_refused(lights, error, text):
    values = divided(DOME, 0.1)[: 4 if len(lights) == 4 else 12]
    with pytest.raises(error, match=text):
        find_ambient_light(values, lights, MASK, VIEW)


@pytest.mark.slow
@cases("channel", {"gray": "gray", "one solution per channel": "rgb"})
def test_normals_are_those_of_a_dark_room(tmp_path, channel):
    colour = channel == "rgb"

    def error(level, ambient):
        folder = tmp_path / f"{level}"
        folder.mkdir(exist_ok=True)
        for name, image in zip(DOME.ids, images(DOME, level), strict=True):
            pixels = np.rint(image * 45000).astype(np.uint16)
            write_png(folder / f"{name}.png", np.dstack([pixels] * 3) if colour else pixels)
        write_png(folder / "mask.png", (255 * MASK).astype(np.uint8))
        made = reconstruct(
            read_source(folder, lights=DOME),
            method="ls", channel=channel, ambient=ambient, surface=False,
        )  # fmt: skip
        return angle_deg(made.normals.normals, NORMALS)[MASK].mean(), made

    (dark, _), (bright, without), (found, made) = (
        error(0.0, "none"), error(0.15, "none"), error(0.15, "estimate"),
    )  # fmt: skip
    assert bright > 1.5 > 1.3 * dark
    assert found < 1.3 * dark + 0.05
    expected = 0.15 / STRENGTHS.mean()
    assert made.ambient.level == pytest.approx(expected, abs=0.003)
    # The albedo does not contain the room; the images are 45000 of 65535.
    gray = made.gray_albedo[MASK] / PAINT[MASK]
    assert np.mean(gray) == pytest.approx(45000 / 65535, rel=0.02)
    assert np.mean(without.gray_albedo[MASK] / PAINT[MASK]) > 1.1 * np.mean(gray)
    assert without.ambient is None


def test_strengths_and_constant_light_are_not_estimated_together(tmp_path):
    for name, image in zip(DOME.ids, images(DOME, 0.1), strict=True):
        write_png(tmp_path / f"{name}.png", np.rint(image * 45000).astype(np.uint16))
    with pytest.raises(DataError, match="strengths of the lights and a constant light cannot both"):
        reconstruct(read_source(tmp_path, lights=DOME), ambient="estimate", semi_calibrated=True)
