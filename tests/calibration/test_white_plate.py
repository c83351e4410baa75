"""Strengths from one rendered card predict the image of another: a white plate."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Lights
from calibration import MatteSurface, calibrate_intensities
from simulator import Lens, bench_camera, render, scene_named


@pytest.mark.slow
@pytest.mark.parametrize("vignetting", [0.0, 0.5])
def test_the_image_of_a_white_plate_is_reproduced(vignetting):
    """12 bits, four chrome spheres on the card, positions wrong by .6 mm."""
    camera = bench_camera()
    lens = Lens(camera, vignetting=vignetting)
    random = np.random.default_rng(1)
    card, plate = (
        render(replace(scene_named(name, leds=24), lens=lens))
        for name in ("spheres", "white-plane")
    )
    true = card.truth.lights
    electrons = random.poisson(card.planes * 20_000.0) + random.normal(0, 2.5, card.planes.shape)
    grey = np.round(electrons / 2.5)
    values = np.where(grey >= 4031, np.nan, grey / 4031).astype(np.float32)
    positions = np.asarray(true.positions_mm) + random.normal(0, 0.6, (24, 3))
    found = calibrate_intensities(
        MatteSurface.card(values, camera), Lights(positions_mm=positions)
    ).lights
    strength = np.asarray(found.intensities)[:, 0]
    expected = np.asarray(true.intensities)[:, 0]
    assert np.abs(strength / (expected / expected.mean()) - 1).mean() < 0.003
    assert np.abs(np.asarray(found.mu) / np.asarray(true.mu) - 1).mean() < 0.02
    predicted = found.vectors_at(camera.points_on_plane())[..., 2] * strength[:, None, None]
    ratio = plate.planes / predicted
    # Vignetting multiplies all images of a pixel alike; without it, one factor fits all pixels.
    ratio /= np.median(ratio, axis=0 if vignetting else None)
    assert np.sqrt(np.mean((ratio - 1) ** 2)) < 0.004
