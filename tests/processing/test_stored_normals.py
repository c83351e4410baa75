"""Normal maps and surfaces in files: equal to those in memory, whatever the bands are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition import CameraModel, DataError, write_exr, write_mask, write_png
from acquisition.files import BandStore
from processing import (
    NormalMap,
    height_mesh,
    integrate,
    normal_curl,
    normal_residual,
    read_normals,
    write_mesh,
    write_normals,
)
from processing.maps import store_normals
from processing.meshes import mesh_rows

SIZE = (61, 34)


def noisy(seed: int = 3) -> NormalMap:
    y, x = np.mgrid[1 : -1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    noise = 0.05 * np.random.default_rng(seed).normal(size=(*SIZE, 3))
    mask = (np.hypot(x, y) < 1.1) & (np.abs(y - 0.2) > 0.05)
    return NormalMap.from_vectors(np.dstack([x, 0.5 * y, 0 * x + 2]) + noise, mask)


def encoded(most: int, kind: type[np.generic]) -> np.ndarray:
    return np.rint((noisy().normals / 2 + 0.5) * most).astype(kind)


def exr(path: Path) -> Path:
    vectors = noisy().normals.copy()
    vectors[30, 10] = np.nan
    write_exr(path / "n.exr", vectors)
    return path / "n.exr"


def encoded_exr(path: Path) -> Path:
    write_exr(path / "n.exr", np.where(noisy().mask[..., None], noisy().normals / 2 + 0.5, 0))
    return path / "n.exr"


def folder(path: Path) -> Path:
    write_normals(path, noisy())
    write_mask(path / "mask.png", np.ones(SIZE, bool))
    return path


def with_alpha(path: Path) -> Path:
    write_png(path / "n.png", encoded(65535, np.uint16), alpha=noisy().mask)
    return path / "n.png"


def opaque(path: Path) -> Path:
    write_png(path / "n.png", encoded(255, np.uint8), alpha=np.ones(SIZE, bool))
    return path / "n.png"


def alpha_and_mask(path: Path) -> Path:
    write_mask(path / "mask.png", np.eye(*SIZE, dtype=bool) | noisy().mask)
    return with_alpha(path)


@pytest.mark.parametrize(
    "make", [exr, encoded_exr, folder, with_alpha, opaque, alpha_and_mask], ids=lambda f: f.__name__
)
@pytest.mark.parametrize("green", ["up", "down"])
def test_a_stored_map_is_that_in_memory(tmp_path, monkeypatch, make, green):
    path = make(tmp_path)
    whole = read_normals(path, green=green)
    monkeypatch.setattr("processing.maps.normal_decoding._BAND_BYTES", 7 * 12 * SIZE[1])
    stored = store_normals(path, tmp_path / "n.raw", green=green)
    np.testing.assert_array_equal(stored.normals[:], whole.normal_map.normals)
    np.testing.assert_array_equal(stored.mask, whole.normal_map.mask)
    assert (stored.warnings, stored.files) == (whole.warnings, whole.files)
    stored.normals.close()


def test_what_holds_no_normals_is_refused(tmp_path):
    write_exr(tmp_path / "n.exr", np.full((*SIZE, 3), 9, np.float32))
    with pytest.raises(DataError, match="no pixel decodes to a unit vector"):
        store_normals(tmp_path / "n.exr", tmp_path / "n.raw")
    np.save(tmp_path / "n.npy", noisy().normals)
    with pytest.raises(DataError, match=r"save it as \.exr"):
        store_normals(tmp_path / "n.npy", tmp_path / "n.raw")


K = np.array([[90.0, 0, 16.5], [0, 90.0, 30.0], [0, 0, 1]])
CAMERAS: dict[str, Callable[[], CameraModel | None]] = {
    "orthographic": lambda: None,
    "perspective": lambda: CameraModel(K, SIZE[1], SIZE[0], 200.0),
}


@pytest.mark.parametrize("camera", CAMERAS)
def test_rows_of_a_surface_are_those_of_the_whole(tmp_path, monkeypatch, camera):
    normal_map, model = noisy(), CAMERAS[camera]()
    surface = integrate(normal_map, camera=model)
    sigma = np.where(normal_map.mask, 2.0, np.nan).astype(np.float32)
    whole = normal_curl(normal_map, camera=model, sigma_deg=sigma)
    residual = normal_residual(surface, normal_map)
    monkeypatch.setattr("processing.surface.curl._BAND", 10)
    monkeypatch.setattr("processing.surface.residual._BAND", 9 * 400 * SIZE[1])
    forms = dict.fromkeys(("curl", "residual"), (SIZE, np.float32))
    with BandStore(tmp_path / "maps", {}, forms) as maps:
        banded = normal_curl(normal_map, camera=model, sigma_deg=sigma, into=maps["curl"])
        np.testing.assert_array_equal(maps["curl"][:], whole.curl_deg)
        assert (banded.spread_deg, banded.excess) == (whole.spread_deg, whole.excess)
        assert 1 < whole.excess < 3
        normal_residual(surface, normal_map, into=maps["residual"])
        np.testing.assert_array_equal(maps["residual"][:], residual)


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("camera", CAMERAS)
def test_a_mesh_of_rows_is_the_complete_mesh(tmp_path, monkeypatch, camera, jumps):
    normal_map = noisy()
    surface = integrate(normal_map, camera=CAMERAS[camera](), discontinuity=jumps)
    monkeypatch.setattr(mesh_rows, "_BAND", 12 * mesh_rows._PIXEL * SIZE[1])
    colours = np.random.default_rng(5).integers(0, 256, (*SIZE, 3), np.uint8)
    for name, given in (("a.ply", {"normals": normal_map, "colours": colours}), ("b.ply", {}),
                        ("c.ply", {"colours": colours[..., 0]}), ("d.stl", {})):  # fmt: skip
        write_mesh(tmp_path / name, surface, mesh=height_mesh(surface, **given))
        expected = (tmp_path / name).read_bytes()
        write_mesh(tmp_path / name, surface, **given)
        assert (tmp_path / name).read_bytes() == expected


def test_a_surface_without_triangles_has_no_mesh(tmp_path):
    line = NormalMap.from_vectors(np.full((1, 5, 3), [0.0, 0.0, 1.0]))
    with pytest.raises(DataError, match="no triangle"):
        write_mesh(tmp_path / "a.ply", integrate(line))
