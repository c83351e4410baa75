"""``sgp detail transfer --memory``: bands of rows in files give the result of the whole."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from acquisition import BandStore
from processing import NormalMap, ShapeFilter, write_normals
from processing._detail import rows
from processing._detail.transfer_memory import TransferSizes
from tests.sgp.test_cli_memory import bands, check_equal, stop  # noqa: F401 - a fixture

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
    least = TransferSizes(SOURCE, TARGET, ShapeFilter(order=2, w=2), refine).least()
    return f"{least // 1024 + 120}K"


def record(folder: Path) -> dict[str, object]:
    """Return a record without times and the limit."""
    found = json.loads((folder / "normals.json").read_text())
    found["parameters"].pop("memory")
    return {name: found[name] for name in ("parameters", "metrics", "notices", "inputs")}


@pytest.mark.parametrize(
    "options",
    [(), ("--refine", 2), ("--tile", "mirror", "--amplitude", -0.5), ("--at", "-10,50")],
    ids=["cut", "corrected", "mirrored", "put"],
)
def test_bands_give_the_result_of_the_whole(sgp, maps, tmp_path, bands, options) -> None:  # noqa: F811
    answers = []
    for name, limit in (("whole", "1G"), ("bands", memory())):
        words = ("detail", "transfer", *maps, *FILTER, *options, "--json", "--memory", limit)
        answer = sgp(*words, "--out", tmp_path / name)
        assert answer.code == 0, answer.err
        answers.append(answer.out.replace(f"/{name}/", "/"))
        assert (len(bands) > 5) == (name == "bands")
    assert answers[0] == answers[1]
    assert record(tmp_path / "bands") == record(tmp_path / "whole")
    check_equal(tmp_path / "bands", tmp_path / "whole")


def test_an_interrupted_transfer_continues(sgp, maps, tmp_path, monkeypatch) -> None:
    """After a full disk and Ctrl-C, also with more memory; what is complete is not done again."""
    command = ["detail", "transfer", *maps, *FILTER, "--refine", 1, "--out"]
    assert sgp(*command, tmp_path / "whole").code == 0
    done: list[slice] = []
    complete = BandStore.complete

    def noted(store: BandStore, band: slice) -> None:
        complete(store, band)
        done.append(band)

    monkeypatch.setattr(BandStore, "complete", noted)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    for error, code in ((full, 3), (KeyboardInterrupt(), 130), (full, 3)):
        with monkeypatch.context() as patched:
            patched.setattr(BandStore, "complete", stop(error, 3))
            assert sgp(*command, tmp_path / "out", "--memory", memory()).code == code
        assert [path.name for path in (tmp_path / "out").iterdir()] == [".part-transfer"]
    assert len(done) == 9
    other = ["detail", "transfer", *maps, *FILTER, "--refine", 2, "--out", tmp_path / "out"]
    assert "another refine" in sgp(*other, "--memory", memory()).error_line(2)
    assert sgp(*command, tmp_path / "out", "--memory", "1G").code == 0
    named = [row for band in done for row in range(band.start, band.stop)]
    assert sorted(named) == sorted(set(named))
    assert len(named) == SOURCE[0] + 1 + 3 * TARGET[0]
    check_equal(tmp_path / "out", tmp_path / "whole")


def test_a_memory_that_is_too_small(sgp, maps, tmp_path) -> None:
    """The least that works is stated, and it works; what needs the whole is named."""
    command = ["detail", "transfer", *maps, *FILTER, "--tile", "plain", "--out", tmp_path / "out"]
    line = sgp(*command, "--memory", "9K").error_line(2)
    sizes = f"{SOURCE[1]} x {SOURCE[0]} and {TARGET[1]} x {TARGET[0]} pixels"
    assert f"--memory 9K is too small for normal maps of {sizes}: give at least" in line
    stated = line.rsplit(" ", 1)[1]
    assert sgp(*command, "--memory", stated).code == 0
    for option in (("--profile",), ("--mirror",), ("--rotate-deg", 20)):
        words = ["detail", "transfer", *maps, *option, "--at", "30,150", "--force", "--out"]
        words.append(tmp_path / "o")
        line = sgp(*words, "--memory", "300K").error_line(2)
        assert f"with {option[0]}, which needs the complete maps: give --memory " in line
        stated = line.split("give --memory ")[1].split(",")[0]
        assert sgp(*words, "--memory", stated).code == 0
