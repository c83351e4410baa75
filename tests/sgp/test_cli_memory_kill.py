"""Commands with ``--memory`` that are killed, and continued by the same command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import Lights, write_lights, write_mask, write_png
from processing import write_normals
from processing.detail import SeparationStage, TransferStage
from processing.superres import SuperResolutionStage
from processing.synthesis import SynthesisStage
from tests.processing.scenes import waves
from tests.sgp.killed import Server, Unfinished, check_killed, server

__all__ = ["server"]

SIZE = (320, 400)
COUNT = 12
# Bands of a few dozen rows, besides interpreter and libraries, which count as nothing then.
MEMORY = "8M"
NO_PROGRAM = """
from processing.surface.blocks import surface_stage
from processing.detail import separation as rows
from processing.recording import pipeline as memory

memory._FIXED = rows._FIXED = surface_stage._FIXED = surface_stage._PROGRAM = 0
"""
# Of normal maps that are enlarged, separated, and transferred to; and of a sheet.
LOW, MAP, CLOTH, SHEET = (1000, 16), (900, 120), (60, 50), (5000, 100)


@pytest.fixture
def options(tmp_path: Path) -> list[str]:
    """Recording and options, for a bumpy ball with noise that fills the frame."""
    (tmp_path / "images").mkdir()
    rng = np.random.default_rng(67)
    y, x = (np.mgrid[: SIZE[0], : SIZE[1]] - 160.0) / 210
    normals = np.stack([x + 0.2 * np.sin(30 * x), -y + 0.2 * np.cos(25 * y), 1 + 0 * x], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    around = np.arange(COUNT) * 2.4
    lights = Lights(directions=np.stack([np.cos(around), np.sin(around), 1 + around / 20], 1))
    write_lights(tmp_path / "lights.json", lights)
    for i, light in enumerate(lights.unit_directions):
        shade = 0.7 * np.clip(normals @ light, 0, 1) + rng.normal(0, 0.003, SIZE)
        pixels = np.rint(np.clip(shade, 0, 1) * 65535).astype(np.uint16)
        write_png(tmp_path / "images" / f"ball.{i:02}.png", pixels)
    write_mask(tmp_path / "images" / "mask.png", x**2 + y**2 < 0.6)
    words = (tmp_path / "images", "--lights", tmp_path / "lights.json", "--memory", MEMORY)
    return [*map(str, words)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stages"),
    [("normals", ()), ("run", ("normals", "detail", "surface"))],
    ids=["normals", "run"],
)
@pytest.mark.parametrize("server", [NO_PROGRAM], indirect=True, ids=[""])
def test_normals(
    server: Server, options: list[str], tmp_path: Path, name: str, stages: tuple[str, ...]
) -> None:
    # A batch repeats a run with --force.
    command = [name, *options, *(["--force"] if stages else []), "--out"]
    found = Unfinished(tmp_path / "out", "normals", SIZE, "albedo", stages)
    check_killed(server, command, found, tmp_path / "whole", kills=6, seed=10)


def write_waves(folder: Path, size: tuple[int, int]) -> None:
    write_normals(folder, waves(size, 68, (0.4, 0.3), (3, 9)))


@pytest.mark.slow
def test_superres(server: Server, tmp_path: Path) -> None:
    write_waves(tmp_path / "low", LOW)
    memory = f"{SuperResolutionStage.of(2, method='bicubic').need(LOW).least // 1024 + 1}K"
    command = ["detail", "superres", str(tmp_path / "low"), "--scale", "2", "--memory", memory]
    found = Unfinished(
        tmp_path / "out", "superres", (2 * LOW[0], 2 * LOW[1], 3), "normals", units=LOW[0], rows=2
    )
    check_killed(server, [*command, "--out"], found, tmp_path / "whole", kills=4, seed=11)


@pytest.mark.slow
def test_separation(server: Server, tmp_path: Path) -> None:
    write_waves(tmp_path / "map", MAP)
    memory = f"{SeparationStage().need(MAP).least // 1024 + 300}K"
    command = ["detail", "separate", str(tmp_path / "map"), "--memory", memory, "--out"]
    found = Unfinished(tmp_path / "out", "detail", (*MAP, 3), "shape", units=2 * MAP[0])
    check_killed(server, command, found, tmp_path / "whole", kills=4, seed=12)


@pytest.mark.slow
def test_transfer(server: Server, tmp_path: Path) -> None:
    write_waves(tmp_path / "cloth", CLOTH)
    write_waves(tmp_path / "map", MAP)
    memory = f"{TransferStage().need(CLOTH, MAP).least // 1024 + 500}K"
    maps = [str(tmp_path / "cloth"), str(tmp_path / "map")]
    command = ["detail", "transfer", *maps, "--refine", "2", "--memory", memory, "--out"]
    begin = CLOTH[0] + 1
    found = Unfinished(
        tmp_path / "out", "normals", (*MAP, 3), "shape", units=begin + 4 * MAP[0], begin=begin,
    )  # fmt: skip
    check_killed(server, command, found, tmp_path / "whole", kills=5, seed=13)


# Sheets count as large: their least memory is more than such a small one needs in memory.
LARGE_SHEETS = """
from processing.synthesis import sheet_synthesis as synthesis_memory

synthesis_memory._SHEET = 10_000
"""


@pytest.mark.slow
@pytest.mark.parametrize("server", [LARGE_SHEETS], indirect=True, ids=[""])
@pytest.mark.parametrize("options", [[], ["--tileable"]], ids=["", "for tiling"])
def test_synthesis(server: Server, tmp_path: Path, options: list[str]) -> None:
    write_waves(tmp_path / "cloth", CLOTH)
    memory = f"{SynthesisStage(SHEET).need(CLOTH).least // 2**20 + 100}M"
    size = f"{SHEET[1]}x{SHEET[0]}"
    words = [str(tmp_path / "cloth"), "--size", size, "--patch", "16", *options]
    command = ["detail", "synthesize", *words, "--memory", memory, "--out"]
    # Strips of 16 rows of patches; for tiling, the last row is a strip of its own.
    alone, patches, bands = bool(options), -(-(SHEET[0] - 4) // 12), -(-SHEET[0] // 512)
    strips = -(-(patches - alone) // 16) + alone
    # Strips, then the share of the cuts, softened bands, the filter, and filtered bands.
    found = Unfinished(
        tmp_path / "out", "synthesize", (*SHEET, 3), "softened", units=strips + 2 + 2 * bands,
        begin=strips + 1, rows=512,
    )  # fmt: skip
    check_killed(server, command, found, tmp_path / "whole", kills=5, seed=14)
