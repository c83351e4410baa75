"""Training pairs, crops, sizes of networks, and `sgp detail train` without torch."""

import hashlib
import json
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import processing
from rig import no_progress
from sgp.cli.exit import UsageError
from sgp.training import (
    CORRECTED,
    HELD_OUT,
    PRESETS,
    RdnSize,
    Task,
    claim_work,
    make_pairs,
    remove_work,
    weight_shapes,
)
from sgp.training.judgement import surface
from sgp.training.pairs import SYMMETRIES, averaged, batch, pair, turned
from sgp.training.presets import REPORTED
from sgp.training.rdn import OUTPUTS
from simulator import random_normals
from simulator.reliefs import rugged_normals

MODELS = Path(processing.__file__).parent / "superres" / "models"


def of_height(height: np.ndarray) -> np.ndarray:
    """Return the normals of a periodic height field."""
    right = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / 2
    down = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) / 2
    normals = np.dstack([-right, down, np.ones_like(height)])
    return (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("scale", [2, 4])
def test_the_target_put_on_the_enlarged_shape_is_the_map(scale):
    normals = random_normals(5, 64)
    low, high = pair(normals, scale, "detail")
    measured = averaged(normals, scale)
    parts = processing.separate(processing.NormalMap.from_vectors(measured))
    np.testing.assert_array_equal(low, parts.detail.normals)
    shape = cv2.resize(parts.shape.normals, (64, 64), interpolation=cv2.INTER_CUBIC)
    again = processing.combine(
        processing.NormalMap.from_vectors(shape), processing.NormalMap.from_vectors(high)
    )
    np.testing.assert_allclose(again.normals, normals, atol=2e-6)
    plain = pair(normals, scale, "normals")
    np.testing.assert_array_equal(plain[0], measured)
    np.testing.assert_array_equal(plain[1], normals)


def test_an_average_is_that_of_its_square():
    normals = random_normals(3, 64)
    low = averaged(normals, 4)
    mean = normals[8:12, 20:24].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(low[2, 5], mean / np.linalg.norm(mean), atol=1e-6)


@settings(max_examples=20)
@given(st.integers(0, SYMMETRIES - 1), st.integers(0, 1000))
def test_a_turned_map_belongs_to_the_turned_surface(symmetry, seed):
    height = np.random.default_rng(seed).normal(size=(6, 6))
    moved = height
    moved = moved[:, ::-1] if symmetry & 1 else moved
    moved = moved[::-1] if symmetry & 2 else moved
    moved = moved.T if symmetry & 4 else moved
    np.testing.assert_allclose(turned(of_height(height), symmetry), of_height(moved), atol=1e-6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    make_pairs("surfaces", random_normals, range(100, 104), folder, 48, 4, "normals", no_progress)
    return folder


def pairs_of(folder: Path):
    return make_pairs(
        "surfaces", random_normals, range(100, 104), folder, 48, 4, "normals", no_progress
    )


def test_pairs_are_made_once(folder):
    def refuse(*_: object) -> None:
        raise AssertionError("made again")

    pairs = make_pairs("surfaces", refuse, range(100, 104), folder, 48, 4, "normals", no_progress)
    low, high = pairs.crop(2, 3, 1, 8)
    normals = random_normals(102, 48)
    np.testing.assert_allclose(high, normals[12:44, 4:36], atol=2e-5)
    np.testing.assert_allclose(low, averaged(normals, 4)[3:11, 1:9], atol=2e-5)


def test_a_batch_depends_on_its_key_alone(folder):
    pairs = pairs_of(folder)
    low, high = batch(pairs, 5, 6, (1, 40))
    assert low.shape == (5, 6, 6, 3)
    assert high.shape == (5, 24, 24, 3)
    again = batch(pairs, 5, 6, (1, 40))
    np.testing.assert_array_equal(high, again[1])
    assert not np.array_equal(low, batch(pairs, 5, 6, (1, 41))[0])
    # The crops of both resolutions show the same place.
    means = high.reshape(5, 6, 4, 6, 4, 3).mean(axis=(2, 4))
    means /= np.linalg.norm(means, axis=-1, keepdims=True)
    np.testing.assert_allclose(low, means, atol=1e-4)


def test_surfaces_of_different_sets_differ():
    trained = [set(Task(4, "detail", seed, "small", 1).surfaces) for seed in range(3)]
    sets = [*trained, set(HELD_OUT), set(CORRECTED), set(REPORTED)]
    assert len(set().union(*sets)) == sum(map(len, sets)) == 3 * 900 + 2 * 128 + 256


def test_only_networks_of_scale_4_have_a_second_part_on_rugged_surfaces():
    four, two = (PRESETS["small"].at(scale) for scale in (4, 2))
    assert (four.steps, two.steps) == (8400, 6000)
    tasks = Task(4, "detail", 0, "small", 700), Task(2, "detail", 0, "small", 700)
    assert [task.first_steps for task in tasks] == [500, 700]
    assert [len(task.rugged) for task in tasks] == [600, 0]
    assert surface(3, 32, 4).tolist() == rugged_normals(3, 32).tolist()
    for seed, scale in ((2, 4), (3, 2)):
        assert surface(seed, 32, scale).tolist() == random_normals(seed, 32).tolist()


def test_sizes_of_the_published_network():
    size = RdnSize(4)
    shapes = weight_shapes(size)
    # Zhang et al. state 22 million parameters for x2; here 5 channels leave the network.
    count = sum(int(np.prod(shape)) + shape[0] for shape in shapes.values())
    assert 22.0e6 < count < 22.6e6
    assert shapes["block15.fusion"] == (64, 64 + 8 * 64, 1, 1)
    assert shapes["fusion1"] == (64, 16 * 64, 1, 1)
    assert shapes["last"][0] == OUTPUTS
    assert PRESETS["paper"].size(4) == size
    assert (size.halo_px, PRESETS["small"].size(4).halo_px) == (134, 19)
    assert (PRESETS["paper"].low_crop(4), PRESETS["paper"].low_crop(2)) == (48, 96)


def test_a_working_folder_belongs_to_one_training(tmp_path):
    task, work = Task(4, "detail", 0, "small", 10), tmp_path / "a.training"
    claim_work(work, task)
    claim_work(work, task)
    with pytest.raises(UsageError, match="other settings"):
        claim_work(work, Task(4, "detail", 1, "small", 10))
    remove_work(work)
    assert not work.exists()
    work.mkdir()
    (work / "precious.txt").write_text("text")
    with pytest.raises(UsageError, match="not the working folder"):
        claim_work(work, task)


@pytest.mark.parametrize("scale", [2, 4])
def test_committed_networks_match_their_descriptions(scale):
    path = MODELS / f"superres-x{scale}.onnx"
    about = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert about["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    size = RdnSize(
        scale,
        about["blocks"],
        about["convolutions"],
        about["growth"],
        about["training"]["settings"]["features"],
        about["training"]["settings"]["upsampling"],
    )
    assert (about["scale"], about["halo_px"]) == (scale, size.halo_px)
    network = cv2.dnn.readNetFromONNX(str(path))
    low = averaged(random_normals(HELD_OUT[1], 24 * scale), scale).transpose(2, 0, 1)
    network.setInput(np.ascontiguousarray(low[None]))
    assert network.forward().shape == (1, OUTPUTS, 24 * scale, 24 * scale)


def test_committed_networks_are_small():
    assert sum(path.stat().st_size for path in MODELS.glob("*.onnx")) < 3e6


@pytest.mark.skipif(find_spec("torch") is not None, reason="torch is installed: [learned]")
def test_without_torch_one_line_names_the_extra(sgp, tmp_path):
    assert "surface-geometry-processing[learned]" in sgp(
        "detail", "train", "--scale", 4, "--out", tmp_path / "x.onnx"
    ).error_line(2)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--scale", 3, "--out", "x.onnx"), "Choose from"),
        (("--scale", 4, "--out", "x.pt"), ".onnx"),
        (("--scale", 4, "--out", "x.onnx", "--steps", 0), "--steps"),
        (("--scale", 4, "--out", "x.onnx", "--preset", "huge"), "--preset"),
        (("--scale", 4, "--out", "x.onnx", "--seed", 2**60), "--seed"),
    ],
)
def test_bad_options_are_refused(sgp, tmp_path, monkeypatch, words, reason):
    monkeypatch.chdir(tmp_path)
    assert reason in sgp("detail", "train", *words).error_line(2)
    assert not list(tmp_path.iterdir())
