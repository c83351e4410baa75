"""``sgp detail transfer --memory``: bands of rows in files give the result of the whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition.files import BandStore
from processing import NormalMap, ShapeFilter, write_normals
from processing.detail import TransferStage
from processing.detail import separation as rows
from tests.sgp.in_bands import check_continued, check_needs_whole
from tests.sgp.test_cli_memory import stop

SOURCE, TARGET = (70, 40), (300, 60)
FILTER = ("--order", 2, "--w", 2)


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, so that tiny maps do not fit."""
    monkeypatch.setattr(rows, "_FIXED", 0)
    monkeypatch.setattr(rows, "_MOST_MARGINS", 0)
    monkeypatch.setattr(rows, "_MOST_ROWS", 70)


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Waves with noise, on the whole frame and in an ellipse."""
    folder = tmp_path_factory.mktemp("maps")
    for name, size in (("cloth", SOURCE), ("vase", TARGET)):
        y, x = np.mgrid[: size[0], : size[1]]
        noise = np.random.default_rng(size[0]).normal(0, 0.1, (2, *size))
        slopes = 0.5 * np.sin(x / 5) + noise[0], 0.4 * np.cos(y / 9) + noise[1]
        mask = ((x - 30) / 29) ** 2 + ((y - 150) / 145) ** 2 < 1 if name == "vase" else None
        vectors = np.dstack([*slopes, np.ones(size)])
        write_normals(folder / name, NormalMap.from_vectors(vectors, mask))
    return [folder / "cloth", folder / "vase"]


def memory(refine: int = 0) -> str:
    """Return a limit for some bands, and for the cuts between copies."""
    stage = TransferStage(refine=refine, shape_filter=ShapeFilter(order=2, w=2))
    least = stage.need(SOURCE, TARGET).least
    return f"{least // 1024 + 120}K"


@pytest.mark.slow
def test_an_interrupted_transfer_continues(sgp, maps, tmp_path, monkeypatch) -> None:
    command = ["detail", "transfer", *maps, *FILTER, "--refine", 1]
    done = check_continued(
        sgp, monkeypatch, tmp_path, command, memory(), ".part-normals",
        other=("--amplitude", 2), reason="amplitude",
    )  # fmt: skip
    assert sum(rows.stop - rows.start for _, rows in done) == SOURCE[0] + 1 + 3 * TARGET[0]


@pytest.mark.slow
def test_a_memory_that_is_too_small(sgp, maps, tmp_path) -> None:
    """The least that works is stated, and it works; what needs the whole is named."""
    command = ["detail", "transfer", *maps, *FILTER, "--tile", "plain", "--out", tmp_path / "out"]
    line = sgp(*command, "--memory", "9K").error_line(2)
    sizes = f"{SOURCE[1]} x {SOURCE[0]} and {TARGET[1]} x {TARGET[0]} pixels"
    assert f"--memory 9K is too small for normal maps of {sizes}: give at least" in line
    stated = line.rsplit(" ", 1)[1]
    assert sgp(*command, "--memory", stated).code == 0
    for option in (("--profile",), ("--mirror",), ("--rotate-deg", 20)):
        words = ["detail", "transfer", *maps, *option, "--at", "30,150", "--force"]
        check_needs_whole(sgp, [*words, "--out", tmp_path / "o"], "300K", option[0])


@pytest.mark.slow
def test_unfinished_maps_are_not_mixed_with_a_transfer_in_memory(
    sgp, maps, tmp_path, monkeypatch
) -> None:
    out = tmp_path / "out"
    command = ["detail", "transfer", *maps, *FILTER, "--out", out]
    with monkeypatch.context() as patched:
        patched.setattr(BandStore, "complete", stop(KeyboardInterrupt(), 2))
        assert sgp(*command, "--memory", memory()).code == 130
    line = sgp(*command, "--profile").error_line(2)
    assert "contains unfinished maps of a command that differs in" in line
    assert sgp(*command, "--profile", "--force").code == 0
    assert (out / "height_profile.png").exists()
    assert not list(out.glob(".part-*"))
