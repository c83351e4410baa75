"""``sgp detail train``: train a network for ``sgp detail superres``."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import simulator
from sgp.cli.console import Stages
from sgp.cli.exit import UsageError
from sgp.cli.options import TrainingSeed, TrainingSteps
from sgp.results import Result, TrainMetrics, check_file
from sgp.training import CORRECTED, HELD_OUT, PRESETS, Domain, PresetName, Scale, Task

_LIBRARIES = ("torch", "onnx")


def train(
    *,
    scale: Scale,
    out: Path,
    preset: PresetName = "small",
    domain: Domain = "detail",
    seed: TrainingSeed = 0,
    steps: TrainingSteps | None = None,
    force: bool = False,
) -> Result:
    """Train a network for `sgp detail superres` on random surfaces of the simulator.

    Requires torch and onnx: pip install "surface-geometry-processing[learned]". It runs on a GPU if
    torch finds one. An interrupted training continues if the same command is given again.

    For example:

        sgp detail train --scale 4 --out superres-x4.onnx
        sgp detail train --scale 2 --out rdn-x2.onnx --preset paper

    Parameters
    ----------
    scale
        Factor of the resolution, 2 or 4.
    out
        File of the network (.onnx); its description with the suffix .json is written next to it.
        During the training, a folder with the suffix .training has its surfaces and checkpoints.
    preset
        small (a small residual dense network, at most 15 minutes on two cores) or paper (the
        published network with the settings of the paper, for a GPU).
    domain
        What the network enlarges: detail (detail components) or normals.
    seed
        Seed of surfaces, first weights and crops.
    steps
        Number of steps; default: that of the preset.
    force
        Overwrite existing files.
    """
    from sgp.training import claim_work, make_pairs, network_model, remove_work, write_network

    check_file(out, ".onnx", force=force)
    check_file(out.with_suffix(".json"), ".json", force=force)
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"{' and '.join(missing)} not found, which training requires: "
            'pip install "surface-geometry-processing[learned]"'
        )
    from sgp.training import fitted_deviations, judged, measure
    from sgp.training import train as run

    chosen = PRESETS[preset].at(scale)
    task = Task(scale, domain, seed, preset, steps or chosen.steps)
    work = out.with_suffix(".training")
    claim_work(work, task)
    with Stages() as progress:
        pairs, rugged = (
            make_pairs(name, normals, seeds, work, chosen.side, scale, domain, progress)
            for name, normals, seeds in (
                ("surfaces", simulator.random_normals, task.surfaces),
                ("rugged surfaces", simulator.reliefs.rugged_normals, task.rugged),
            )
        )
        weights = run(task, pairs, rugged, work / "checkpoint.pt", progress)
        raw = network_model(out, task, weights)
        measured = measure(raw, CORRECTED, chosen.side, "deviations", progress, self_ensemble=False)
        model = replace(raw, deviations=fitted_deviations(measured))
        judgement = judged(
            measure(
                model, HELD_OUT, chosen.side, "held-out surfaces", progress, self_ensemble=False
            )
        )
    description = write_network(model, task, judgement)
    remove_work(work)
    ratios = judgement.actual_over_predicted
    return Result(
        outputs={"network": out, "description": description},
        metrics=TrainMetrics(
            steps=task.steps,
            parameters=sum(one.numel() for one in weights.values()),
            bicubic_mae_deg=judgement.bicubic_deg,
            network_mae_deg=judgement.network_deg,
            actual_over_predicted=list(ratios),
        ),
        summary=[
            f"{out}: mean error on held-out surfaces {judgement.network_deg:.3f} degrees, "
            f"{judgement.change:+.1%} against bicubic interpolation",
            f"actual over predicted deviation {min(ratios):.2f} to {max(ratios):.2f}",
        ],
    )
