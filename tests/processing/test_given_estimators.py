"""Estimators of users: functions, and entry points of the group ``sgp.estimators``."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

from acquisition import DataError, Lights, read_source, write_png
from processing import photometric_stereo, reconstruct, stereo
from processing.stereo import method as methods
from sgp.app import build

LIGHTS = Lights(directions=[[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]])
NORMAL = np.array([0.36, 0.48, 0.8])
VALUES = np.tile(0.5 * LIGHTS.unit_directions @ NORMAL, (4, 5, 1)).transpose(2, 0, 1)
MASK = np.ones((4, 5), bool)


def mine(values, vectors, law=None, view=None):
    inverse = np.linalg.pinv(vectors[0].T.astype(np.float64))
    scaled = values @ inverse.T
    return scaled, np.sqrt(np.mean((values - scaled @ vectors[0]) ** 2, axis=1))


def doubtful(values, vectors, law=None, view=None):
    scaled, rms = mine(values, vectors)
    scaled[::2] = np.nan
    return scaled, rms


@pytest.fixture
def installed(monkeypatch):
    """The entry point ``mine``."""
    points = EntryPoints(
        EntryPoint(name, f"{__name__}:{name}", "sgp.estimators") for name in ("mine", "removed")
    )
    real = methods.entry_points
    monkeypatch.setattr(
        methods,
        "entry_points",
        lambda *, group: points if group == "sgp.estimators" else real(group=group),
    )
    monkeypatch.setattr(methods, "_GIVEN", {})


def test_a_function_is_a_method():
    found = photometric_stereo(VALUES, LIGHTS, MASK, method=mine)
    np.testing.assert_allclose(found.normal_map.normals, np.tile(NORMAL, (4, 5, 1)), atol=1e-6)
    np.testing.assert_allclose(found.albedo, 0.5, atol=1e-6)


def test_what_a_function_does_not_determine_has_no_normal():
    found = photometric_stereo(VALUES, LIGHTS, MASK, method=doubtful)
    assert np.count_nonzero(found.normal_map.mask) == 10


def test_an_entry_point_is_a_method(installed):
    assert stereo.installed_methods() == (*stereo.METHODS, "mine", "removed")
    found = photometric_stereo(VALUES, LIGHTS, MASK, method="mine")
    np.testing.assert_allclose(found.normal_map.normals[0, 0], NORMAL, atol=1e-6)
    with pytest.raises(DataError, match=r"'other' is not a method .*, best, mine, removed"):
        photometric_stereo(VALUES, LIGHTS, MASK, method="other")
    with pytest.raises(DataError, match="the method removed cannot be loaded: AttributeError"):
        photometric_stereo(VALUES, LIGHTS, MASK, method="removed")


def test_a_recording_is_reconstructed_by_a_function(tmp_path):
    y, x = np.mgrid[1:-1:24j, -1:1:24j]
    normals = np.dstack([x, y, 0 * x + 2]) / np.sqrt(x**2 + y**2 + 4)[..., None]
    ball = np.pad(normals @ LIGHTS.unit_directions.T, [(8, 8), (8, 8), (0, 0)])
    for i in range(4):
        pixels = (60_000 * np.clip(ball[:, :, i], 0, 1)).astype(np.uint16)
        write_png(tmp_path / f"ball.{i}.png", pixels)
    made = reconstruct(read_source(tmp_path, lights=LIGHTS), method=mine)
    inner = made.normals.normals[14:-14, 14:-14]
    assert np.abs(inner - normals[6:-6, 6:-6]).max() < 0.01


@pytest.mark.parametrize(
    ("method", "message"),
    [
        pytest.param("lss", "'lss' is not a method", id="another name"),
        pytest.param(lambda *_: None, "did not return a pair", id="nothing"),
        pytest.param(lambda values, *_: 1 // 0, r"failed: ZeroDivisionError\(", id="an exception"),
        pytest.param(3, "a name or a function, not int", id="a number"),
        pytest.param(
            lambda values, *_: (values, values), r"expected \(20, 3\) and \(20,\)", id="shapes"
        ),
    ],
)
def test_what_is_no_method_is_refused(method, message):
    with pytest.raises(DataError, match=message):
        photometric_stereo(VALUES, LIGHTS, MASK, method=method)


def test_the_command_offers_the_methods():
    app = build(["normals"])
    _, bound, _ = app.parse_args(["normals", ".", "--method", "ls", "--out", "x"])
    assert bound.arguments["options"].method == "ls"
