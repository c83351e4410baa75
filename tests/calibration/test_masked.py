"""Masks of spheres that are off are refined in the images, exact masks are not changed."""

import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from calibration import calibrate_spheres
from calibration.spheres import TracedOutline, fit_ellipse, mask_outlines
from calibration.spheres.outline.outline_noise import outline_covariance
from calibration.spheres.propose.sphere_marks import masked_spheres, painted_covariance
from simulator import render, scene_named
from tests.quick_sample import quick

from .uneven_balls import uneven_ball

DISC = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))


@pytest.fixture(scope="module")
def scene():
    rendering = render(scene_named("spheres", width=640, height=512, leds=8, seed=21))
    values = (rendering.planes + rendering.ambient) * np.float32(2)
    values[values > 1] = np.nan
    mask = rendering.truth.sphere_masks[0]
    outline, _ = fit_ellipse(mask_outlines(mask)[0])
    return SimpleNamespace(values=values, mask=mask, outline=outline, camera=rendering.truth.camera)


def bitten(mask):
    rows, columns = np.nonzero(mask)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    distance = np.hypot(x - columns.max(), y - rows.mean())
    return mask & (distance > 0.35 * np.sqrt(mask.sum() / np.pi))


def changed(mask, change):
    mask = mask.astype(np.uint8)
    if change == "grown":
        return cv2.dilate(mask, DISC, iterations=2) > 0
    if change == "shrunk":
        return cv2.erode(mask, DISC) > 0
    if change == "shifted":
        return np.roll(mask, (1, -2), (0, 1)) > 0
    return bitten(mask > 0) if change == "bitten" else mask > 0


def off_px(image, outline):
    return outline.change_to(image.outline)


@pytest.mark.parametrize(
    ("change", "refined"),
    quick(
        [("exact", False), ("bitten", False), ("shifted", True), ("grown", True), ("shrunk", True)],
        every=5,
    ),
)
def test_a_mask_that_is_off_is_refined(scene, change, refined):
    (image,) = masked_spheres(scene.values, [changed(scene.mask, change)], scene.camera)
    assert (image.mask_off_px > 0.5) == refined
    assert not image.unconfirmed
    sigma = np.sqrt(np.diag(outline_covariance(image)))
    off = np.abs(off_px(image, scene.outline))
    assert np.all(off < (0.25 if refined else sigma))


def test_the_notice_names_the_mask_that_was_off(scene):
    masks = [changed(scene.mask, "grown")]
    calibration = calibrate_spheres(scene.values, masks=masks, camera=scene.camera)
    (notice,) = [one for one in calibration.warnings if one.code == "mask-refined"]
    x, y = scene.outline.centre_px
    assert f"the sphere at ({x:.0f}, {y:.0f}) px is off by 1." in notice.text
    assert notice.severity == "info"


def disc(values, x, y, radius):
    rows, columns = np.mgrid[: values.shape[1], : values.shape[2]]
    return np.hypot(columns - x, rows - y) < radius


def deviations(image, circle):
    """Return the errors of centre x, centre y and radius in standard deviations, as chi-square."""
    off = np.array([*image.outline.centre_px, image.outline.radius_px]) - circle
    return off @ np.linalg.solve(outline_covariance(image), off)


def test_a_mask_is_refined_where_only_all_images_together_show_the_outline():
    """Half of the outline is dark, and the edges there are uneven."""
    values, (x, y, radius), _ = uneven_ball(4)
    (image,) = masked_spheres(values, [disc(values, x, y, radius + 1.5)])
    assert image.mask_off_px == pytest.approx(1.5, abs=0.3)
    assert image.outline.radius_px == pytest.approx(radius, abs=0.3)
    assert deviations(image, (x, y, radius)) < 11.3
    assert not image.unconfirmed


def test_a_mask_is_kept_where_the_images_show_no_outline():
    """Nothing but highlights is bright."""
    values, (x, y, radius), _ = uneven_ball(4)
    dark = np.where(values < 0.9, 0.001, values).astype(np.float32)
    (image,) = masked_spheres(dark, [disc(dark, x, y, radius + 1.5)])
    assert image.mask_off_px == 0
    assert image.outline.radius_px == pytest.approx(radius + 1.5, abs=0.2)
    assert image.unconfirmed
    assert deviations(image, (x, y, radius)) < 7.8


@pytest.mark.parametrize("off_px", quick([8, 12], every=2))
def test_a_mask_beside_the_sphere_is_named(scene, off_px):
    """What is farther away than the errors of painting is not taken for the outline."""
    masks = [np.roll(scene.mask, off_px, axis=1)]
    calibration = calibrate_spheres(scene.values, masks=masks, camera=scene.camera)
    (notice,) = [one for one in calibration.warnings if one.code == "mask-unconfirmed"]
    (x, y), radius = scene.outline.centre_px, scene.outline.radius_px
    assert f"the outline of the mask of the sphere at ({x + off_px:.0f}, {y:.0f}) px" in notice.text
    stated = re.search(r"masks, ([\d.]+) px, .* are off by ([\d.]+) degrees", notice.text)
    sigma_px, degrees = map(float, stated.groups())
    assert 1 <= sigma_px < 1.3
    assert degrees == pytest.approx(np.degrees(2 * sigma_px / radius), abs=0.2)


def painted(kind, circle, rng, fine=4):
    """Return a mask 0..1 of a circle as a person paints it, which is off by some pixels."""
    x, y, radius = circle
    size = int(2.6 * radius)
    angles = np.arange(720) * (np.pi / 360)
    radii = np.full(720, radius)
    if kind == "polygon":
        count = rng.integers(10, 28)
        angles = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * 2 * np.pi / count
        radii = radius + rng.normal(0, 1, count)
    elif kind == "rough":
        for harmonic in range(12):
            wave = np.cos(harmonic * angles + rng.uniform(0, 2 * np.pi))
            radii = radii + rng.normal(0, 1.2 / (1 + harmonic / 2)) * wave
    elif kind == "shifted":
        x, y = x + rng.normal(0, 1.5), y + rng.normal(0, 1.5)
    else:
        radii += rng.uniform(0.5, 3) * (1 if kind == "grown" else -1)
    points = np.stack([x + radii * np.cos(angles), y + radii * np.sin(angles)], axis=1)
    large = np.zeros((size * fine, size * fine), np.uint8)
    corners = np.rint(((points + 0.5) * fine - 0.5) * 16).astype(np.int32)
    cv2.fillPoly(large, [corners], 255, shift=4)
    mask = cv2.resize(large, (size, size), interpolation=cv2.INTER_AREA) / 255
    return mask if rng.random() < 0.5 else mask > 0.5


@pytest.mark.slow
def test_stated_errors_of_painted_masks_contain_the_actual_ones():
    """Mean of chi-square over its 3 degrees of freedom, of 200 masks of balls of 35 to 120 px."""
    rng = np.random.default_rng(77)
    found = []
    for kind in ["polygon", "rough", "shifted", "grown", "shrunk"] * 40:
        radius = rng.uniform(35, 120)
        circle = (1.3 * radius, 1.3 * radius, radius)
        (points,) = mask_outlines(painted(kind, circle, rng))
        outline, _ = fit_ellipse(points)
        off = np.subtract(outline.circle_px, circle)
        covariance = painted_covariance(TracedOutline(outline, points, 1.0))
        found.append(off @ np.linalg.solve(covariance, off) / 3)
    assert 0.6 < np.mean(found) < 1.5
    assert np.mean(np.array(found) > 5.4) < 0.02


def test_a_mask_of_a_painted_ball_is_named():
    rows, columns = np.mgrid[:120, :160]
    x, y = (columns - 80) / 40, (rows - 60) / 40
    inside = np.hypot(x, y) < 1
    height = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    images = []
    for angle in np.arange(6):
        light = np.array([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.75**0.5])
        shading = np.clip(x * light[0] - y * light[1] + height * light[2], 0, None)
        half = light + np.array([0, 0, 1])
        half /= np.linalg.norm(half)
        gloss = 3 * np.exp(-400 * ((x - half[0]) ** 2 + (y + half[1]) ** 2))
        images.append(np.where(inside, 0.4 * shading + gloss, 0.4))
    (image,) = masked_spheres(np.array(images, np.float32), [inside])
    assert image.painted
