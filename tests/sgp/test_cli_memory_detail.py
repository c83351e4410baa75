"""``sgp detail ... --memory``: what is computed in bands is what is computed at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import write_png
from processing import ShapeFilter, write_normals
from processing.detail import TransferStage, separation
from processing.maps import normal_map_files
from processing.superres import SuperResolutionStage, higher_resolution
from processing.synthesis import sheet_synthesis
from tests.cases import cases
from tests.processing.scenes import waves
from tests.sgp.in_bands import CTRL_C, FULL_DISK, check_equal, interrupted

RELIEF, LOW, SOURCE, TARGET = (330, 60), (95, 13), (70, 40), (300, 60)
SEPARATE = ["separate", "relief"]
THIN = [*SEPARATE, "--order", 1, "--w", 3]
SUPERRES, BICUBIC = ["superres", "low", "--scale"], ["--method", "bicubic"]
SHEET = ["synthesize", "hide", "--size", "110x600", "--patch", 16]
TRANSFER = ["transfer", "cloth", "vase"]
FILTERED = [*TRANSFER, "--order", 2, "--w", 2]
REFINED = [*FILTERED, "--refine", 1]
slow = pytest.mark.slow


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter, libraries and strips count as little, so that tiny maps do not fit."""
    for module, sizes in {
        separation: {"_FIXED": 0, "_MOST_MARGINS": 0, "_MOST_ROWS": 70},
        higher_resolution: {"_FIXED": 0, "TILE_PX": 16},
        sheet_synthesis: {"_FIXED": 0, "_FIGURES": 0, "_OF_BAND": 1, "_SHEET": 60},
    }.items():
        for name, size in sizes.items():
            monkeypatch.setattr(module, name, size)


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Waves with noise: in an ellipse, with a hole, and on the whole frame."""
    folder = tmp_path_factory.mktemp("maps")
    y, x = np.mgrid[: RELIEF[0], : RELIEF[1]]
    relief, vase = (((x - 30) / 29) ** 2 + ((y - a) / (a - 5)) ** 2 < 1 for a in (160, 150))
    hole = (abs(x - 5) < 2) & (abs(y - 40) < 9)
    for name, made in {
        "relief": waves(RELIEF, 21, (0.5, 0.4), (17, 30), mask=relief),
        "low": waves(LOW, 907, (0.4, 0.3), (3, 5), 0.2, ~hole[: LOW[0], : LOW[1]]),
        "hide": waves((90, 100), 7, (0.5, 0.4), (3, 5), 0.15),
        "cloth": waves(SOURCE, SOURCE[0], (0.5, 0.4), (5, 9)),
        "vase": waves(TARGET, TARGET[0], (0.5, 0.4), (5, 9), mask=vase[: TARGET[0]]),
    }.items():
        write_normals(folder / name, made)
    return folder


@pytest.fixture
def detail(sgp, maps: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Call a command of ``sgp detail`` in the folder of the maps."""
    monkeypatch.chdir(maps)
    return partial(sgp, "detail")


def limit(command: list[Any]) -> str:
    """Return a memory for some bands of a command, which is less than the whole needs."""
    if command[0] == "superres":
        return f"{SuperResolutionStage.of(4).need(LOW).least // 1024 + 1}K"
    if command[0] == "transfer":  # also for the cuts between copies
        stage = TransferStage(shape_filter=ShapeFilter(order=2, w=2))
        return f"{stage.need(SOURCE, TARGET).least // 1024 + 120}K"
    return {"separate": "400K", "synthesize": "3500K"}[command[0]]


@cases(
    ("command", "work", "other", "reason", "units"),
    {
        "separate": (THIN, "detail", [*THIN, "--green", "down"], "green", 2 * RELIEF[0]),
        "superres": pytest.param(
            [*SUPERRES, 4, *BICUBIC], "superres", [*SUPERRES, 2, *BICUBIC], "scale, maps", None,
            marks=slow,
        ),
        "synthesize": pytest.param(
            SHEET, "synthesize", [*SHEET, "--seed", 5], "seed", None, marks=slow
        ),
        "transfer": pytest.param(
            REFINED, "normals", [*REFINED, "--amplitude", 2], "amplitude",
            SOURCE[0] + 1 + 3 * TARGET[0], marks=slow,
        ),
    },
)  # fmt: skip
def test_what_is_interrupted_continues(
    detail, bands, tmp_path, command, work, other, reason, units
) -> None:
    """After a full disk and Ctrl-C, with more memory; what is complete is not done again."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    detail(*command, "--out", whole).ok()
    options = ["--out", out, "--memory", limit(command)]
    for error, code in (FULL_DISK, CTRL_C):
        with interrupted(error, 1):
            answer = detail(*command, *options)
        assert answer.code == code, answer.err
        assert [path.name for path in out.iterdir()] == [f".part-{work}"]
    assert len(bands) == 2
    line = detail(*other, *options).error_line(2)
    assert f"differs in {reason}: repeat that" in line
    # While the files of the result are written.
    with interrupted(FULL_DISK[0], 0, normal_map_files, "write_mask"):
        assert detail(*command, *options).code == 3
    assert len(list(out.iterdir())) > 1
    detail(*command, *options[:-1], "1G").ok()
    named = [(step, row) for step, rows in bands for row in range(rows.start, rows.stop)]
    assert sorted(named) == sorted(set(named))
    assert len({(step, rows.start) for step, rows in bands}) == len(bands) > 2
    assert units in (None, len(named))
    check_equal(out, whole)


@cases(
    ("command", "of", "whole"),
    {
        "separate": (SEPARATE, "a normal map of 60 x 330 pixels", ()),
        "superres": pytest.param(
            [*SUPERRES, 4], "a normal map of 13 x 95 pixels at scale 4", (), marks=slow
        ),
        "synthesize": (
            SHEET,
            "a sheet of 110 x 600 pixels",
            (
                ["synthesize", "hide", "--onto hide"],
                ["synthesize", "hide", "--size", "40x40", "--method efros-leung"],
            ),
        ),
        "transfer": pytest.param(
            [*FILTERED, "--tile", "plain"],
            "normal maps of 40 x 70 and 60 x 300 pixels",
            tuple(
                [*TRANSFER, "--at", "30,150", option]
                for option in ("--profile", "--mirror", "--rotate-deg 20")
            ),
            marks=slow,
        ),
    },
)
def test_a_memory_that_is_too_small(detail, tmp_path, command, of, whole) -> None:
    """The least that works is stated, and it works; what needs the whole is named."""
    words = [*command, "--out", tmp_path / "out", "--memory"]
    line = detail(*words, "9K").error_line(2)
    assert f"--memory 9K is too small for {of}: give at least" in line
    assert not (tmp_path / "out").exists()
    detail(*words, line.rsplit(" ", 1)[1]).ok()
    for *words, option in whole:
        words = [*words, *option.split(), "--force", "--out", tmp_path / "o", "--memory"]
        line = detail(*words, "300K").error_line(2)
        name = option if "method" in option else option.split()[0]
        assert f"with {name}, which needs the complete maps: give --memory " in line
        detail(*words, line.split("give --memory ")[1].split(",")[0]).ok()


def test_a_file_that_is_no_map(detail, tmp_path) -> None:
    """The error is that of the whole, and nothing is left."""
    write_png(tmp_path / "gray.png", np.full((*RELIEF, 3), 90, np.uint8))
    command = ["separate", tmp_path / "gray.png", "--out", tmp_path / "o", "--w", 1]
    other = detail(*command)
    banded = detail(*command, "--memory", "400K")
    assert banded.error_line(banded.code) == other.error_line(other.code)
    assert other.code
    assert not (tmp_path / "o").exists()


def test_a_map_that_is_read_at_once(detail, tmp_path) -> None:
    np.save(tmp_path / "low.npy", np.tile(np.float32([0, 0, 1]), (*LOW, 1)))
    command = ["superres", tmp_path / "low.npy", "--scale", 4, "--out", tmp_path / "out"]
    line = detail(*command, "--memory", limit(command)).error_line(4)
    assert "save it as .exr" in line
    assert not (tmp_path / "out").exists()


@slow
def test_unfinished_maps_are_not_mixed_with_a_transfer_in_memory(detail, tmp_path) -> None:
    out = tmp_path / "out"
    command = [*FILTERED, "--out", out]
    with interrupted(CTRL_C[0], 2):
        assert detail(*command, "--memory", limit(command)).code == 130
    line = detail(*command, "--profile").error_line(2)
    assert "contains unfinished maps of a command that differs in" in line
    detail(*command, "--profile", "--force").ok()
    assert (out / "height_profile.png").exists()
    assert not list(out.glob(".part-*"))
