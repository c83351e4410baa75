"""The comparison of images with their transfer curve: it finds wrong curves, and nothing else."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import LINEAR, SRGB, CameraModel, Frame, Lights, Source, TransferCurve
from processing import reconstruct
from simulator import SCENES, render, scene_named
from tests.processing.scenes import sunflower
from tests.quick_sample import quick

SIZE = 64
WHITE = 255


def dome(count: int = 12) -> Lights:
    return Lights(sunflower(count, 0.8))


def ball() -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    x, y = (columns - 31.5) / 30, (31.5 - rows) / 30
    mask = x**2 + y**2 < 0.9
    return np.dstack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))]), mask


def shades(lights: Lights) -> np.ndarray:
    normals, mask = ball()
    light = np.clip(np.einsum("hwc,nc->nhw", normals, lights.unit_directions), 0, None)
    rng = np.random.default_rng(3)
    albedo = rng.uniform(0.5, 0.9, mask.shape)
    return np.where(mask, albedo * light * rng.normal(1, 0.01, light.shape), 0)


def recording(
    images: np.ndarray, lights: Lights, transfer: TransferCurve, white: float = WHITE, **other
) -> Source:
    """Return a source of images relative to white, without files."""
    if np.isfinite(white):
        images = np.rint(np.clip(images, 0, 1) * white).astype(np.uint16)
    here = Path(__file__)
    frames = [
        Frame(here, name, image.shape, load=lambda image=image: image)
        for name, image in zip(lights.ids, images, strict=True)
    ]
    return Source(
        here.parent, "images", tuple(frames), lights, mask=ball()[1], white_level=white,
        transfer=transfer, transfer_origin="a table of the test", **other,
    )  # fmt: skip


def doubts(source: Source) -> list[str]:
    found = reconstruct(source, surface=False).warnings
    return [notice.text for notice in found if notice.code == "transfer-curve-doubtful"]


CURVES = {"linear": LINEAR, "srgb": SRGB, "power": TransferCurve.power(2.2)}


@pytest.mark.parametrize("true", CURVES)
@pytest.mark.parametrize("taken", quick(CURVES, every=3))
def test_a_wrong_curve_is_named_with_both_figures(true: str, taken: str) -> None:
    lights = dome()
    samples = CURVES[true].samples(shades(lights))
    found = doubts(recording(samples, lights, CURVES[taken]))
    if (true == "linear") == (taken == "linear"):
        assert found == []
        return
    (text,) = found
    figures = [float(figure) for figure in re.findall(r"([\d.]+)%", text)]
    assert len(figures) == 2
    assert figures[0] > 5 * figures[1] > 0
    other = "sRGB" if taken == "linear" else "linear"
    assert f"but as {other} only" in text
    assert text.endswith(f"; state the transfer curve: {other}")


@pytest.mark.parametrize("dtype", quick([np.float32, np.uint16], every=2))
def test_intensities_and_exposures_are_considered(dtype: type) -> None:
    """Samples of lights of different strength are at different places of the curve."""
    lights = dome()
    strength = np.linspace(0.3, 1.0, 12)
    exposures = np.linspace(1000.0, 500.0, 12)
    signal = shades(lights) * (strength * exposures / 1000)[:, None, None]
    strong = replace(lights, intensities=np.repeat(strength[:, None], 3, 1))
    for true in (LINEAR, SRGB):
        for taken in (LINEAR, SRGB):
            source = recording(true.samples(signal), strong, taken, 60_000)
            frames = zip(source.frames, exposures, strict=True)
            source = replace(
                source, frames=tuple(replace(f, exposure_us=float(e)) for f, e in frames)
            )
            assert bool(doubts(source)) == (true != taken)


@pytest.mark.slow
def test_near_lights() -> None:
    camera = CameraModel(np.array([[300.0, 0, 31.5], [0, 300, 31.5], [0, 0, 1]]), SIZE, SIZE, 300.0)
    near = Lights(positions_mm=250 * dome().unit_directions)
    normals, mask = ball()
    vectors = near.vectors_at(camera.points_on_plane().reshape(-1, 3)).reshape(12, SIZE, SIZE, 3)
    light = np.where(mask, 0.3 * np.clip(np.einsum("hwc,nhwc->nhw", normals, vectors), 0, None), 0)
    for true in (LINEAR, SRGB):
        source = recording(true.samples(light), near, LINEAR, camera=camera)
        assert bool(doubts(source)) == (true != LINEAR)


@pytest.mark.parametrize("mirrored", quick([False, True], every=2))
def test_wrong_lights_are_not_blamed_on_the_curve(mirrored: bool) -> None:
    lights = dome()
    vectors = lights.unit_directions
    other = vectors * [-1, 1, 1] if mirrored else np.roll(vectors, 5, axis=0)
    for true in (LINEAR, SRGB):
        samples = true.samples(shades(Lights(directions=other)))
        source = recording(samples, lights, true)
        assert doubts(source) == []


def test_too_few_lights_say_nothing() -> None:
    lights = dome(4)
    assert doubts(recording(SRGB.samples(shades(lights)), lights, LINEAR)) == []


def test_too_few_pixels_say_nothing() -> None:
    lights = dome()
    mask = np.zeros((SIZE, SIZE), np.bool_)
    mask[28:36, 28:36] = True
    source = recording(SRGB.samples(shades(lights)), lights, LINEAR)
    assert doubts(replace(source, mask=mask)) == []


def test_floats_have_no_white_and_are_not_doubted() -> None:
    lights = dome()
    samples = SRGB.samples(shades(lights)).astype(np.float32)
    assert doubts(recording(samples, lights, LINEAR, np.inf)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(SCENES) - {"spheres"})[::3])
def test_simulated_scenes_are_quiet_and_found_with_a_display_curve(name: str) -> None:
    rendering = render(scene_named(name, width=96, height=80, leds=12))
    truth = rendering.truth
    full = np.quantile(rendering.planes[:, truth.mask], 0.999) / 0.8
    rng = np.random.default_rng(5)
    signal = rng.poisson(np.clip(rendering.planes / full, 0, 1) * 3e4) / 3e4
    for true in (LINEAR, SRGB):
        source = recording(true.samples(signal), truth.lights, LINEAR, 4095, camera=truth.camera)
        assert bool(doubts(replace(source, mask=truth.mask))) == (true != LINEAR)
    source = recording(SRGB.samples(signal), truth.lights, SRGB, 4095, camera=truth.camera)
    assert doubts(replace(source, mask=truth.mask)) == []
