"""How much of the detail of a map super-resolution could add at best.

For each map, two figures:

- Noise: the part of the power above the resolution of the reduced map that no surface has. It is
  twice the power of the curl of the slopes, because errors of a measurement have as much of it as
  of a gradient, and a surface has none (aliasing counts as noise, too). No method knows it, so the
  root mean square error cannot be smaller than its root.
- Learnt: how far the network of the program gets on one half of a map after it was trained further
  on the other half. A network that knows random surfaces only cannot be expected to be better. It
  requires torch and onnx, and takes 15 to 40 CPU seconds for each half.

    python benchmarks/superres_limits.py owl plant 160 --steps 450
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from harness import command_line

import processing
from benchmarks.paper.sources import Sources
from rig.arrays import Bool, Float32

_SCALE = 4
_WINDOW_PX = 64  # of the spectrum
_STEEPEST = 0.15  # least z of the normals in a window
_SIDE, _BATCH = 16, 8  # crops at low resolution
_EVERY = 3  # candidates for crops
_GAP_PX = 13  # between the halves, at low resolution
_SHIFTS = ((0, 0), (0, 2), (1, 0), (1, 2), (2, 0), (2, 2), (3, 0), (3, 2))
_RATE, _WARMING = 5e-4, 30


def noise_share(truth: processing.NormalMap, scale: int) -> float:
    """Return the share of noise in the power above the resolution of a map that is reduced."""
    frequency = np.fft.fftfreq(_WINDOW_PX)
    up, right = np.meshgrid(-frequency, frequency, indexing="ij")
    largest = np.maximum(abs(up), abs(right))
    lost = (largest > 0.5 / scale) & (largest < 0.42)
    hann = np.outer(*[np.hanning(_WINDOW_PX)] * 2)
    radius2 = np.maximum(up**2 + right**2, 1e-9)
    curl = gradient = 0.0
    for row in range(0, truth.size[0] - _WINDOW_PX + 1, _WINDOW_PX // 2):
        for column in range(0, truth.size[1] - _WINDOW_PX + 1, _WINDOW_PX // 2):
            window = slice(row, row + _WINDOW_PX), slice(column, column + _WINDOW_PX)
            normals = truth.normals[window].astype(np.float64)
            if not truth.mask[window].all() or normals[..., 2].min() < _STEEPEST:
                continue
            slopes = (-normals[..., k] / normals[..., 2] for k in (0, 1))
            p, q = (np.fft.fft2((one - one.mean()) * hann) for one in slopes)
            curl += float((abs(up * p - right * q) ** 2 / radius2)[lost].sum())
            gradient += float((abs(right * p + up * q) ** 2 / radius2)[lost].sum())
    return 2 * curl / (curl + gradient) if gradient else math.nan


class Half(NamedTuple):
    """Vectors that are (0, 0, 1) outside the mask, and the mask."""

    normals: Float32
    mask: Bool


def halves(truth: processing.NormalMap) -> list[Half]:
    """Return the left and the right half of a map, with a gap between them."""
    height, width = (length // _SCALE * _SCALE for length in truth.size)
    middle = width // 2 // _SCALE * _SCALE
    facing = np.array([0, 0, 1], np.float32)
    normals = np.where(truth.mask[..., None], truth.normals, facing)
    parts = slice(0, middle), slice(middle + _SCALE * _GAP_PX, width)
    return [Half(normals[:height, part].copy(), truth.mask[:height, part].copy()) for part in parts]


def learnt(known: Half, other: Half, steps: int) -> list[float]:
    """Return the errors of bicubic interpolation and of the network before and after, in degrees.

    Parameters
    ----------
    known, other
        The half to train on, and the half to judge.
    steps
        Steps of Adam.
    """
    import onnx
    import torch

    from sgp.training import RdnSize, forward
    from sgp.training.pairs import SYMMETRIES, pair, turned
    from sgp.training.rdn import as_images
    from sgp.training.steps import loss, results, squared_angle, squared_chord

    torch.set_num_threads(1)
    model = processing.superres.read_superres_model(None, _SCALE)
    shape = model.training["settings"]
    names = ("blocks", "convolutions", "growth", "features", "upsampling")
    size = RdnSize(_SCALE, *(shape[name] for name in names))
    weights: dict[str, Any] = {
        one.name: torch.from_numpy(onnx.numpy_helper.to_array(one).copy())
        for one in onnx.load_from_string(model.data).graph.initializer
    }
    low, high = (as_images(one[None]) for one in pair(other.normals, _SCALE, "detail"))
    inside = torch.from_numpy(other.mask)

    def errors() -> list[float]:
        with torch.no_grad():
            both = results(low, forward(size, weights, low), _SCALE)
            angles = [squared_angle(squared_chord(one, high)).sqrt()[0] for one in both]
        return [math.degrees(float(one[inside].mean())) for one in angles]

    pairs, places = [], list[tuple[int, int, int]]()
    for down, right in _SHIFTS:
        cut = known.normals[down:, right:]
        rows, columns = (length // _SCALE for length in cut.shape[:2])
        window = slice(down, down + _SCALE * rows), slice(right, right + _SCALE * columns)
        pairs.append(pair(known.normals[window].copy(), _SCALE, "detail"))
        blocks = known.mask[window].reshape(rows, _SCALE, columns, _SCALE).mean(axis=(1, 3))
        places += [
            (len(pairs) - 1, top, left)
            for top in range(0, rows - _SIDE + 1, _EVERY)
            for left in range(0, columns - _SIDE + 1, _EVERY)
            if blocks[top : top + _SIDE, left : left + _SIDE].mean() > 0.5
        ]
    bicubic, before = errors()
    for one in weights.values():
        one.requires_grad_()
    optimizer = torch.optim.Adam(list(weights.values()), lr=_RATE)
    random = np.random.default_rng(steps)
    for step in range(steps):
        share = 0.5 + 0.5 * math.cos(math.pi * step / steps)
        optimizer.param_groups[0]["lr"] = _RATE * share * min(1, (step + 1) / _WARMING)
        crops = []
        for index, top, left in random.choice(places, _BATCH):
            symmetry = int(random.integers(SYMMETRIES))
            sides = zip(pairs[index], (1, _SCALE), strict=True)
            crops.append(
                [
                    turned(
                        one[s * top : s * (top + _SIDE), s * left : s * (left + _SIDE)], symmetry
                    )
                    for one, s in sides
                ]
            )
        given, wanted = (as_images(np.stack(one)) for one in zip(*crops, strict=True))
        lost = loss(given, wanted, forward(size, weights, given), _SCALE)
        optimizer.zero_grad()
        lost.backward()
        optimizer.step()
    return [bicubic, before, errors()[1]]


def main(maps: list[str], steps: int) -> None:
    """Print both figures for each map; with 0 steps, only the noise."""
    sources = Sources.found()
    for name in maps:
        truth = sources.relief(name) if name.isdigit() else sources.given(name)
        share = noise_share(truth, _SCALE)
        line = f"{name}: noise {share:.2f} of the power, {math.sqrt(share):.2f} of the error"
        if steps:
            parts = halves(truth)
            found = [learnt(*pair, steps) for pair in (parts, parts[::-1])]
            changes = [[one / bicubic - 1 for one in after] for bicubic, *after in found]
            before, after = np.mean(changes, axis=0)
            line += f"; network {before:+.1%}, trained on the other half {after:+.1%}"
        print(line, flush=True)


if __name__ == "__main__":
    parser = command_line(__doc__)
    parser.add_argument("maps", nargs="+", help="owl, plant, or the number of a relief")
    parser.add_argument("--steps", type=int, default=450, help="steps of the training; 0: none")
    asked = parser.parse_args()
    main(asked.maps, asked.steps)
