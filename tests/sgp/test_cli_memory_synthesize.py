"""``sgp detail synthesize --memory``: a sheet in files is the sheet in memory."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from acquisition import BandStore
from processing import NormalMap, write_normals
from processing._synthesis import synthesis_memory
from tests.sgp.test_cli_memory import bands, check_equal, stop  # noqa: F401 - a fixture

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


@pytest.mark.parametrize(
    "options",
    [(), ("--tileable", "--seed", 3), ("--rotate", "--crop", "5,5,80,80")],
    ids=["", "for tiling", "turned"],
)
def test_a_sheet_in_files_is_that_in_memory(sgp, hide, tmp_path, bands, options) -> None:  # noqa: F811
    answers = []
    for name, limit in (("whole", "1G"), ("bands", LITTLE)):
        words = ("detail", "synthesize", hide, *SIZE, *options, "--json", "--memory", limit)
        answer = sgp(*words, "--out", tmp_path / name)
        assert answer.code == 0, answer.err
        answers.append(answer.out.replace(f"/{name}/", "/"))
        assert (len(bands) > 5) == (name == "bands")
    assert answers[0] == answers[1]
    check_equal(tmp_path / "bands", tmp_path / "whole")


def test_an_interrupted_sheet_continues(sgp, hide, tmp_path, monkeypatch) -> None:
    """After a full disk and Ctrl-C, also with more memory; what is complete is not done again."""
    command = ["detail", "synthesize", hide, *SIZE, "--out"]
    assert sgp(*command, tmp_path / "whole").code == 0
    done: list[slice] = []
    complete = BandStore.complete

    def noted(store: BandStore, steps: slice) -> None:
        complete(store, steps)
        done.append(steps)

    monkeypatch.setattr(BandStore, "complete", noted)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    for error, code in ((full, 3), (KeyboardInterrupt(), 130), (full, 3)):
        with monkeypatch.context() as patched:
            patched.setattr(BandStore, "complete", stop(error, 1))
            assert sgp(*command, tmp_path / "out", "--memory", LITTLE).code == code
        assert [path.name for path in (tmp_path / "out").iterdir()] == [".part-synthesize"]
    other = ["detail", "synthesize", hide, *SIZE, "--seed", 5, "--out", tmp_path / "out"]
    assert "another seed: repeat that" in sgp(*other, "--memory", LITTLE).error_line(2)
    assert sgp(*command, tmp_path / "out", "--memory", "1G").code == 0
    assert [steps.start for steps in done] == list(range(len(done)))
    check_equal(tmp_path / "out", tmp_path / "whole")


def test_a_memory_that_is_too_small(sgp, hide, tmp_path) -> None:
    """The least that works is stated, and it works; what needs the whole is named."""
    command = ["detail", "synthesize", hide, *SIZE, "--out", tmp_path / "out"]
    line = sgp(*command, "--memory", "9K").error_line(2)
    assert "--memory 9K is too small for a sheet of 110 x 600 pixels: give at least" in line
    stated = line.rsplit(" ", 1)[1]
    assert sgp(*command, "--memory", stated).code == 0
    for options, option, of in (
        (("--onto", hide), "--onto", "a target of 100 x 90"),
        (("--size", "40x40", "--method", "efros-leung"), "--method efros-leung", "a sheet of"),
    ):
        words = ["detail", "synthesize", hide, *options, "--force", "--out", tmp_path / "o"]
        line = sgp(*words, "--memory", "300K").error_line(2)
        assert f"is too small for {of}" in line
        assert f"with {option}, which needs the complete maps: give --memory " in line
        stated = line.split("give --memory ")[1].split(",")[0]
        assert sgp(*words, "--memory", stated).code == 0
