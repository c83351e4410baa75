"""Training with torch: the ONNX file, checkpoints, and what the losses lead to."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from subprocess import PIPE

import cv2
import numpy as np
import pytest

from rig import no_progress
from sgp.training import PRESETS, RdnSize, Task, make_pairs, weight_shapes
from simulator import random_normals
from simulator.reliefs import rugged_normals

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_spec("torch") is None or find_spec("onnx") is None,
        reason="training requires torch and onnx, the extra [learned]",
    ),
]

TINY = replace(
    PRESETS["small"],
    blocks=1,
    convolutions=2,
    growth=8,
    features=8,
    surfaces=6,
    rugged=4,
    side=48,
    crop=8,
)


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    monkeypatch.setitem(PRESETS, "small", TINY)
    monkeypatch.setattr("sgp.commands.detail_train.HELD_OUT", range(3))
    monkeypatch.setattr("sgp.commands.detail_train.CORRECTED", range(3, 6))


@pytest.mark.parametrize("upsampling", ["direct", "convolved"])
@pytest.mark.parametrize("scale", [2, 4])
def test_opencv_computes_what_torch_computes(scale, upsampling):
    import torch

    from sgp.training import first_weights, forward
    from sgp.training.rdn import onnx_bytes

    size = RdnSize(scale, 2, 3, 24, 20, upsampling)
    random = torch.Generator().manual_seed(4)
    weights = first_weights(size, 0)
    weights["last.weight"].normal_(0, 0.1, generator=random)
    content = onnx_bytes(size, {name: one.numpy() for name, one in weights.items()})
    assert content == onnx_bytes(size, {name: one.numpy() for name, one in weights.items()})
    network = cv2.dnn.readNetFromONNX(np.frombuffer(content, np.uint8))
    for height, width in ((40, 56), (33, 17)):
        low = torch.randn((1, 3, height, width), generator=random)
        expected = forward(size, weights, low).numpy()
        network.setInput(low.numpy())
        computed = network.forward()
        assert np.abs(expected).max() > 1
        np.testing.assert_allclose(computed, expected, atol=1e-5 * np.abs(expected).max())


def test_an_untrained_network_is_bicubic_interpolation():
    import torch

    from sgp.training import first_weights, forward

    for scale in (2, 4):
        size = PRESETS["small"].size(scale)
        output = forward(size, first_weights(size, 3), torch.randn(1, 3, 9, 11))
        assert output.shape == (1, 5, 9 * scale, 11 * scale)
        assert not output[:, :3].any()
        assert (output[:, 3:] == -5).all()


def test_weights_have_an_effect_as_far_as_the_halo():
    import torch

    from sgp.training import first_weights, forward

    for upsampling in ("direct", "convolved"):
        size = RdnSize(2, 1, 2, 8, 8, upsampling)
        weights = {name: one.abs() for name, one in first_weights(size, 1).items()}
        weights["last.weight"] += 0.1
        low = torch.zeros(1, 3, 41, 41)
        moved = low.clone()
        moved[..., 20, 20] = 1
        change = forward(size, weights, moved) - forward(size, weights, low)
        rows = np.flatnonzero(change.abs().sum(dim=(0, 1, 3)).numpy()) // 2
        reach = max(20 - rows.min(), rows.max() - 20)
        assert size.halo_px - 2 <= reach <= size.halo_px


class KilledError(Exception):
    """Ends a training at a step, as a signal does."""


@pytest.mark.parametrize("last", [8, 11], ids=["first part", "second part"])
def test_a_killed_training_continues_to_the_same_weights(tmp_path, last):
    from sgp.training import train

    task = Task(4, "detail", 0, "small", 12)
    pairs = make_pairs(
        "p", random_normals, task.surfaces, tmp_path, TINY.side, 4, "detail", no_progress
    )
    few = make_pairs(
        "r", rugged_normals, task.rugged, tmp_path, TINY.side, 4, "detail", no_progress
    )
    whole = train(task, pairs, few, tmp_path / "whole.pt", no_progress)

    def kill(stage: str, done: int, total: int) -> None:
        if done == last:
            raise KilledError

    seconds = iter(range(0, 10**6, 31))  # each step writes a checkpoint
    checkpoint = tmp_path / "checkpoint.pt"
    with pytest.raises(KilledError):
        train(task, pairs, few, checkpoint, kill, lambda: next(seconds))
    assert checkpoint.is_file()
    steps = []
    again = train(task, pairs, few, checkpoint, lambda stage, done, total: steps.append(done))
    assert steps[0] == last - 1
    assert 8 <= task.first_steps < 10  # one kill in each part
    for name, one in whole.items():
        np.testing.assert_array_equal(one.numpy(), again[name].numpy(), name)


@pytest.mark.parametrize("damage", [b"", b"text", None], ids=["empty", "text", "other"])
def test_damaged_checkpoints_are_named(tmp_path, damage):
    import torch

    from acquisition import DataError
    from sgp.training import train

    task = Task(4, "normals", 0, "small", 2)
    pairs = make_pairs(
        "p", random_normals, task.surfaces, tmp_path, TINY.side, 4, "normals", no_progress
    )
    path = tmp_path / "checkpoint.pt"
    if damage is None:
        torch.save({"weights": {}}, path)
    else:
        path.write_bytes(damage)
    with pytest.raises(DataError, match=r"checkpoint\.pt: the checkpoint cannot be read"):
        train(task, pairs, pairs, path, no_progress)


def test_the_likelihood_leads_to_the_mean_square_error():
    """With errors of known size, the fitted constants are their mean squares."""
    import torch

    from sgp.training.steps import loss, results

    random = torch.Generator().manual_seed(0)
    low = torch.zeros(1, 3, 24, 24)
    low[:, 2] = 1
    errors = 0.1 * torch.randn((1, 2, 96, 96), generator=random)
    high = torch.cat([errors, torch.ones(1, 1, 96, 96)], 1)
    high = high / high.norm(dim=1, keepdim=True)
    logs = torch.full((1, 2, 1, 1), -2.0, requires_grad=True)
    optimizer = torch.optim.Adam([logs], lr=0.1)
    for _ in range(200):
        output = torch.cat([torch.zeros(1, 3, 96, 96), logs.expand(1, 2, 96, 96)], 1)
        optimizer.zero_grad()
        loss(low, high, output, 4).backward()
        optimizer.step()
    bicubic, _ = results(low, output, 4)
    squares = torch.acos((bicubic * high).sum(1).double()) ** 2
    np.testing.assert_allclose(logs.detach().exp().ravel(), [float(squares.mean())] * 2, rtol=0.02)


def test_the_command_writes_a_network_and_its_description(sgp, tmp_path: Path):
    out = tmp_path / "net.onnx"
    words = ("detail", "train", "--scale", 4, "--domain", "normals", "--steps", 6, "--out", out)
    answer = sgp(*words, "--json").ok()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["net.json", "net.onnx"]
    about = json.loads(out.with_suffix(".json").read_text(encoding="utf-8"))
    assert about["sha256"] == hashlib.sha256(out.read_bytes()).hexdigest()
    assert (about["name"], about["scale"], about["domain"]) == ("net", 4, "normals")
    assert about["training"]["steps"] == 6
    figures = json.loads(answer.out)["metrics"]
    count = sum(int(np.prod(s)) + s[0] for s in weight_shapes(TINY.size(4)).values())
    assert figures["parameters"] == count
    assert 0 < figures["network_mae_deg"] < 2 * figures["bicubic_mae_deg"]
    assert len(figures["actual_over_predicted"]) == 10
    assert sgp(*words).code == 2


# The command with a tiny preset, which writes a checkpoint after each step.
CHILD = """
import sys
from dataclasses import replace
import sgp
from sgp.training import presets, steps
from sgp.commands import detail_train
sizes = dict(blocks=1, convolutions=2, growth=8, features=8, surfaces=6, rugged=4, side=48, crop=8)
presets.PRESETS["small"] = replace(presets.PRESETS["small"], **sizes)
detail_train.HELD_OUT, detail_train.CORRECTED = range(3), range(3, 6)
steps._SAVE_EVERY_S = -1.0
sgp.main()
"""


def test_a_process_killed_on_the_way_leads_to_the_same_files(tmp_path):
    def command(out: Path) -> list[str | Path]:
        words = ["detail", "train", "--scale", "4", "--steps", "12", "--out", out]
        return [sys.executable, "-c", CHILD, *words]

    alone = os.environ | {"OMP_NUM_THREADS": "1"}  # several threads round differently each time
    out, whole = tmp_path / "a" / "n.onnx", tmp_path / "b" / "n.onnx"
    for path in (out, whole):
        path.parent.mkdir()
    checkpoint = out.with_suffix(".training") / "checkpoint.pt"
    killed = 0
    while not out.exists():
        with subprocess.Popen(command(out), env=alone, stderr=PIPE, text=True) as process:
            assert process.stderr is not None
            began = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
            while process.poll() is None and not killed:
                if checkpoint.exists() and checkpoint.stat().st_mtime_ns != began:
                    process.kill()
                    killed += 1
                    break
                time.sleep(0.002)
            talk = process.communicate()[1]
        assert process.returncode in (0, -signal.SIGKILL), talk
    assert killed > 0
    subprocess.run(command(whole), env=alone, check=True, capture_output=True)
    assert out.read_bytes() == whole.read_bytes()
    assert out.with_suffix(".json").read_text() == whole.with_suffix(".json").read_text()
    assert sorted(path.name for path in out.parent.iterdir()) == ["n.json", "n.onnx"]
