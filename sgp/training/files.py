"""The files of a training: its working folder, the network and its description."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import acquisition
import processing
import rig
from sgp.cli.exit import UsageError
from sgp.results import dumps
from sgp.training.judgement import Judgement
from sgp.training.presets import CORRECTED, HELD_OUT, Task
from sgp.training.rdn import onnx_bytes

if TYPE_CHECKING:
    import torch

_FORMAT = 1
_TASK = "training.json"


def claim_work(folder: Path, task: Task) -> None:
    """Create the working folder of a training, or check that it belongs to this training.

    Raises
    ------
    UsageError
        If it belongs to a training with other settings.
    StorageError
        If it cannot be created.
    """
    acquisition.make_folder(folder)
    content = f"{dumps(asdict(task))}\n".encode()
    noted = folder / _TASK
    try:
        same = rig.read_bounded(noted) == content
    except FileNotFoundError:
        if any(not acquisition.files.is_part_file(path) for path in folder.iterdir()):
            raise UsageError(
                f"{folder} is not the working folder of a training: give another --out"
            ) from None
        acquisition.write_durably(noted, content)
        return
    except rig.UnreadableError:
        same = False
    if not same:
        raise UsageError(
            f"{folder} belongs to a training with other settings ({_TASK} in it): repeat those to "
            "continue it, remove the folder, or give another --out"
        )


def remove_work(folder: Path) -> None:
    """Remove the files of a finished training, and their folder.

    Raises
    ------
    StorageError
        If a file cannot be removed.
    """
    acquisition.files.remove_part_files(folder)
    try:
        for path in [*folder.glob("*.npy"), folder / "checkpoint.pt", folder / _TASK]:
            path.unlink(missing_ok=True)
        folder.rmdir()
    except OSError as error:
        raise acquisition.files.storage_error(folder, "remove", error) from error


def network_model(
    out: Path, task: Task, weights: Mapping[str, torch.Tensor]
) -> processing.SuperResolutionModel:
    """Return a network as it will be read from `out`, without corrected deviations."""
    content = onnx_bytes(task.size, {name: one.numpy() for name, one in weights.items()})
    return processing.SuperResolutionModel(
        out,
        out.stem,
        task.scale,
        task.domain,
        task.size.halo_px,
        hashlib.sha256(content).hexdigest(),
        {},
        content,
    )


def write_network(model: processing.SuperResolutionModel, task: Task, judgement: Judgement) -> Path:
    """Write a network and its description; return the path of the description."""
    out = model.path
    description = out.with_suffix(".json")
    text = f"{dumps(_description(model, task, judgement))}\n"
    with acquisition.files.staged(out.parent) as place:
        acquisition.write_durably(place / out.name, model.data)
        acquisition.write_durably(place / description.name, text.encode())
    return description


def _description(
    model: processing.SuperResolutionModel, task: Task, judgement: Judgement
) -> dict[str, Any]:
    import onnx
    import torch

    size, seeds, rugged = task.size, task.surfaces, task.rugged
    return {
        "format": _FORMAT,
        **{name: getattr(model, name) for name in ("name", "scale", "domain")},
        "architecture": "rdn",
        **{name: getattr(size, name) for name in ("blocks", "convolutions", "growth")},
        "halo_px": model.halo_px,
        "sha256": model.sha256,
        "deviations": None if model.deviations is None else asdict(model.deviations),
        "training": {
            "seed": task.seed,
            "steps": task.steps,
            "preset": task.preset_name,
            "settings": asdict(task.preset),
            "data": f"random surfaces of the simulator, seeds {seeds[0]} to {seeds[-1]}"
            + (f", and rugged ones, {rugged[0]} to {rugged[-1]}" if rugged else ""),
            "deviations": f"measured on seeds {CORRECTED[0]} to {CORRECTED[-1]}",
            "held_out": {"seeds": f"{HELD_OUT[0]} to {HELD_OUT[-1]}", **asdict(judgement)},
            "software": {
                "name": acquisition.files.SOFTWARE,
                "version": acquisition.files.software_version(),
                "torch": torch.__version__,
                "onnx": onnx.__version__,
            },
            "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu",
            "threads": torch.get_num_threads(),
        },
    }
