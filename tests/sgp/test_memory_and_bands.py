"""Memory does not change an answer: files, pictures, records, lines and notices are equal."""

from __future__ import annotations

import io
import json
import re
import shutil
import sys
from collections.abc import Callable
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from acquisition import read_image
from processing.superres import higher_resolution
from sgp.app import build, run

ROOT = Path(__file__).parents[2]
COIN, PAINTED, BOTH = (
    f"../{name} --lights ../{name}/derived/truth/lights.json"
    for name in ("coin", "painted", "both")
)
FEW = "--exclude 3-11"
# Commands that run in memory and at the least memory that they state.
COMMANDS = {
    "normals": f"normals {COIN}",
    "normals by Cauchy": f"normals {COIN} --method cauchy",
    "normals by trimming": f"normals {COIN} --method trimmed --exclude auto",
    "normals by least squares": f"normals {COIN} --method ls --distant --green-out down",
    "normals at a known height": f"normals {COIN} --height-mm 4.5",
    "normals of a mosaic": f"normals {PAINTED}",
    "normals of two exposures": f"normals {BOTH} --mask ../both/derived/truth/mask.png",
    "normals of 3 images": f"normals {COIN} {FEW}",
    "normals of 16-bit images": "normals ../coin-images",
    "normals of a part": "normals ../coin-lp --crop 40,30,200,180",
    "normals of a reduced recording": f"normals {COIN} --downscale 2",
    "run": f"run {COIN} --stl --height-sigma --triangles 900",
    "run of a mosaic": f"run {PAINTED} --discontinuity --filter guided --w 4",
    "run of 3 images": f"run {COIN} {FEW} --distant",
    "run of 16-bit images": "run ../coin-images --distant",
    "separate": "detail separate ../n",
    "separate by box": "detail separate ../n --filter box --order 1 --w 3",
    "separate by guided": "detail separate ../n --filter guided --w 4 --green-out down",
    "separate by bilateral": "detail separate ../n --filter bilateral --w 3",
    "separate a picture": "detail separate ../n/normals.png --green down",
    "transfer": "detail transfer ../cloth ../n",
    "transfer corrected": "detail transfer ../cloth ../n --refine 2 --amplitude -.5",
    "transfer mirrored": "detail transfer ../part ../n --tile mirror --keep-target-detail",
    "transfer repeated": "detail transfer ../part ../n --tile plain --w 3",
    "transfer put": "detail transfer ../part ../n --at=-10,50",
    "synthesize": "detail synthesize ../cloth --size 320x400",
    "synthesize for tiling": "detail synthesize ../cloth --size 320x400 --tileable --seed 3",
    "synthesize turned": "detail synthesize ../part --size 320x400 --rotate --crop 5,5,80,80",
    "superres": "detail superres ../part --scale 2",
    "superres of points": "detail superres ../part --scale 2 --sampling points --pixel-mm .2",
    "superres by bicubic": "detail superres ../part --scale 4 --method bicubic",
    "simulate": "simulate ripples --size 320x256 --led-count 12",
}
# What differs in blocks of rows by less than the error that is stated: heights and their files.
SURFACES = {
    "surface": "surface ../n --stl --mask ../disc.png --albedo ../n/albedo.exr",
    "surface of deviations": "surface ../n --sigma ../n/normal_sigma_deg.exr --pixel-mm .4",
    "surface seen by a camera": "surface ../n --camera ../coin/derived/truth/camera.json",
}
OF_HEIGHTS = {
    f"out/{name}"
    for name in ("height.exr", "height.png", "depth.exr", "normal_residual_deg.exr",
                 "surface.ply", "surface.stl", "surface.json")
} | {"stdout"}  # fmt: skip
# Memory is a parameter, bands are announced, and the first command may compile kernels.
OF_MEMORY = re.compile(r', "memory"(: "\w+")?')
ANNOUNCED = re.compile(r"bands of rows|as a whole|blocks of \d+|compiling kernels")


# The first test also makes the recordings.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def revisions() -> ModuleType:
    """The comparison of two revisions."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
        import compare_revisions

    return compare_revisions


def run_here(words: str, folder: Path) -> tuple[int, str, str]:
    """Run a command in a folder; return exit code, stdout and stderr."""
    out, errors, tokens = io.StringIO(), io.StringIO(), words.split()
    with chdir(folder), redirect_stdout(out), redirect_stderr(errors):
        code = run(build(tokens), tokens)
    return code, out.getvalue(), errors.getvalue()


@pytest.fixture(scope="module")
def top(revisions: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of recordings and normal maps."""
    folder: Path = tmp_path_factory.mktemp("memory") / "top"
    revisions.make_inputs(folder, run_here)
    for words in (
        "normals coin-images --out n",
        "normals cloth-images --out cloth-normals",
        "normals coin-lp --crop 90,60,110,90 --out part",
    ):
        code, _, errors = run_here(words, folder)
        assert code == 0, errors
    (folder / "cloth").rename(folder / "cloth-recording")
    (folder / "cloth-normals").rename(folder / "cloth")
    return folder


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map is too small for several bands otherwise."""
    monkeypatch.setattr(higher_resolution, "TILE_PX", 16)


@pytest.fixture
def outcome(
    sgp: Callable, revisions: ModuleType, top: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str, str, str], dict[str, str]]:
    """Run a command with a memory in a folder; return its files and what it prints."""

    def run(name: str, words: str, memory: str) -> dict[str, str]:
        shutil.rmtree(place := top / name, ignore_errors=True)
        place.mkdir()
        monkeypatch.chdir(place)
        answer = sgp(*words.split(), "--out", "out", "--memory", memory)
        assert answer.code == 0, answer.err
        out, err = (revisions.stable(text) for text in (answer.out, answer.err))
        kept = {**revisions.state_of(place), "stdout": out, "stderr": err}
        return {
            file: "\n".join(
                OF_MEMORY.sub("", line) for line in text.splitlines() if not ANNOUNCED.search(line)
            )
            for file, text in kept.items()
        }

    return run


def least_memory(sgp: Callable, words: str) -> str:
    """Return what the refusal of too little memory says."""
    error = sgp(*words.split(), "--out", "refused", "--memory", "1M").err
    if "rendering" in error:
        return re.search(r"at least (\d+) MB", error)[1] + "M"
    return re.search(r"--memory (\w+)\n", error)[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_bands_give_the_answer_of_the_whole(sgp, revisions, outcome, bands, name) -> None:
    words = COMMANDS[name]
    whole = outcome("whole", words, "64G")
    assert not bands
    banded = outcome("bands", words, least_memory(sgp, words))
    assert len(bands) > 2 or words.startswith("simulate")
    assert revisions.differences(whole, banded) == []


@pytest.mark.parametrize("name", SURFACES)
def test_blocks_give_nearly_the_surface_of_the_whole(sgp, revisions, top, outcome, name) -> None:
    """All but what depends on heights is equal; heights differ by less than is stated."""
    words = SURFACES[name]
    whole = outcome("whole", words, "64G")
    blocks = outcome("blocks", words, least_memory(sgp, words))
    assert whole.keys() == blocks.keys()
    assert {file for file in whole if whole[file] != blocks[file]} <= OF_HEIGHTS
    one, other = (
        json.loads((top / place / "out" / "surface.json").read_text())
        for place in ("whole", "blocks")
    )
    stated = other["metrics"].pop("block_error")
    assert other["metrics"].pop("blocks") >= 2
    assert other["metrics"].pop("block_rounds") < 12
    assert one["metrics"].keys() == other["metrics"].keys()
    for key in ("unit", "vertices", "parts", "curl_deg", "curl_excess"):
        assert other["metrics"].get(key) == one["metrics"].get(key), key
    for key in ("height_range", "normal_residual_deg"):
        assert other["metrics"][key] == pytest.approx(one["metrics"][key], rel=1e-3), key
    heights = [read_image(top / place / "out" / "height.exr") for place in ("whole", "blocks")]
    np.testing.assert_array_equal(*(np.isnan(height) for height in heights))
    assert np.nanmax(np.abs(heights[0] - heights[1])) < max(2 * stated, 5e-4 * np.nanmax(heights))
    for file in OF_HEIGHTS:
        if file.endswith((".ply", ".stl")) and file in whole:
            first, second = (top / place / file for place in ("whole", "blocks"))
            assert first.stat().st_size == second.stat().st_size
