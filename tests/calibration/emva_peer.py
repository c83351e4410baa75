"""The reference package of EMVA 1288, in a process of its own, on images that a test recorded."""

import json
import subprocess
import sys
from pathlib import Path

from acquisition.pixels import write_tiff

FIGURES = (
    "K", "sigma_y_dark", "sigma_d", "u_e_sat", "SNR_max", "DR", "LE_min", "LE_max", "u_I_mean",
    "DSNU1288", "PRNU1288",
)  # fmt: skip

# Version 1.0.2 calls a function that NumPy 2.0 removed.
_PROGRAM = """
import json, sys
import numpy
numpy.asfarray = lambda values: numpy.asarray(values, float)
from emva1288.process.data import Data1288
from emva1288.process.loader import LoadImageData
from emva1288.process.parser import ParseEmvaDescriptorFile
from emva1288.process.results import Results1288
images = LoadImageData(ParseEmvaDescriptorFile(sys.argv[1]).images)
results = Results1288(Data1288(images.data).data)
print(json.dumps({name: float(getattr(results, name)) for name in sys.argv[2:]}))
"""


def reference_figures(folder: Path, bit_depth: int, source) -> dict[str, float]:
    """Return the figures of the reference package; PRNU is in percent there."""
    height, width = source.frames[0].shape
    lines = ["v 4.0", f"n {bit_depth} {width} {height}"]
    groups: dict[tuple[str, float], list] = {}
    for frame in source.frames:
        groups.setdefault((frame.role, frame.exposure_us), []).append(frame)
    for k, ((role, time_us), frames) in enumerate(groups.items()):
        # The number of photons only gives the quantum efficiency, which is not compared.
        head = f"b {time_us * 1e3} {time_us}" if role == "light" else f"d {time_us * 1e3}"
        lines.append(head)
        for r, frame in enumerate(frames):
            name = f"{role}{k:03}_{r:03}.tif"
            write_tiff(folder / name, frame.read())
            lines.append(f"i {name}")
    descriptor = folder / "EMVA1288_Data.txt"
    descriptor.write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-c", _PROGRAM, str(descriptor), *FIGURES]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)
    if done.returncode:
        raise AssertionError(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])
