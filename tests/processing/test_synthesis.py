"""Synthesis of detail: exact properties of the sheet, closed forms of the figures, bad input."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from acquisition import DataError, angle_deg
from processing import NormalMap, separate, synthesize
from processing.synthesis import texture_figures
from simulator.shapes import BandNoise, LizardScales
from tests.processing.scenes import one_thread

PATCH = 24


def sheet_of(body, side, seed_at=(0, 0), pixel_mm=0.5):
    """Return the detail of a simulated material, seen from above."""
    y, x = np.mgrid[:side, :side] * pixel_mm
    _, zx, zy = body.evaluate(x + seed_at[0], -y - seed_at[1])
    return separate(NormalMap.from_vectors(np.dstack([-zx, -zy, np.ones_like(zx)]))).detail


@pytest.fixture(scope="module")
def noise():
    return sheet_of(BandNoise(radius_mm=400, rms_mm=0.15, wavelength_mm=5, seed=3), 96)


@pytest.fixture(scope="module")
def made(noise):
    return synthesize(noise, (200, 230), patch=PATCH, seed=5)


def test_a_sheet_keeps_the_character_of_its_exemplar():
    scales = sheet_of(LizardScales(radius_mm=400, seed=3), 128)
    made = synthesize(scales, (200, 230), patch=32, seed=5)
    lengths = np.linalg.norm(made.detail.normals.astype(np.float64), axis=2)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)
    assert made.detail.mask.all()
    figures = texture_figures(made.detail, scales, patch=32)
    assert figures.detail_angle_deg == pytest.approx(figures.exemplar_angle_deg, rel=0.07)
    assert figures.slope_distance < 0.1
    assert figures.spectrum_distance < 0.25
    assert figures.repeat_score < figures.exemplar_repeat_score + 0.15
    assert made.steps.ratio < 1.15
    # Random places without a search give larger steps than any that are accepted here.
    assert made.steps.seam_deg > 0.5 * made.steps.interior_deg


def test_a_sheet_depends_on_the_seed_alone(noise, made):
    with one_thread():
        alone = synthesize(noise, (200, 230), patch=PATCH, seed=5)
    np.testing.assert_array_equal(alone.detail.normals, made.detail.normals)
    np.testing.assert_array_equal(alone.labels, made.labels)
    other = synthesize(noise, (200, 230), patch=PATCH, seed=6)
    assert np.mean(angle_deg(other.detail.normals, made.detail.normals)) > 1


def test_a_sheet_for_tiling_continues_at_its_other_side(noise):
    made = synthesize(noise, (130, 150), patch=PATCH, seed=1, tileable=True)
    normals, plain = made.detail.normals, synthesize(noise, (130, 150), patch=PATCH).detail.normals
    inside = np.mean(angle_deg(normals[:, 1:], normals[:, :-1]))
    for axis in (0, 1):
        first, last = np.take(normals, 0, axis), np.take(normals, -1, axis)
        assert np.mean(angle_deg(first, last)) < 1.15 * inside
        # Without wrapping, unrelated columns meet.
        first, last = np.take(plain, 0, axis), np.take(plain, -1, axis)
        assert np.mean(angle_deg(first, last)) > 1.5 * inside


def slanted(side=64):
    """Return vectors that all lean to the right and a little up, by angles that differ."""
    tilt = np.random.default_rng(2).uniform(0.2, 0.4, (side, side))
    return NormalMap.from_vectors(np.dstack([tilt, 0.5 * tilt, np.ones_like(tilt)]))


@pytest.mark.parametrize(
    ("options", "directions"),
    [
        ({}, [(2, 1)]),
        ({"rotate": True}, [(2, 1), (-1, 2), (-2, -1), (1, -2)]),
        ({"mirror": True}, [(2, 1), (-2, 1)]),
        (
            {"rotate": True, "mirror": True},
            [(x, y) for a, b in ((2, 1), (1, 2)) for x in (a, -a) for y in (b, -b)],
        ),
    ],
    ids=["as it is", "turned", "mirrored", "both"],
)
def test_copies_turn_their_normals(options, directions, monkeypatch):
    """Every vector that leans along (2, 1) leans along one of the turned directions."""
    monkeypatch.setattr("processing.synthesis.sheet_synthesis.matching_kernel", lambda *_: None)
    made = synthesize(slanted(), (150, 150), patch=12, **options).detail.normals
    leans = made[..., :2] / np.linalg.norm(made[..., :2], axis=2, keepdims=True)
    # The cosines of the angles to each direction.
    near = leans @ (np.array(directions).T / np.sqrt(5)) > 1 - 1e-5
    assert (near.sum(axis=2) == 1).all()


def test_a_turned_copy_is_the_turned_surface():
    """The copy of a cone's detail has the pixels and normals of the turned cone."""
    from processing.synthesis.exemplar import prepare_exemplar

    y, x = np.mgrid[4:-5:-1, -6:7].astype(float)
    cone = NormalMap.from_vectors(np.dstack([x + 0.1, y + 0.2 * x, 5 + 0 * x]))
    made = prepare_exemplar(cone, 6, rotate=True, mirror=True)
    # A turn by a quarter moves the vector (a, b) at (x, y) to (-b, a) at (-y, x).
    quarter = made.vectors[2, :13, :9]
    np.testing.assert_array_equal(
        quarter[6, 4], cone.normals[4, 6] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    )
    np.testing.assert_allclose(
        quarter[0, 4], cone.normals[4, 12] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-7
    )
    np.testing.assert_allclose(made.vectors[1, :9, 0], cone.normals[:, 12] * [-1, 1, 1], atol=1e-7)
    # Every copy has as many places as the exemplar.
    assert [int((one >= 0).sum()) for one in made.classes] == [(9 - 5) * (13 - 5)] * 8


def test_patches_stay_inside_the_mask(noise):
    mask = np.hypot(*np.mgrid[-48:48, -48:48]) < 40
    mask[40:44, 40:44] = False
    holed = NormalMap.from_vectors(np.where(mask[..., None], noise.normals, 0), mask)
    made = synthesize(holed, (60, 70), patch=16)
    assert made.detail.mask.all()
    np.testing.assert_allclose(np.linalg.norm(made.detail.normals, axis=2), 1, atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (3, 200), (17, 16), (64, 65)])
def test_sheets_of_any_size(noise, size):
    made = synthesize(noise, size, patch=16)
    assert made.detail.size == size
    np.testing.assert_allclose(np.linalg.norm(made.detail.normals, axis=2), 1, atol=1e-6)


def test_lags_at_which_only_flat_parts_overlap_are_not_judged(noise):
    """Rounding of the transforms would be divided by nothing."""
    normals = np.zeros((512, 512, 3), np.float32)
    normals[..., 2] = 1
    normals[20:40, 20:40] = noise.normals[:20, :20]
    assert texture_figures(NormalMap.from_vectors(normals), noise, patch=16).repeat_score < 0.6


def test_the_figures_of_known_maps(noise):
    tiled = NormalMap(np.tile(noise.normals, (3, 3, 1)), np.tile(noise.mask, (3, 3)))
    figures = texture_figures(tiled, noise, patch=PATCH)
    assert figures.repeat_score == pytest.approx(1, abs=1e-3)
    assert figures.exemplar_repeat_score < 0.6
    assert figures.detail_angle_deg == pytest.approx(figures.exemplar_angle_deg, rel=1e-6)
    assert figures.slope_distance < 1e-3
    same = texture_figures(noise, noise)
    assert same.spectrum_distance == 0
    # Twice the slopes at small angles: 4 times the power, at every frequency.
    small = NormalMap.from_vectors(noise.normals * [0.05, 0.05, 1])
    steep = NormalMap.from_vectors(noise.normals * [0.1, 0.1, 1])
    figures = texture_figures(steep, small)
    assert figures.spectrum_distance == pytest.approx(np.log(4), rel=0.02)
    assert figures.detail_angle_deg == pytest.approx(2 * figures.exemplar_angle_deg, rel=0.01)
    angles = np.degrees(np.arctan2(np.hypot(*np.moveaxis(small.normals[..., :2], 2, 0)), 1))
    assert figures.slope_distance == pytest.approx(angles.mean() / angles.std(), rel=0.02)


def holes():
    mask = np.ones((64, 64), bool)
    mask[::8] = False
    return NormalMap.from_vectors(np.where(mask[..., None], slanted().normals, 0), mask)


@pytest.mark.parametrize(
    ("exemplar", "size", "options", "message"),
    [
        (slanted(20), (50, 50), {"patch": 24}, "20 x 20 pixels, less than a patch of 24 x 24"),
        (holes(), (50, 50), {"patch": 12}, "no patch of 12 x 12 pixels fits into the mask"),
        (
            NormalMap.from_vectors(np.tile([0.0, 0, 1], (64, 64, 1))),
            (50, 50),
            {"patch": 12},
            "the exemplar is flat: its mean detail angle is 0 degrees",
        ),
        (slanted(), (0, 50), {}, "50 x 0 pixels has no pixels"),
        (slanted(), (50, 50), {"patch": 5}, "a patch of 5 x 5 pixels is too small"),
        (slanted(), (50, 50), {"patch": 12, "overlap": 5}, "overlap by 2 to 4"),
        (slanted(), (50, 50), {"overlap": 1}, "an overlap of 1 pixels is out of range"),
        (slanted(), (50, 50), {"seed": -1}, "a seed of -1 is out of range"),
        (slanted(), (50, 23), {"patch": 12, "tileable": True}, "at least 24 pixels wide"),
    ],
)
def test_bad_input(exemplar, size, options, message):
    with pytest.raises(DataError, match=message):
        synthesize(exemplar, size, **options)


def test_scales_with_turned_copies_are_refused_by_their_own_figure():
    """Turned scales do not continue each other: the steps across cuts show it."""
    scales = sheet_of(LizardScales(radius_mm=400, scale_mm=8), 128)
    plain, turned = (
        synthesize(scales, (200, 200), patch=PATCH, rotate=rotate).steps.ratio
        for rotate in (False, True)
    )
    assert plain < turned


def test_patches_of_neighbouring_strips_are_joined_like_all_others(noise):
    made = synthesize(noise, (16 * 6 * 2 + 20, 60), patch=8, overlap=2, seed=4).detail.normals
    steps = angle_deg(made[1:], made[:-1]).mean(axis=1)
    borders = [96 - 1, 96, 192 - 1, 192]
    assert steps[borders].mean() < 1.15 * steps.mean()


@pytest.fixture(scope="module")
def disc(noise):
    """Return an object that is steep at its rim, where no patch fits, and flat in the middle."""
    away = np.hypot(*np.mgrid[-48:48, -48:48])
    slopes = noise.normals[..., :2] / noise.normals[..., 2:] * np.clip(away / 30, 0.3, 2)[..., None]
    mask = away < 44
    return NormalMap.from_vectors(np.dstack([slopes, np.ones((96, 96))]) * mask[..., None], mask)


def test_an_object_with_flat_parts_away_from_its_rim(disc):
    figures = texture_figures(synthesize(disc, (256, 256), patch=PATCH).detail, disc, patch=PATCH)
    assert figures.detail_angle_deg == pytest.approx(figures.exemplar_angle_deg, rel=0.07)


def angles_of(vectors):
    return np.arctan2(np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2])


def test_steep_patches_make_up_for_a_rim_where_none_fits(disc, monkeypatch):
    """The shares of the classes do so by themselves, before the filter makes a sheet steeper."""
    from processing.synthesis.exemplar import prepare_exemplar

    meant = angles_of(disc.normals)[disc.mask].mean()
    prepared = prepare_exemplar(disc, PATCH, rotate=False, mirror=False)
    patches = sliding_window_view(angles_of(disc.normals), (PATCH, PATCH)).mean(axis=(2, 3))
    classes = prepared.classes[0, : len(patches), : patches.shape[1]]
    means = np.array([patches[classes == c].mean() for c in range(len(prepared.shares))])
    assert prepared.shares @ means == pytest.approx(meant, rel=0.02)
    # Equal shares would leave the sheet a quarter too flat.
    assert means.mean() < 0.8 * meant
    # The search for patches that fit leaves the sheet a little flatter than the shares alone.
    monkeypatch.setattr("processing.synthesis.sheet_synthesis.matching_kernel", lambda *_: None)
    unfiltered = synthesize(disc, (256, 256), patch=PATCH).detail.normals
    assert angles_of(unfiltered).mean() > 0.85 * meant
