"""``sgp detail synthesize --memory``: a sheet in files is the sheet in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from processing import NormalMap, write_normals
from processing.synthesis import sheet_synthesis as synthesis_memory
from tests.sgp.in_bands import check_continued, check_needs_whole

SIZE = ("--size", "110x600", "--patch", 16)
# More than a strip needs, less than the sheet.
LITTLE = "3500K"


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter, libraries and strips count as little, so that a small sheet does not fit."""
    monkeypatch.setattr(synthesis_memory, "_FIXED", 0)
    monkeypatch.setattr(synthesis_memory, "_FIGURES", 0)
    monkeypatch.setattr(synthesis_memory, "_OF_BAND", 1)
    monkeypatch.setattr(synthesis_memory, "_SHEET", 60)


@pytest.fixture(scope="module")
def hide(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Waves with noise."""
    y, x = np.mgrid[:90, :100]
    noise = np.random.default_rng(7).normal(0, 0.15, (2, *x.shape))
    slopes = 0.5 * np.sin(x / 3) + noise[0], 0.4 * np.cos(y / 5) + noise[1]
    folder = tmp_path_factory.mktemp("hide")
    write_normals(folder, NormalMap.from_vectors(np.dstack([*slopes, np.ones(x.shape)])))
    return folder


@pytest.mark.slow
def test_an_interrupted_sheet_continues(sgp, hide, tmp_path, monkeypatch) -> None:
    command = ["detail", "synthesize", hide, *SIZE]
    done = check_continued(
        sgp, monkeypatch, tmp_path, command, LITTLE, ".part-synthesize",
        other=("--seed", 5), reason="seed",
    )  # fmt: skip
    assert len({(step, units.start) for step, units in done}) == len(done)


def test_a_memory_that_is_too_small(sgp, hide, tmp_path) -> None:
    """The least that works is stated, and it works; what needs the whole is named."""
    command = ["detail", "synthesize", hide, *SIZE, "--out", tmp_path / "out"]
    line = sgp(*command, "--memory", "9K").error_line(2)
    assert "--memory 9K is too small for a sheet of 110 x 600 pixels: give at least" in line
    stated = line.rsplit(" ", 1)[1]
    assert sgp(*command, "--memory", stated).code == 0
    for options, option in (
        (("--onto", hide), "--onto"),
        (("--size", "40x40", "--method", "efros-leung"), "--method efros-leung"),
    ):
        words = ["detail", "synthesize", hide, *options, "--force", "--out", tmp_path / "o"]
        check_needs_whole(sgp, words, "300K", option)
