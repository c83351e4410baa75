"""Cost of whole commands: reading, checking, hashing and encoding as well as the kernels.

Each command runs in a process of its own, twice, and the second run counts, with the caches of
compiled kernels warm. "CPU s" are those of all threads, "yardsticks" their ratio to a plain copy of
the command's input and output files in Python, read and written once, and "GB" the peak of the
resident memory. "limit" is what issue 13 asks for, on two cores without other work. Inputs are
synthetic: normals of waves with noise, which hardly compress, a wavy mesh, and JPEG photographs.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from harness import command_line
from separation import relief

from processing import write_normals

# CPU seconds (wall for `run`) and GB; 0 is no limit.
_LIMITS = {
    "separate": (4.0, 0.0),
    "transfer": (8.0, 1.2),
    "project": (5.0, 0.0),
    "run": (60.0, 2.5),
}


def write_mesh(path: Path, faces: int) -> None:
    """Write a wavy grid as a binary PLY."""
    side = round((faces / 2) ** 0.5) + 1
    y, x = np.mgrid[:side, :side].astype(np.float32)
    z = 20 * np.sin(x / 60) * np.cos(y / 70)
    number = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    c, d = number[1:, :-1].ravel(), number[1:, 1:].ravel()
    table = np.zeros(2 * len(a), [("count", "u1"), ("corners", "<i4", 3)])
    table["count"] = 3
    table["corners"] = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {side * side}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(table)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = np.stack([x, y, z], axis=-1).astype("<f4")
    path.write_bytes(header.encode() + vertices.tobytes() + table.tobytes())


def write_photographs(folder: Path, megapixels: float, count: int) -> None:
    """Write colour photographs of a dome with waves, and their lights."""
    folder.mkdir()
    height, width = (round((megapixels * 1e6 * side) ** 0.5) for side in (2 / 3, 3 / 2))
    y, x = np.mgrid[:height, :width].astype(np.float32)
    u, v = (x - width / 2) / (0.46 * width), (y - height / 2) / (0.46 * height)
    normals = np.stack(
        [0.6 * u - 0.25 * np.sin(x / 40), -0.6 * v + 0.25 * np.sin(y / 50), np.ones_like(u)], -1
    )
    normals /= np.sqrt(np.einsum("ijk,ijk->ij", normals, normals))[..., None]
    inside = u * u + v * v < 1
    rng = np.random.default_rng(0)
    lines = [str(count)]
    for i in range(count):
        turn = 2 * np.pi * i / count
        light = np.array([0.64 * np.cos(turn), 0.64 * np.sin(turn), 0.77], np.float32)
        signal = 0.8 * inside * np.clip(normals @ light, 0, None) + 0.004
        samples = 255 * signal ** (1 / 2.2) + rng.standard_normal(signal.shape, np.float32)
        image = np.repeat(np.clip(samples, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        cv2.imwrite(str(folder / f"im{i:02}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
        lines.append(f"im{i:02}.jpg {light[0]:.5f} {light[1]:.5f} {light[2]:.5f}")
    (folder / "lights.lp").write_text("\n".join(lines) + "\n", encoding="ascii")
    cv2.imwrite(str(folder / "mask.png"), inside.astype(np.uint8) * 255)


def cost(words: list[str]) -> tuple[float, float, float]:
    """Return CPU seconds, wall seconds and peak GB of a command."""
    measure = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(done.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss)"
    )
    begun = time.perf_counter()
    answer = subprocess.run(
        [sys.executable, "-c", measure, *words], capture_output=True, text=True, check=True
    )
    wall = time.perf_counter() - begun
    code, cpu, peak_kb = answer.stdout.split()
    if code != "0":
        raise SystemExit(answer.stderr)
    return float(cpu), wall, float(peak_kb) * 1024 / 1e9


def copy_s(paths: list[Path], place: Path) -> float:
    """Return the CPU seconds for reading files and writing their bytes."""
    before = time.process_time()
    for path in paths:
        place.write_bytes(path.read_bytes())
    return time.process_time() - before


def files_in(*places: Path) -> list[Path]:
    return [
        path
        for place in places
        for path in ([place] if place.is_file() else sorted(place.rglob("*")))
        if path.is_file()
    ]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--megapixels", type=float, default=4.0, help="of the normal map")
    parser.add_argument("--faces", type=float, default=5.5e6, help="of the mesh")
    parser.add_argument("--photograph", type=float, default=24.0, help="megapixels of a photograph")
    parser.add_argument("--images", type=int, default=12, help="number of photographs")
    parser.add_argument(
        "--commands", nargs="+", default=list(_LIMITS), choices=list(_LIMITS), help="which"
    )
    options = parser.parse_args()
    print(f"{'':10}{'CPU s':>8}{'wall s':>8}{'yardsticks':>12}{'GB':>7}   limit", flush=True)
    with tempfile.TemporaryDirectory(prefix="sgp-cost-") as name:
        root = Path(name)
        sgp = [sys.executable, "-m", "sgp"]
        for command in options.commands:
            out, source = root / f"{command}-out", root / command
            words = [str(source), "--out", str(out), "--force"]
            if command == "project":
                write_mesh(source.with_suffix(".ply"), round(options.faces))
                source = source.with_suffix(".ply")
                words[0] = str(source)
            elif command == "run":
                write_photographs(source, options.photograph, options.images)
            else:
                write_normals(source, relief(options.megapixels))
                words = ["detail", command, *words]
                if command == "transfer":
                    words.insert(3, str(source))
            if command in ("project", "run"):
                words.insert(0, command)
            cost([*sgp, *words])
            cpu, wall, peak = cost([*sgp, *words])
            copy = copy_s(files_in(source, out), root / "copy")
            most, memory = _LIMITS[command]
            limit = f"{most:g} s {'wall' if command == 'run' else 'CPU'}"
            limit += f", {memory:g} GB" if memory else ""
            print(
                f"{command:10}{cpu:8.2f}{wall:8.1f}{cpu / max(copy, 1e-3):12.0f}{peak:7.2f}"
                f"   {limit}",
                flush=True,
            )


if __name__ == "__main__":
    main()
