"""Errors of the shifts of images under different lights, and of normals after their correction.

Simulated objects are recorded with the noise of their sensor, and each image is moved by Lanczos
interpolation: by a random amount, or as a camera that creeps from the first image to the last.
Errors are relative to the mean of all images, which no method can know. Normals are those of
`reconstruct` with the true shifts unknown: of images that stand still, of moved ones as they are,
and of moved ones with ``align="auto"``.

    python benchmarks/image_shifts.py --seed 31 --out docs/measured/image-shifts.csv
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from harness import Table, command_line
from imperfections.recordings import Recording, mask_file, photographed

from acquisition import angle_deg, read_source
from acquisition.comparison import lanczos
from processing import reconstruct
from processing.recording import AlignChoice
from processing.registration import find_image_shifts
from rig.arrays import Float32, Float64
from simulator import scene_named

_SCENES = ("coin", "scales", "textile", "woodcarving", "leather", "ripples", "noise", "sphere")
_SIZE = (480, 400)
# Largest shift of an image along each axis, px; "creep" moves by 4 px from first to last.
_SHIFTS = ("0", "0.2", "2", "8", "30", "creep")
_NORMALS = ("creep", "30")
# Shorter interpolated normals are at the outline.
WHOLE = 0.9


def shifted(image: Float32, right: float, down: float) -> Float32:
    """Return an image whose content is further right and down."""
    whole = np.floor([right, down]).astype(int)
    kernels = lanczos(-(right - whole[0])), lanczos(-(down - whole[1]))
    made = cv2.sepFilter2D(image, cv2.CV_32F, *kernels, borderType=cv2.BORDER_REPLICATE)
    return np.roll(np.asarray(made, np.float32), (whole[1], whole[0]), (0, 1))


def shifts_of(kind: str, count: int, rng: np.random.Generator) -> Float64:
    """Return the shifts ``(N, 2)`` of the images, with the median 0."""
    shifts = np.zeros((count, 2))
    if kind == "creep":
        shifts[:, 0] = np.linspace(0, 4, count)
    else:
        shifts = rng.uniform(-float(kind), float(kind), (count, 2))
    return np.asarray(shifts - np.median(shifts, axis=0))


def normals_deg(recording: Recording, align: AlignChoice, shifts: Float64) -> float:
    """Return the mean angular error of the normals, which are those of an image that stays."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "images"
        recording.write(folder)
        source = read_source(
            folder,
            lights=recording.lights,
            mask_path=mask_file(folder),
            camera=recording.camera,
        )
        made = reconstruct(source, align=align, surface=False)
    if recording.normals is None:
        return float("nan")
    moved = made.source.shifts_px
    stays = [name not in moved for name in recording.lights.ids]
    by = shifts[stays].mean(axis=0) if moved else np.zeros(2)
    parts = [shifted(np.float32(part), *by) for part in np.moveaxis(recording.normals, 2, 0)]
    truth = np.stack(parts, axis=2)
    lengths = np.linalg.norm(truth, axis=2)
    inside = made.normals.mask & (lengths > WHOLE)
    # `angle_deg` normalises.
    return float(angle_deg(made.normals.normals[inside], truth[inside]).mean())


def main() -> None:
    """Print one row for each object, number of lights and kind of shift."""
    parser = command_line(__doc__)
    parser.add_argument("--seed", type=int, default=31, help="seed of scenes, noise and shifts")
    parser.add_argument("--lights", type=int, nargs="+", default=[8, 12, 36])
    parser.add_argument("--out", type=Path, help="table of errors (.csv)")
    options = parser.parse_args()
    table = Table(options.out)
    for number, name in enumerate(_SCENES):
        for count in options.lights:
            seed = options.seed + number
            width, height = _SIZE
            scene = scene_named(name, width=width, height=height, leds=count, seed=seed)
            still = photographed(name, scene, seed)
            images = still.images if still.images.ndim == 3 else still.images.mean(axis=3)
            strengths = np.asarray(still.lights.intensities).mean(axis=1)
            points = np.zeros((1, 3))
            vectors = np.moveaxis(still.lights.vectors_at(points), 0, 1)[0]
            rng = np.random.default_rng(seed)

            def vectors_at(rows: Float64, _: Float64, of: Float64 = vectors) -> Float64:
                return np.broadcast_to(of, (len(rows), *of.shape))

            for kind in _SHIFTS:
                true = shifts_of(kind, count, rng)
                moved = np.stack([shifted(one, *by) for one, by in zip(images, true, strict=True)])
                began_s = time.process_time()
                found = find_image_shifts(
                    np.float32(moved / strengths[:, None, None]), still.mask, vectors_at
                )
                cpu_s = time.process_time() - began_s
                error = found.shifts_px - true
                error -= error.mean(axis=0)
                row = {
                    "object": name,
                    "lights": str(count),
                    "shift px": kind,
                    "rms px": f"{np.sqrt((error**2).sum(axis=1).mean()):.3f}",
                    "stated px": f"{np.sqrt((found.sigma_px**2).sum(axis=1).mean()):.3f}",
                    "determined": str(found.determined),
                    "cpu s": f"{cpu_s:.2f}",
                    "still deg": "",
                    "moved deg": "",
                    "aligned deg": "",
                }
                if kind in _NORMALS and count == 12 and still.images.ndim == 3:
                    recording = replace(still, images=moved)
                    row["still deg"] = f"{normals_deg(still, 'auto', 0 * true):.2f}"
                    row["moved deg"] = f"{normals_deg(recording, 'off', true):.2f}"
                    row["aligned deg"] = f"{normals_deg(recording, 'auto', true):.2f}"
                table.add(row)


if __name__ == "__main__":
    main()
