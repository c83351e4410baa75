"""Albedo in colour: its values, its gray value, sources without colour, and its picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import SRGB, CameraModel, DataError, Lights, read_source, write_png
from calibration.radiance import luma
from processing import NormalMap, integrate, reconstruct
from processing.colour import albedo_picture

HEIGHT, WIDTH = 36, 40
COUNT = 10
MM = 2.0  # size of a pixel on the object, in the plane z = 0
CAMERA = CameraModel(
    np.array([[400.0, 0, 19.5], [0, 400.0, 17.5], [0, 0, 1]]), WIDTH, HEIGHT, 400.0 * MM
)


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return normals, mask and RGB albedo of a bump with a red and a blue half."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    x, y = (x - 19.5) / 20, (17.5 - y) / 20
    normals = np.stack([0.6 * x, 0.6 * y, np.ones_like(x)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    albedo = np.where(x[..., None] < 0, (0.7, 0.3, 0.2), (0.15, 0.35, 0.6))
    return normals, x**2 + y**2 < 0.7, albedo


def distant(intensities: np.ndarray | None = None) -> Lights:
    around = np.linspace(0, 2 * np.pi, COUNT, endpoint=False)
    directions = np.stack([np.cos(around), np.sin(around), np.full(COUNT, 1.4)], 1)
    return Lights(directions, intensities=intensities)


def save(folder: Path, images: np.ndarray, mask: np.ndarray) -> Path:
    folder.mkdir()
    write_png(folder / "mask.png", mask.astype(np.uint8) * np.uint8(255))
    for i, image in enumerate(images):
        write_png(folder / f"i.{i}.png", np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16))
    return folder


def shaded(lights: Lights, points: np.ndarray | None = None) -> np.ndarray:
    """Return ``(N, H, W, 3)`` matte images, divided by 2 to stay below white."""
    normals, _, albedo = scene()
    at = np.zeros((1, 1, 3)) if points is None else points
    vectors = lights.vectors_at(at)
    light = np.clip(
        np.einsum("nhwc,hwc->nhw", np.broadcast_to(vectors, (COUNT, *normals.shape)), normals),
        0,
        None,
    )
    return 0.5 * light[..., None] * albedo  # fmt: skip


def relative_error(found: np.ndarray) -> np.ndarray:
    _, mask, albedo = scene()
    return (np.abs(found - 0.5 * albedo).max(axis=2) / albedo.max(axis=2))[mask]


@pytest.mark.parametrize("method", ["ls", "cauchy"])
def test_the_albedo_has_the_colour_of_the_surface(tmp_path, method) -> None:
    lights, (_, mask, _) = distant(), scene()
    source = read_source(save(tmp_path / "rgb", shaded(lights), mask), lights=lights)
    stages = []
    result = reconstruct(
        source,
        method=method,
        channel="gray",
        surface=False,
        on_progress=lambda *step: stages.append(step),
    )
    assert result.albedo.shape == (HEIGHT, WIDTH, 3)
    assert relative_error(result.albedo).max() < 1e-3
    np.testing.assert_allclose(luma(result.albedo), result.gray_albedo, rtol=1e-4)
    assert not result.albedo[~mask].any()
    assert stages[-1] == ("colour", COUNT, COUNT)


def test_highlights_and_shadows_do_not_change_the_colour(tmp_path) -> None:
    lights, (_, mask, _) = distant(), scene()
    images = shaded(lights)
    images[2, 10:26, 8:32] += 0.6  # white gloss
    images[6, 4:20, 5:30] = 0  # a cast shadow
    source = read_source(save(tmp_path / "rgb", images, mask), lights=lights)
    result = reconstruct(source, channel="gray", surface=False)
    assert relative_error(result.albedo).max() < 0.03
    # The plain sums over the images are wrong by much more.
    plain = images.mean(axis=0)
    plain *= (result.gray_albedo / luma(plain))[..., None]
    assert relative_error(plain).max() > 0.08


def test_coloured_lights_and_an_unlit_image(tmp_path) -> None:
    strength = np.ones((COUNT, 3)) * (1.3, 1.0, 0.6)
    strength[::2] *= 0.7
    lights, (_, mask, _) = distant(strength), scene()
    images = shaded(distant()) * strength[:, None, None]
    images[3] = 0
    source = read_source(save(tmp_path / "rgb", images, mask), lights=lights)
    result = reconstruct(source, channel="gray", surface=False)
    assert len(result.lights) == COUNT - 1
    assert relative_error(result.albedo).max() < 2e-3


@pytest.mark.slow
def test_near_lights(tmp_path) -> None:
    far, (normals, mask, _) = distant(), scene()
    positions = far.unit_directions * np.linspace(120, 200, COUNT)[:, None]
    lights = Lights(positions_mm=positions)
    surface = integrate(NormalMap.from_vectors(normals.astype(np.float32), mask), camera=CAMERA)
    images = shaded(lights, np.nan_to_num(surface.points()))
    folder = save(tmp_path / "rgb", images / 2, mask)
    source = read_source(folder, lights=lights, camera=CAMERA)
    result = reconstruct(source, channel="gray", surface=False)
    assert result.lights.near
    assert relative_error(2 * result.albedo).max() < 2e-3


def test_a_mosaic_has_colour(tmp_path) -> None:
    lights, (_, mask, _) = distant(), scene()
    images = shaded(lights)
    mosaic = np.zeros((COUNT, HEIGHT, WIDTH))
    for site, channel in ((0, 1), (1, 0), (2, 2), (3, 1)):  # GRBG
        place = np.s_[:, site // 2 :: 2, site % 2 :: 2]
        mosaic[place] = images[(*place, channel)]
    source = read_source(save(tmp_path / "raw", mosaic, mask), lights=lights)
    result = reconstruct(replace(source, cfa="GRBG"), surface=False)
    error = relative_error(result.albedo)
    assert np.median(error) < 0.01  # except at the edge between the colours


def test_sources_without_colour_have_a_gray_albedo(tmp_path) -> None:
    lights, (_, mask, _) = distant(), scene()
    gray = luma(shaded(lights).astype(np.float32))
    for name, images in (("gray", gray), ("rgb", np.repeat(gray[..., None], 3, axis=3))):
        source = read_source(save(tmp_path / name, images, mask), lights=lights)
        result = reconstruct(source, channel="gray", surface=False)
        np.testing.assert_array_equal(result.albedo, result.gray_albedo)


def test_the_picture_follows_srgb_and_states_its_white() -> None:
    _, mask, albedo = scene()
    linear = (0.4 * albedo).astype(np.float32)
    linear[20, 20] *= 50  # one glossy pixel does not darken the rest
    picture = albedo_picture(linear, mask)
    assert picture.white == pytest.approx(0.4 * 0.7, rel=0.01)
    light = picture.white * SRGB.light(picture.pixels / 255)
    usual = mask.copy()
    usual[20, 20] = False
    step = picture.white * SRGB.light(1.0) * 0.006
    assert np.abs(light - linear)[usual].max() < step
    assert not picture.pixels[~mask].any()
    gray = albedo_picture(linear[..., 0], mask)
    assert gray.pixels.shape == mask.shape


@pytest.mark.parametrize(
    ("value", "sample"), [(0, 0), (np.nan, 0), (np.inf, 255), (1e-40, 255), (3e38, 255)]
)
def test_a_picture_of_extreme_values(value, sample) -> None:
    mask = scene()[1]
    picture = albedo_picture(np.full(mask.shape, value, np.float32), mask)
    assert (picture.pixels[mask] == sample).all()


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(DataError, match="does not fit a mask"):
        albedo_picture(np.ones((3, 3), np.float32), scene()[1])
