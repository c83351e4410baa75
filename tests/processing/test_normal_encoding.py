"""How images encode normals: zero at 127, 127.5 or 128, curves, two channels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from processing import read_normals
from processing.maps import store_normals
from processing.maps.normal_encoding import normal_encoding
from rig.arrays import Float64, UInt8

Y, X = np.mgrid[:60, :80]


def surface(slope: float) -> Float64:
    """Return unit normals ``(60, 80, 3)`` whose slopes are up to about ``slope``."""
    right = slope * np.sin(X / 7.3 + Y / 11) * np.cos(Y / 19)
    up = slope * np.cos(X / 13 - Y / 8.1)
    normals = np.stack([right, up, np.ones_like(right)], -1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def coded(
    scale: float, zero: float, rounded: Callable[..., object] = np.rint
) -> Callable[..., UInt8]:
    return lambda n: np.clip(rounded(n * scale + zero), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("slope", [0.12, 0.5, 2.0])
@pytest.mark.parametrize(
    ("code", "zero"),
    [
        pytest.param(coded(127.5, 127.5), 127.5, id="of 255"),
        pytest.param(coded(127, 128), 128, id="around 128"),
        pytest.param(coded(127, 127), 127, id="around 127"),
        pytest.param(coded(127.5, 127.5, np.floor), 127, id="rounded down"),
        pytest.param(coded(128, 128), 128, id="128 for one, cut off"),
        pytest.param(coded(127, 128, np.floor), 127.5, id="around 128, rounded down"),
    ],
)
def test_the_code_of_zero(slope: float, code: Callable[..., UInt8], zero: float) -> None:
    codes = code(surface(slope)).reshape(-1, 3)
    found = normal_encoding((codes / 127.5 - 1).astype(np.float32))
    # Shallow slopes leave the scales 127.5 and 128 open, and then the answer is None.
    assert found.zero in ([zero / 127.5 - 1] if slope > 0.2 else [zero / 127.5 - 1, None])


@pytest.mark.parametrize("change", ["jpeg", "noise", "half"])
@pytest.mark.parametrize("zero", [127.5, 128.0])
def test_lossy_codes_do_not_show_it_or_show_it_rightly(change: str, zero: float) -> None:
    codes = coded(255 - zero, zero)(surface(0.5))
    if change == "jpeg":
        codes = cv2.imdecode(cv2.imencode(".jpg", codes)[1], cv2.IMREAD_UNCHANGED)
    elif change == "noise":
        noise = np.random.default_rng(1).normal(0, 2, codes.shape)
        codes = np.clip(np.rint(codes + noise), 0, 255)
    else:
        codes = cv2.resize(codes, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    found = normal_encoding((codes.reshape(-1, 3) / 127.5 - 1).astype(np.float32))
    assert found.zero in (None, zero / 127.5 - 1)
    assert found.curve is None


def _two_channels(normals: Float64) -> Float64:
    return np.concatenate([normals[..., :2] / 2 + 0.5, 0 * normals[..., :1] + 1], -1)


CURVES: dict[str, tuple[Callable[..., Float64], str]] = {
    "1.1": (lambda n: ((n + 1) / 2) ** (1 / 1.1), "power curve of exponent 1.1"),
    "2.2": (lambda n: ((n + 1) / 2) ** 2.2, "power curve of exponent 0.45"),
    "srgb": (lambda n: 1.055 * ((n + 1) / 2) ** (1 / 2.4) - 0.055, "the sRGB curve"),
    "two channels": (_two_channels, "z is computed"),
}


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("most", [255, 65535])
def test_curves_and_two_channels_are_undone(tmp_path: Path, name: str, most: int) -> None:
    coded_as, said = CURVES[name]
    # Away from black, where the sRGB curve is a line.
    normals = surface(0.8)
    samples = np.rint(coded_as(normals) * most).astype(np.uint8 if most == 255 else np.uint16)
    cv2.imwrite(str(tmp_path / "n.png"), samples[..., ::-1])
    found = read_normals(tmp_path / "n.png")
    assert [said in notice.text for notice in found.warnings if notice.code == "normals-encoding"]
    off = np.linalg.norm(found.normal_map.normals - normals, axis=-1)
    assert off.max() < 0.02
    stored = store_normals(tmp_path / "n.png", tmp_path / "bands.raw")
    assert (stored.normals[:] == found.normal_map.normals).all()
    assert stored.warnings == found.warnings
    stored.normals.close()


@pytest.mark.parametrize(
    ("code", "facing"), [((128, 128, 255), 1), ((127, 127, 255), 1), ((128, 131, 255), 0)]
)
def test_a_flat_map(tmp_path: Path, code: tuple[int, int, int], facing: int) -> None:
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((8, 9, 3), code[::-1], np.uint8))
    normals = read_normals(tmp_path / "flat.png").normal_map.normals
    assert (normals == [0, 0, 1]).all() == facing


def _light(values: Float64) -> Float64:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        pytest.param(lambda v: v, [], id="encoded"),
        pytest.param(lambda v: v * [1, 1, 0], ["z is computed"], id="two channels"),
        pytest.param(_light, ["inverse of the sRGB curve"], id="taken for sRGB"),
    ],
)
def test_encoded_floats(tmp_path: Path, change: Callable[..., Float64], said: list[str]) -> None:
    normals = surface(0.8)
    np.save(tmp_path / "n.npy", change(normals / 2 + 0.5).astype(np.float32))
    found = read_normals(tmp_path / "n.npy")
    assert len(found.warnings) == len(said)
    assert all(part in one.text for part, one in zip(said, found.warnings, strict=True))
    assert np.abs(found.normal_map.normals - normals).max() < 1e-3


def test_a_curve_is_found_in_a_jpeg_file(tmp_path: Path) -> None:
    normals = surface(0.8)
    codes = np.rint(((normals + 1) / 2) ** (1 / 1.1) * 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "n.jpg"), codes[..., ::-1])
    found = read_normals(tmp_path / "n.jpg")
    assert "power curve of exponent 1.1" in found.warnings[0].text


def test_a_shallow_map_with_a_curve_has_z(tmp_path: Path) -> None:
    normals = surface(0.05)
    light = (normals + 1) / 2
    codes = np.rint((1.055 * light ** (1 / 2.4) - 0.055) * 255).astype(np.uint8)
    assert (codes[..., 2] == 255).all()
    cv2.imwrite(str(tmp_path / "n.png"), codes[..., ::-1])
    assert np.abs(read_normals(tmp_path / "n.png").normal_map.normals - normals).max() < 0.02


@pytest.mark.parametrize("slope", [0.1, 0.8])
def test_vectors_of_x_and_y_as_floats(tmp_path: Path, slope: float) -> None:
    normals = surface(slope)
    np.save(tmp_path / "n.npy", (normals * [1, 1, 0]).astype(np.float32))
    found = read_normals(tmp_path / "n.npy")
    assert [one.code for one in found.warnings] == ["normals-encoding"]
    assert np.abs(found.normal_map.normals - normals).max() < 1e-6
