"""The estimated memory of surfaces against the measured one."""

import os
import subprocess
import sys

import pytest

from processing.surface import SurfaceStage

MEASURE = """
import sys
from pathlib import Path
import numpy as np
from acquisition import CameraModel
from acquisition.files import BandFile
from acquisition.files import BandStore
from processing import NormalMap, integrate
from processing.maps import StoredNormals
from processing.surface import SurfaceStage, integrate_in_blocks

def peak(size, name, rows):
    height, width = size
    noise = np.random.default_rng(4).standard_normal((height, width, 3), np.float32)
    normal_map = NormalMap.from_vectors(0.05 * noise + np.float32([0.1, 0.2, 1]))
    del noise
    mask, folder = normal_map.mask, Path(name)
    folder.mkdir()
    stored = BandFile(folder / "normals.raw", (height, width, 3), np.dtype(np.float32))
    stored[0:height] = normal_map.normals
    K = [[3 * width, 0, width / 2], [0, 3 * width, height / 2], [0, 0, 1]]
    camera = CameraModel(np.array(K, float), width, height, 500) if with_camera else None
    if rows:
        del normal_map
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins here
    before = kilobytes("VmRSS")
    if rows:
        forms = SurfaceStage(with_camera).forms(size)
        with BandStore(folder / "surface", {}, forms) as store:
            given = StoredNormals(stored, mask, (), ())
            integrate_in_blocks(given, store, rows=rows, camera=camera, discontinuity=jumps)
    else:
        integrate(normal_map, camera=camera, discontinuity=jumps)
    return (kilobytes("VmHWM") - before) * 1024

def kilobytes(name):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))

height, width, rows, with_camera, jumps = map(int, sys.argv[1:])
jumps = bool(jumps)
peak((128, 96), "small", min(rows, 32))  # compiles
print(peak((height, width), "large", rows))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="peaks of memory are read from /proc")
@pytest.mark.parametrize("jumps", [False, True], ids=["smooth", "jumps"])
@pytest.mark.parametrize(
    ("size", "rows", "camera"), [((1000, 1000), None, False), ((2236, 2236), 256, True)]
)
def test_estimates_are_above_the_measured_peak(tmp_path, size, rows, camera, jumps):
    # The first process compiles kernels that are in no cache: its memory for that would be reused.
    for each in ((128, 96), size):
        folder = tmp_path / str(each[0])
        folder.mkdir()
        measured = subprocess.run(
            [
                sys.executable,
                "-c",
                MEASURE,
                *(str(int(n or 0)) for n in (*each, rows, camera, jumps)),
            ],
            cwd=folder,
            env={**os.environ, "NUMBA_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=True,
        )
    peak = int(measured.stdout)
    # The allocator keeps up to 12 MB more or less.
    assert peak < SurfaceStage(camera, jumps=jumps).solving(size, rows) < 2 * peak + 12_000_000


def test_estimates_grow_with_what_is_given():
    size, stage = (3000, 4000), SurfaceStage()
    whole = stage.solving(size)
    blocks = [stage.solving(size, rows) for rows in (256, 750, 1500)]
    assert blocks == sorted(blocks)
    assert blocks[-1] < whole
    assert blocks[0] < SurfaceStage(True).solving(size, 256) < whole
    known = [SurfaceStage(True, weighted).solving(size) for weighted in (False, True)]
    assert whole < known[0] < known[1]
    need = stage.need(size)
    assert whole < need.whole
    assert stage.blocks(size, need.least)[1] == need.least < need.whole / 1.5
    assert stage.blocks(size, need.whole)[0] > stage.blocks(size, need.least)[0]
    # A map that fits into one block shares no rows.
    assert stage.solving((64, 4000), 64) == stage.solving((64, 4000), 640)
