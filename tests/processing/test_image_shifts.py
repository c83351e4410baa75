"""Shifts of images under different lights, and images that are moved back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition import DataError, Lights, downscale, read_source, write_mask, write_png
from acquisition.comparison import lanczos
from acquisition.values import angle_deg
from calibration import EstimateError, linear_stack, open_stack
from calibration.radiance import Shift
from processing import reconstruct
from processing.recording import AlignChoice
from processing.registration import find_image_shifts
from rig.arrays import Bool, Float32, Float64
from tests.cases import cases
from tests.quick_sample import quick

COUNT = 8
SIDE = 124


def ring(count: int = COUNT, height: float = 1.3) -> Float64:
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.stack([np.cos(around), np.sin(around), np.full(count, height)], 1)


LIGHTS = Lights(directions=ring())
UNIT = LIGHTS.unit_directions


def relief(
    seed: int = 3, *, painted: bool = True, steep: float = 6.0
) -> tuple[Float32, Float64, Bool]:
    """Return images of rough ground with paint in a disc, their true normals and the mask."""
    rng = np.random.default_rng(seed)
    height = cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE)), (0, 0), 2.5) * steep
    slope_y, slope_x = np.gradient(height)
    normals = np.stack([-slope_x, slope_y, np.ones_like(height)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    paint = 0.5 + 0.2 * np.sign(cv2.GaussianBlur(rng.normal(size=(SIDE, SIDE)), (0, 0), 3.0))
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    mask = x**2 + y**2 < (0.36 * SIDE) ** 2
    shade = np.clip(normals @ UNIT.T, 0, None) * (paint[..., None] if painted else 0.6)
    images = np.where(mask[..., None], shade, 0.02).transpose(2, 0, 1)
    blurred = [cv2.GaussianBlur(image, (0, 0), 0.8) for image in images]
    return np.asarray(blurred, np.float32), normals, mask


def shifted(image: Float32, right: float, down: float) -> Float32:
    whole = np.floor([right, down]).astype(int)
    kernels = lanczos(-(right - whole[0])), lanczos(-(down - whole[1]))
    made = cv2.sepFilter2D(image, cv2.CV_32F, *kernels, borderType=cv2.BORDER_REPLICATE)
    return np.roll(made, (whole[1], whole[0]), (0, 1))


def moved(images: Float32, shifts: Float64) -> Float32:
    return np.stack([shifted(one, *by) for one, by in zip(images, shifts, strict=True)])


def at(rows: Float64, columns: Float64) -> Float64:
    return np.broadcast_to(UNIT, (len(rows), COUNT, 3))


def drawn(most: float, seed: int) -> Float64:
    shifts = np.random.default_rng(seed).uniform(-most, most, (COUNT, 2))
    return shifts - np.median(shifts, axis=0)


@cases("most", {"none": 0.0, "small": 0.3, "usual": 3.0, "large": 8.0})
@pytest.mark.parametrize("painted", quick([True, False], every=2))
def test_shifts_are_found_to_hundredths_of_a_pixel(most: float, painted: bool) -> None:
    images, _, mask = relief(painted=painted)
    rng = np.random.default_rng(8)
    true = drawn(most, 5)
    noisy = moved(images, true) + rng.normal(0, 0.003, images.shape).astype(np.float32)
    found = find_image_shifts(noisy, mask, at)
    assert found.determined
    error = found.shifts_px - true
    error -= error.mean(axis=0)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.05
    assert np.abs(error).max() < 5 * found.sigma_px.max() + 0.02


def test_a_first_look_at_images_that_stand_still_is_enough() -> None:
    images, _, mask = relief()
    found = find_image_shifts(images, mask, at, least_px=0.1)
    assert not found.shifts_px.any()
    images[2] = shifted(images[2], 0.4, 0.0)
    found = find_image_shifts(images, mask, at, least_px=0.1)
    assert np.allclose(found.shifts_px[2], (0.4, 0.0), atol=0.03)


@pytest.mark.parametrize("bump", quick([1.0, 4.0, 6.0], every=3))
def test_a_first_look_sees_bumps_of_every_size(bump: float) -> None:
    """Half of the images are bumped; their structure is between the finest and coarsest scale."""
    rng = np.random.default_rng(5)
    paint = cv2.GaussianBlur(rng.normal(size=(260, 260)), (0, 0), 2.5)
    paint = np.asarray(0.6 + 0.1 * paint / paint.std(), np.float32)
    mask = np.zeros(paint.shape, bool)
    mask[20:-20, 20:-20] = True
    true = np.repeat([[0.0, 0.0], [bump, 0.0]], COUNT // 2, axis=0)
    seen = moved(np.stack([paint * np.float32(light[2]) for light in UNIT]), true)
    found = find_image_shifts(seen, mask, at, least_px=0.1)
    assert np.ptp(found.shifts_px[:, 0]) == pytest.approx(bump, abs=0.1)


def test_missing_samples_do_not_matter() -> None:
    images, _, mask = relief()
    true = drawn(2.0, 6)
    seen = moved(images, true)
    seen[seen > np.quantile(seen, 0.99)] = np.nan
    error = find_image_shifts(seen, mask, at).shifts_px - true
    assert np.abs(error - error.mean(axis=0)).max() < 0.1


def test_a_bare_ball_does_not_determine_shifts() -> None:
    y, x = np.mgrid[:SIDE, :SIDE] / (0.4 * SIDE) - 1.25
    inside = x**2 + y**2 < 0.98
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    normals = np.stack([x, -y, z], axis=2) * inside[..., None]
    images = np.clip(normals @ UNIT.T, 0, None).transpose(2, 0, 1).astype(np.float32)
    found = find_image_shifts(images, inside, at)
    assert not found.significant(0.15).any() or not found.determined


def test_the_gain_is_that_of_images_that_moved() -> None:
    images, _, mask = relief()
    creeping = np.linspace([0, 0], [1, 0.5], COUNT)
    found = find_image_shifts(moved(images, creeping), mask, at)
    assert found.real
    assert found.gain > 0.5
    # Another curve imitates shifts.
    assert find_image_shifts(np.clip(images, 0, None) ** 0.45, mask, at).gain < 0.05


@cases(("count", "side"), {"few images": (4, SIDE), "a small object": (COUNT, 9)})
def test_too_little_is_refused(count: int, side: int) -> None:
    images, _, _ = relief()
    mask = np.zeros((SIDE, SIDE), bool)
    mask[:side, :side] = True
    with pytest.raises(EstimateError, match="needed to find shifts"):
        find_image_shifts(images[:count], mask, at)


# Images that are moved back where they are read.


def test_a_moved_image_is_that_at_the_other_place() -> None:
    images, _, _ = relief()
    image = images[0]
    shift = Shift(2.3, -4.6)
    whole = shift.moved(shifted(image, *shift), 0, slice(0, SIDE))
    inner = slice(20, -20), slice(20, -20)
    assert np.abs(whole - image)[inner].max() < 0.01
    assert np.isnan(whole[0]).all()
    assert np.isnan(whole[:, -1]).all()
    for first in range(0, SIDE, 37):
        wanted = slice(first, min(first + 37, SIDE))
        rows = shift.rows(wanted, SIDE)
        part = shift.moved(shifted(image, *shift)[rows], rows.start, wanted)
        np.testing.assert_allclose(part, whole[wanted], atol=1e-6)


@cases("part", {"none": 0.0, "a quarter": 0.25, "half": 0.5})
def test_the_noise_of_a_moved_image_is_as_stated(part: float) -> None:
    noise = np.random.default_rng(2).normal(size=(400, 400)).astype(np.float32)
    shift = Shift(part, -part)
    made = shift.moved(noise, 0, slice(0, 400))
    assert np.nanvar(made) == pytest.approx(shift.noise, rel=0.03)


def written(folder: Path, images: Float32) -> Path:
    folder.mkdir()
    for i, image in enumerate(images):
        write_png(folder / f"g.{i}.png", np.rint(np.clip(image, 0, 1) * 60_000).astype(np.uint16))
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    images, _, mask = relief(steep=2.0)
    shifts = np.zeros((COUNT, 2))
    shifts[:3] = (1.6, -0.7)  # the others decide where the object is
    write_mask(tmp_path / "mask.png", mask)
    written(tmp_path / "still", images)
    return written(tmp_path / "ground", moved(images, shifts))


def test_a_source_with_shifts_is_moved_back_in_memory_and_in_bands(folder: Path) -> None:
    source = read_source(folder, lights=LIGHTS)
    shifts = dict.fromkeys(source.light_ids[:3], (1.6, -0.7))
    aligned = replace(source, shifts_px=shifts)
    stack, plain = linear_stack(aligned), linear_stack(source)
    assert np.array_equal(stack.values[3:], plain.values[3:])
    assert np.isnan(stack.values[1, 0]).all()
    with open_stack(aligned) as lazy:
        rows = [lazy.rows(top, min(top + 40, SIDE)).values for top in range(0, SIDE, 40)]
    np.testing.assert_allclose(np.concatenate(rows, axis=1), stack.values, atol=1e-6)
    half = downscale(aligned, 2)
    assert half.shifts_px[source.light_ids[2]] == (0.8, -0.35)


def test_a_moved_camera_is_corrected_by_default(folder: Path) -> None:
    _, normals, _ = relief(steep=2.0)

    def error_deg(folder: Path, align: AlignChoice, *, expected: bool) -> float:
        source = read_source(folder, lights=LIGHTS, mask_path=folder.parent / "mask.png")
        made = reconstruct(source, align=align, surface=False)
        codes = [notice.code for notice in made.warnings]
        assert ("images-aligned" in codes) is expected
        inside = made.normals.mask
        return float(angle_deg(made.normals.normals, normals)[inside].mean())

    still = error_deg(folder.parent / "still", "auto", expected=False)
    assert error_deg(folder, "auto", expected=True) < 1.1 * still
    assert error_deg(folder, "off", expected=False) > 1.5 * still


def test_after_a_bump_half_of_the_images_stay_where_they_are(tmp_path: Path) -> None:
    images, _, mask = relief(steep=2.0)
    shifts = np.repeat([[0.0, 0.0], [1.6, -0.7]], COUNT // 2, axis=0)
    write_mask(tmp_path / "mask.png", mask)
    folder = written(tmp_path / "bumped", moved(images, shifts))
    source = read_source(folder, lights=LIGHTS, mask_path=tmp_path / "mask.png")
    back = reconstruct(source, surface=False).source.shifts_px
    assert set(back) in ({*source.light_ids[:4]}, {*source.light_ids[4:]})
    np.testing.assert_allclose(np.abs([*back.values()]), [[1.6, 0.7]] * 4, atol=0.05)


def test_images_that_stand_still_give_the_same_result(folder: Path) -> None:
    mask = folder.parent / "mask.png"
    source = read_source(folder.parent / "still", lights=LIGHTS, mask_path=mask)
    choices: tuple[AlignChoice, ...] = ("off", "auto")
    one, other = (reconstruct(source, align=align, surface=False) for align in choices)
    assert np.array_equal(one.normals.normals, other.normals.normals)
    assert [str(a) for a in one.warnings] == [str(b) for b in other.warnings]


def test_the_sites_of_a_mosaic_are_not_moved(folder: Path) -> None:
    source = replace(read_source(folder, lights=LIGHTS), cfa="RGGB")
    aligned = replace(source, shifts_px={source.light_ids[0]: (1.0, 0.0)})
    with pytest.raises(DataError, match="cannot be moved by parts of a pixel"):
        linear_stack(aligned, channel="mosaic")
