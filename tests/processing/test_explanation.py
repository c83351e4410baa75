"""What is wrong with a recording is named, and nothing if nothing is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import Lights, read_source, write_png
from processing import reconstruct
from processing.checks import Verdict
from processing.recording.pipeline import AmbientChoice
from rig.arrays import Float64
from tests.quick_sample import quick

HEIGHT, WIDTH = 84, 96
ABOVE_MM = 450.0
# Samples of radiance, where 1 is white.
SCALE = 1.5


def lights_of(count: int, seed: int) -> Lights:
    """Return near lights in three rings; their strengths differ, as those of LEDs do."""
    rng = np.random.default_rng(seed)
    rows = np.arange(count)
    up = np.radians(np.array([30, 50, 70])[rows % 3])
    around = 2 * np.pi * rows / count * 3 + rows % 3
    unit = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], 1)
    return Lights(positions_mm=unit * ABOVE_MM, intensities=rng.uniform(0.8, 1.2, count))


class Recording:
    """Images of a painted relief of 160 mm under near lights, by the model of near lights."""

    def __init__(self, seed: int = 3, count: int = 24) -> None:
        rng = np.random.default_rng(seed)
        self.lights = lights_of(count, seed)
        self.pixel_mm = 160 / WIDTH
        y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
        waves = rng.uniform(-0.12, 0.12, (12, 2))
        height = sum(
            1.5 * np.sin(a * x + b * y + i) / (0.6 + np.hypot(a, b) * 6)
            for i, (a, b) in enumerate(waves)
        )
        self.height_mm = (height - np.mean(height)) * self.pixel_mm
        down, right = np.gradient(self.height_mm / self.pixel_mm)
        normals = np.dstack([-right, down, np.ones_like(x)])
        self.normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
        paint = cv2.GaussianBlur(rng.uniform(0, 1, (HEIGHT, WIDTH)), (0, 0), 3)
        self.albedo = 0.35 + 2.5 * (paint - paint.mean())
        points = np.dstack(
            [(x - WIDTH / 2) * self.pixel_mm, (HEIGHT / 2 - y) * self.pixel_mm, self.height_mm]
        )
        cosines = np.einsum("nhwk,hwk->nhw", self.lights.vectors_at(points), self.normals)
        strengths = np.asarray(self.lights.intensities)[:, :1, None]
        self.images = strengths * self.albedo * np.maximum(cosines, 0)
        self.images += rng.normal(0, 0.001, self.images.shape)


def verdict_of(recording: Recording, folder: str, ambient: AmbientChoice = "none") -> Verdict:
    for name, image in zip(recording.lights.ids, recording.images, strict=True):
        level = np.clip(image * SCALE, 0, 1) * 65535
        write_png(f"{folder}/{name}.png", np.rint(level).astype(np.uint16))
    write_png(f"{folder}/mask.png", np.full((HEIGHT, WIDTH), 255, np.uint8))
    source = read_source(folder, lights=recording.lights)
    made = reconstruct(
        source, pixel_mm=recording.pixel_mm, align="off", surface=False, ambient=ambient
    )
    return made.verdict


def moved(image: Float64, right: float) -> Float64:
    matrix = np.array([[1, 0, right], [0, 1, 0]], np.float64)
    return np.asarray(
        cv2.warpAffine(image, matrix, image.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    )


def change(text: str) -> Callable[[Callable[[Recording], None]], Callable[[Recording], None]]:
    def named(function: Callable[[Recording], None]) -> Callable[[Recording], None]:
        CHANGES[text] = function
        return function

    return named


CHANGES: dict[str, Callable[[Recording], None]] = {}


@change("ambient-light")
def _(r: Recording) -> None:
    r.images = r.images + 0.1 * r.albedo * (1 + r.normals[..., 2]) / 2


@change("ambient-light-changes")
def _(r: Recording) -> None:
    shares = np.random.default_rng(6).uniform(0, 0.1, len(r.images))[:, None, None]
    r.images = r.images + shares * r.albedo * (1 + r.normals[..., 2]) / 2


@change("transfer-curve-doubtful")
def _(r: Recording) -> None:
    r.images = np.clip(r.images, 0, 1) ** 0.6


@change("tone-curve")
def _(r: Recording) -> None:
    stored = r.images * SCALE
    r.images = (stored - 0.05 * np.sin(2 * np.pi * stored)) / SCALE


@change("light-brightness")
def _(r: Recording) -> None:
    errors = np.random.default_rng(5).normal(1, 0.08, len(r.images))
    r.images = r.images * errors[:, None, None]


@change("lights-fading")
def _(r: Recording) -> None:
    r.images = r.images * np.linspace(1, 0.8, len(r.images))[:, None, None]


@change("images-moved")
def _(r: Recording) -> None:
    r.images[10:] = [moved(image, 2) for image in r.images[10:]]


@change("images-drift")
def _(r: Recording) -> None:
    count = len(r.images) - 1
    r.images = np.stack([moved(image, 4 * k / count) for k, image in enumerate(r.images)])


@change("lights-shuffled")
def _(r: Recording) -> None:
    r.images = r.images[::-1]


@change("images-swapped")
def _(r: Recording) -> None:
    r.images[[4, 6]] = r.images[[6, 4]]


@change("images-turned")
def _(r: Recording) -> None:
    r.images = r.images[:, ::-1, ::-1]


@change("lights-mirrored")
def _(r: Recording) -> None:
    r.images = r.images[:, :, ::-1]


@change("lights-not-distant")
def _(r: Recording) -> None:
    r.lights = replace(
        Lights(directions=r.lights.unit_directions), intensities=r.lights.intensities
    )


@pytest.mark.parametrize("name", quick(CHANGES, every=5))
def test_the_cause_is_named(name: str, tmp_path: Path) -> None:
    recording = Recording()
    CHANGES[name](recording)
    verdict = verdict_of(recording, str(tmp_path))
    found = {cause.name for cause in verdict.causes}
    found |= {other for cause in verdict.causes for other in cause.alternatives}
    assert name in found


@pytest.mark.slow
def test_a_thin_object_and_images_without_noise_have_a_verdict(tmp_path: Path) -> None:
    recording = Recording()
    recording.images = np.full_like(recording.images, 0.3)
    assert verdict_of(recording, str(tmp_path)).tried
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[50:52] = 255  # every block is at the border of the object
    write_png(tmp_path / "mask.png", mask)
    source = read_source(tmp_path, lights=recording.lights)
    thin = reconstruct(source, pixel_mm=recording.pixel_mm, align="off", surface=False).verdict
    assert "ambient-light" in thin.not_excluded


def test_sizes_are_those_of_the_truth(tmp_path: Path) -> None:
    recording = Recording(seed=8)
    CHANGES["ambient-light"](recording)
    cause = verdict_of(recording, str(tmp_path)).causes[0]
    assert cause.name == "ambient-light"
    # Relative to the albedo with the room light, of which the first step knows nothing else.
    assert cause.size == pytest.approx(10, abs=1.5)
    assert cause.normals_deg > 1


@pytest.mark.parametrize("seed", quick(range(20, 24), every=4))
def test_nothing_is_named_without_a_cause(seed: int, tmp_path: Path) -> None:
    verdict = verdict_of(Recording(seed), str(tmp_path))
    assert verdict.answer == "good"
    assert not verdict.causes
    # A tilt of all lights turns all normals, and changes no image of a flat relief.
    assert "lights-tilted" in verdict.not_excluded
    assert set(verdict.least) >= {"ambient-light", "image-shifted", "light-brightness"}


def test_distant_lights_are_not_called_near(tmp_path: Path) -> None:
    """The height of an object adds the same to all pixels: alone, it shows no distance."""
    recording = Recording(count=12)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    dome = np.exp(-((x - 34) ** 2 + (y - 36) ** 2) / 400)
    height = 12 * dome + 6 * np.exp(-((x - 70) ** 2 + (y - 54) ** 2) / 100)
    down, right = np.gradient(height)
    normals = np.dstack([-right, down, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    turn, up = 2 * np.pi * np.arange(12) / 12, np.radians(np.resize([65, 35], 12))
    unit = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], 1)
    recording.lights = Lights(directions=unit)
    shading = np.maximum(np.einsum("nk,hwk->nhw", unit, normals), 0)
    room = 0.05 + np.random.default_rng(0).normal(0, 0.001, shading.shape)
    recording.images = (shading * (0.4 + 0.16 * np.sin(x / 9) * np.cos(y / 7)) + room) / SCALE
    verdict = verdict_of(recording, str(tmp_path), ambient="estimate")
    assert "lights-not-distant" in verdict.tried
    assert verdict.answer == "good", verdict.causes
