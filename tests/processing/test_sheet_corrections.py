"""What is done to a sheet after its patches are placed: softer cuts, and a filter."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from processing import NormalMap
from processing.synthesis import texture_figures
from processing.synthesis.seam_steps import cut_steps
from processing.synthesis.sheet_synthesis import softened_bands, softening_share
from processing.synthesis.spectrum_match import filtered_bands, matching_kernel


def soften_cuts(sheet, labels, *, wrapped):
    share = softening_share(sheet, labels)
    for rows, band in softened_bands(sheet, labels, share, wrapped=wrapped) if share else ():
        sheet[rows] = band


def match_spectrum(sheet, exemplar, *, wrapped):
    kernel = matching_kernel(sheet, exemplar)
    for rows, band in () if kernel is None else filtered_bands(sheet, kernel, wrapped=wrapped):
        sheet[rows] = band


def smooth_noise(side, sigma, seed, gain=0.2):
    """Return unit vectors whose slopes are noise, smoothed by a Gaussian and wrapped."""
    slopes = np.random.default_rng(seed).normal(size=(side, side, 2)).astype(np.float32)
    reach = 16
    slopes = cv2.copyMakeBorder(slopes, *[reach] * 4, cv2.BORDER_WRAP)
    slopes = cv2.GaussianBlur(slopes, (0, 0), sigma)[reach:-reach, reach:-reach]
    slopes *= gain / slopes.std()
    return NormalMap.from_vectors(np.dstack([slopes, np.ones((side, side), np.float32)]))


def squares(side, square):
    row, column = np.indices((side, side)) // square
    return (row % 2 * 2 + column % 2).astype(np.uint8)


@pytest.mark.parametrize("wrapped", [False, True])
def test_steps_across_cuts_become_those_inside(wrapped):
    """Squares of unrelated noise; the other side of the sheet is a cut only if it is wrapped."""
    side, square = 600, 50
    labels = squares(side, square)
    parts = [smooth_noise(side, 3, seed).normals for seed in range(4)]
    sheet = np.choose(labels[..., None], parts)
    before = cut_steps(sheet, labels, wrapped=wrapped).ratio
    given = sheet.copy()
    soften_cuts(sheet, labels, wrapped=wrapped)
    assert before > 2
    assert cut_steps(sheet, labels, wrapped=wrapped).ratio == pytest.approx(1, abs=0.15)
    np.testing.assert_allclose(np.linalg.norm(sheet, axis=2), 1, atol=1e-6)
    changed = (sheet != given).any(axis=2)
    at = np.zeros(side, bool)
    at[square - 1 :: square] = at[::square] = True
    at[[0, -1]] = wrapped
    # Copies of the same pixel are normalised again, which may change the last bit.
    moved = np.abs(sheet - given).max(axis=2) > 1e-6
    np.testing.assert_array_equal(moved & ~(at[:, None] | at), False)
    assert moved[:, at].mean() > 0.9
    assert changed.any()


def test_cuts_that_are_not_seen_are_left_as_they_are():
    sheet = smooth_noise(128, 2, 1).normals
    given = sheet.copy()
    soften_cuts(sheet, np.zeros((128, 128), np.uint8), wrapped=False)
    np.testing.assert_array_equal(sheet, given)


def test_the_filter_gives_a_sheet_the_spectrum_of_its_exemplar():
    exemplar, other = smooth_noise(256, 2.0, 2), smooth_noise(512, 1.6, 3, 0.17).normals.copy()
    before = texture_figures(NormalMap.from_vectors(other), exemplar)
    match_spectrum(other, exemplar, wrapped=True)
    after = texture_figures(NormalMap.from_vectors(other), exemplar)
    assert before.spectrum_distance > 1
    assert after.spectrum_distance < 0.5 * before.spectrum_distance
    assert after.detail_angle_deg == pytest.approx(after.exemplar_angle_deg, rel=0.05)


def islands(side, seed):
    """Return round islands with flat parts inside and between them, wrapped."""
    noise = smooth_noise(side, 5, seed).normals[..., 0]
    raised = np.where(noise > 0, np.float32(3), np.float32(0))
    heights = cv2.GaussianBlur(np.tile(raised, (3, 3)), (0, 0), 1.5)
    down, right = (np.gradient(heights, axis=k)[side : 2 * side, side : 2 * side] for k in (0, 1))
    return NormalMap.from_vectors(np.dstack([-right, down, np.ones_like(right)]))


def test_the_filter_leaves_what_has_the_spectrum_already():
    """Islands: bands of little power, five orders below the others, are not lifted."""
    given = islands(256, 4)
    sheet = np.tile(given.normals, (2, 2, 1))
    match_spectrum(sheet, given, wrapped=True)
    assert texture_figures(NormalMap.from_vectors(sheet), given).spectrum_distance < 0.1


def test_small_sheets_do_not_follow_chance():
    """Another part of the same noise has another power in each band, and hardly changes."""
    changes = []
    for seed in range(4):
        exemplar, sheet = smooth_noise(96, 2, seed), smooth_noise(128, 2, seed + 100).normals
        given = sheet.copy()
        match_spectrum(sheet, exemplar, wrapped=True)
        changes.append(np.square(sheet - given).sum() / np.square(given[..., :2]).sum())
    # With gains that follow chance, the rms change is .21.
    assert 0 < np.mean(np.sqrt(changes)) < 0.13


def test_flat_parts_of_small_sheets_show_no_waves():
    """Gains that alternate from band to band make a long filter, and steps of 3.5 degrees."""
    waves = []
    for seed in (4, 5, 6):
        material = islands(256, seed).normals
        sheet = material[120:248, 120:248].copy()
        flat = np.hypot(sheet[..., 0], sheet[..., 1]) < 1e-3
        match_spectrum(sheet, NormalMap.from_vectors(material[:96, :96]), wrapped=False)
        waves.append(np.degrees(np.hypot(sheet[..., 0], sheet[..., 1])[flat].mean()))
    assert np.mean(waves) < 2
