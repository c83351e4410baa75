"""Highlights that were clipped below the white level of the files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import Lights, Source, import_frames, read_source
from acquisition.imports import read_import
from acquisition.pixels import write_tiff
from processing import reconstruct
from tests.quick_sample import quick

SIZE = 96
AROUND = np.linspace(0, 2 * np.pi, 12, endpoint=False)
LIGHTS = Lights(directions=np.stack([np.cos(AROUND), np.sin(AROUND), np.full(12, 1.5)], 1))
RNG = np.random.default_rng(12)


def ball() -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    x, y = (columns - 47.5) / 44, (47.5 - rows) / 44
    mask = x**2 + y**2 < 0.9
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    return np.where(mask[..., None], np.stack([x, y, z], -1), 0.0), mask


def stack(exposure: float, bits: int = 12) -> list[np.ndarray]:
    """Return grey values with photon noise; above an exposure of 1 they are clipped."""
    normals, _ = ball()
    most = 2**bits - 1
    images = []
    for light in LIGHTS.unit_directions:
        photons = RNG.poisson(10_000 * exposure * np.clip(normals @ light, 0, None))
        images.append(np.clip(np.rint(photons / 10_000 * most), 0, most).astype(np.uint16))
    return images


def write(folder: Path, images: list[np.ndarray]) -> Path:
    folder.mkdir()
    for number, pixels in enumerate(images):
        write_tiff(folder / f"ball_{number:02}.tif", pixels)
    write_tiff(folder / "mask.tif", ball()[1] * np.uint8(255))
    return folder


def error_deg(source: Source) -> float:
    """Return the mean error of the normals that all lights reach."""
    normals, mask = ball()
    lit = mask & (normals @ LIGHTS.unit_directions.T > 0.05).all(axis=-1)
    found = reconstruct(source, method="ls").normals.normals
    across = np.linalg.norm(np.cross(normals, found), axis=-1)
    return float(np.degrees(np.arctan2(across, np.sum(normals * found, axis=-1)))[lit].mean())


@pytest.mark.parametrize("bits", quick([10, 12, 14], every=3))
def test_clipped_highlights_are_left_out(tmp_path: Path, bits: int) -> None:
    images = stack(1.25, bits)
    source = read_source(write(tmp_path / "clipped", images), lights=LIGHTS)
    assert source.white_level == 2**bits - 1
    (notice,) = [n for n in source.warnings if n.code == "samples-in-low-bits"]
    assert f"{bits}-bit samples in the low bits of 16" in notice.text
    clipped = error_deg(replace(source, white_level=65535.0))
    left_out = error_deg(source)
    # Photon noise of 1 % alone is about half a degree.
    assert left_out < 1
    assert clipped > 5 * left_out


def test_a_session_keeps_the_white_level(tmp_path: Path) -> None:
    folder = write(tmp_path / "clipped", stack(1.25))
    session = import_frames(read_import(folder), tmp_path / "out")
    assert session.manifest.camera.white_dn == 4095
    assert read_source(tmp_path / "out").white_level == 4095


def with_peak(images: list[np.ndarray], count: int) -> None:
    """Set a few samples to the largest value of 12 bits."""
    images[3].flat[:count] = 4095


def stretched(images: list[np.ndarray]) -> None:
    """Replace the grey values by those of 8 bits, stretched to 12: every sixteenth exists."""
    scale = max(int(pixels.max()) for pixels in images)
    for pixels in images:
        pixels[:] = np.rint(np.rint(pixels / scale * 255) * 4095 / 255)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda images: None, id="not saturated"),
        pytest.param(lambda images: with_peak(images, 15), id="few samples"),
        pytest.param(stretched, id="stretched 8 bits"),
    ],
)
def test_without_a_pile_nothing_is_guessed(
    tmp_path: Path, change: Callable[[list[np.ndarray]], None]
) -> None:
    images = stack(0.8)
    change(images)
    source = read_source(write(tmp_path / "in", images))
    assert source.white_level == 65535
    assert source.warnings == ()
