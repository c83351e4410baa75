"""The peers that are trained: their geometry, their networks, and the files of their weights."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, spline_filter
from scipy.spatial.transform import Rotation

import acquisition
import processing
from benchmarks.paper import train as command
from benchmarks.paper.peers import checkpoints, dgts, pu_net, pu_net_training
from benchmarks.paper.peers.layers import NumpyLayers, TorchLayers, first_weights
from benchmarks.paper.peers.onnx_weights import read_weights
from benchmarks.paper.peers.protocol import NAMES, Peer, costs, peer
from sgp.cli.exit import UsageError

learned = pytest.mark.skipif(
    find_spec("torch") is None or find_spec("onnx") is None,
    reason="training requires torch and onnx, the extra [learned]",
)
WEIGHTS = sorted(pu_net.WEIGHTS.parent.glob("*.onnx"))


def flat_patch(seed: int = 0) -> np.ndarray:
    points = np.random.default_rng(seed).uniform(-0.7, 0.7, (pu_net.POINTS, 3))
    points[:, 2] = 0
    return pu_net.normalised(points)[0]


def pu_weights() -> dict[str, np.ndarray]:
    return first_weights(pu_net.weight_shapes(), 3)


def generators() -> dict[str, np.ndarray]:
    weights: dict[str, np.ndarray] = {}
    for level in range(dgts.LEVELS):
        weights |= first_weights(dgts.weight_shapes("generator", level, 3), level)
    return weights


def test_every_peer_is_found_by_its_name_and_another_is_refused():
    for name in NAMES:
        assert isinstance(peer(name), Peer)
    with pytest.raises(UsageError, match="no peer 'pu-net': use one of dspl, lapl, "):
        peer("pu-net")


def _copies(given: int):
    return lambda asked: np.ones((given, asked), np.float32)


def test_costs_are_those_of_the_work():
    taken = costs(Peer("copies", "", _copies), 2000, 4000)
    assert 0 <= taken.fit_cpu_s < 0.1
    assert np.isnan(taken.peak_mb) or 25 < taken.peak_mb < 60


@pytest.mark.parametrize("path", WEIGHTS, ids=lambda path: path.stem)
def test_weights_are_small_and_described(path):
    assert path.stat().st_size < 1_500_000
    weights = read_weights(path)
    described = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    if path.stem.startswith("rdn"):
        assert described["domain"] == "normals"
        return
    if path == pu_net.WEIGHTS:
        shapes = pu_net.weight_shapes()
        assert described["weights"] == sum(one.size for one in weights.values())
    else:
        shapes = {}
        for level in range(dgts.LEVELS):
            shapes |= dgts.weight_shapes("generator", level, 3)
    assert {name: one.shape for name, one in weights.items() if name.endswith(".weight")} == {
        f"{name}.weight": shape for name, shape in shapes.items()
    }


def test_networks_have_the_sizes_that_the_pages_state():
    def count(shapes):
        return sum(outputs * (inputs + 1) for outputs, inputs in shapes.values())

    assert count(pu_net.weight_shapes()) == 207_043
    assert 190_000 < sum(
        count(dgts.weight_shapes(kind, level, outputs))
        for level in range(dgts.LEVELS)
        for kind, outputs in (("generator", 3), ("critic", 1))
    ) < 195_000  # fmt: skip


def test_a_damaged_file_is_refused(tmp_path):
    whole = WEIGHTS[0].read_bytes()
    for name, content in (
        ("cut", whole[: len(whole) // 2]),
        ("text", b"not a network"),
        ("no", b""),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(acquisition.DataError, match=f"{name}: "):
            read_weights(tmp_path / name)
    with pytest.raises(acquisition.MissingPathError, match="no such file"):
        read_weights(tmp_path / "none")


# PU-Net


def test_farthest_points_are_spread():
    line = np.stack([np.arange(9.0), np.zeros(9), np.zeros(9)], axis=1).astype(np.float32)
    assert pu_net.farthest(line, 3).tolist() == [0, 8, 4]


def test_neighbourhoods_are_those_of_each_patch():
    patches = np.stack([flat_patch(0), flat_patch(1)])
    both = pu_net.Patches.of(patches)
    second = pu_net.Patches.of(patches[1:])
    weights: dict[str, np.ndarray] = pu_weights()
    made, alone = (
        np.stack(pu_net.pu_net(NumpyLayers(weights), one.points, one.arrays))
        for one in (both, second)
    )
    np.testing.assert_allclose(made[:, pu_net.POINTS :], alone, atol=1e-6)


def test_points_with_a_network_without_effect_are_repeated():
    weights = {name: 0 * one for name, one in pu_weights().items()}
    points = np.random.default_rng(5).uniform(0, 40, (600, 3))
    made = pu_net.enlarged(points, weights)
    np.testing.assert_allclose(made.reshape(600, 4, 3), np.repeat(points[:, None], 4, 1), atol=1e-4)


def test_the_frame_of_a_patch_follows_shift_and_scale():
    weights = pu_weights()
    points = np.random.default_rng(6).uniform(0, 40, (400, 3))
    made = pu_net.enlarged(points, weights)
    moved = pu_net.enlarged(3 * points + np.array([10, -4, 2]), weights)
    np.testing.assert_allclose(moved, 3 * made + np.array([10, -4, 2]), atol=1e-3)


def test_a_patch_is_level_and_its_frame_gives_its_points_back():
    random = np.random.default_rng(7)
    points = random.uniform(-9, 9, (300, 3)) * [1, 1, 0]
    points = 5 + Rotation.from_euler("xyz", [30, -40, 20], degrees=True).apply(points)
    patch, middle, axes = pu_net.normalised(points)
    np.testing.assert_allclose(patch[:, 2], 0, atol=1e-6)
    assert np.linalg.norm(patch, axis=1).max() == pytest.approx(1)
    np.testing.assert_allclose(patch @ axes + middle, points, atol=1e-5)
    assert np.linalg.det(axes) > 0


def test_feet_lie_on_the_surface_with_its_normals():
    y, x = np.mgrid[:120.0, :120.0]
    heights = (3 * np.sin(x / 7) + y / 4).astype(np.float32)
    surface = pu_net_training.Heights(
        heights, heights[::2, ::2], heights[::4, ::4], spline_filter(heights, output=np.float32)
    )
    patch = pu_net_training.patch_of(surface, np.random.default_rng(0))
    feet, normals = patch.feet(patch.given)
    x, y, z = (feet @ patch.axes + patch.middle).T
    inside = np.all([(x > 6), (x < 113), (y > 6), (y < 113)], axis=0)
    assert inside.sum() > 50
    np.testing.assert_allclose(z[inside], (3 * np.sin(x / 7) + y / 4)[inside], atol=1e-3)
    # Normals of the surface, turned into the ball: across both directions within it.
    slope = np.stack([np.ones_like(x), 0 * x, 3 / 7 * np.cos(x / 7)], axis=-1)
    for along in (slope, np.broadcast_to([0, 1, 0.25], slope.shape)):
        across = ((along @ np.linalg.inv(patch.axes)) * normals).sum(axis=1)
        np.testing.assert_allclose(across[inside], 0, atol=1e-3)


# DGTS


def test_a_grid_is_cut_into_faces_with_their_neighbours():
    mesh = dgts.Mesh(2, 3)
    assert mesh.faces.shape == (12, 3)
    place = dgts.plane(2, 3).reshape(-1, 3)
    a, b, c = (place[mesh.faces[:, corner]] for corner in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    for face, (neighbours, opposite) in enumerate(zip(mesh.neighbours, mesh.opposite, strict=True)):
        for edge, (other, vertex) in enumerate(zip(neighbours, opposite, strict=True)):
            ends = {mesh.faces[face, edge], mesh.faces[face, (edge + 1) % 3]}
            assert ends <= set(mesh.faces[other])
            assert vertex in mesh.faces[other]
            assert vertex not in ends
    index, weight = mesh.corners
    np.testing.assert_allclose(weight.sum(axis=1), 1, rtol=1e-6)
    assert all(
        set(mesh.faces.reshape(-1)[index[v][weight[v, :, 0] > 0]]) == {v} for v in range(len(place))
    )


def test_features_of_faces_do_not_depend_on_the_pose():
    mesh = dgts.Mesh(4, 4)
    random = np.random.default_rng(1)
    place = dgts.plane(4, 4).reshape(-1, 3) + random.normal(scale=0.2, size=(25, 3))
    turned = Rotation.from_euler("xyz", [20, -50, 130], degrees=True).apply(place) + 7
    np.testing.assert_allclose(
        dgts.features_of(turned, mesh, np.stack),
        dgts.features_of(place, mesh, np.stack),
        atol=1e-9,
    )


def test_displacements_along_the_normal_lift_a_plane():
    mesh = dgts.Mesh(3, 3)
    place = dgts.plane(3, 3).reshape(-1, 3).astype(np.float64)
    deltas = np.tile([0.0, 0.0, 0.5], (len(mesh.faces), 1))
    made = dgts.moved(place, mesh, deltas, np.stack)
    np.testing.assert_allclose(made - place, np.tile([0, 0, 0.5], (16, 1)), atol=1e-9)


def test_subdivision_keeps_the_triangles():
    grid = dgts.plane(2, 2)
    grid[..., 2] = np.random.default_rng(2).normal(size=(3, 3))
    fine = dgts.doubled(grid)
    np.testing.assert_array_equal(fine[::2, ::2], grid)
    # The middle of a cell is that of the diagonal along which it is cut.
    np.testing.assert_allclose(fine[1, 1], (grid[0, 1] + grid[1, 0]) / 2)


def test_generators_without_effect_keep_a_target():
    weights = {name: 0 * one for name, one in generators().items()}
    y, x = np.mgrid[1:-1:60j, -1:1:70j]
    target = processing.NormalMap.from_vectors(
        np.dstack([x, y, np.full_like(x, 3)]), x**2 + y**2 < 0.8
    )
    made = dgts.onto(target, weights, seed=1)
    assert (made.mask == target.mask).all()
    # At the rim, normals depend on how the surface is continued.
    inner = binary_erosion(target.mask, iterations=3)
    assert processing.angular_error(made, target).map_deg[inner].max() < 0.05


def test_noise_changes_what_generators_make():
    weights = generators()
    bases = dgts.with_levels(np.zeros((33, 33)), 32, 32)
    first, second = (dgts.generate(weights, bases, dgts.noises_of(bases, seed)) for seed in (0, 1))
    assert first.shape == (33, 33, 3)
    assert np.abs(first - second).max() > 1e-3


# Training


def test_training_without_torch_names_the_extra(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(checkpoints, "find_spec", lambda name: None)
    assert command.main(["pu_net", "--out", str(tmp_path / "a.onnx")]) == 2
    said = capsys.readouterr().err
    assert "torch and onnx not found" in said
    assert "surface-geometry-processing[learned]" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("lapl", "invalid choice: 'lapl' (choose from"),
        ("pu_net --exemplar textile", "--exemplar is not an option of pu_net"),
    ],
)
def test_bad_options_of_training_are_refused(tmp_path, capsys, words, message):
    with pytest.raises(SystemExit):
        command.main([*words.split(), "--out", str(tmp_path / "a.onnx")])
    assert message in capsys.readouterr().err


def test_a_loss_converges_when_its_last_fifths_agree():
    assert not checkpoints.converged(np.linspace(2, 1, 100).tolist())
    assert checkpoints.converged([*np.linspace(2, 1, 60), *[1.0] * 40])
    assert not checkpoints.converged(np.linspace(1, 2, 100).tolist())
    assert not checkpoints.converged([1.0, 1.0])


@learned
def test_a_checkpoint_of_another_version_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    checkpoints.save(path, "dgts", {})
    with pytest.raises(acquisition.DataError, match="a checkpoint of dgts, version 1; pu_net"):
        checkpoints.load(path, "pu_net")
    monkeypatch.setattr(checkpoints, "VERSION", 2)
    with pytest.raises(acquisition.DataError, match="dgts, version 2 is required"):
        checkpoints.load(path, "dgts")
    path.write_bytes(b"nothing")
    with pytest.raises(acquisition.DataError, match="cannot be read"):
        checkpoints.load(path, "dgts")


@learned
def test_pu_net_trains_and_its_graph_is_what_numpy_runs(tmp_path):
    from onnx.reference import ReferenceEvaluator

    from benchmarks.paper.peers import pu_net_training

    out = tmp_path / "pu.onnx"
    pu_net_training.train(out, lambda *_: None, steps=3, count=1, rugged=1)
    assert not out.with_suffix(".pt").exists()
    given = pu_net.Patches.of(flat_patch()[None])
    made = pu_net.pu_net(NumpyLayers(read_weights(out)), given.points, given.arrays)
    graph = ReferenceEvaluator(str(out)).run(None, {"points": given.points, **given.arrays})
    np.testing.assert_allclose(np.stack(graph), np.stack(made), atol=1e-5)


@learned
def test_an_assignment_uses_every_target_once():
    from benchmarks.paper.peers.pu_net_training import assigned

    random = np.random.default_rng(0)
    target = random.normal(size=(256, 3)).astype(np.float32)
    order = random.permutation(256)
    assert (assigned(target[order], target, random) == order).all()


@learned
def test_torch_trains_what_numpy_runs():
    """Also where the largest of several values are equal: at rims, and in small neighbourhoods."""
    import torch

    mesh = dgts.Mesh(4, 4)
    place = dgts.plane(4, 4).reshape(-1, 3)
    place += np.random.default_rng(3).normal(scale=0.1, size=place.shape).astype(np.float32)
    features = dgts.features_of(place, mesh, np.stack)
    cloud = pu_net.Patches.of(flat_patch()[None])
    made = []
    for kind, turned in ((NumpyLayers, np.asarray), (TorchLayers, torch.as_tensor)):
        faces, points = (
            kind({name: turned(one) for name, one in weights.items()})
            for weights in (generators(), pu_weights())
        )
        deltas = dgts.face_network(
            faces, "generator0", 0, 3, turned(features), turned(mesh.neighbours)
        )
        arrays = {name: turned(one) for name, one in cloud.arrays.items()}
        made.append([deltas, *pu_net.pu_net(points, turned(cloud.points), arrays)])
    for one, other in zip(*made, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


@learned
def test_the_first_level_of_dgts_learns_to_reconstruct(tmp_path, monkeypatch):
    from benchmarks.paper.peers import dgts_training

    monkeypatch.setattr(dgts, "LEVELS", 1)
    monkeypatch.setattr(dgts, "CELLS", 4)
    dgts_training.train(tmp_path / "a.onnx", lambda *_: None, exemplar="textile", steps=200)
    (losses,) = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["losses"]
    assert losses[-1] < 0.2 * losses[0]


@learned
def test_an_interrupted_training_of_dgts_continues_and_its_graph_is_what_numpy_runs(
    tmp_path, monkeypatch
):
    from onnx.reference import ReferenceEvaluator

    from benchmarks.paper.peers import dgts_training

    monkeypatch.setattr(dgts, "LEVELS", 2)
    monkeypatch.setattr(dgts, "CELLS", 8)
    monkeypatch.setattr(dgts, "EXEMPLAR_PX", 9)
    monkeypatch.setattr(dgts_training, "_SAVE_EVERY_S", 0.0)
    whole, parted = tmp_path / "whole.onnx", tmp_path / "parted.onnx"
    dgts_training.train(whole, lambda *_: None, exemplar="textile", steps=3)

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == "level 2 of 2" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dgts_training.train(parted, interrupt, exemplar="textile", steps=3)
    dgts_training.train(parted, lambda *_: None, exemplar="textile", steps=3)
    first, second = read_weights(whole), read_weights(parted)
    for name, one in first.items():
        np.testing.assert_allclose(second[name], one, atol=1e-5)
    inputs, made = {}, []
    for level in range(2):
        mesh = dgts.Mesh(4 << level, 4 << level)
        place = dgts.plane(mesh.rows, mesh.columns).reshape(-1, 3)
        inputs[f"features{level}"] = dgts.features_of(place, mesh, np.stack)
        inputs[f"neighbours{level}"] = mesh.neighbours
        made.append(
            dgts.face_network(
                NumpyLayers(first), f"generator{level}", level, 3,
                inputs[f"features{level}"], mesh.neighbours,
            )
        )  # fmt: skip
    for graph, own in zip(ReferenceEvaluator(str(whole)).run(None, inputs), made, strict=True):
        np.testing.assert_allclose(graph, own, atol=1e-5)


def test_weights_lie_where_the_tables_look():
    assert pu_net.WEIGHTS.parent == Path(dgts.__file__).with_name("weights")
